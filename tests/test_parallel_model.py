"""The model of sums over nodes: its limits, a case by hand, and the bytes that are really sent."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import parallel_model as model
from benchmarks import printed, sums
from benchmarks.methods import DIRECT
from benchmarks.on_ranks import on_ranks
from benchmarks.parallel_model import Machine, Measured, Network, Rates

MODELS = (
    model.replicated,
    model.gathered,
    model.distributed,
    model.sliced,
    model.hierarchical,
)
MEASURED = Measured(
    points=1000,
    rates=Rates(tree=0.125, sharing=0.25, upward=0.5, rest=4.0),
    boxes=1.0 / 7.0,  # leaves of eight points
    box_bytes=100.0,
    box_seconds=2.0,
    value_bytes=24.0,
    weight_bytes=24.0,
)
MACHINE = Machine(cores=4, efficiency=0.5, network=Network(latency=0.001, bandwidth=100.0))


@pytest.mark.parametrize("share", MODELS)
def test_one_node_sends_nothing_and_loses_nothing(share):
    cost = share(MEASURED, 4096.0, 1, MACHINE)
    assert cost.communication == cost.received == 0.0
    assert cost.seconds == 4096.0 * (0.125 + 0.5 + 4.0) / 2.0
    assert model.strong(share, MEASURED, 4096.0, 1, MACHINE) == 1.0
    assert model.weak(share, MEASURED, 4096.0, 1, MACHINE) == 1.0


@pytest.mark.parametrize("share", MODELS)
@pytest.mark.parametrize("nodes", [2, 8, 1024])
def test_nodes_without_messages_and_repeated_work_are_so_many_times_as_fast(share, nodes):
    perfect = replace(MEASURED, rates=Rates(0.0, 0.0, 0.0, 4.0), box_seconds=0.0)
    machine = replace(MACHINE, network=Network(latency=0.0, bandwidth=math.inf))
    one, many = (share(perfect, 2.0**20, r, machine).seconds for r in (1, nodes))
    assert one / many == nodes
    assert model.strong(share, perfect, 2.0**20, nodes, machine) == 1.0
    assert model.weak(share, perfect, 2.0**20, nodes, machine) == 1.0


def test_replicated_data_by_hand():
    """Amdahl's law: 4096 points on 8 nodes of a speed of two cores."""
    cost = model.replicated(MEASURED, 4096.0, 8, MACHINE)
    assert cost.computing == 4096 * (0.125 + 0.25 + 0.5 + 4.0 / 8) / 2
    assert cost.received == 4096 * 24 * 7 / 8
    # 16 small messages and one with the values, of three steps each
    assert cost.communication == pytest.approx(17 * 3 * 0.001 + 4096 * 24 * 7 / 8 / 100)


def test_gathered_expansions_by_hand():
    """512 leaves and 73 larger boxes; of two levels seven boxes each are filled by all nodes."""
    cost = model.gathered(MEASURED, 4096.0, 8, MACHINE)
    before = model.replicated(MEASURED, 4096.0, 8, MACHINE)
    boxes = 4096 / 7
    others = (boxes - 14) * 7 / 8
    spared = 4096 * 0.5 * others / boxes / 2
    assert before.computing - cost.computing == pytest.approx(spared)
    assert cost.received - before.received == pytest.approx(others * 100)
    longer = 3 * 0.001 + others * 100 / 100
    assert cost.communication - before.communication == pytest.approx(longer)


def test_distributed_points_by_hand():
    """Eight nodes, each with a corner of 4 x 4 x 4 leaves, and of 2 x 2 x 2 boxes above them."""
    ghosts = (5**3 - 4**3) * 8
    own = 4096 / 8
    computing = own * (0.25 + 0.5 + 4.0) + (own + ghosts) * 0.125 + 2 * 2 * 2.0
    moved = own * 7 / 8 * (24 + 24 + 24)
    halo = (6**3 - 4**3) + (4**3 - 2**3)
    divided = 7 + 7
    cost = model.distributed(MEASURED, 4096.0, 8, MACHINE)
    received = moved + ghosts * 48 + 100 * halo + 2 * 7 / 8 * 100 * divided
    assert cost.computing == pytest.approx(computing / 2)
    assert cost.received == pytest.approx(received)
    assert cost.communication == pytest.approx((45 * 3 + 10 * 7) * 0.001 + received / 100)

    also = model.sliced(MEASURED, 4096.0, 8, MACHINE)
    assert also.computing == cost.computing
    assert also.received - cost.received == pytest.approx(4096 * 24 * 7 / 8)

    cost = model.hierarchical(MEASURED, 4096.0, 8, MACHINE)
    received = ghosts * 48 + 100 * halo + 2 * 2 * 100 * 2
    assert cost.computing == pytest.approx(computing / 2)
    assert cost.received == pytest.approx(received)
    assert cost.communication == pytest.approx((45 * 3 + 3 * 7) * 0.001 + received / 100)


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("parts", [1, 2, 3])
def test_surroundings_are_those_of_the_mean_node(parts, width):
    """Counted among 8 x 8 x 8 boxes and more, of which each node has a cube."""
    side = 4
    owner = np.stack(np.meshgrid(*3 * [np.arange(parts * side) // side], indexing="ij"))
    cells = np.stack(np.meshgrid(*3 * [np.arange(parts * side)], indexing="ij"))
    counts = []
    for node in np.ndindex(3 * (parts,)):
        low = side * np.array(node)[:, None, None, None]
        near = np.all((cells >= low - width) & (cells < low + side + width), axis=0)
        mine = np.all(owner == np.array(node)[:, None, None, None], axis=0)
        counts.append(np.count_nonzero(near & ~mine))
    found = model.surroundings((parts * side) ** 3, width, parts**3)
    assert found == pytest.approx(np.mean(counts))


def test_surroundings_are_no_more_than_there_is():
    assert model.surroundings(8.0, 2, 8) == 7.0
    assert model.surroundings(2.0, 2, 2) == 1.0


def test_rates_at_other_sizes():
    """They are those that are given where they are given, and half way at the geometric mean."""
    other = replace(MEASURED, points=4000, rates=Rates(0.25, 0.25, 1.0, 8.0))
    assert model.at(MEASURED, other, 1000).rates == MEASURED.rates
    assert model.at(MEASURED, other, 4000).rates == other.rates
    assert model.at(MEASURED, other, 2000).rates.rest == pytest.approx(6.0)
    assert model.at(MEASURED, other, 16000).rates.rest == pytest.approx(12.0)


EFFICIENCIES = {  # as they are printed beside the seconds, in per cent
    "K table 4": (
        (100.00, 100.00, 98.74, 90.28, 87.00, 86.62),
        (100.00, 99.82, 96.41, 87.31, 76.37, 61.23),
    ),
    "K table 5": (
        (100.00, 98.97, 98.75, 92.27, 91.58, 87.79),
        (100.0, 96.91, 93.91, 81.27, 74.76, 68.84),
    ),
    "T table 5": ((100.0, 98.8, 99.0, 90.2, 86.4, 86.5), (100.0, 95.4, 97.2, 87.6, 82.2, 77.3)),
}


@pytest.mark.parametrize("table", printed.STRONG, ids=lambda table: table.name)
def test_printed_seconds_agree_with_printed_efficiencies(table):
    """Within the digits of the seconds: a mistake in copying would be larger."""
    for backend, expected in zip((DIRECT, table.treecode), EFFICIENCIES[table.name], strict=True):
        seconds = table.of(backend)
        found = [100 * seconds[1] / value / cores for cores, value in seconds.items()]
        np.testing.assert_allclose(found, expected, rtol=4e-3)


@pytest.mark.skipif(not sums.can_measure({"ranks": 2}), reason="mpi4py or mpirun is missing")
@pytest.mark.parametrize(
    "options",
    [
        {"backend": "direct"},
        {"backend": "kitc", "degree": 3, "leaf_size": 200},
        {"backend": "taylor", "degree": 3, "leaf_size": 200},
    ],
    ids=lambda options: options["backend"],
)
def test_the_model_counts_the_bytes_that_the_code_counts(options):
    """And the row of a measurement has the rates that the model asks for."""
    row = on_ranks(2, points="cube", size=2000, **options)
    measured = Measured.of(row | options)
    cost = model.replicated if options["backend"] == "direct" else model.gathered
    # Shares are cut where clusters end, so expansions are not quite halved.
    wanted = pytest.approx(cost(measured, 2000.0, 2, MACHINE).received, rel=0.2)
    assert row["received"] == (24000 if options["backend"] == "direct" else wanted)
    one = model.replicated(measured, 2000.0, 1, Machine(1, 1.0, MACHINE.network))
    assert one.seconds == pytest.approx(row["seconds"])
    assert measured.rates.rest > 0.0
