"""The seconds of a sum that nodes share: a model, with rates that were measured.

A node is one rank of MPI whose threads share its part. A treecode is `gathered`, a direct sum
`replicated`, `fmm` is `distributed`, or `sliced` where all nodes know all points. All nodes have as
much to do as each other, and no message is sent while anything is computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

from benchmarks.methods import FMM
from benchmarks.rows import Row

POSITION_BYTES = 24  # of a point
_FIRST_LEVEL = 2  # the coarsest level whose cubes have expansions
_ROUNDS = 16  # small messages to all: eight exchanges of `treecode.ranks`, of two messages each
# Of a distributed sum, counted: 33 exchanges, a third of which a second message follows.
_SPREAD_ROUNDS = 45
# Positions, strengths and values to and from owners; ghosts twice; expansions; four with counts.
_EXCHANGES = 10
_HALO_EXCHANGES = 3  # without the first three
_NEIGHBOURS = 26  # of a part of space
_GHOSTS, _LISTS = 1, 2  # leaves that touch; cubes that touch the parent: so many cubes away
_CUTS = 2  # between a node's part of the curve and those before and behind it


@dataclass(frozen=True)
class Network:
    """What joins the nodes.

    Attributes
    ----------
    latency : float
        Seconds of a message without contents.
    bandwidth : float
        Bytes a second into a node.
    """

    latency: float
    bandwidth: float

    def gather(self, nodes: int, received: float = 0.0) -> float:
        """Return the seconds until all nodes know what each had; bytes that a node receives."""
        return self.latency * math.log2(nodes) + received / self.bandwidth

    def exchange(self, partners: int, received: float) -> float:
        """Return the seconds of a message to, and one from, each of some partners."""
        return self.latency * partners + received / self.bandwidth


@dataclass(frozen=True)
class Machine:
    """Nodes and their network.

    Attributes
    ----------
    cores : int
        Of a node.
    efficiency : float
        Of its threads: so many cores' work for each core.
    network : Network
    """

    cores: int
    efficiency: float
    network: Network

    @property
    def speed(self) -> float:
        """Seconds of one core that a node does in a second."""
        return self.cores * self.efficiency


@dataclass(frozen=True)
class Rates:
    """Seconds of one core for a point.

    Attributes
    ----------
    tree : float
        Checking and sorting the points, and who acts on whom.
    sharing : float
        What more is done where there are other ranks: of all points shares along a curve, and
        targets sorted apart; of own points of `fmm` the way to their owners.
    upward : float
        Weights, and expansions of all clusters.
    rest : float
        What is done for each target.
    """

    tree: float
    sharing: float
    upward: float
    rest: float

    def toward(self, other: Rates, part: float) -> Rates:
        """Return the rates a part of the way from these to others, or beyond them."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Rates(*(a + part * (b - a) for a, b in pairs))


@dataclass(frozen=True)
class Measured:
    """A sum as it was measured.

    Attributes
    ----------
    points : int
    rates : Rates
    boxes : float
        Clusters for a point.
    box_bytes, box_seconds : float
        The expansion of a cluster; the seconds of one core for the translations to it.
    value_bytes, weight_bytes : float
        Values, and weights, of a point.
    """

    points: int
    rates: Rates
    boxes: float
    box_bytes: float
    box_seconds: float
    value_bytes: float
    weight_bytes: float

    @classmethod
    def of(cls, row: Row) -> Measured:
        """Return the sum of a row of `on_ranks.in_turns`, on its fewer ranks."""
        n = row["n1"]
        set_on_each = row["n"] / (row["ranks"] if row["backend"] == FMM else 1)
        tree, upward = row["tree"] / n, row["upward"] / n
        return cls(
            points=n,
            rates=Rates(
                tree=tree,
                sharing=max(0.0, row["tree2"] / set_on_each - tree),
                upward=upward,
                rest=row["seconds"] / n - tree - upward,
            ),
            boxes=row["clusters"] / n,
            box_bytes=row["expansion_bytes"] / row["clusters"],
            box_seconds=row["translations"] / row["clusters"],
            value_bytes=row["value_bytes"],
            weight_bytes=row["weight_bytes"],
        )


@dataclass(frozen=True)
class Cost:
    """What a sum takes on each node: seconds, and bytes that it receives."""

    computing: float
    communication: float = 0.0
    received: float = 0.0

    @property
    def seconds(self) -> float:
        return self.computing + self.communication


Model = Callable[[Measured, float, int, Machine], Cost]


def replicated(measured: Measured, points: float, nodes: int, machine: Machine) -> Cost:
    """Every node has all points, sorts them and fills all expansions, and has a share of targets.

    Parameters
    ----------
    measured : Measured
    points : float
        Of all nodes.
    nodes : int
    machine : Machine
    """
    rates = measured.rates
    everywhere = rates.tree + rates.upward + (rates.sharing if nodes > 1 else 0.0)
    received = points * measured.value_bytes * (1.0 - 1.0 / nodes)
    return Cost(
        points * (everywhere + rates.rest / nodes) / machine.speed,
        _ROUNDS * machine.network.gather(nodes) + machine.network.gather(nodes, received),
        received,
    )


def gathered(measured: Measured, points: float, nodes: int, machine: Machine) -> Cost:
    """The same, but every node fills the expansions of its own clusters, which are then gathered.

    Clusters of several nodes are filled by all of them.
    """
    rates, network = measured.rates, machine.network
    before = replicated(measured, points, nodes, machine)
    boxes = points * measured.boxes
    shared = min(sum(_shared(levels_of(measured, points), nodes)), boxes)
    others = (boxes - shared) * (1.0 - 1.0 / nodes)
    spared = points * rates.upward * others / boxes
    received = others * measured.box_bytes
    return Cost(
        before.computing - spared / machine.speed,
        before.communication + network.gather(nodes, received),
        before.received + received,
    )


def distributed(measured: Measured, points: float, nodes: int, machine: Machine) -> Cost:
    """Every node has its own points, and what of the others acts on them (`fmm`).

    Points may be anywhere at first. They go to their owners, and the values come back. Ghosts are
    the points of neighbouring leaves. The expansions around a part of space are told at each level.
    Those of the cubes that a cut of the curve divides are summed over all nodes. Exchanges are
    between all nodes: a message to each, empty or not.
    """
    network = machine.network
    own, levels = points / nodes, levels_of(measured, points)
    ghosts, computing = _own_part(measured, own, nodes, levels)
    moved = own * (1.0 - 1.0 / nodes)
    moved *= POSITION_BYTES + measured.weight_bytes + measured.value_bytes
    finer = [boxes for boxes in levels if boxes >= nodes]
    halo = sum(surroundings(boxes, _LISTS, nodes) for boxes in finer) * measured.box_bytes
    summed = 2.0 * (1.0 - 1.0 / nodes) * sum(_shared(levels, nodes)) * measured.box_bytes
    messages = moved + ghosts * (POSITION_BYTES + measured.weight_bytes) + halo
    return Cost(
        computing / machine.speed,
        _SPREAD_ROUNDS * network.gather(nodes)
        + _EXCHANGES * network.exchange(nodes - 1, 0.0)
        + network.exchange(0, messages + summed),
        messages + summed,
    )


def sliced(measured: Measured, points: float, nodes: int, machine: Machine) -> Cost:
    """The same, where all nodes know all points: each gives a slice, and gets all values."""
    cost = distributed(measured, points, nodes, machine)
    received = points * measured.value_bytes * (1.0 - 1.0 / nodes)
    return Cost(
        cost.computing,
        cost.communication + machine.network.gather(nodes, received),
        cost.received + received,
    )


def hierarchical(measured: Measured, points: float, nodes: int, machine: Machine) -> Cost:
    """A distributed sum of points that are with their owners, with messages to neighbours alone.

    The expansion of a cube that is divided is then summed by the nodes that have a part of it.
    """
    network = machine.network
    own, levels = points / nodes, levels_of(measured, points)
    ghosts, computing = _own_part(measured, own, nodes, levels)
    halo = sum(surroundings(max(boxes, nodes), _LISTS, nodes) for boxes in levels)
    summed = 2.0 * _CUTS * len(levels) * (nodes > 1)  # up and down
    received = ghosts * (POSITION_BYTES + measured.weight_bytes)
    received += (halo + summed) * measured.box_bytes
    return Cost(
        computing / machine.speed,
        _SPREAD_ROUNDS * network.gather(nodes)
        + _HALO_EXCHANGES * network.exchange(min(_NEIGHBOURS, nodes - 1), 0.0)
        + network.exchange(0, received),
        received,
    )


def levels_of(measured: Measured, points: float) -> list[float]:
    """Return the cubes of each level that has expansions, from the leaves up, if points are even.

    Of eight boxes seven are leaves.
    """
    leaves = max(1.0, 0.875 * points * measured.boxes)
    depth = max(_FIRST_LEVEL, round(math.log(leaves, 8.0)))
    return [leaves / 8.0**k for k in range(depth - _FIRST_LEVEL + 1)]


def surroundings(boxes: float, width: int, nodes: int) -> float:
    """Return the boxes within `width` of a node's own, a cube of them, that other nodes have.

    Parameters
    ----------
    boxes : float
        Of all nodes at a level.
    width : int
        In boxes.
    nodes : int
        They form a cube too. Its surface has no others outside, so that the mean node has
        neighbours on a part of its faces.
    """
    side = (boxes / nodes) ** (1.0 / 3.0)
    inside = 1.0 - nodes ** (-1.0 / 3.0)
    around = (side + 2.0 * width * inside) ** 3 - side**3
    return min(around, (nodes - 1) * side**3)


def _shared(levels: list[float], nodes: int) -> list[float]:
    """Return the cubes of each level that several nodes have: each cut divides one."""
    return [min(boxes, nodes - 1.0) for boxes in levels]


def _own_part(
    measured: Measured, own: float, nodes: int, levels: list[float]
) -> tuple[float, float]:
    """Return a node's ghosts, and the seconds of one core for its own points with them."""
    rates = measured.rates
    ghosts = surroundings(levels[0], _GHOSTS, nodes) * own * nodes / levels[0]
    seconds = own * (rates.upward + rates.rest) + (own + ghosts) * rates.tree
    # Finding the owners is taken to cost what `sharing` does. Cubes that are divided are worked at
    # by all that have a part.
    if nodes > 1:
        seconds += own * rates.sharing + _CUTS * len(levels) * measured.box_seconds
    return ghosts, seconds


def strong(model: Model, measured: Measured, points: float, nodes: int, machine: Machine) -> float:
    """Return the efficiency of so many nodes: 1 if they are so many times as fast as one."""
    one = model(measured, points, 1, machine).seconds
    return one / model(measured, points, nodes, machine).seconds / nodes


def weak(model: Model, measured: Measured, points: float, nodes: int, machine: Machine) -> float:
    """Return the efficiency of nodes with so many points each: 1 if they take as long as one."""
    one = model(measured, points, 1, machine).seconds
    return one / model(measured, points * nodes, nodes, machine).seconds


def at(first: Measured, second: Measured, points: float) -> Measured:
    """Return a sum at another number of points: rates are linear in its logarithm.

    A point of a treecode meets more clusters in a larger tree.
    """
    part = math.log(points / first.points) / math.log(second.points / first.points)
    return Measured(
        points=round(points),
        rates=first.rates.toward(second.rates, part),
        boxes=second.boxes,
        box_bytes=second.box_bytes,
        box_seconds=second.box_seconds,
        value_bytes=second.value_bytes,
        weight_bytes=second.weight_bytes,
    )
