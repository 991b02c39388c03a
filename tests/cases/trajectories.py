"""Trajectories with numbers that are known: rods, swimmers and tracers."""

import numpy as np

from mrs.output import vtkhdf
from mrs.output.topology import Topology

RODS = Topology(np.empty(0, int), [np.array([0, 1, 2, 3, 0]), np.arange(4, 9), np.arange(9, 12)])
SWIMMERS = Topology(np.arange(6), [np.array([i, i + 3]) for i in range(3)])
TRACERS = Topology(np.arange(5), [])


def rods_frame(i):
    """Return points and the arrays that vary, at points and at cells, of frame i."""
    rng = np.random.default_rng(i)
    at_points = {"velocity": rng.standard_normal((12, 3)), "tension": rng.random(12)}
    return rng.random((12, 3)), at_points, {"bending_energy": rng.random(3)}


def write_rods(path, frames, start=0):
    """Write the frames from `start` on; begin the file if it is not there."""
    if not path.exists():
        constant = {"radius": np.linspace(0.1, 0.2, 12)}, {"rod_id": np.arange(3)}
        vtkhdf.create(path, RODS, *constant, {"kind": "rods", "epsilon": 0.1, "tags": ["a", "b"]})
    for i in range(start, frames):
        vtkhdf.append(path, 0.1 * i, *rods_frame(i))


def write_run(directory, frames=3):
    """Write one body of each kind."""
    write_rods(directory / "rods.vtkhdf", frames)
    radius = {"radius": np.full(6, 0.1)}
    vtkhdf.create(directory / "swimmers.vtkhdf", SWIMMERS, radius, {}, {"kind": "swimmers"})
    vtkhdf.create(directory / "tracers.vtkhdf", TRACERS, meta={"kind": "tracers"})
    for i in range(frames):
        rng = np.random.default_rng(i)
        arrays = {"orientation": rng.random((6, 3)), "velocity": rng.random((6, 3))}
        energy = {"energy": rng.random(9)}
        vtkhdf.append(directory / "swimmers.vtkhdf", 0.1 * i, rng.random((6, 3)), arrays, energy)
        vtkhdf.append(directory / "tracers.vtkhdf", 0.1 * i, rng.random((5, 3)))


def same(left, right):
    """Assert that there are the same arrays under the same names."""
    assert set(left) == set(right)
    for name, array in left.items():
        np.testing.assert_array_equal(array, right[name], err_msg=name)
