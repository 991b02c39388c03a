"""Errors of time steps beside the tolerance, of rods drawn at random.

    python -m benchmarks.scenes_at_random 30

Rods differ in number, shape, spacing, moduli, blobs, beats, bases; half of the scenes are over a
wall. The error is the largest distance of a node from its place in a run of rkc2 at a tolerance a
hundred times smaller, in lengths of the rod.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import mrs
from benchmarks.methods import DIRECT

_END = 0.3  # periods of the beat
_FINER = 0.01  # tolerance of the reference


def drawn(seed: int) -> tuple[mrs.Fluid, dict[str, Any], float]:
    """Return the fluid, the arguments of the rods, and the tolerance of a scene."""
    rng = np.random.default_rng(seed)
    count, nodes = int(rng.integers(1, 5)), int(rng.integers(12, 31))
    length = 10.0 ** rng.uniform(-1.0, 1.0)
    spacing = length / (nodes - 1)
    epsilon = spacing * rng.uniform(1.5, 4.0)
    line = mrs.geometry.helix(length * rng.uniform(0.02, 0.15), length, length, nodes)
    apart = max(rng.uniform(0.2, 1.0) * length, 0.5 * epsilon)
    origins = mrs.geometry.grid((count, 1), apart) + np.array([0.0, 0.0, 0.1 * length])
    bending = length**4 * 10.0 ** rng.uniform(-1.0, 1.5)
    shearing = bending / length**2 * 10.0 ** rng.uniform(1.0, 3.0)
    rods = {
        "centerlines": mrs.geometry.array(line, origins),
        "bending": bending,
        "twisting": bending * rng.uniform(0.5, 2.0),
        "shearing": shearing,
        "stretching": shearing * rng.uniform(1.0, 3.0),
        "beat": mrs.TravellingWave((rng.uniform(0.5, 4.0) / length, 0.0, 0.0), length, 1.0),
        "delay": rng.uniform(0.0, 1.0, count),
        "base": "clamped" if rng.random() < 0.7 else "free",
    }
    where = {"boundary": mrs.Wall()} if rng.random() < 0.5 else {}
    return mrs.Fluid(1.0, epsilon, **where), rods, 10.0 ** rng.uniform(-4.0, -2.5)


def run(seed: int, integrator: mrs.Integrator) -> mrs.Simulation:
    """Return a scene at its end."""
    fluid, rods, _ = drawn(seed)
    sim = mrs.Simulation(fluid, [mrs.Rods(**rods)], backend=DIRECT, integrator=integrator)
    return sim.run(_END)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, help="how many scenes")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    options = parser.parse_args()
    ratios = []
    for seed in range(options.first, options.first + options.count):
        tolerance = drawn(seed)[2]
        start = time.perf_counter()
        sim = run(seed, mrs.Integrator(tolerance=tolerance))
        seconds = time.perf_counter() - start
        exact = run(seed, mrs.Integrator("rkc2", tolerance=_FINER * tolerance))
        apart = np.linalg.norm(sim.state.positions - exact.state.positions, axis=1)
        ratios.append(apart.max() / sim.bodies[0].length_scale / tolerance)
        print(
            f"seed {seed}: tolerance {tolerance:.1e}, error {ratios[-1] * tolerance:.1e}, ratio "
            f"{ratios[-1]:.2f}; {sim.stepper.steps} steps, {sim.scene.evaluations} sums, reference "
            f"{exact.scene.evaluations}; {sim.stepper.method.name}, {seconds:.1f} s",
            flush=True,
        )
    print(f"{np.mean(np.array(ratios) <= 1.0):.0%} within tolerance, largest {max(ratios):.2f}")


if __name__ == "__main__":
    main()
