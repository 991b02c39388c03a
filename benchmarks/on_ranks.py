"""Measurements on ranks of MPI, of one thread each: `on_ranks` starts this program by mpirun."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import treecode as tc
from benchmarks import point_sets
from benchmarks.machine import mpirun
from benchmarks.methods import FMM
from benchmarks.rows import Row
from benchmarks.sums import FEW, TURNS, Sum
from treecode.methods.fmm.level import CLASSES
from treecode.ranks import ranks_of, world

_LEAST, _MOST = 3, 7  # turns of some ranks and of all; more than the least for a minute only
_PAUSE = 0.001  # seconds between looks at a message, by a rank that shall not keep a core busy
_SHORT, _LONG = 8, 1 << 24  # bytes of a message
_MESSAGES = {_SHORT: 1000, _LONG: 30}  # that go there and back
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes, of `ru_maxrss`


def on_ranks(ranks: int, task: str = "in_turns", **case: object) -> Row:
    """Start so many ranks, and return the row of their task.

    Parameters
    ----------
    ranks : int
    task : {"in_turns", "rank_memory", "messages"}, optional
        One of the functions below.
    **case
        Its options.
    """
    command = [mpirun() or "mpirun", "-n", str(ranks), sys.executable, "-m", __name__]
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    command += [task, json.dumps(case)]
    written = ""
    for _ in range(1 + (task == rank_memory.__name__)):  # it needs filled caches on disk
        written = subprocess.run(
            command, env=environment, check=True, stdout=subprocess.PIPE, text=True
        ).stdout
    return dict(json.loads(written))


def in_turns(comm: Any, fewer: int = 1, weak: bool = False, **case: Any) -> Row:
    """Measure a sum on some of the ranks and on all, in turns.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    fewer : int, optional
        How many are some.
    weak : bool, optional
        Some ranks have a sum of as many points a rank as all have; of the same sum otherwise.
    **case
        Of `sums.Sum`, for all ranks.
    """
    few = comm.Split(comm.rank >= fewer)
    alone, shared = None, Sum(**case, comm=comm)
    if comm.rank < fewer:
        less = case | ({"size": case["size"] * fewer // comm.size} if weak else {})
        less |= {"comm": few} if fewer > 1 else {"distributed": False}
        alone = Sum(**less)
    notes: list[dict[str, float]] = []

    def turn() -> list[float]:
        one = _lap(alone) if alone else {}
        _wait_quietly(comm)
        two = _lap(shared)
        notes.append({**one, **{f"{name}2": value for name, value in two.items()}})
        return list(comm.bcast([notes[-1].get("seconds"), notes[-1]["seconds2"]]))

    turn()  # samples its error, and no rank compiles while another one is timed
    notes.clear()
    start, times = time.monotonic(), []
    while len(times) < _LEAST or (
        comm.bcast(time.monotonic() < start + TURNS) and len(times) < _MOST
    ):
        times.append(turn())
    one, two = np.array(times).T
    shared.collect()
    if alone is None or comm.rank:
        return {}
    row: Row = {name: float(np.median([note[name] for note in notes])) for name in notes[0]}
    info = shared.plan.info()
    return {
        **row,
        "efficiency": float(np.median(one / two)) * (1.0 if weak else fewer / comm.size),
        "n1": len(alone.problem.points),
        "received": info.get("received_bytes", 0) / shared.share,
        "repeats": len(notes),
        "extrapolated": shared.share < 1.0,
        **(_sizes(alone) if fewer == 1 else {}),
        **shared.row(),
    }


def _lap(run: Sum) -> dict[str, float]:
    """Return the seconds of a lap, and of its stages, at all targets."""
    setting, summing = run.lap()
    seconds = run.plan.info()["seconds"]
    return {
        "seconds": setting + summing / run.share,
        "tree": setting,
        "upward": seconds.get("weights", 0.0) + seconds.get("upward", 0.0),
        "translations": seconds.get("translations", 0.0),
        "waiting": seconds.get("waiting", 0.0) / run.share,
        "communication": seconds.get("communication", 0.0) / run.share,
    }


def _wait_quietly(comm: Any) -> None:
    """Wait for all ranks without keeping a core busy."""
    ready = comm.Ibarrier()
    while not ready.Test():
        time.sleep(_PAUSE)


def _sizes(run: Sum) -> Row:
    """Return what ranks would tell each other of a sum on one: clusters, and bytes."""
    made, kernel = run.plan._sum, run.problem.kernel
    if run.backend == FMM:
        counts, item = np.diff(made._tree.first), np.dtype(made._operators.dtype).itemsize
        levels = made._operators.levels.items()
        expansions = sum(CLASSES * item * o.rank * int(counts[level]) for level, o in levels)
    else:  # an array of clusters, weights and terms is the only one of three axes
        expansions = sum(array.nbytes for array in made._expansion if np.ndim(array) == 3)
    return {
        "clusters": run.plan.info()["clusters"],
        "expansion_bytes": expansions,
        "value_bytes": 8 * kernel.value_size,
        "weight_bytes": 8 * kernel.weight_size,
    }


def rank_memory(comm: Any, size: int, epsilon: float, **options: Any) -> Row:
    """Measure by how much a sum raises the largest memory of a rank that the system has seen.

    K example 1: each rank draws organisms of its own, and never has those of the others. What
    compilers and the building of operators take would hide it: both have been left on disk before.
    """
    ranks = ranks_of(comm)
    plan = tc.Plan(tc.RegularizedStokeslet(epsilon), comm=comm, **options)
    few, forces = point_sets.organisms(FEW, epsilon, ranks.rank, octant=True)
    plan.set_points(few).execute(forces)  # loads code
    before = _largest_memory()
    points, forces = point_sets.organisms(size // ranks.size, epsilon, ranks.rank, octant=True)
    plan.set_points(points).execute(forces)
    each = ranks.exchange(_largest_memory() - before)
    return {"n": size, "bytes": max(each), "error": None}


def _largest_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT


def messages(comm: Any) -> Row:
    """Measure latency (seconds) and bandwidth (bytes a second) between two ranks."""
    seconds = {}
    for size, count in _MESSAGES.items():
        buffer = np.zeros(size, np.uint8)
        times = []
        for _ in range(count):
            start = time.perf_counter()
            if comm.rank == 0:
                comm.Send(buffer, 1)
                comm.Recv(buffer, 1)
            else:
                comm.Recv(buffer, 0)
                comm.Send(buffer, 0)
            times.append(0.5 * (time.perf_counter() - start))
        seconds[size] = float(np.median(times))
    return {
        "latency": seconds[_SHORT],
        "bandwidth": (_LONG - _SHORT) / (seconds[_LONG] - seconds[_SHORT]),
    }


TASKS: dict[str, Callable[..., Row]] = {
    task.__name__: task for task in (in_turns, rank_memory, messages)
}


def main() -> None:
    """Do what the command line says: a task, and its options as JSON; rank 0 prints the row."""
    comm = world()
    row = TASKS[sys.argv[1]](comm, **json.loads(sys.argv[2]))
    if ranks_of(comm).rank == 0:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
