"""Plans and simulations in several threads, and copies of them: the same bits as alone."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import mrs
import treecode as tc
from mrs.fluid.mobility import Mobility
from treecode.blas import blas_of_one_thread

KERNEL = tc.RegularizedStokeslet(epsilon=0.02)
WAYS = {
    "direct": {"backend": "direct"},
    "direct in singles": {"backend": "direct", "precision": "float32"},
    "kitc": {"backend": "kitc", "degree": 3, "leaf_size": 100},
    "taylor": {"backend": "taylor", "degree": 3, "leaf_size": 100},
    "fmm": {"backend": "fmm", "tol": 1e-2, "leaf_size": 30},
    "fmm of a degree": {"backend": "fmm", "degree": 3, "tol": 1e-2, "leaf_size": 30},
    "auto": {"tol": 1e-3},
}
each_way = pytest.mark.parametrize("options", WAYS.values(), ids=WAYS)
each_copy = pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda what: pickle.loads(pickle.dumps(what))],
    ids=["copy", "deepcopy", "pickle"],
)


def some(n=4000, strengths=1):
    rng = np.random.default_rng(0)
    return rng.random((n, 3)), *rng.standard_normal((strengths, n, 3))


@each_way
def test_one_plan_in_two_threads(options):
    """Errors of 0.3 to 1.3, when the work arrays of one sum were those of the other."""
    points, f, g, h = some(strengths=3)
    plan = tc.Plan(KERNEL, **options).set_points(points)
    alone = [plan.execute(q) for q in (f, g, h)]
    with ThreadPoolExecutor(3) as pool:
        for _ in range(3):
            together = list(pool.map(plan.execute, (f, g, h)))
            assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def test_threads_that_are_given_points_get_a_sum_of_their_own():
    """What belongs together is held together, by the lock of the plan."""
    points, f = some(2000)
    plan = tc.Plan(KERNEL, "kitc", degree=2, leaf_size=50)

    def moved(factor):
        with plan.lock:
            return plan.set_points(factor * points).execute(f)

    factors = 1.0, 2.0, 3.0
    alone = [moved(factor) for factor in factors]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(moved, factors))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))


def suspension(**options):
    x, p = mrs.random_suspension(300, 5.0, 0.15, reach=0.3, seed=1)
    swimmers = mrs.Swimmers(x, p, length=0.3, force=0.1, epsilon=0.06)
    return mrs.Simulation(mrs.Fluid(), [swimmers], **options)


def test_one_simulation_in_two_threads():
    """Evaluations of several states, and velocities meanwhile."""
    sim = suspension(backend=mrs.Backend("kitc", theta=0.6, degree=3, leaf_size=50))
    states = [sim.state._replace(positions=s * sim.state.positions) for s in (1.0, 1.1, 1.2)]
    where = np.random.default_rng(0).uniform(0.0, 5.0, (500, 3))
    alone = [sim.scene.rates(0.0, state) for state in states]
    field = sim.velocity(where)
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            asked = pool.submit(sim.velocity, where)
            together = list(pool.map(lambda state: sim.scene.rates(0.0, state), states))
            assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))
            assert np.array_equal(asked.result(), field)
    assert all(seconds >= 0.0 for seconds in sim.profile.seconds.values())


def test_looking_at_a_run_from_another_thread_changes_nothing():
    """Its time is that of the stage that the run is in."""
    quiet, watched = (suspension(backend="direct") for _ in range(2))
    quiet.run(0.1)
    seen = []

    class Look(mrs.Tracker):
        def handle(self, sim):
            with ThreadPoolExecutor(1) as pool:
                seen.append(pool.submit(sim.velocity, np.zeros((1, 3))).result())

    watched.trackers.append(Look())
    watched.run(0.1)
    assert seen
    assert np.array_equal(quiet.state.positions, watched.state.positions)
    assert set(watched.profile.seconds) == set(quiet.profile.seconds)


def blas_threads():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_blas_gets_its_threads_back():
    """Whoever of two sums ends last: the number is that of the process."""
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        first, second = (blas_of_one_thread for _ in range(2))
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert set(blas_threads()) == {1}
        second.__exit__(None, None, None)
        assert blas_threads() == before


# --- copies -----------------------------------------------------------------------------------


@each_copy
@each_way
def test_copies_of_plans(options, copied):
    """Empty, with points, and after a sum."""
    points, f = some(2000)
    plan = tc.Plan(KERNEL, **options)
    values = copied(plan).set_points(points).execute(f)
    assert np.array_equal(copied(plan.set_points(points)).execute(f), values)
    assert np.array_equal(plan.execute(f), values)
    after = copied(plan)
    assert np.array_equal(after.execute(f), values)
    assert after.choice == plan.choice
    plan.set_points(points[::2])  # is not the copy's concern
    assert np.array_equal(after.execute(f), values)


@each_copy
def test_copies_of_mobilities(copied):
    points, f = some(2000)
    no = np.zeros(len(points), bool)
    body = np.repeat([0, 1], len(points) // 2)
    make = 1.0, np.full(len(points), 0.02), body == 0, no, no, body, mrs.Backend(tolerance=1e-3)
    sums = Mobility(*make)
    values = copied(sums)(points, f)
    assert np.array_equal(sums(points, f), values)
    assert np.array_equal(copied(sums)(points, f), values)
    assert copied(sums).history() == sums.history()


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda sim: pickle.loads(pickle.dumps(sim))])
def test_copies_of_simulations(copied):
    """They go on alone, bit by bit alike."""
    sim = suspension(backend=mrs.Backend("kitc", tolerance=1e-3))
    sim.run(0.05)
    other = copied(sim)
    assert np.array_equal(other.run(0.1).state.positions, sim.run(0.1).state.positions)
