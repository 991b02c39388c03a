"""The fast multipole method reaches its tolerance, on any points, with any kernel that it takes."""

import math
import re
from typing import NamedTuple

import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import each_kernel, exact, random_case, with_epsilon
from tests.cases.rotne_prager import RotnePrager
from tests.test_degenerate import POINTS
from treecode.choice import search
from treecode.methods import fmm
from treecode.methods.fmm import hierarchy, legendre, octree, operators, sizing, store, symmetry
from treecode.methods.fmm.level import OFFSETS, meeting
from treecode.methods.fmm.symmetry import find_symmetry
from treecode.threads import Threads

KERNEL = tc.RegularizedStokeslet(epsilon=0.05)


@pytest.fixture(autouse=True)
def _own_store(monkeypatch, tmp_path_factory):
    """Operators of the tests are kept together, apart from the user's."""
    root = tmp_path_factory.getbasetemp() / "operators"
    monkeypatch.setattr(store, "folder", lambda: root)


def error(kernel, tol, points, strengths, targets=None, **options):
    """Return the relative error and the plan."""
    plan = tc.Plan(kernel, "fmm", tol=tol, **options).set_points(points, targets)
    expected = tc.evaluate(kernel, points, strengths, targets, backend="direct")
    return tc.relative_error(plan.execute(strengths), expected), plan


@each_kernel
def test_reaches_the_tolerance(kernel):
    """In a cube of random points most pairs are far."""
    tol = 1e-3
    points, strengths, _ = random_case(kernel, 6000, 0)
    achieved, plan = error(kernel, tol, points, strengths, leaf_size=30)
    info = plan.info()
    assert achieved <= tol
    assert info["near_pairs"] < 0.2 * 6000**2
    singular = not hasattr(kernel, "epsilon")
    assert info["precision"] == ("float64" if singular else "float32")
    levels = plan._sum._operators.levels.values()
    # A kernel without a length of its own needs the operators of one size alone.
    assert len({id(level.matrices) for level in levels}) == (1 if singular else len(levels))
    assert len(levels) > 1


def test_converges():
    """Each tolerance is reached, and is not reached by accident: the error falls with it."""
    points, strengths, _ = random_case(KERNEL, 3000, 1)
    errors = []
    tolerances = 10.0 ** -np.array([2.0, 4.0, 6.0])
    for tol in tolerances:
        achieved, plan = error(KERNEL, tol, points, strengths, leaf_size=40)
        assert plan.info()["near_pairs"] < 0.5 * 3000**2
        errors.append(achieved)
    assert np.all(errors <= tolerances)
    assert np.all(np.diff(np.log10(errors)) < -1.0)


@pytest.mark.slow
@pytest.mark.parametrize("tol", [1e-8, 1e-10, 1e-12])
def test_converges_to_rounding(tol):
    """Twelve digits; operators of up to two gigabytes a level."""
    points, strengths, _ = random_case(KERNEL, 3000, 1)
    achieved, plan = error(KERNEL, tol, points, strengths, leaf_size=40)
    assert plan.info()["near_pairs"] < 0.5 * 3000**2
    assert achieved <= tol


def test_same_sign():
    """Forces that all point one way: nearly all of the flow comes from afar."""
    points, _, _ = random_case(KERNEL, 6000, 2)
    achieved, _ = error(KERNEL, 1e-4, points, np.ones((6000, 3)), leaf_size=30)
    assert achieved <= 1e-4


@pytest.mark.parametrize("kernel", [KERNEL, tc.Stokeslet()], ids=["blob", "singular"])
@pytest.mark.parametrize("name", POINTS)
def test_points_no_one_wishes_for(kernel, name):
    """However the points lie and whatever their scale."""
    make, length = POINTS[name]
    kernel = with_epsilon(kernel, 0.1 * length)
    points = make(np.random.default_rng(1))
    strengths = np.random.default_rng(0).uniform(-1.0, 1.0, (len(points), kernel.strength_size))
    plan = tc.Plan(kernel, "fmm", tol=1e-2, leaf_size=10).set_points(points)
    expected = exact(kernel, points, strengths, None)
    assert tc.relative_error(plan.execute(strengths), expected.astype(float)) <= 1e-2
    assert plan.info()["depth"] <= 48


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e3])
def test_units_do_not_matter(unit):
    """In metres or micrometres forces and torques are done with the same accuracy, in singles."""
    points, strengths, _ = random_case(KERNEL, 3000, 15)
    kernel = tc.RegularizedStokesletRotlet(epsilon=0.05 * unit)
    loads = 1e-9 * np.hstack([strengths, unit * strengths[::-1]])
    plan = tc.Plan(kernel, "fmm", tol=1e-2, leaf_size=20).set_points(unit * points)
    values = plan.execute(loads)
    expected = tc.evaluate(kernel, unit * points, loads, backend="direct")
    for columns in (slice(0, 3), slice(3, 6)):
        assert tc.relative_error(values[:, columns], expected[:, columns]) <= 1e-2
    assert plan.info()["precision"] == ("float32" if unit > 1e-9 else "float64")


@pytest.mark.parametrize("targets", [None, 0, 1, 5])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_points(count, targets):
    points, strengths, others = random_case(KERNEL, count, 3, targets=targets)
    achieved, _ = error(KERNEL, 1e-6, points, strengths, others)
    assert achieved < 1e-14


def clump(count, rng):
    """Return points of a cube, half of them in a clump a thousandth of its side."""
    points = rng.uniform(-1.0, 1.0, (count, 3))
    points[::2] = 0.3 + 1e-3 * points[::2]
    return points


def test_cubes_of_different_size_meet():
    """Beside a clump large leaves act on small cubes and small cubes on large leaves."""
    rng = np.random.default_rng(4)
    points = clump(6000, rng)
    kernel = tc.RegularizedStokeslet(epsilon=1e-4)
    strengths = np.ones((6000, 3))
    achieved, plan = error(kernel, 1e-4, points, strengths, leaf_size=20)
    assert achieved <= 1e-4
    assert len(plan._sum._lists.proxy_boxes)
    assert len(plan._sum._lists.coarse_boxes)
    assert plan.info()["near_pairs"] < 0.1 * 6000**2


def test_targets_apart():
    """Targets inside, beside and far away from the sources, and much fewer."""
    points, strengths, _ = random_case(KERNEL, 6000, 5)
    rng = np.random.default_rng(6)
    targets = rng.uniform(-1.0, 1.0, (400, 3)) * rng.choice([1.0, 3.0, 100.0], (400, 1))
    achieved, _ = error(KERNEL, 1e-4, points, strengths, targets, leaf_size=30)
    assert achieved <= 1e-4


def test_moving_points_keep_the_operators(monkeypatch):
    """While the root fits nothing is built, nor looked up, in later steps."""
    points, strengths, _ = random_case(KERNEL, 4000, 8)
    plan = tc.Plan(KERNEL, "fmm", tol=1e-2, leaf_size=30).set_points(points)
    monkeypatch.setattr(hierarchy, "get_level", None)
    moved = 0.99 * points
    values = plan.set_points(moved).execute(strengths)
    expected = tc.evaluate(KERNEL, moved, strengths, backend="direct")
    assert tc.relative_error(values, expected) <= 1e-2


@pytest.mark.parametrize(
    ("cells", "extra", "depth"), [(0, 0, 3), (2, 3, 3), (4, 3, 4), (1, 4, 3), (1, 5, 4)]
)
def test_levels_are_not_opened_for_few(cells, extra, depth):
    """A lattice of full leaves, and some that are fuller: 1 % of the points, or twice as full."""
    rng = np.random.default_rng(11)
    corners = (np.indices((8, 8, 8)).reshape(3, -1, 1) + np.array([0.25, 0.75, 0.25, 0.75])) / 8.0
    more = corners[:, :cells, :1] + rng.uniform(0.0, 0.05, (3, cells, extra))
    points = np.concatenate([corners.reshape(3, -1), more.reshape(3, -1)], axis=1)
    with Threads() as threads:
        tree, _, _ = octree.build_octree(points, None, 4, 1.0, threads)
    assert tree.depth == depth


def test_user_kernel():
    """A kernel known by its values alone, that of another file."""
    rng = np.random.default_rng(9)
    points, forces = rng.random((4000, 3)), rng.standard_normal((4000, 3))
    achieved, plan = error(RotnePrager(0.01, 1.3), 1e-3, points, forces, leaf_size=40)
    assert achieved <= 1e-3
    assert plan.info()["far_pairs"] > 0


def stokeslet_table(kernel, points):
    """Return K 7.2 at points (3, n), (n, 3, 3): what `tabulate` does, fast without a compiler."""
    r = points.T
    distance = np.sqrt((r * r).sum(axis=1) + kernel.epsilon**2)[:, None, None]
    h1 = 1.0 / distance + kernel.epsilon**2 / distance**3
    return np.eye(3) * h1 + r[:, :, None] * r[:, None] / distance**3


@pytest.mark.interpreted
def test_table_of_a_kernel():
    points = np.random.default_rng(14).uniform(-1.0, 1.0, (3, 5))
    kernel = tc.RegularizedStokeslet(epsilon=0.3)
    assert symmetry.tabulate(kernel, points) == pytest.approx(stokeslet_table(kernel, points))


class Chiral(NamedTuple):
    """Not its own mirror image: force to velocity along it and across it."""

    strength_size = weight_size = value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        s = 1.0 / (1.0 + dx * dx + dy * dy + dz * dz)
        return (
            acc[0] + s * (w[0] + w[1] * dz - w[2] * dy),
            acc[1] + s * (w[1] + w[2] * dx - w[0] * dz),
            acc[2] + s * (w[2] + w[0] * dy - w[1] * dx),
        )


def test_chiral_kernel_is_refused():
    points = np.random.default_rng(10).random((400, 3))
    with pytest.raises(ValueError, match=r"isotropic.*Chiral"):
        tc.Plan(Chiral(), "fmm", leaf_size=10).set_points(points)


class Unused(NamedTuple):
    """A fourth strength that does nothing."""

    strength_size = weight_size = 4
    value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        s = tc.inverse_sqrt(1e-4 + dx * dx + dy * dy + dz * dz)
        d = s * s * s * (w[0] * dx + w[1] * dy + w[2] * dz)
        return acc[0] + s * w[0] + d * dx, acc[1] + s * w[1] + d * dy, acc[2] + s * w[2] + d * dz


class Silent(Unused):
    """A fourth value that is always zero."""

    strength_size = weight_size = 3
    value_size = 4
    value_lengths = (1, 1, 1, 1)

    def pair(self, dx, dy, dz, w, acc):
        s = tc.inverse_sqrt(1e-4 + dx * dx + dy * dy + dz * dz)
        return acc[0] + s * w[0], acc[1] + s * w[1], acc[2] + s * w[2], acc[3]


class Compact(NamedTuple):
    """Nothing beyond a distance."""

    reach: float

    strength_size = weight_size = value_size = 1
    value_lengths = (0,)

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        r2 = (dx * dx + dy * dy + dz * dz) / (self.reach * self.reach)
        t = tc.where(r2 < 1.0, 1.0 - r2, 0.0)
        return (acc[0] + w[0] * t * t * t * t,)


@pytest.mark.parametrize(
    ("kernel", "words"),
    [
        (Unused(), "number 3 of its weight_size.*Unused"),
        (Silent(), "number 3 of its value_size.*Silent"),
        (Compact(0.02), "vanishes at a distance.*Compact"),
        (Compact(0.3), "vanishes at a distance.*Compact"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_kernels_it_does_not_take_are_refused(monkeypatch, kernel, words):
    """By name, where SVDs did not converge; and "auto" takes what needs no operators of theirs."""
    monkeypatch.setattr(search, "FEW", 0)
    rng = np.random.default_rng(17)
    points, strengths = rng.random((2000, 3)), rng.standard_normal((2000, kernel.strength_size))
    with pytest.raises(ValueError, match=f"^backend must be 'kitc' or 'direct' .*{words}"):
        tc.Plan(kernel, "fmm", leaf_size=10).set_points(points)
    method, offers = type(fmm.METHOD), fmm.METHOD.offers

    def cheapest(self, case, given):
        return [offer._replace(seconds=1e-9 * offer.seconds) for offer in offers(case, given)]

    monkeypatch.setattr(method, "offers", cheapest)
    monkeypatch.setattr(method, "building_seconds", lambda *args: 0.0)
    plan = tc.Plan(kernel, tol=1e-3).set_points(points)
    values = plan.execute(strengths)
    exact_values = tc.evaluate(kernel, points, strengths, backend="direct")
    assert tc.relative_error(values, exact_values) <= 1e-3
    # Without operators it sums points, as it does where there are few.
    assert plan.choice.backend != "fmm" or plan.info()["degree"] is None


class Uneven(NamedTuple):
    """Lengths along x count for more: only y and z may change places."""

    strength_size = weight_size = value_size = 3
    value_lengths = (1, 1, 1)

    def weights(self, q):
        return q

    def pair(self, dx, dy, dz, w, acc):
        s = tc.inverse_sqrt(0.01 + 1.5 * dx * dx + dy * dy + dz * dz)
        d = s * s * s * (w[0] * dx + w[1] * dy + w[2] * dz)
        return (
            acc[0] + s * w[0] + d * dx,
            acc[1] + s * w[1] + d * dy,
            acc[2] + s * w[2] + d * dz,
        )


def test_kernel_of_less_symmetry():
    rng = np.random.default_rng(13)
    points, strengths = rng.random((3000, 3)), rng.standard_normal((3000, 3))
    assert find_symmetry(Uneven(), 0.1).values.axes.tolist() == [[0, 1, 2], [0, 2, 1]]
    achieved, plan = error(Uneven(), 1e-4, points, strengths, leaf_size=40)
    assert achieved <= 1e-4
    assert plan.info()["far_pairs"] > 0


@each_kernel
def test_axes_may_change_places(kernel):
    """Torques and angular velocities change their sign too if the handedness does."""
    found = find_symmetry(kernel, 0.1)
    assert len(found.values.axes) == 6
    assert found.adjoint == (kernel.weight_size == kernel.value_size)
    if kernel.value_size == 6:
        swap = found.values.axes.tolist().index([1, 0, 2])
        assert found.values.becomes[swap].tolist() == [1, 0, 2, 4, 3, 5]
        assert found.values.signs[swap].tolist() == [1, 1, 1, -1, -1, -1]


@pytest.mark.interpreted
def test_operators_come_from_disk(monkeypatch, tmp_path):
    """A level is built once, read by others, built again if damaged; the disk is bounded."""
    for module in (operators, symmetry):
        monkeypatch.setattr(module, "tabulate", stokeslet_table)
    monkeypatch.setattr(store, "folder", lambda: tmp_path)

    def get(half):
        store._memory.clear()
        return store.get_level(KERNEL, half, 1e-2, 2, np.float32)

    built = get(0.5)
    (path,) = tmp_path.glob("*")
    with monkeypatch.context() as context:
        context.setattr(store, "build_level", None)
        read = get(0.5)
    for one, other in zip(built, read, strict=True):
        for a, b in zip(*(x if isinstance(x, tuple) else (x,) for x in (one, other)), strict=True):
            assert np.array_equal(a, b)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:3000] + b"????" + whole[3004:]):
        path.write_bytes(damaged)
        assert np.array_equal(get(0.5).matrices, built.matrices)
    assert path.stat().st_size == len(whole)
    monkeypatch.setattr(store, "DISK_BYTES", 2.5 * len(whole))
    for half in (1.0, 2.0, 4.0):
        get(half)
    assert len(list(tmp_path.glob("*"))) == 2


@each_kernel
def test_translations_are_the_kernel(kernel):
    """Point to point through two cubes: C_t is the kernel for every mirror image of t."""
    half, tol = 0.7, 1e-3
    level = operators.build_level(kernel, half, tol, None, np.float64)
    rng = np.random.default_rng(11)
    x, y = rng.uniform(-1.0, 1.0, (2, 3, 40))

    def functions(points, bases, members, channels):
        p = [legendre.polynomials(axis, level.degree) for axis in points]
        products = np.einsum("an,bn,cn->abcn", *p).reshape(level.degree**3, -1)
        out = np.zeros((8, level.rank, channels, points.shape[1]))
        for c in range(8):
            full = np.zeros((channels * level.degree**3, level.rank))
            full[members[c]] = bases[c]
            full = full.reshape(channels, -1, level.rank)
            out[c] = np.einsum("ikm,kn->min", full, products)
        return out

    u = functions(x, level.value_bases(float), level.value_members, kernel.value_size)
    v = functions(y, level.source_bases(float), level.source_members, kernel.weight_size)
    for t, offset in enumerate(OFFSETS):
        used = level.used[t]
        matrix = level.matrices[level.begin[t] : level.begin[t + 1]].reshape(8, -1, used)
        for signs in ((1, 1, 1), (-1, 1, -1)):
            shift = 2.0 * np.array(offset) * signs
            expected = operators.tabulate(kernel, half * (shift[:, None] + x - y))
            total = np.zeros_like(expected)
            for p in range(8):
                for k, q in enumerate(meeting(p, offset)):
                    parity = math.prod(s for d, s in enumerate(signs) if (p ^ q) >> d & 1)
                    block = parity * matrix[p, k * used : (k + 1) * used]
                    total += np.einsum("bm,min,bjn->nij", block, u[p, :used], v[q, :used])
            scale = np.linalg.norm(expected)
            assert np.linalg.norm(total - expected) < 20 * tol * scale


@pytest.mark.interpreted
def test_small_enough_to_interpret(monkeypatch):
    """All passes, between cubes of one size and of different sizes."""
    for module in (operators, symmetry):
        monkeypatch.setattr(module, "tabulate", stokeslet_table)
    rng = np.random.default_rng(12)
    points = rng.uniform(-1.0, 1.0, (60, 3))
    points[::2] = 0.3 + 0.05 * points[::2]
    forces = np.ones((60, 3))
    kernel = tc.RegularizedStokeslet(epsilon=0.011)  # of no other test: nothing is kept
    achieved, plan = error(kernel, 0.5, points, forces, leaf_size=1, degree=1)
    assert achieved < 0.3
    assert plan.info()["far_pairs"] > 0
    targets = rng.uniform(-1.0, 1.0, (5, 3))
    achieved, _ = error(kernel, 0.5, points, forces, targets, leaf_size=4, degree=1)
    assert achieved < 0.3


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
def test_memory_is_foreseen(monkeypatch, tol):
    """What operators would take is known within a factor of 3, and refused if it is too much."""
    points, strengths, _ = random_case(KERNEL, 4000, 12)
    plan = tc.Plan(KERNEL, "fmm", tol=tol, leaf_size=30).set_points(points)
    held = sum(level.matrices.nbytes for level in plan._sum._operators.levels.values())
    sizes = len(plan._sum._operators.levels)

    def allowed(room):
        least = held * (1.0 + sizing._BUILDING / sizes) / sizing._MEMORY
        monkeypatch.setattr(sizing, "memory_limit", lambda: room * least)
        return tc.Plan(KERNEL, "fmm", tol=tol, leaf_size=30).set_points

    allowed(3.0)(points)
    with pytest.raises(ValueError, match=r"tol must be .* to fit in memory, got 0\.0") as refusal:
        allowed(1.0 / 3.0)(points)
    least = float(re.search(r"at least (\S+)", str(refusal.value))[1])
    tc.Plan(KERNEL, "fmm", tol=least, leaf_size=30).set_points(points)
    allowed(0.0)(points[:30])  # needs no operators
    # Another sum is found.
    plan = tc.Plan(KERNEL, tol=1e-2).set_points(points)
    assert tc.relative_error(plan.execute(strengths), exact(KERNEL, points, strengths)) <= 1e-2
    assert plan.backend != "fmm"
