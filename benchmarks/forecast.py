"""Measured sums beside the papers' tables and the model, and what the model foretells."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass
from typing import Any

from benchmarks import parallel_model, plots, printed, tables
from benchmarks.methods import DIRECT, FMM, KITC
from benchmarks.parallel_model import Machine, Measured, Model, Network, strong, weak
from benchmarks.rows import Row
from mrs import markdown

CLUSTER = Machine(cores=64, efficiency=0.8, network=Network(latency=2e-6, bandwidth=12.5e9))
NODES = (1, 4, 16, 64, 256, 1024, 10_000)
POINTS = (10**6, 10**7, 10**8, 10**9)  # of all nodes
EACH = (10**5, 10**6)  # of a node
MODELS: dict[str, Model] = {
    "replicated": parallel_model.sliced,
    "distributed": parallel_model.distributed,
    "distributed, hierarchical": parallel_model.hierarchical,
}
COLORS = dict(zip(MODELS, ("#000000", "#0072B2", "#009E73"), strict=True))
TREECODE_MODELS: dict[str, Model] = {"replicated": parallel_model.gathered}

_PAPERS = """
Printed: seconds of the papers, by cores of one node (K) or processes (T). Measured: ranks here. The
model goes on to more ranks from the rates that are measured on one, and from messages within one
memory ({latency:.2g} us and {bandwidth:.2g} GB/s, a message of 8 bytes and of 16 MiB there and
back). It takes every further core to be as fast as one by itself: caches, memory and clock rates
that cores share are not in it. A rank expands its own clusters. In T table 6 each process has as
many points: rates are linear in the logarithm of N, through the two sums that are measured.
"""

_MODEL = """
Microseconds of one core for a point, measured on one rank. Tree: checks, sorting, lists. Sharing:
what `set_points` takes more on two ranks, for all points, of `fmm` for own ones. Upward: weights
and expansions. Rest: what is done for each target, which ranks share.
"""

_FORECAST = """
The model: nothing of this was measured on more than two ranks. It assumes nodes of {cores} cores
like the one here, threads with an efficiency of {efficiency:.0%}, one rank a node, messages of
{latency:.2g} us and {bandwidth:.3g} GB/s a node, points that are even in space, and the same work
for all nodes. {sum}

* *Replicated*: every node has all points, and gives a slice of them to the distributed sum.
  {value_bytes:g} bytes of values are gathered for each point.
* *Distributed*: a node has its own points, and is told ghosts and expansions around them. Exchanges
  are between all nodes. Cubes that a cut of the curve divides are summed over all nodes in one
  message: at each level as many as there are cuts, or all.
* *Distributed, hierarchical*: points are with their owners before, exchanges are with 26
  neighbours, and a divided cube is summed by the nodes that have a part of it. The code does not do
  so.

Seconds of a sum, and in brackets the efficiency in per cent against one node.
"""


def pages(rows: list[Row], messages: Row) -> Iterator[str]:
    """Yield the lines of the papers' tables, the rates of the model, and the forecast.

    Parameters
    ----------
    rows : list of Row
        Sums on one rank and on two.
    messages : Row
        Of `on_ranks.messages`.
    """
    yield from section("The tables of the papers", _PAPERS.format(**_network(_here(messages))))
    yield from _papers(rows, _here(messages))
    yield from section("The rates of the model", _MODEL)
    yield from _rates([row for row in rows if not row.get("distributed")])
    if fmm := _basis(rows, FMM):
        measured = Measured.of(fmm)
        text = _FORECAST.format(
            cores=CLUSTER.cores,
            efficiency=CLUSTER.efficiency,
            value_bytes=measured.value_bytes,
            sum=f"Rates are those of `fmm`, {tables.options(fmm)}, {fmm['n']:,} points.",
            **_network(CLUSTER),
        )
        yield from section("Forecast: more nodes for one sum", text)
        yield from _strong(measured, POINTS, MODELS)
        yield from section("Forecast: as many points a node", "The same, by points of a node.")
        yield from _weak(measured)
    if kitc := _basis(rows, KITC):
        text = f"`kitc`, {tables.options(kitc)}. A treecode has no distributed sum."
        yield from section("Forecast: a treecode", text)
        yield from _strong(Measured.of(kitc), (kitc["n"],), TREECODE_MODELS)


def section(title: str, text: str) -> Iterator[str]:
    """Yield a heading and the text below it."""
    yield from ("", f"## {title}", "", text.strip(), "")


def percent(value: float | None) -> str:
    """Return a part in per cent, "" for None."""
    return "" if value is None else tables.figure(100.0 * value, 2)


def printed_efficiency(row: Row) -> float | None:
    """Return the efficiency on two processes or cores that a paper prints for a sum like this."""
    for table in (printed.WEAK,) if row.get("weak") else printed.STRONG:
        seconds = table.of(row["backend"])
        if table.points == row["points"] and seconds:
            return seconds[1] / seconds[2] / (1.0 if table is printed.WEAK else 2.0)
    return None


def _here(messages: Row) -> Machine:
    return Machine(1, 1.0, Network(messages["latency"], messages["bandwidth"]))


def _network(machine: Machine) -> dict[str, float]:
    """Return microseconds and gigabytes a second."""
    network = machine.network
    return {"latency": 1e6 * network.latency, "bandwidth": 1e-9 * network.bandwidth}


def _basis(rows: list[Row], backend: str) -> Row | None:
    """Return the sum whose rates the forecast takes: the largest of its kind."""
    same = [
        row
        for row in rows
        if row["backend"] == backend
        and row["points"] == "organisms"
        and not row.get("distributed")
        and (backend == FMM or row["precision"] == "float64")
    ]
    return max(same, key=lambda row: (row["n"], row.get("tol", 0.0)), default=None)


@dataclass(frozen=True)
class _Column:
    """Seconds in a paper's table, and our sum that is like theirs.

    Attributes
    ----------
    table : printed.Scaling
    row : Row
    first, second : Measured
        The sum at one or two numbers of points; between and beyond them its rates are known.
    """

    table: printed.Scaling
    row: Row
    first: Measured
    second: Measured

    @property
    def weak(self) -> bool:
        return self.table is printed.WEAK

    def points(self, ranks: int) -> int:
        return self.first.points * (ranks if self.weak else 1)

    def model(self, ranks: int, machine: Machine) -> float:
        """Return the seconds of the model."""
        direct = self.row["backend"] == DIRECT
        model = parallel_model.replicated if direct else parallel_model.gathered
        n = self.points(ranks)
        measured = parallel_model.at(self.first, self.second, n) if self.weak else self.first
        return model(measured, n, ranks, machine).seconds

    def measured(self) -> dict[int, float]:
        """Return seconds by ranks."""
        return {1: self.row["seconds"], 2: self.row["seconds2"]}

    def efficiency(self, one: float, seconds: float, ranks: int) -> float:
        """Return that of ranks which take so many seconds."""
        return one / seconds / (1 if self.weak else ranks)


def _columns(rows: list[Row]) -> Iterator[_Column]:
    """Yield the columns of the papers' tables for which there are sums."""
    for table in (*printed.STRONG, printed.WEAK):
        for backend in (DIRECT, table.treecode):
            same = [
                row
                for row in rows
                if (row["points"], row["backend"]) == (table.points, backend)
                and row["precision"] == "float64"
            ]
            fixed = [row for row in same if not row.get("weak")]
            first = [row for row in same if row.get("weak")] if table is printed.WEAK else fixed
            if first and fixed:
                yield _Column(table, first[0], Measured.of(first[0]), Measured.of(fixed[0]))


def _papers(rows: list[Row], machine: Machine) -> Iterator[str]:
    header = (
        "table,backend,ranks,N,printed (s),printed: efficiency (%),measured (s),"
        "measured: efficiency (%),model (s),model: efficiency (%)"
    )
    lines = (line for column in _columns(rows) for line in _paper(column, machine))
    return markdown.table(header.split(","), lines)


def _paper(column: _Column, machine: Machine) -> Iterator[list[str]]:
    """Yield a line for each number of ranks in a column."""
    backend = column.row["backend"]
    theirs, ours = column.table.of(backend), column.measured()
    about = "~" if column.row["extrapolated"] else ""
    for ranks in theirs:
        cells = [tables.figure(theirs[ranks])]
        cells.append(percent(column.efficiency(theirs[1], theirs[ranks], ranks)))
        if ranks in ours:
            measured = column.row["efficiency"] if ranks > 1 else 1.0
            cells += [about + tables.figure(ours[ranks]), percent(measured)]
        else:
            cells += ["", ""]
        one, seconds = (column.model(r, machine) for r in (1, ranks))
        cells += [tables.figure(seconds), percent(column.efficiency(one, seconds, ranks))]
        yield [column.table.name, backend, str(ranks), f"{column.points(ranks):,}", *cells]


def _rates(rows: list[Row]) -> Iterator[str]:
    header = (
        f"{tables.CASE},tree (us),sharing (us),upward (us),rest (us),points for a cluster,"
        "bytes of its expansion"
    )

    def line(row: Row) -> list[str]:
        measured = Measured.of(row)
        rates = (1e6 * rate for rate in astuple(measured.rates))
        numbers = *rates, 1.0 / measured.boxes, measured.box_bytes
        points, _, *others = tables.case(row)
        return [points, f"{measured.points:,}", *others, *map(tables.figure, numbers)]

    return markdown.table(header.split(","), map(line, rows))


def _cell(model: Model, measured: Measured, points: float, nodes: int, efficiency: float) -> str:
    seconds = model(measured, points, nodes, CLUSTER).seconds
    return f"{tables.figure(seconds)} ({percent(efficiency)})"


def _strong(measured: Measured, sizes: Iterable[int], models: dict[str, Model]) -> Iterator[str]:
    """Yield a table of sums by points and nodes."""
    lines = (
        [f"{n:,}", f"{nodes:,}"]
        + [
            _cell(model, measured, n, nodes, strong(model, measured, n, nodes, CLUSTER))
            for model in models.values()
        ]
        for n in sizes
        for nodes in NODES
    )
    return markdown.table(["N", "nodes", *models], lines)


def _weak(measured: Measured) -> Iterator[str]:
    """Yield a table of sums by points of a node and nodes."""
    lines = (
        [f"{own:,}", f"{nodes:,}", f"{own * nodes:,}"]
        + [
            _cell(model, measured, own * nodes, nodes, weak(model, measured, own, nodes, CLUSTER))
            for model in MODELS.values()
        ]
        for own in EACH
        for nodes in NODES
    )
    return markdown.table(["points of a node", "nodes", "N", *MODELS], lines)


def plot_papers(axes: Any, rows: list[Row], messages: Row) -> None:
    """Draw efficiency against ranks: printed, measured and of the model, of the treecodes."""
    machine = _here(messages)
    columns = [column for column in _columns(rows) if column.row["backend"] != DIRECT]
    for style, column in enumerate(columns):
        backend, name = column.row["backend"], column.table.name
        theirs = column.table.of(backend)
        model = {r: column.model(r, machine) for r in theirs}
        look = {"color": plots.COLORS[backend], "linestyle": plots.DASHES[style]}
        for seconds, label, marker in ((theirs, "printed", plots.PAPERS), (model, "model", {})):
            parts = [100 * column.efficiency(seconds[1], seconds[r], r) for r in theirs]
            axes.plot(list(theirs), parts, label=f"{name}, {label}", **marker | look)
        marker = {"marker": plots.MARKERS[style], "color": plots.COLORS[backend]}
        measured = 100 * column.row["efficiency"]
        axes.plot(2, measured, linestyle="none", label=f"{name}, measured here", **marker)
    axes.set(xscale="log", xlabel="cores, processes or ranks", ylabel="efficiency (%)")
    axes.set_xticks([1, 2, 4, 8, 16, 32], ["1", "2", "4", "8", "16", "32"])
    axes.set_xticks([], minor=True)
    axes.set_title("the papers' tables, and the model", fontsize="medium")
    axes.set(ylim=(0, 120))


def plot_forecast(axes: Any, rows: list[Row]) -> None:
    """Draw the efficiency that the model foretells against nodes, of the largest sums."""
    fmm = _basis(rows, FMM)
    if fmm is None:
        return
    measured, most, own = Measured.of(fmm), POINTS[-1], EACH[0]
    for name, model in MODELS.items():
        fixed = [100 * strong(model, measured, most, nodes, CLUSTER) for nodes in NODES]
        each = [100 * weak(model, measured, own, nodes, CLUSTER) for nodes in NODES]
        axes.plot(NODES, fixed, color=COLORS[name], label=f"model: {name}")
        axes.plot(NODES, each, "--", color=COLORS[name])
    axes.set(
        xscale="log",
        xlabel=f"nodes of {CLUSTER.cores} cores",
        ylabel="efficiency (%)",
        ylim=(0, 110),
    )
    title = f"forecast, {FMM}: {most:.0e} points (dashed: {own:.0e} a node)"
    axes.set_title(title, fontsize="medium")
