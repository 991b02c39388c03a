"""What a step costs: K's rods (K 8.2) made to beat; the time outside the sums, and memory.

    python benchmarks/simulation.py [--rods 15] [--nodes 151] [--steps 10]

And how many evaluations the published rod (Olson, Lim & Cortez 2013) needs for a millisecond.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

import mrs


def carpet(rods: int, nodes: int) -> mrs.Simulation:
    """Return rods x rods beating helices, by KITC with theta 0.7 and n = 5."""
    options = {"rows": rods, "columns": rods, "nodes": nodes}
    scene = mrs.scenario.make("cilia_array", options)
    backend = mrs.Backend("kitc", theta=0.7, degree=5)
    return scene.build(backend=backend, integrator=mrs.Integrator("euler", dt=1e-6))


def cost(rods: int, nodes: int, steps: int) -> None:
    """Print a row for a carpet."""
    sim = carpet(rods, nodes)
    sim.step(1e-6)  # compiles, or loads from the cache; estimates the spectral radius
    evaluations, inside = sim.mobility.evaluations, sim.mobility.seconds
    start = time.perf_counter()
    for _ in range(steps):
        sim.step(sim.time + 1e-6)
    seconds = time.perf_counter() - start
    evaluations, inside = sim.mobility.evaluations - evaluations, sim.mobility.seconds - inside
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("| nodes | steps | evaluations | seconds | outside the sums | peak memory (MB) |")
    print("|---|---|---|---|---|---|")
    share = 1.0 - inside / seconds
    print(
        f"| {len(sim.state.positions)} | {steps} | {evaluations} | {seconds:.1f} "
        f"| {100 * share:.1f} % | {memory:.0f} |"
    )


def published_rod(integrator: mrs.Integrator, t_end: float) -> None:
    """Print a row for the rod that coils."""
    scene = mrs.scenario.make("rod_relaxation", {})
    sim = scene.build(backend=mrs.Backend("direct"), integrator=integrator)
    sim.run(t_end)
    per_interval = sim.mobility.evaluations / (t_end / 1e-3)
    error = np.linalg.norm(sim.state.positions - _reference(t_end)) / scene.length
    print(f"| {integrator.name} | {integrator.dt} | {per_interval:.1f} | {error:.1e} |")


def _reference(t_end: float) -> np.ndarray:
    scene = mrs.scenario.make("rod_relaxation", {})
    integrator = mrs.Integrator("rk4", dt=5e-6)
    return (
        scene.build(backend=mrs.Backend("direct"), integrator=integrator).run(t_end).state.positions
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rods", type=int, default=15, help="along x and y, default %(default)s")
    parser.add_argument("--nodes", type=int, default=151, help="of a rod, default %(default)s")
    parser.add_argument("--steps", type=int, default=10, help="default %(default)s")
    options = parser.parse_args()
    cost(options.rods, options.nodes, options.steps)
    print("\n| integrator | dt (s) | evaluations a millisecond | error after 20 ms, in lengths |")
    print("|---|---|---|---|")
    for name, dt in (("euler", 7.0e-6), ("rkc2", 1.0e-3), ("rkc2", 2.0e-3), ("rkc2", "auto")):
        published_rod(mrs.Integrator(name, dt=dt), 0.02)


if __name__ == "__main__":
    main()
