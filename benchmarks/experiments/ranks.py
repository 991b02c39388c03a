"""Ranks of MPI

The same sum on one rank and on two, of one thread each, in turns. Replicated: every rank has all
points and a share of the targets, as in algorithm 2 of T. Distributed: every rank gives a part of
the points, in any order, and gets their values. The efficiency is half the ratio of the times, the
median over turns. "Waiting" is the time until the other rank is done, "communication" the exchange
of values, both in parts of the time of rank 0. A "~" marks times and bytes scaled up from sampled
targets. E is K eq. (8.1) at 2000 random targets.

Every number is marked for what it is: printed in a paper, measured here, or of the model in
`benchmarks/parallel_model.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks import forecast, plots, tables
from benchmarks.experiments.curve import SINGLE, treecode
from benchmarks.methods import DIRECT, FMM, KITC, TAYLOR
from benchmarks.on_ranks import messages, on_ranks, rank_memory
from benchmarks.rows import Row
from mrs import markdown

measure = on_ranks

MEMORY, MESSAGES = rank_memory.__name__, messages.__name__


def cases(quick: bool) -> Iterator[Row]:
    """Yield messages, sums on one rank and two, on two and four, and memory."""
    two: Row = {"ranks": 2}
    few, many = (10_000, 20_000) if quick else (640_000, 5_120_000)
    organisms: Row = {"points": "organisms", "size": few, "epsilon": 0.02}
    larger = organisms | {"size": many}
    rods: Row = {"points": "rods", "size": 8 if quick else 80}
    cube: Row = {"points": "cube", "size": 20_000 if quick else 1_000_000}
    fmm: Row = {"backend": FMM, "tol": 1e-3}
    apart: Row = {"distributed": True}
    yield two | {"task": MESSAGES}
    yield two | cube | {"backend": DIRECT}
    yield two | cube | treecode(TAYLOR, 0.5, 6)
    yield two | cube | treecode(TAYLOR, 0.5, 6) | {"size": cube["size"] // 4, "weak": True}
    for points, leaf_size in ((organisms, 2000), (rods, 1000)):
        for precision in ({}, SINGLE):
            yield two | points | treecode(KITC, 0.7, 7, leaf_size) | precision
    for data in ({}, apart):
        yield two | organisms | fmm | data
        if not quick:
            yield two | organisms | fmm | {"tol": 3e-5} | data
        yield two | larger | fmm | data
    for method in (treecode(KITC, 0.7, 7), fmm, fmm | apart):
        yield {"ranks": 4, "fewer": 2} | organisms | method
    for ranks, data in {1: {}, 2: apart, 4: apart}.items():
        size: Row = {"size": many, "epsilon": 0.02}
        yield {"ranks": ranks, "task": MEMORY} | size | fmm | data


def table(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of all tables, with a heading before each but the first."""
    yield from _sums(_of(rows))
    if more := _of(rows, ranks=4):
        yield from forecast.section("Four ranks on two cores", _FOUR)
        yield from _four(more)
    if memory := [row for row in rows if row.get("task") == MEMORY]:
        yield from forecast.section("Memory of a rank", _MEMORY)
        yield from _memory(memory)
    sums, network = _of(rows), [row for row in rows if row.get("task") == MESSAGES]
    if sums and network:
        yield from forecast.pages(sums, network[0])


_FOUR = """
The two ranks of this table are of one thread each, on two cores. The four share these cores, and
do the same sum in turns with the two.
"""

_MEMORY = """
By how much a sum raises the largest resident memory of a rank (`ru_maxrss`), points and values
included, compiled code not: the largest of the ranks. Operators come from the disk.
"""


def _of(rows: list[Row], ranks: int = 2) -> list[Row]:
    """Return the rows of sums on so many ranks."""
    return [row for row in rows if row["ranks"] == ranks and "task" not in row]


def _sums(rows: list[Row]) -> Iterator[str]:
    header = (
        f"{tables.CASE},data,E,1 rank (s),2 ranks (s),efficiency (%),"
        "printed: efficiency (%),waiting (%),communication (%),MB received"
    )
    return markdown.table(header.split(","), map(_line, rows))


def _line(row: Row) -> list[str]:
    theirs = forecast.printed_efficiency(row)
    about = "~" if row["extrapolated"] else ""
    return [
        *tables.case(row),
        _data(row),
        tables.error(row["error"]),
        tables.seconds(row),
        tables.seconds(row, "seconds2"),
        forecast.percent(row["efficiency"]),
        forecast.percent(theirs),
        f"{100 * row['waiting2'] / row['seconds2']:.1f}",
        f"{100 * row['communication2'] / row['seconds2']:.1f}",
        about + f"{row['received'] / 1e6:.2f}",
    ]


def _data(row: Row) -> str:
    """Return how points are shared; of weak scaling how many they are on one rank."""
    data = "distributed" if row.get("distributed") else "replicated"
    return data + (f", 1 rank: N {row['n1']:,}" if row.get("weak") else "")


def _four(rows: list[Row]) -> Iterator[str]:
    header = f"{tables.CASE},data,2 ranks (s),4 ranks (s),4 ranks: times as long"

    def line(row: Row) -> list[str]:
        longer = row["fewer"] / row["ranks"] / row["efficiency"]
        both = tables.seconds(row), tables.seconds(row, "seconds2")
        return [*tables.case(row), _data(row), *both, f"{longer:.2f}"]

    return markdown.table(header.split(","), map(line, rows))


def _memory(rows: list[Row]) -> Iterator[str]:
    def line(row: Row) -> list[str]:
        own = row["n"] // row["ranks"]
        total, each = tables.figure(row["bytes"] / 1e6), tables.figure(row["bytes"] / own)
        return [f"{row['n']:,}", tables.options(row), str(row["ranks"]), f"{own:,}", total, each]

    header = "N,parameters,ranks,points of a rank,MB of a rank,bytes for each of its points"
    return markdown.table(header.split(","), map(line, rows))


def plot(rows: list[Row], figure: Any) -> None:
    """Draw a bar for the efficiency of each sum; below, efficiency against ranks and nodes."""
    sums, network = _of(rows), [row for row in rows if row.get("task") == MESSAGES]
    height = 0.8 + 0.25 * len(sums)
    figure.set_size_inches(plots.WIDTH, 5.5 + height)
    above, below = figure.subfigures(2, 1, height_ratios=[height, 4.5])
    _bars(above.subplots(), sums)
    if sums and network:
        papers, nodes = below.subplots(1, 2)
        forecast.plot_papers(papers, sums, network[0])
        forecast.plot_forecast(nodes, sums)
    plots.finish(figure)


def _bars(axes: Any, rows: list[Row]) -> None:
    for i, row in enumerate(rows):
        axes.barh(i, 100 * row["efficiency"], color=plots.COLORS[row["backend"]])
    words = ((*tables.case(row), _data(row)) for row in rows)
    axes.set_yticks(range(len(rows)), [", ".join(filter(None, some)) for some in words])
    axes.tick_params("y", labelsize="small")
    axes.invert_yaxis()
    axes.set(xlabel="efficiency of two ranks, measured (%)", xlim=(0, 120))
