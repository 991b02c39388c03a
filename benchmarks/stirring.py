"""Pushers and pullers that stir a periodic box: how far tracers get, and whether bodies cluster.

    python -m benchmarks.stirring [--count 2000] [--time 20] [--seeds 3] [--output FILE]

Boxes are as dense as the scenario `swimmer_suspension`, with as many tracers as swimmers. Sums are
within 1e-3, steps within 1e-2 of a swimmer's length: statistics need no more. Runs are kept in
outputs/stirring: what was stopped goes on at the next call. Errors are standard errors of the mean
over seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mrs
from benchmarks.machine import machine_today, publish
from mrs import markdown
from mrs import observables as obs
from mrs.run import scenario_files

STROKES = "pusher", "puller"
DENSITY = 1000 / 12.0**3  # swimmers in a cubic length
TUMBLE_RATE = 0.2  # those that go straight on meet the same tracers again, once round the box
FRAMES = 100
SHOWN = 1, 3, 6, 12, 25, 50  # lags in the table, in frames
LATE = slice(25, 51)  # lags from a quarter of a run to a half, which many times begin
PARTS = 4  # of an edge of the box, where bodies are counted


class Stirred(NamedTuple):
    """Numbers of one run."""

    msd: np.ndarray
    """Of tracers, over all times in the run, by lag in frames."""
    exponent: float
    """Of its growth at late lags."""
    diffusivity: float
    tracer_variance: float
    swimmer_variance: float
    """Of the counts in parts of the box over their mean, a mean over the second half of the run."""
    seconds: float


def edge(count: int) -> float:
    """Return the edge of the box of some swimmers."""
    return float((count / DENSITY) ** (1 / 3))


def run(directory: Path, count: int, time: float, stroke: str, seed: int) -> None:
    """Make a run, or go on with it."""
    options = {
        "count": count,
        "tracers": count,
        "size": edge(count),
        "stroke": stroke,
        "seed": seed,
        "tumble_rate": TUMBLE_RATE,
        "t_end": time,
        "interval": time / FRAMES,
        "backend": {"tolerance": 1e-3},
        "integrator": {"tolerance": 1e-2},
    }
    sim = scenario_files.make("swimmer_suspension", options).simulation(directory)
    if (directory / "checkpoint.h5").exists():
        mrs.restart(sim)
    if sim.time < time:
        sim.run(time)


def measured(directory: Path) -> Stirred:
    """Return the numbers of a finished run."""
    tracers, swimmers = (obs.tracks(directory, body) for body in ("tracers", "swimmers"))
    lags = tracers.times - tracers.times[0]
    msd = obs.mean_square_displacement(tracers.times, tracers.positions)
    late = lags[LATE], msd[LATE]
    return Stirred(
        msd,
        obs.growth_exponent(*late),
        obs.diffusivity(*late),
        _variance(tracers),
        _variance(swimmers),
        _seconds(directory),
    )


def _variance(tracks: obs.Tracks) -> float:
    """Return the variance of the counts in parts of the box over their mean; 1 at random places."""
    assert tracks.cell is not None
    places = tracks.positions[FRAMES // 2 :] @ np.linalg.inv(tracks.cell)
    part = np.floor(PARTS * (places - np.floor(places))).astype(int) @ PARTS ** np.arange(3)
    counts = [np.bincount(frame, minlength=PARTS**3) for frame in part]
    return float(np.mean([count.var(ddof=1) / count.mean() for count in counts]))


def _seconds(directory: Path) -> float:
    """Return the real time of a run, whose clock begins anew when it goes on."""
    with (directory / "log.csv").open() as file:
        column = file.readline().split(",").index("wall")
        wall = np.loadtxt(file, delimiter=",", usecols=column)
    steps = np.diff(wall, prepend=0.0)
    return float(np.where(steps < 0.0, wall, steps).sum())


def told(values: Sequence[float]) -> str:
    """Return the mean over seeds with its standard error."""
    if len(values) == 1:
        return f"{values[0]:.4g}"
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values):.4g} +- {error:.1g}"


def displacements(runs: dict[str, list[Stirred]], interval: float) -> Iterator[str]:
    """Yield the lines of a table: the mean square displacement of tracers by lag."""

    def line(lag: int) -> list[str]:
        values = (told([stirred.msd[lag] for stirred in runs[stroke]]) for stroke in STROKES)
        return [f"{lag * interval:.4g}", *values]

    return markdown.table(["lag", *(f"{stroke}s" for stroke in STROKES)], map(line, SHOWN))


def summary(runs: dict[str, list[Stirred]]) -> Iterator[str]:
    """Yield the lines of a table: the other numbers."""
    meanings = {
        "exponent": "exponent of growth, late",
        "diffusivity": "diffusivity of tracers",
        "tracer_variance": "variance of counts of tracers / mean",
        "swimmer_variance": "variance of counts of swimmers / mean",
        "seconds": "seconds of a run",
    }

    def line(name: str) -> list[str]:
        values = (told([getattr(one, name) for one in runs[stroke]]) for stroke in STROKES)
        return [meanings[name], *values]

    return markdown.table(["number", *(f"{stroke}s" for stroke in STROKES)], map(line, meanings))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000, help="swimmers, and tracers")
    parser.add_argument(
        "--time", type=float, default=20.0, help="simulated; a swimmer has length 1"
    )
    parser.add_argument("--seeds", type=int, default=3, help="runs of each kind")
    parser.add_argument("--output", type=Path, help="a file; the terminal by default")
    options = parser.parse_args()
    count, time = options.count, options.time
    runs: dict[str, list[Stirred]] = {stroke: [] for stroke in STROKES}
    for seed in range(options.seeds):
        for stroke in STROKES:
            directory = Path(f"outputs/stirring/{stroke}s_{count}_{time:g}_{seed}")
            run(directory, count, time, stroke, seed)
            runs[stroke].append(measured(directory))
    lines = [
        "# Stirring\n",
        f"{machine_today()}. Written by `python -m benchmarks.stirring`.\n",
        f"{count} swimmers of length 1 and thrust 1, and as many tracers, in a box of edge",
        f"{edge(count):.4g}, to t = {time:g}. They tumble {TUMBLE_RATE:g} times a unit of time.",
        f"Viscosity 1. Means over {options.seeds} seeds, with standard errors.\n",
        "## Mean square displacement of tracers\n",
        *displacements(runs, time / FRAMES),
        "\n## Other numbers\n",
        f"Late are lags from {time / 4:g} to {time / 2:g}. Counts are those in {PARTS**3} parts of",
        "the box in the second half of the run; at random places their variance / mean is 1.\n",
        *summary(runs),
    ]
    publish(lines, options.output)


if __name__ == "__main__":
    main()
