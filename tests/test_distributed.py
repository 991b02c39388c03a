"""A fast multipole sum of points that no rank has all of: the curve, the pieces, the values."""

import itertools
import time

import numpy as np
import pytest

import treecode as tc
from mrs.profile import STAGES
from tests.test_ranks import by_mpi, mpirun
from treecode import curve
from treecode.curve import cells_of, first_keys
from treecode.methods.fmm.curve import Pieces, keys_of
from treecode.methods.fmm.octree import Box, build_octree
from treecode.methods.fmm.partition import aligned, divide
from treecode.ranks import OneRank, ranks_of
from treecode.threads import Threads

KERNEL = tc.Stokeslet()  # of no length: one set of operators serves all cubes
LEAF = 20


def cube(rng, n):
    return rng.random((n, 3))


def sphere(rng, n):
    points = rng.standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def rods(rng, n):
    along = np.linspace(0.0, 0.3, 50)[:, None]
    return np.concatenate([rng.random(3) + along * rng.standard_normal(3) for _ in range(n // 50)])


def clumps(rng, n):
    """Four of very different sizes, and points that are one."""
    parts = [rng.random(3) + 10.0**-k * rng.standard_normal((n // 5, 3)) for k in range(1, 5)]
    return np.concatenate([*parts, np.tile(rng.random(3), (n // 5, 1))])


SETS = {"cube": cube, "sphere": sphere, "rods": rods, "clumps": clumps}


def shares(n, size):
    """Equal slices of n points."""
    return [slice(n * rank // size, n * (rank + 1) // size) for rank in range(size)]


# --- the curve -----------------------------------------------------------------------------------


def by_bits(cell, level):
    """Return the first key of a cube, a bit at a time."""
    key = 0
    for bit, d in itertools.product(range(level), range(3)):
        key |= (int(cell[d]) >> bit & 1) << 3 * bit + d
    return key << 3 * (curve.LEVELS - level)


@pytest.mark.parametrize("level", [0, 1, 5, 21])
def test_keys_of_cubes(level):
    cells = np.random.default_rng(0).integers(0, 1 << level, (50, 3))
    keys = first_keys(level, cells)
    assert keys.tolist() == [by_bits(cell, level) for cell in cells]
    assert np.array_equal(cells_of(level, keys), cells)


def test_keys_of_points_are_in_the_order_of_a_tree():
    """Also of points in the planes between cubes, and far from the origin."""
    rng = np.random.default_rng(0)
    for points in (rng.random((3, 5000)), rng.integers(0, 9, (3, 5000)) / 8.0, 1e9 + cube(rng, 3)):
        box = Box.around(points)
        width = 2.0 * float((box.high - box.low).max())
        with Threads() as threads:
            keys = keys_of(points, box, width, threads)
            tree, order, _ = build_octree(points.copy(), None, LEAF, width, threads)
        for first, stop in tree.source[tree.leaf]:
            inside = keys[order[first:stop]]
            before = keys[order[:first]]
            assert not len(before) or before.max() <= inside.min()


def test_pieces_of_equal_work():
    """Within the work of one point, on one rank that knows all, and on three."""
    rng = np.random.default_rng(0)
    keys = np.sort(rng.integers(0, 1 << 63, 3000, dtype=np.uint64))
    work = rng.random(3000)

    class Three(OneRank):
        size = 3

    begin = divide(Three(), keys, work)
    each = np.diff(np.append(0.0, work.cumsum())[np.searchsorted(keys, begin)])
    assert np.abs(each - work.sum() / 3).max() <= 1.0


@pytest.mark.parametrize("points", SETS)
def test_cubes_of_two_pieces_are_split_by_any_rule(points):
    """They have points on both sides, and more than twice as many as a leaf."""

    class Four(OneRank):
        size = 4

    columns = SETS[points](np.random.default_rng(1), 2000).T.copy()
    box = Box.around(columns)
    width = 2.0 * float((box.high - box.low).max())
    with Threads() as threads:
        keys = np.sort(keys_of(columns, box, width, threads))
    begin = aligned(Four(), divide(Four(), keys, np.ones(len(keys))), (keys,), LEAF)
    assert (np.diff(begin.astype(float)) >= 0).all()
    shared = Pieces(Four(), box, begin).shared()
    for level, cell in zip(shared.level[1:], shared.cell[1:], strict=True):
        first = first_keys(level, cell[None])[0]
        inside = keys[(keys >= first) & (keys < first + curve.length(level))]
        assert len(inside) > 2 * LEAF
        assert len(np.unique(np.searchsorted(begin, inside, "right"))) > 1


def described(tree, boxes):
    """Return level, cell and number of sources of some boxes."""
    return [(tree.level[i], *tree.cell[i], *np.diff(tree.source[i])) for i in boxes]


@pytest.mark.parametrize("points", SETS)
@pytest.mark.parametrize("size", [2, 5])
def test_leaves_of_all_ranks_are_those_of_one_tree(points, size, on_ranks):
    places = SETS[points](np.random.default_rng(2), 2000)
    columns = places.T.copy()
    box = Box.around(columns)
    width = 2.0 * float((box.high - box.low).max())
    with Threads() as threads:
        tree, _, _ = build_octree(columns.copy(), None, LEAF, width, threads)

    def leaves(comm):
        ranks = ranks_of(comm)
        with Threads(most=1) as threads:
            keys = keys_of(columns, box, width, threads)
            raw = divide(ranks, np.sort(keys[comm.rank :: size]), np.ones(len(keys) // size))
            begin = aligned(ranks, raw, (np.sort(keys[comm.rank :: size]),), LEAF)
            own = (keys >= begin[comm.rank]) & (keys < begin[comm.rank + 1])
            pieces = Pieces(ranks, box, begin)
            tree, _, _ = build_octree(columns[:, own], None, LEAF, width, threads, pieces)
        full = np.flatnonzero(tree.leaf & (np.diff(tree.source)[:, 0] > 0))
        return described(tree, full)

    found = on_ranks(size, leaves)
    wanted = described(tree, np.flatnonzero(tree.leaf))
    assert sorted(itertools.chain(*found)) == sorted(wanted)


# --- sums ----------------------------------------------------------------------------------------


def distributed(on_ranks, kernel, sources, targets, strengths, cuts, **options):
    """Return the values of all ranks one after the other, and the plan of each."""
    size = len(cuts[0])

    def one(comm):
        plan = tc.Plan(kernel, "fmm", comm=comm, distributed=True, **options)
        own = None if targets is None else targets[cuts[-1][comm.rank]]
        plan.set_points(sources[cuts[0][comm.rank]], own)
        return plan.execute(strengths[cuts[0][comm.rank]]), plan

    found = on_ranks(size, one)
    for each in found:
        assert not isinstance(each, Exception), each
    return np.concatenate([values for values, _ in found]), [plan for _, plan in found]


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.parametrize("points", SETS)
def test_values_are_those_of_one_process(points, size, apart, on_ranks):
    """To a tenth of the tolerance, with as many pairs of points."""
    rng = np.random.default_rng(3)
    sources = SETS[points](rng, 3000)
    strengths = rng.standard_normal((len(sources), 3))
    targets = 1.4 * rng.random((1000, 3)) - 0.2 if apart else None
    options = {"tol": 1e-3, "leaf_size": LEAF}
    one = tc.Plan(KERNEL, "fmm", **options).set_points(sources, targets)
    wanted = one.execute(strengths)
    cuts = [shares(len(each), size) for each in (sources, targets) if each is not None]
    values, plans = distributed(on_ranks, KERNEL, sources, targets, strengths, cuts, **options)
    assert tc.relative_error(values, wanted) < 1e-4
    exact = tc.evaluate(KERNEL, sources, strengths, targets, backend="direct")
    assert tc.relative_error(values, exact) < 1e-3
    assert len({plan.info()["near_pairs"] for plan in plans}) == 1
    assert plans[0].choice.parameters["tol"] == 1e-3


UNEVEN = {
    "none on the first": [slice(0, 0), slice(0, 1200), slice(1200, 3000)],
    "one on the last": [slice(0, 1800), slice(1800, 2999), slice(2999, 3000)],
    "all on one": [slice(0, 0), slice(0, 3000), slice(3000, 3000)],
}


@pytest.mark.parametrize("cut", UNEVEN)
def test_any_rank_may_give_any_points(cut, on_ranks):
    """Few or none, of a kernel with torques, to a finer tolerance."""
    kernel = tc.RegularizedStokesletRotlet(epsilon=0.02)
    rng = np.random.default_rng(4)
    points, strengths = rng.random((3000, 3)), rng.standard_normal((3000, 6))
    options = {"tol": 1e-5, "leaf_size": LEAF}
    values, _ = distributed(on_ranks, kernel, points, None, strengths, [UNEVEN[cut]], **options)
    exact = tc.evaluate(kernel, points, strengths, backend="direct")
    assert tc.relative_error(values, exact) < 1e-5


@pytest.mark.parametrize("n", [0, 1, 2, 7])
def test_few_points(n, on_ranks):
    """Fewer than ranks, and none at all."""
    rng = np.random.default_rng(5)
    points, strengths = rng.random((n, 3)), rng.standard_normal((n, 3))
    values, _ = distributed(on_ranks, KERNEL, points, None, strengths, [shares(n, 3)], tol=1e-3)
    exact = tc.evaluate(KERNEL, points, strengths, backend="direct")
    assert np.allclose(values, exact, rtol=1e-12)


def test_one_place(on_ranks):
    """All points are one: no cube parts them."""
    kernel = tc.RegularizedStokeslet(epsilon=1e-3)
    strengths = np.random.default_rng(6).standard_normal((300, 3))
    points = np.ones((300, 3))
    options = {"tol": 1e-3, "leaf_size": LEAF}
    cuts = [shares(300, 3)]
    values, _ = distributed(on_ranks, kernel, points, None, strengths, cuts, **options)
    exact = tc.evaluate(kernel, points, strengths, backend="direct")
    assert np.allclose(values, exact, rtol=1e-6)


def test_stages_are_those_of_a_profile(on_ranks):
    """All of them are shown there, and none is counted within another."""

    def told(comm):
        plan = tc.Plan(KERNEL, "fmm", tol=1e-3, leaf_size=LEAF, comm=comm)
        points = np.random.default_rng(0).random((3000, 3))
        for _ in range(2):
            start = time.perf_counter()
            plan.set_points(points).execute(points)
            whole = time.perf_counter() - start
        return plan.info()["seconds"], whole

    for seconds, whole in on_ranks(2, told):
        assert {"partition", "ghosts", "communication", "gathering"} < set(seconds) < set(STAGES)
        assert sum(seconds.values()) <= whole


def test_work_is_shared_where_points_crowd(on_ranks):
    """Half of the points in a corner; what a rank does is within a tenth of the mean, or a leaf."""
    rng = np.random.default_rng(7)
    points = np.concatenate([rng.random((4000, 3)), 0.02 * rng.random((4000, 3))])
    strengths = rng.standard_normal((8000, 3))
    options = {"tol": 1e-3, "leaf_size": LEAF}
    cuts = [shares(8000, 3)]
    _, plans = distributed(on_ranks, KERNEL, points, None, strengths, cuts, **options)
    work = [plan._sum._across._leaf_work.sum() for plan in plans]
    assert max(work) <= 1.15 * np.mean(work)


def test_the_next_sum_of_moved_points(on_ranks):
    """Pieces and operators are kept; other strengths and other numbers of points are taken."""
    rng = np.random.default_rng(8)
    points, strengths = rng.random((3000, 3)), rng.standard_normal((2, 3000, 3))
    cut = shares(3000, 2)

    def several(comm):
        own = cut[comm.rank]
        plan = tc.Plan(KERNEL, "fmm", tol=1e-4, leaf_size=LEAF, comm=comm, distributed=True)
        out = []
        for moved in (points, points + 0.01, points[::-1]):
            plan.set_points(moved[own])
            out += [plan.execute(q[own]) for q in strengths]
        fewer = own if comm.rank else slice(0, 400)
        return [*out, plan.set_points(points[fewer]).execute(strengths[0][fewer])]

    first, second = on_ranks(2, several)
    for i, moved in enumerate((points, points + 0.01, points[::-1])):
        for k, q in enumerate(strengths):
            both = np.concatenate([first[2 * i + k], second[2 * i + k]])
            assert tc.relative_error(both, tc.evaluate(KERNEL, moved, q, backend="direct")) < 1e-4
    some = np.r_[:400, 1500:3000]
    exact = tc.evaluate(KERNEL, points[some], strengths[0][some], backend="direct")
    assert tc.relative_error(np.concatenate([first[6], second[6]]), exact) < 1e-4


def test_a_tolerance_over_the_targets_of_all(on_ranks):
    """The estimate is that of all values; a finer tolerance that is asked for later is kept."""
    rng = np.random.default_rng(9)
    points, strengths = rng.random((4000, 3)), rng.standard_normal((4000, 3))
    exact = tc.evaluate(KERNEL, points, strengths, backend="direct")
    cut = shares(4000, 2)

    def finer(comm):
        own = cut[comm.rank]
        plan = tc.Plan(KERNEL, "fmm", tol=1e-2, leaf_size=LEAF, comm=comm, distributed=True)
        values = plan.set_points(points[own]).execute(strengths[own])
        told = plan.estimate_error(strengths[own], samples=4000)
        assert plan.refine(strengths[own], 1e-7)
        return values, told, plan.execute(strengths[own]), plan.choice

    found = on_ranks(2, finer)
    coarse, fine = (np.concatenate([each[i] for each in found]) for i in (0, 2))
    assert found[0][1] == found[1][1] == pytest.approx(tc.relative_error(coarse, exact), rel=1e-6)
    assert tc.relative_error(fine, exact) < 1e-7
    assert found[0][3] == found[1][3]


def test_a_choice_has_the_pieces(on_ranks):
    """So a sum that goes on has the same bits; on other ranks the pieces are divided anew."""
    rng = np.random.default_rng(10)
    points, strengths = clumps(rng, 3000), rng.standard_normal((3000, 3))

    def again(comm):
        make = {"tol": 1e-3, "leaf_size": LEAF, "comm": comm}
        plan = tc.Plan(KERNEL, "fmm", **make).set_points(points)
        values = plan.execute(strengths)
        other = tc.Plan(KERNEL, "fmm", **make)
        other.use(tc.Choice(**plan.choice.as_dict()))
        assert np.array_equal(other.set_points(points).execute(strengths), values)
        return plan.choice

    choice = on_ranks(3, again)[0]

    def elsewhere(comm):
        plan = tc.Plan(KERNEL, "fmm", tol=1e-3, leaf_size=LEAF, comm=comm)
        plan.use(choice)
        return plan.set_points(points).execute(strengths)

    exact = tc.evaluate(KERNEL, points, strengths, backend="direct")
    for values in on_ranks(2, elsewhere):
        assert tc.relative_error(values, exact) < 1e-3


REFUSED = {
    "another method": (
        lambda comm: tc.Plan(KERNEL, "kitc", comm=comm, distributed=True),
        r"backend must be 'fmm' with distributed=True, got 'kitc'",
    ),
    "auto": (
        lambda comm: tc.Plan(KERNEL, comm=comm, distributed=True),
        r"backend must be 'fmm' with distributed=True, got 'auto'",
    ),
    "groups": (
        lambda comm: tc.Plan(KERNEL, "fmm", comm=comm, distributed=True).set_points(
            np.eye(3), groups=[0, 0, 1]
        ),
        "groups must be None with distributed=True",
    ),
    "targets of one": (
        lambda comm: tc.Plan(KERNEL, "fmm", comm=comm, distributed=True).set_points(
            np.eye(3), np.eye(3) if comm.rank else None
        ),
        r"targets must be given by all ranks or by none, got None on rank 0",
    ),
    "strengths of one": (
        lambda comm: (
            tc.Plan(KERNEL, "fmm", comm=comm, distributed=True)
            .set_points(np.eye(3))
            .execute(np.ones((3 - comm.rank, 3)))
        ),
        r"strengths must have shape \(3, 3\), got \(2, 3\)",
    ),
    "pieces": (
        lambda comm: tc.Plan(KERNEL, "fmm", comm=comm).use(tc.Choice("fmm", tol=1.0, pieces="g")),
        r"choice.pieces must be hexadecimal numbers of 64 bits, got 'g'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, on_ranks):
    """On all ranks, with the words of the one that fails."""
    make, message = REFUSED[case]
    for error in on_ranks(2, make):
        assert isinstance(error, ValueError)
        with pytest.raises(ValueError, match=message):
            raise error


def test_one_rank_by_itself():
    """With `distributed` it is a plan as any other."""
    rng = np.random.default_rng(11)
    points, strengths = rng.random((2, 500, 3))
    plan = tc.Plan(KERNEL, "fmm", tol=1e-3, distributed=True).set_points(points)
    wanted = tc.evaluate(KERNEL, points, strengths, backend="fmm", tol=1e-3)
    assert np.array_equal(plan.execute(strengths), wanted)


# --- ranks that are processes --------------------------------------------------------------------

PROCESSES = """
kernel = tc.RegularizedStokeslet(1e-3)
points, strengths = rng.random((2, 4000, 3))
own = slice(comm.rank * 300, None if comm.rank == comm.size - 1 else (comm.rank + 1) * 300)
plan = tc.Plan(kernel, "fmm", tol=1e-3, leaf_size=20, comm=comm, distributed=True)
for _ in range(2):
    values = plan.set_points(points[own]).execute(strengths[own])
exact = tc.evaluate(kernel, points, strengths, backend="direct")
assert tc.relative_error(np.concatenate(comm.allgather(values)), exact) < 1e-3
assert plan.estimate_error(strengths[own]) < 1e-3
try:
    plan.execute(strengths[own][: 10 + comm.rank] if comm.rank == 1 else strengths[own])
except ValueError as error:
    told = comm.allgather(str(error))
show(len(set(told)), told[0].split(",")[0])
"""


@by_mpi
@pytest.mark.parametrize("ranks", [2, 4])
def test_values_and_errors_of_processes(ranks, tmp_path):
    """With MPI's own messages; an error of one rank is that of all."""
    rows = 3700 if ranks == 2 else 300
    assert mpirun(ranks, PROCESSES, tmp_path) == f"1 strengths must have shape ({rows}\n"
