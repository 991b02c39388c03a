"""Random forces in a cube: one sum by each treecode, its time and its error.

python benchmarks/random_forces.py [--points 100000]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import treecode as tc


def main() -> None:
    parser = argparse.ArgumentParser(description="Sum random forces in a cube by each treecode.")
    parser.add_argument("--points", type=int, default=100_000, help="default %(default)s")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    points, forces = rng.random((options.points, 3)), rng.standard_normal((options.points, 3))
    kernel = tc.RegularizedStokeslet(epsilon=0.01)
    print(f"{options.points} regularized Stokeslets, epsilon {kernel.epsilon}")
    print("backend   seconds   error (sampled)   pairs per target")
    for backend, degree in (("kitc", 7), ("taylor", 10)):
        plan = tc.Plan(kernel, backend, theta=0.6, degree=degree)
        plan.set_points(points[:1000]).execute(forces[:1000])  # compiles, or loads from the cache
        start = time.perf_counter()
        plan.set_points(points).execute(forces)
        seconds = time.perf_counter() - start
        info = plan.info()
        pairs = (info["near_pairs"] + info["far_pairs"]) / options.points
        error = plan.estimate_error(forces)
        print(f"{backend:8s} {seconds:8.2f}   {error:15.1e}   {pairs:16.0f}")


if __name__ == "__main__":
    main()
