"""Processes that share sums and runs, the ranks of MPI: the only module that knows MPI."""

from __future__ import annotations

import math
import os
import pickle
import sys
import traceback
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import wraps
from threading import Lock
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, runtime_checkable

import numpy as np

_P = ParamSpec("_P")
_R = TypeVar("_R")
_T = TypeVar("_T")
# Of a communicator.
_NEEDED = (
    "rank",
    "size",
    "allgather",
    "alltoall",
    "Allgatherv",
    "Allreduce",
    "Ialltoallv",
    "Abort",
)
# Set by mpirun and by srun.
_LAUNCHED = "PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK"
_SIZES = "PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS"
_TOLD = "told_by_rank"  # attribute of an error that all ranks know of: the rank that it comes from
_BLOCKS = 64  # of an array, whose sums tell it from another


class Delivery:
    """Rows that are on their way.

    Parameters
    ----------
    rows : ndarray
        Where they arrive.
    request : mpi4py.MPI.Request or None
    """

    def __init__(self, rows: np.ndarray, request: Any) -> None:
        self._rows, self._request, self._looking = rows, request, Lock()

    def look(self) -> None:
        """Let messages go on: MPI moves them while it is called. Any thread may, now and then."""
        if self._request and self._looking.acquire(blocking=False):
            self._request.Test()
            self._looking.release()

    def rows(self) -> np.ndarray:
        """Wait for the rows, and return them."""
        if self._request:
            self._request.Wait()
        return self._rows


NOTHING = Delivery(np.empty(0), None)


class OneRank:
    """A process by itself: what `Ranks` does is nothing here.

    Attributes
    ----------
    rank, size : int
        The number of this process, from 0 on, and how many there are.
    received : int
        Bytes that arrays have brought from others so far.
    """

    rank, size, received = 0, 1, 0

    def exchange(self, value: _T) -> list[_T]:
        """Return what each rank gives; an error that one of them tells is raised."""
        return [value]

    def first(self, value: _T) -> _T:
        """Return what rank 0 gives: what depends on it is decided alike."""
        return self.exchange(value)[0]

    def require_same(self, **arrays: np.ndarray | None) -> None:
        """Refuse arrays of 64-bit numbers that differ from rank to rank."""

    def cuts(self, count: int) -> np.ndarray:
        """Return where equal shares of so many begin and end, (size + 1,) int64."""
        return count * np.arange(self.size + 1) // self.size

    def share(self, count: int) -> slice:
        """Return which of so many are this rank's."""
        return slice(*self.cuts(count)[self.rank : self.rank + 2].tolist())

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows of all ranks, (n, ...) numbers of each, one after the other."""
        return rows

    def add_up(self, numbers: np.ndarray) -> np.ndarray:
        """Return the sum over all ranks of an array."""
        return numbers

    def deliver(self, rows: np.ndarray, sent: list[int]) -> tuple[np.ndarray, list[int]]:
        """Give each rank so many of the rows; return those that all give, and of whom how many."""
        return rows, sent

    def post(self, rows: np.ndarray, sent: list[int], got: list[int]) -> Delivery:
        """Begin to `deliver`, where each rank knows how many rows it gets from whom."""
        return Delivery(rows, None)

    @contextmanager
    def together(self) -> Iterator[None]:
        """Do what is inside on all ranks, or raise on all of them the error of one."""
        yield

    def lead(self, helper: object, action: Callable[[], _T]) -> _T:
        """Let rank 0 do something, such as to write files, and return its result on all ranks.

        The others take part in the `joint` methods of `helper` that it calls meanwhile.
        """
        return action()

    @contextmanager
    def call(self, name: str, arguments: tuple[Any, ...]) -> Iterator[None]:
        """Let the others, if rank 0 leads, make the same call of a `joint` method."""
        yield

    def abort(self, status: int) -> None:
        """End all ranks at once, if others may wait for this one."""


class Ranks(OneRank):
    """The processes of a communicator, which all make the same calls.

    A rank that fails tells so where it leaves `together`. The others hear of it at their next
    exchange, and raise the same error.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.rank, self.size = comm.rank, comm.size
        self._leads = False
        _end_all_on_errors(comm)

    def __deepcopy__(self, memo: dict[int, Any]) -> Ranks:
        return self

    def __reduce__(self) -> Any:
        raise TypeError(
            "what is shared by ranks (comm=...) cannot be pickled: make it where it is needed"
        )

    def exchange(self, value: _T) -> list[_T]:
        """Return what each rank gives; an error that one of them tells is raised."""
        return self._meet(value, None)

    def require_same(self, **arrays: np.ndarray | None) -> None:
        """Refuse arrays of 64-bit numbers that differ from rank to rank."""
        told = self.exchange({name: _fingerprint(array) for name, array in arrays.items()})
        for rank, theirs in enumerate(told):
            for name, fingerprint in theirs.items():
                if fingerprint != told[0].get(name):
                    error = ValueError(
                        f"{name} must be the same on all ranks, got others on rank {rank} than on "
                        "rank 0 (random numbers without a seed, or processors of two kinds?)"
                    )
                    raise _known_to_all(error, 0)

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows of all ranks, (n, ...) numbers of each, one after the other."""
        counts = self.exchange(len(rows))  # hears of errors as well
        together = np.empty((sum(counts), *rows.shape[1:]), rows.dtype)
        sizes = [count * math.prod(rows.shape[1:]) for count in counts]
        self._comm.Allgatherv(np.ascontiguousarray(rows), (together, sizes))
        self.received += together.nbytes - rows.nbytes
        return together

    def add_up(self, numbers: np.ndarray) -> np.ndarray:
        """Return the sum over all ranks of an array."""
        self.exchange(None)  # hears of errors
        total = np.empty_like(numbers)
        self._comm.Allreduce(np.ascontiguousarray(numbers), total)
        self.received += total.nbytes
        return total

    def deliver(self, rows: np.ndarray, sent: list[int]) -> tuple[np.ndarray, list[int]]:
        """Give each rank so many of the rows; return those that all give, and of whom how many."""
        self.exchange(None)  # hears of errors
        got = self._comm.alltoall(sent)
        return self.post(rows, sent, got).rows(), got

    def post(self, rows: np.ndarray, sent: list[int], got: list[int]) -> Delivery:
        """Begin to `deliver`, where each rank knows how many rows it gets from whom."""
        self.exchange(None)  # hears of errors
        one = math.prod(rows.shape[1:])
        arrive = np.empty((sum(got), *rows.shape[1:]), rows.dtype)
        sizes = [one * count for count in sent], [one * count for count in got]
        given = np.ascontiguousarray(rows), sizes[0]
        request = self._comm.Ialltoallv(given, (arrive, sizes[1]))
        self.received += (sum(sizes[1]) - sizes[1][self.rank]) * rows.itemsize
        return Delivery(arrive, request)

    @contextmanager
    def together(self) -> Iterator[None]:
        """Do what is inside on all ranks, or raise on all of them the error of one."""
        try:
            yield
        except BaseException as error:
            if not hasattr(error, _TOLD):
                self._meet(None, error)
            raise
        self.exchange(None)

    def lead(self, helper: object, action: Callable[[], _T]) -> _T:
        """Let rank 0 do something, and return its result on all ranks; the others help."""
        if self.rank:
            nothing: Any = None
            while (call := self.first(nothing)) is not None:
                name, arguments = call
                with suppress(Exception), self.together():  # rank 0 has it too, and may go on
                    getattr(helper, name)(*arguments)
            return self.first(nothing)
        self._leads = True
        try:
            result = action()
        except BaseException as error:
            self._meet(None, error)
            raise
        finally:
            self._leads = False
        self.first(None)
        self.first(result)
        return result

    @contextmanager
    def call(self, name: str, arguments: tuple[Any, ...]) -> Iterator[None]:
        """Let the others, if this rank leads, make the same call of a `joint` method."""
        if not self._leads:
            yield
            return
        self._leads = False
        try:
            self.first((name, arguments))
            with self.together():
                yield
        finally:
            self._leads = True

    def abort(self, status: int) -> None:
        """End all ranks at once."""
        self._comm.Abort(status)

    def _meet(self, value: Any, error: BaseException | None) -> list[Any]:
        try:
            told = self._comm.allgather((value, error and _packed(error)))
        except Exception as lost:  # of MPI: nothing can be told any more
            raise _known_to_all(lost, self.rank) from None
        failed = [rank for rank, (_, packed) in enumerate(told) if packed is not None]
        if not failed:
            return [value for value, _ in told]
        if failed[0] == self.rank:
            assert error is not None
            raise _known_to_all(error, self.rank)
        content, trace = told[failed[0]][1]
        cause = RemoteError(f"on rank {failed[0]}:\n{trace}")
        raise _known_to_all(pickle.loads(content), failed[0]) from cause


class RemoteError(Exception):
    """Shows where another rank has failed."""


def world() -> Any:
    """Return the communicator of all ranks that a launcher of MPI has started, None for one alone.

    Raises
    ------
    ImportError
        If there are others, and no mpi4py.
    """
    launched = any(name in os.environ for name in _LAUNCHED)
    if not launched or any(os.environ.get(name) == "1" for name in _SIZES):
        return None
    try:
        from mpi4py import MPI
    except ImportError:
        raise ImportError(
            "mpi4py is missing, without which each of the processes would do all of the work: "
            "pip install mpi4py"
        ) from None
    return MPI.COMM_WORLD


def ranks_of(comm: Any) -> OneRank:
    """Return the ranks of a communicator of mpi4py, or this process by itself for None.

    Raises
    ------
    TypeError
        If it is no communicator.
    """
    if comm is None:
        return OneRank()
    if not all(hasattr(comm, name) for name in _NEEDED):
        raise TypeError(
            f"comm must be a communicator of mpi4py such as MPI.COMM_WORLD, or None, got {comm!r}"
        )
    return OneRank() if comm.size == 1 else Ranks(comm)


@runtime_checkable
class Shared(Protocol):
    """What ranks share."""

    ranks: OneRank


_S = TypeVar("_S", bound=Shared)


def in_step(method: Callable[Concatenate[_S, _P], _R]) -> Callable[Concatenate[_S, _P], _R]:
    """Let a method that all ranks call end alike on all of them."""

    @wraps(method)
    def with_others(self: _S, /, *arguments: _P.args, **options: _P.kwargs) -> _R:
        if self.ranks.size == 1:  # without a context: it would be 1 % of a small sum
            return method(self, *arguments, **options)
        with self.ranks.together():
            return method(self, *arguments, **options)

    return with_others


def joint(method: Callable[Concatenate[_S, _P], _R]) -> Callable[Concatenate[_S, _P], _R]:
    """Let a method be called by all ranks, or by rank 0 where it leads: the others take part."""

    @wraps(method)
    def with_others(self: _S, /, *arguments: _P.args, **options: _P.kwargs) -> _R:
        if self.ranks.size == 1:
            return method(self, *arguments, **options)
        with self.ranks.call(method.__name__, arguments):
            return method(self, *arguments, **options)

    return with_others


def _known_to_all(error: BaseException, rank: int) -> BaseException:
    setattr(error, _TOLD, rank)
    return error


def _packed(error: BaseException) -> tuple[bytes, str]:
    """Return an error as bytes that other ranks can read, and its traceback."""
    trace = "".join(traceback.format_tb(error.__traceback__))
    try:
        content = pickle.dumps(error)
        pickle.loads(content)
    except Exception:  # of a class that cannot be pickled
        content = pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return content, trace


def _fingerprint(array: np.ndarray | None) -> tuple[tuple[int, ...], int]:
    """Return a shape, and a number that differs for other numbers or another order of them."""
    if array is None:
        return (), 0
    words = np.ascontiguousarray(array).view(np.uint64).ravel()
    if not len(words):
        return array.shape, 0
    blocks = np.add.reduceat(words, np.arange(0, len(words), -(-len(words) // _BLOCKS)))
    return array.shape, zlib.crc32(blocks.tobytes())


def _end_all_on_errors(comm: Any) -> None:
    """Let an error that ends the script of one rank end all: they would wait for it for ever."""
    if not isinstance(sys.excepthook, _Hook):
        sys.excepthook = _Hook(comm, sys.excepthook)


class _Hook:
    """Shows an error that ends a script, and ends the other ranks.

    One that all ranks know of ends each of them, and is shown by rank 0 alone.
    """

    def __init__(self, comm: Any, show: Any) -> None:
        self._comm, self._show = comm, show

    def __call__(
        self, kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        by_hand = type(error) is KeyboardInterrupt  # reached each rank by itself, anywhere
        if self._comm.rank == 0 or not (by_hand or hasattr(error, _TOLD)):
            self._show(kind, error, trace)
            sys.stderr.flush()
        if by_hand or not hasattr(error, _TOLD):
            self._comm.Abort(1)
