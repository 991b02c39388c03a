"""One sum on one rank of MPI and on several, in turns: `on_ranks` starts this program by mpirun."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import numpy as np

from benchmarks.machine import mpirun
from benchmarks.rows import Row
from benchmarks.sums import REPEATS, Sum
from treecode.ranks import world

_PAUSE = 0.001  # seconds between looks at a message, by a rank that shall not keep a core busy


def on_ranks(ranks: int, **case: object) -> Row:
    """Measure on one rank and on several, of one thread each, in turns."""
    command = [mpirun() or "mpirun", "-n", str(ranks), sys.executable, "-m", __name__]
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, json.dumps(case)], env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    return dict(json.loads(done.stdout))


def main() -> None:
    """Measure the case that the command line has as JSON; rank 0 prints the row."""
    comm = world()
    case = json.loads(sys.argv[1])
    alone, shared = Sum(**case), Sum(**case, comm=comm)
    for sum_ in (alone, shared):  # no rank compiles while another one is timed
        sum_.lap()
    laps = []
    for _ in range(REPEATS):
        one = sum(alone.lap()) if comm.rank == 0 else 0.0
        ready = comm.Ibarrier()
        while not ready.Test():
            time.sleep(_PAUSE)
        two = sum(shared.lap())
        seconds = shared.plan.info()["seconds"]
        laps.append([one, two, seconds["waiting"], seconds["communication"]])
    if comm.rank:
        return
    one, two, waiting, communication = np.median(laps, axis=0).tolist()
    times = np.array(laps)
    row = {
        "seconds": one,
        "seconds2": two,
        "efficiency": float(np.median(times[:, 0] / times[:, 1])) / comm.size,
        "waiting": waiting / two,
        "communication": communication / two,
        "received": shared.plan.info()["received_bytes"],
        "repeats": len(laps),
        "extrapolated": False,
        **shared.row(),
    }
    print(json.dumps(row))


if __name__ == "__main__":
    main()
