"""A wall goes with all that a plan does: copies, groups, choices that are used again, and ranks."""

import copy
import pickle

import numpy as np
import pytest

import treecode as tc

KERNEL = tc.RegularizedStokeslet(epsilon=0.02)
WALL = tc.Wall(normal=(0.0, 0.6, 0.8))
WAYS = {
    "direct": {"backend": "direct"},
    "kitc": {"backend": "kitc", "degree": 3, "leaf_size": 100},
    "taylor": {"backend": "taylor", "degree": 3, "leaf_size": 100},
    "fmm": {"backend": "fmm", "tol": 1e-2, "leaf_size": 30},
}
each_way = pytest.mark.parametrize("options", WAYS.values(), ids=WAYS)


def points_and_forces(n=3000):
    """Return points over the wall, some of them on it, and forces."""
    rng = np.random.default_rng(0)
    points = rng.random((n, 3)) @ WALL.frame
    points[:10] -= np.outer(WALL.heights(points[:10]), WALL.normal)
    return points, rng.standard_normal((n, 3))


@each_way
@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda plan: pickle.loads(pickle.dumps(plan))], ids=["copy", "pickle"]
)
def test_copies_give_the_same_bits(options, copied):
    points, forces = points_and_forces(1000)
    plan = tc.Plan(KERNEL, **options, boundary=WALL).set_points(points)
    np.testing.assert_array_equal(copied(plan).execute(forces), plan.execute(forces))


@each_way
def test_a_choice_gives_the_same_bits(options):
    """A resumed run has the choice, and points that have moved since it was made."""
    points, forces = points_and_forces()
    plan = tc.Plan(KERNEL, **options, boundary=WALL).set_points(points)
    plan.execute(forces)
    moved = 1.1 * points
    expected = plan.set_points(moved).execute(forces)
    other = tc.Plan(KERNEL, **options, boundary=WALL)
    other.use(tc.Choice(**plan.choice.as_dict()))
    np.testing.assert_array_equal(other.set_points(moved).execute(forces), expected)


def test_each_term_of_fmm_has_its_own_root():
    """Its side is in the choice, under the number of the term."""
    points, forces = points_and_forces()
    plan = tc.Plan(KERNEL, "fmm", tol=1e-2, boundary=WALL).set_points(points)
    plan.execute(forces)
    assert {"width", "1.width"} <= set(plan.choice.parameters)
    with pytest.raises(ValueError, match=r"choice\.2\.width must be None"):
        plan.use(tc.Choice(**plan.choice.as_dict(), **{"2.width": 1.0}))


def test_tolerance_of_groups():
    """Targets near the wall, where the flow is small, have errors of their own."""
    points, forces = points_and_forces()
    low = points - np.outer(0.999 * WALL.heights(points), WALL.normal)
    targets, groups = np.concatenate([points, low]), np.repeat([0, 1], len(points))
    plan = tc.Plan(KERNEL, "kitc", tol=1e-4, boundary=WALL)
    values = plan.set_points(points, targets, groups).execute(forces)
    exact = tc.evaluate(KERNEL, points, forces, targets, backend="direct", boundary=WALL)
    for group in (0, 1):
        one = groups == group
        assert tc.relative_error(values[one], exact[one]) <= 1e-4
    assert np.abs(exact[groups == 1]).max() < 0.1 * np.abs(exact[groups == 0]).max()


@each_way
def test_ranks_share_the_terms(options, on_ranks):
    """Walks give the bits of one process; the fast multipole method sums in another order."""
    points, forces = points_and_forces()
    expected = tc.Plan(KERNEL, **options, boundary=WALL).set_points(points).execute(forces)

    def one(comm):
        plan = tc.Plan(KERNEL, **options, boundary=WALL, comm=comm)
        return plan.set_points(points).execute(forces)

    for values in on_ranks(3, one):
        if options["backend"] == "fmm":
            assert tc.relative_error(values, expected) < 1e-3
        else:
            np.testing.assert_array_equal(values, expected)


def test_ranks_have_points_of_their_own(on_ranks):
    """Each rank makes the images of its points."""
    points, forces = points_and_forces()
    exact = tc.evaluate(KERNEL, points, forces, backend="direct", boundary=WALL)

    def one(comm):
        mine = slice(comm.rank, None, comm.size)
        plan = tc.Plan(KERNEL, "fmm", tol=1e-3, boundary=WALL, comm=comm, distributed=True)
        return plan.set_points(points[mine]).execute(forces[mine])

    found = np.empty_like(exact)
    for rank, values in enumerate(on_ranks(2, one)):
        found[rank::2] = values
    assert tc.relative_error(found, exact) <= 1e-3
