"""What a rank does for all: expansions of clusters, and targets, in shares of equal work."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import treecode as tc
from tests.cases.grid_method import Grid
from tests.cases.inverse_distance import InverseDistance
from tests.test_ranks import KERNEL, TREECODES, some
from treecode import upward
from treecode.methods import registry
from treecode.ranks import ranks_of
from treecode.shared_sum import balanced

EXPANDING = {name: options for name, options in TREECODES.items() if name != "direct"}
KITC = TREECODES["kitc"]


def clumped(n=3000, width=1e-3):
    """Return points in a cube, half of which are in a small part of it, and strengths."""
    points, strengths = some(n)
    points[::2] = 0.3 + width * points[::2]
    return points, strengths


def walk_of(plan):
    """Return the walk that a rank, or one process, makes itself."""
    return getattr(plan._sum, "_own", plan._sum)


# --- expansions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("targets", [None, 5, 400], ids=["sources", "few apart", "apart"])
@pytest.mark.parametrize("options", EXPANDING.values(), ids=EXPANDING)
def test_expansions_are_those_of_one_process(options, targets, on_ranks):
    """Bitwise, on all ranks: which clusters have one, and all of their numbers; pairs as well."""
    points, forces = clumped(1500)
    where = None if targets is None else 3.0 * some(targets)[0] - 1.0
    alone = tc.Plan(KERNEL, **options).set_points(points, where)
    alone.execute(forces)
    expansion, info = walk_of(alone)._expansion, alone.info()
    assert len(expansion.data) > 10

    def same(comm):
        plan = tc.Plan(KERNEL, **options, comm=comm).set_points(points, where)
        for factor in (2.0, 1.0):
            plan.execute(factor * forces)
        own = walk_of(plan)._expansion
        pairs = [plan.info()[name] == info[name] for name in ("near_pairs", "far_pairs")]
        return [np.array_equal(own.slot, expansion.slot), own.data.dtype == expansion.data.dtype,
                np.array_equal(own.data, expansion.data), *pairs]  # fmt: skip

    for ranks in (2, 3, 40):
        assert on_ranks(ranks, same) == [[True] * 5] * ranks


@pytest.mark.parametrize("ranks", [1, 2, 3, 30])
def test_a_cluster_is_filled_by_who_has_all_its_sources(ranks, on_ranks, monkeypatch):
    """Once, and by no other rank; by all of them if its sources are in several shares."""
    points, forces = clumped()
    filled, fill = [], upward._fill

    def noting(expansion, tree, clusters, *arguments):
        filled.extend((id(expansion.data), cluster) for cluster in clusters.tolist())
        fill(expansion, tree, clusters, *arguments)

    def one(comm):
        plan = tc.Plan(KERNEL, **KITC, comm=comm).set_points(points)
        plan.execute(forces)
        return walk_of(plan)

    monkeypatch.setattr(upward, "_fill", noting)
    walks = on_ranks(ranks, one) if ranks > 1 else [one(None)]
    tree, slot = walks[0]._tree, walks[0]._expansion.slot
    holder = np.repeat(np.arange(ranks), len(points) // ranks)
    expected = [
        (rank, cluster)
        for cluster in np.flatnonzero(slot >= 0).tolist()
        for held in [np.unique(holder[tree.start[cluster] : tree.stop[cluster]]).tolist()]
        for rank in (held if len(held) == 1 else range(ranks))
    ]
    rank_of = {id(walk._expansion.data): rank for rank, walk in enumerate(walks)}
    assert sorted((rank_of[data], cluster) for data, cluster in filled) == sorted(expected)


def test_bytes_and_seconds_of_expansions(on_ranks):
    """Each rank receives the rows that others alone have filled, and others' values."""
    points, forces = clumped()

    def told(comm):
        plan = tc.Plan(KERNEL, **KITC, comm=comm).set_points(points)
        plan.execute(forces)
        return plan.info(), walk_of(plan)

    for rank, (info, walk) in enumerate(on_ranks(2, told)):
        begin, end = (1500, 3000) if rank == 0 else (0, 1500)
        tree, expansion = walk._tree, walk._expansion
        theirs = (expansion.slot >= 0) & (tree.start >= begin) & (tree.stop <= end)
        rows = expansion.data[expansion.slot[theirs]]
        assert info["received_bytes"] == rows.nbytes + 1500 * 3 * 8
        assert info["seconds"]["expansions"] > 0.0
        assert info["seconds"]["weights"] > 0.0
    alone = tc.Plan(KERNEL, **KITC).set_points(points)
    alone.execute(forces)
    assert "expansions" not in alone.info()["seconds"]


def test_rows_of_any_numbers_are_gathered(on_ranks):
    """In the order of the ranks; a rank may have none."""
    rows = np.arange(72, dtype=np.float32).reshape(6, 3, 4)

    def gathered(comm):
        ranks = ranks_of(comm)
        own = rows[[0, 0, 4][comm.rank] : [0, 4, 6][comm.rank]]
        together = ranks.gather(own)
        assert together.dtype == np.float32
        return np.array_equal(together, rows), ranks.received

    assert on_ranks(3, gathered) == [(True, 288), (True, 96), (True, 192)]


# --- targets -------------------------------------------------------------------------------------

shares = st.lists(st.tuples(st.integers(0, 500), st.integers(0, 10**7)), min_size=2, max_size=9)


@given(shares)
def test_shares_of_equal_work(parts):
    """If work is constant within the shares, it is equal between the new ones, up to a target."""
    counts = np.array([count for count, _ in parts])
    work = np.array([density * count for count, density in parts], float)
    cuts = np.concatenate([[0], np.cumsum(counts)])
    moved = balanced(cuts, work.tolist())
    assert (np.diff(moved) >= 0).all()
    assert moved[0] == 0
    assert moved[-1] == cuts[-1]
    each = np.repeat([density for _, density in parts], counts)
    new = np.diff(np.concatenate([[0], np.cumsum(each)])[moved])
    if len(work) * work.max() <= 1.02 * work.sum():
        assert np.array_equal(moved, cuts)
    else:
        assert np.abs(new - work.mean()).max() <= max(each) * (1.0 + 1e-9)


@pytest.mark.parametrize("kernel", [KERNEL, InverseDistance(0.05)], ids=type)
@pytest.mark.parametrize("options", TREECODES.values(), ids=TREECODES)
def test_shares_follow_the_work(options, kernel, on_ranks):
    """Of a clump, and of points that are scattered; and no bit of the values changes."""
    points, forces = clumped()
    strengths = forces[:, : kernel.strength_size]
    one = tc.evaluate(kernel, points, strengths, **options)

    def spread(comm):
        plan = tc.Plan(kernel, **options, comm=comm)
        found = []
        for _ in range(3):
            same = np.array_equal(plan.set_points(points).execute(strengths), one)
            work = comm.allgather(walk_of(plan).effort)
            assert sum(work) == plan._sum.effort
            found.append((same, max(work) / np.mean(work)))
        return found

    told = on_ranks(3, spread)
    assert told == [told[0]] * 3
    assert all(same for same, _ in told[0])
    assert told[0][2][1] < 1.05
    assert (told[0][0][1] > 1.15) == (options["backend"] != "direct")


def test_when_shares_are_equal_again(on_ranks):
    """Where there are other numbers of targets; not where points are only set again."""
    points, forces = clumped()

    def counted(comm):
        plan = tc.Plan(KERNEL, **KITC, comm=comm).set_points(points)
        found = []

        def note():
            found.append(walk_of(plan).targets.shape[1])

        note()
        plan.execute(forces)
        plan.set_points(points)
        note()
        plan.set_points(points)
        note()
        plan.set_points(points, points[:-1])
        note()
        return found

    first, second = on_ranks(2, counted)
    assert first[0] == second[0] == 1500
    assert first[1] != 1500
    assert first[1] == first[2] == 3000 - second[1]
    assert first[3] == 1499


def test_fewer_targets_than_ranks(on_ranks):
    """The ranks without any fill expansions too."""
    points, forces = clumped()
    for options in TREECODES.values():
        for targets in (points[:2] + 1.0, points[:0]):
            one = tc.evaluate(KERNEL, points, forces, targets, **options)

            def same(comm, options=options, targets=targets, one=one):
                plan = tc.Plan(KERNEL, **options, comm=comm)
                found = [plan.set_points(points, targets).execute(forces) for _ in range(3)]
                return [np.array_equal(values, one) for values in found]

            assert on_ranks(5, same) == [[True] * 3] * 5


def test_a_sum_that_does_not_know_of_ranks(on_ranks, monkeypatch):
    """It has equal shares, each with the outermost targets: all choose by the same box."""
    monkeypatch.setattr(registry, "_methods", dict(registry._methods))
    tc.methods.register(Grid())
    points, forces = clumped()
    targets = points[:2000] + 20.0

    def counted(comm):
        plan = tc.Plan(KERNEL, "grid", degree=4, comm=comm)
        found = []
        for _ in range(2):
            plan.set_points(points, targets).execute(forces)
            own = walk_of(plan).targets
            box = np.array_equal(own.min(axis=1), targets.min(axis=0))
            found.append((own.shape[1], box and np.array_equal(own.max(axis=1), targets.max(0))))
        return found

    assert on_ranks(2, counted) == [[(1006, True)] * 2] * 2
