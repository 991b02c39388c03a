"""A plan keeps what does not depend on the strengths and tells the truth about its work."""

import numba
import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import FREE, each_backend, each_kernel, each_treecode, random_case
from tests.cases.rotne_prager import RotnePrager
from treecode.methods.fmm import hierarchy

KERNEL = tc.RegularizedStokeslet(epsilon=0.05)


def clustered(n, seed=0):
    """Points at three densities, so that leaves differ in size and depth."""
    rng = np.random.default_rng(seed)
    scale = rng.choice([1.0, 0.1, 0.01], n)[:, None]
    return scale * rng.random((n, 3))


@each_backend
def test_second_execute_equals_a_fresh_plan(backend):
    points = clustered(2000)
    first, second = np.random.default_rng(1).standard_normal((2, 2000, 3))
    plan = tc.Plan(KERNEL, backend, degree=3, leaf_size=50).set_points(points)
    plan.execute(first)
    fresh = tc.Plan(KERNEL, backend, degree=3, leaf_size=50).set_points(points)
    assert np.array_equal(plan.execute(second), fresh.execute(second))


@pytest.mark.parametrize("backend", FREE)
@each_kernel
def test_result_does_not_depend_on_threads(kernel, backend):
    points, strengths, _ = random_case(kernel, 3000, 2)
    plan = tc.Plan(kernel, backend, degree=2, leaf_size=50).set_points(points)
    results = []
    before = numba.get_num_threads()
    try:
        for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
            numba.set_num_threads(threads)
            results.append(plan.execute(strengths))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(result, results[0]) for result in results)


@each_treecode
def test_every_source_counts_once_for_every_target(backend):
    """Near and far pairs of a leaf-only tree add up; with a tree, constants are summed exactly.

    Interpolation reproduces a constant, so the weights of a far cluster add up to its own.
    """
    points = clustered(1500)
    plan = tc.Plan(KERNEL, backend, degree=2, leaf_size=20).set_points(points)
    plan.execute(np.ones((1500, 3)))
    info = plan.info()
    assert info["far_pairs"] > 0
    terms = 27 if backend == "kitc" else 10
    assert info["far_pairs"] % terms == 0
    assert 0 < info["near_pairs"] < 1500**2
    whole = tc.Plan(KERNEL, backend, degree=2, leaf_size=1500).set_points(points)
    whole.execute(np.ones((1500, 3)))
    assert (whole.info()["near_pairs"], whole.info()["far_pairs"]) == (1500**2, 0)


def test_pair_counts_are_those_of_the_papers_recursion():
    """K algorithm 2, target by target, in plain Python over the plan's own clusters."""
    points = clustered(600)
    plan = tc.Plan(KERNEL, "kitc", theta=0.6, degree=1, leaf_size=20).set_points(points)
    plan.execute(np.ones((600, 3)))
    tree, targets = plan._sum._tree, plan._sum.targets.T

    def visit(x, c):
        size = tree.stop[c] - tree.start[c]
        distance = np.linalg.norm(x - tree.center[:, c])
        if distance > 0 and tree.radius[c] <= 0.6 * distance:
            return (0, 8) if size > 8 else (size, 0)
        if tree.children[c] == 0:
            return size, 0
        kids = range(tree.child[c], tree.child[c] + tree.children[c])
        return np.sum([visit(x, kid) for kid in kids], axis=0)

    near, far = np.sum([visit(x, 0) for x in targets], axis=0)
    info = plan.info()
    assert (info["near_pairs"], info["far_pairs"]) == (near, far)


@each_treecode
def test_estimated_error_is_the_error(backend):
    points = clustered(2500)
    strengths = np.random.default_rng(3).standard_normal((2500, 3))
    plan = tc.Plan(KERNEL, backend, degree=3, leaf_size=40).set_points(points)
    exact = tc.evaluate(KERNEL, points, strengths, backend="direct")
    error = tc.relative_error(plan.execute(strengths), exact)
    assert plan.estimate_error(strengths, samples=10_000) == pytest.approx(error, rel=1e-6)
    assert plan.estimate_error(strengths, samples=500) == pytest.approx(error, rel=0.5)


@each_backend
def test_targets_apart_from_sources(backend):
    """Targets anywhere give what the same points give as sources with no strength."""
    points, targets = clustered(1500), np.random.default_rng(5).uniform(-2, 2, (700, 3))
    strengths = np.random.default_rng(4).standard_normal((1500, 3))
    options = {"backend": backend, "theta": 0.5, "degree": 6, "leaf_size": 40}
    apart = tc.evaluate(KERNEL, points, strengths, targets, **options)
    exact = tc.evaluate(KERNEL, points, strengths, targets, backend="direct")
    assert tc.relative_error(apart, exact) < 0.5**6
    own = tc.evaluate(KERNEL, points, strengths, points, **options)
    assert tc.relative_error(own, tc.evaluate(KERNEL, points, strengths, **options)) < 1e-13


def test_info_before_and_after():
    plan = tc.Plan(KERNEL, "kitc", degree=2, leaf_size=30).set_points(clustered(500))
    before = plan.info()
    assert before["near_pairs"] is None
    plan.execute(np.ones((500, 3)))
    info = plan.info()
    assert info["sources"] == info["targets"] == 500
    assert set(info["seconds"]) == {"tree", "weights", "near", "far", "walk"}
    assert info["bytes"] >= 500 * 4 * 8  # coordinates and order at least
    assert info["clusters"] > 1
    assert info["depth"] >= 1


def test_progress_reaches_the_end(capsys):
    tc.evaluate(KERNEL, clustered(1000), np.ones((1000, 3)), backend="direct", progress=True)
    assert "100%" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        (None, "must be a treecode.Choice.*None"),
        ("kitc", "must be a treecode.Choice.*'kitc'"),
        (tc.Choice("nope"), r"\.backend must be one of 'direct', 'kitc', 'taylor', 'fmm'.*'nope'"),
        (tc.Choice("auto"), r"\.backend must be one of"),
        (tc.Choice("kitc"), r"\.theta must be given for backend 'kitc'"),
        (
            tc.Choice("kitc", theta=0.7, degree=0, leaf_size=100),
            r"\.degree must be an integer from 1 to",
        ),
        (
            tc.Choice("taylor", theta=1.7, degree=3, leaf_size=100),
            r"\.theta must be a number between 0 and 1",
        ),
        (
            tc.Choice("taylor", theta=0.7, degree=3, leaf_size=0),
            r"\.leaf_size must be an integer from 1",
        ),
        (tc.Choice("direct", precision="half"), r"\.precision must be one of"),
        (tc.Choice("direct", theta=0.7), r"\.theta must be None with backend 'direct', got 0\.7"),
        (tc.Choice("fmm"), r"\.tol must be given for backend 'fmm'"),
        (tc.Choice("fmm", tol=1e-20), r"\.tol must be a number between 1e-13 and 1"),
        (
            tc.Choice("fmm", tol=1e-2, width=-1.0),
            r"\.width must be a number between 0 \(",
        ),
    ],
)
def test_a_choice_that_is_none_is_refused(choice, words):
    """Before anything is changed."""
    points = clustered(50)
    plan = tc.Plan(KERNEL, "direct").set_points(points)
    values = plan.execute(points)
    with pytest.raises(
        (TypeError, ValueError), match=f"^choice{words}" if words[0] == "\\" else f"^choice {words}"
    ):
        plan.use(choice)
    assert np.array_equal(plan.execute(points), values)


def test_a_choice_for_another_kernel_is_refused():
    with pytest.raises(TypeError, match=r"taylor.*RotnePrager"):
        tc.Plan(RotnePrager(0.1, 1.0)).use(tc.Choice("taylor", theta=0.7, degree=3, leaf_size=100))


def test_points_are_set_after_a_choice():
    points = clustered(50)
    plan = tc.Plan(KERNEL, "direct").set_points(points)
    plan.use(tc.Choice("kitc", theta=0.7, degree=2, leaf_size=10))
    with pytest.raises(RuntimeError, match="set_points must be called first"):
        plan.execute(points)
    assert plan.set_points(points).execute(points).shape == (50, 3)


@pytest.mark.parametrize("options", [{"backend": "fmm"}, {"tol": 1e-3}, {"backend": "kitc"}])
def test_refused_points_change_nothing(options):
    """Where fmm ended in KeyError at the next sum."""
    points = clustered(2000)
    plan = tc.Plan(KERNEL, **options).set_points(points)
    values = plan.execute(points)
    for bad in (np.full((3, 3), np.nan), points[:, :2], np.full((2000, 3), 1e70)):
        with pytest.raises(ValueError, match=r"^sources must"):
            plan.set_points(bad)
        with pytest.raises(ValueError, match=r"^targets must"):
            plan.set_points(points[:5], bad)
        assert np.array_equal(plan.execute(points), values)


def test_points_that_fail_are_none(monkeypatch):
    """Operators that do not fit in memory, say: the plan has neither the old nor the new points."""
    points = clustered(2000)
    plan = tc.Plan(KERNEL, "fmm", tol=1e-2, leaf_size=30).set_points(points)
    plan.execute(points)

    def full(*arguments):
        raise MemoryError

    with monkeypatch.context() as context:
        context.setattr(hierarchy, "get_level", full)
        with pytest.raises(MemoryError):
            plan.set_points(1e3 * points)
    with pytest.raises(RuntimeError, match="set_points must be called first"):
        plan.execute(points)
    values = plan.set_points(1e3 * points).execute(points)
    assert np.array_equal(
        values,
        tc.Plan(KERNEL, "fmm", tol=1e-2, leaf_size=30).set_points(1e3 * points).execute(points),
    )


def test_options_of_evaluate_are_told():
    with pytest.raises(
        TypeError, match=r"evaluate\(\) has the options backend, .*tol, .* got tolerance"
    ):
        tc.evaluate(KERNEL, np.eye(3), np.eye(3), tolerance=1e-3)
