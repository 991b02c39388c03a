"""Ranks that are threads of one process, which start at once."""

import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

_PATIENCE = 120.0  # seconds: another rank may compile


class ThreadComm:
    """The part of a communicator that is used, among the threads of one process."""

    def __init__(self, rank, size, room, barrier):
        self.rank, self.size, self._room, self._barrier = rank, size, room, barrier

    def allgather(self, value):
        self._room[self.rank] = pickle.dumps(value)
        self._barrier.wait(_PATIENCE)
        told = [pickle.loads(each) for each in self._room]
        self._barrier.wait(_PATIENCE)
        return told

    def alltoall(self, values):
        return [told[self.rank] for told in self.allgather(values)]

    def Allreduce(self, own, total):  # noqa: N802
        total[...] = np.sum(self.allgather(own), axis=0)

    def Ialltoallv(self, given, got):  # noqa: N802
        values, sizes = given
        pieces = self.alltoall(np.split(values.ravel(), np.cumsum(sizes)[:-1]))
        assert [piece.size for piece in pieces] == got[1]
        got[0].ravel()[...] = np.concatenate(pieces)
        return self

    def Test(self):  # noqa: N802
        return True

    def Wait(self):  # noqa: N802
        pass

    def Allgatherv(self, own, into):  # noqa: N802
        values, sizes = into
        parts = self.allgather(own)
        assert [part.size for part in parts] == sizes
        values[...] = np.concatenate(parts)

    def Abort(self, status):  # noqa: N802
        raise AssertionError("not among threads")


def call_on_ranks(size, function):
    """Call a function on some ranks, and return what each returns or raises."""
    room, barrier = [None] * size, threading.Barrier(size)

    def one(rank):
        try:
            return function(ThreadComm(rank, size, room, barrier))
        except Exception as error:
            return error

    with ThreadPoolExecutor(size) as pool:
        return list(pool.map(one, range(size)))
