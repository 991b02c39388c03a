"""Ranks of MPI share a sum: the same bits as one process, and one error for all."""

import copy
import os
import pickle
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import treecode as tc
from treecode.shared_sum import along_curve

ROOT = Path(__file__).parents[1]
PLACES = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
MPIRUN = shutil.which("mpirun", path=PLACES)

try:
    import mpi4py
except ImportError:
    mpi4py = None

by_mpi = pytest.mark.skipif(
    MPIRUN is None or mpi4py is None, reason="mpi4py or mpirun is missing: pip install '.[test]'"
)

KERNEL = tc.RegularizedStokeslet(epsilon=0.05)
TREECODES = {
    "direct": {"backend": "direct"},
    "kitc": {"backend": "kitc", "degree": 3, "leaf_size": 60},
    "kitc in singles": {"backend": "kitc", "degree": 3, "leaf_size": 60, "precision": "float32"},
    "taylor": {"backend": "taylor", "degree": 3, "leaf_size": 60},
}


def test_the_tests_have_an_mpi():
    """The extra `test` installs both, so that these tests are not skipped where all are run."""
    text = (ROOT / "pyproject.toml").read_text()
    (extra,) = (line for line in text.splitlines() if line.startswith("test = "))
    assert '"mpi4py>=4"' in extra
    assert '"mpich>=' in extra


# --- ranks that are processes --------------------------------------------------------------------

HEAD = """
import os, sys, time
import numpy as np
from mpi4py import MPI
import treecode as tc
comm = MPI.COMM_WORLD
rng = np.random.default_rng(0)
def show(*words):
    if comm.rank == 0:
        print(*words, flush=True)
"""


def mpirun(ranks, program, tmp_path, *, passes=True, timeout=300):
    """Run a program on some ranks of one thread each; return what it writes."""
    script = tmp_path / "program.py"
    script.write_text(f"{HEAD}{program}")
    done = subprocess.run(
        [MPIRUN, "-n", str(ranks), sys.executable, script],
        env=os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert (done.returncode == 0) == passes, done.stderr
    return done.stdout if passes else done.stderr


SAME_BITS = f"""
WAYS = {TREECODES!r}
for kernel in (tc.RegularizedStokeslet(0.05), tc.RegularizedStokesletRotlet(0.05)):
    points, forces = rng.random((2000, 3)), rng.standard_normal((2000, kernel.strength_size))
    apart = 3.0 * rng.random((500, 3)) - 1.0
    for targets in (None, apart, apart[:2], apart[:0]):
        for name, options in WAYS.items():
            one = tc.Plan(kernel, **options).set_points(points, targets)
            all_ = tc.Plan(kernel, **options, comm=comm).set_points(points, targets)
            for scale in (1.0, 3.0):
                q = scale * forces
                assert np.array_equal(one.execute(q), all_.execute(q)), (name, kernel, len(one))
        for options in ({{"backend": "fmm", "tol": 1e-3, "leaf_size": 60}}, {{"tol": 1e-3}}):
            one = tc.Plan(kernel, **options).set_points(points, targets).execute(forces)
            plan = tc.Plan(kernel, **options, comm=comm).set_points(points, targets)
            values = plan.execute(forces)
            assert len(one) == 0 or tc.relative_error(values, one) <= 1e-4
            assert len(one) == 0 or plan.estimate_error(forces, by_unit=True) <= 1e-3
            assert len(set(comm.allgather(str(plan.choice and plan.choice.as_dict())))) == 1
            assert len(set(comm.allgather(values.tobytes()))) == 1
show("same")
"""


@by_mpi
@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_sums_are_those_of_one_process(ranks, tmp_path):
    """Bitwise for direct sums and treecodes, a tenth of the tolerance for the others."""
    assert mpirun(ranks, SAME_BITS, tmp_path) == "same\n"


MOVED_SHARES = f"""
from tests.cases.inverse_distance import InverseDistance
WAYS = {TREECODES!r}
points, charges = rng.random((3000, 3)), rng.standard_normal((3000, 3))
points[::2] = 0.3 + 1e-3 * points[::2]
targets = 3.0 * rng.random((1000, 3)) - 1.0
for kernel in (InverseDistance(0.05), tc.RegularizedStokeslet(0.05)):
    q = charges[:, :kernel.strength_size]
    for where in (None, targets):
        for name, options in WAYS.items():
            alone = tc.Plan(kernel, **options)
            plan = tc.Plan(kernel, **options, comm=comm)
            for step in range(4):
                one, all_ = [
                    each.set_points(points + 0.01 * step, where).execute(q)
                    for each in (alone, plan)
                ]
                assert np.array_equal(one, all_), (name, kernel, step)
                assert plan.info()["near_pairs"] == alone.info()["near_pairs"]
            work = comm.allgather(plan._sum._own.effort)
            assert max(work) < 1.1 * np.mean(work), (name, kernel, work)
few = points[:9]  # and one cluster
for options in ({{"backend": "kitc", "degree": 1}}, {{"backend": "taylor", "degree": 1}}):
    plan = tc.Plan(kernel, **options, comm=comm)
    for where in (None, few + 5.0, few[:1] + 5.0):
        one = tc.evaluate(kernel, few, q[:9], where, **options)
        assert np.array_equal(plan.set_points(few, where).execute(q[:9]), one), options
show("same")
"""


@by_mpi
@pytest.mark.parametrize("ranks", [2, 4])
def test_shares_that_follow_the_work_change_no_bit(ranks, tmp_path):
    """Of a clump that moves, targets apart from it, and one cluster for all ranks."""
    assert mpirun(ranks, MOVED_SHARES, tmp_path) == "same\n"


CHOICES = """
points, forces = rng.random((2, 4000, 3))
kernel = tc.RegularizedStokeslet(0.05)
alone = tc.Plan(kernel, tol=1e-2).set_points(points)
alone.execute(forces)

plan = tc.Plan(kernel, tol=1e-2, comm=comm).set_points(points)
plan.execute(forces)
assert plan.choice == alone.choice
assert plan.refine(forces, 1e-6) and alone.refine(forces, 1e-6)
assert plan.choice == alone.choice
plan.use(tc.EXACT)
alone.use(tc.EXACT)
values = [each.set_points(points).execute(forces) for each in (plan, alone)]
assert np.array_equal(*values)

plan = tc.Plan(kernel, tol=1e-2, comm=comm).set_points(points)
make = plan._search._make
def refusing(choice, *arguments):
    if comm.rank == 1 and choice.backend == "kitc":
        raise ValueError("no memory")
    return make(choice, *arguments)
plan._search._make = refusing
plan.execute(forces)
(choice,) = set(comm.allgather(plan.choice.backend))
show(choice != "kitc")
"""


@by_mpi
def test_one_choice_for_all(tmp_path):
    """That of one process, also when it is made anew; and none that a rank cannot make."""
    assert mpirun(2, CHOICES, tmp_path) == "True\n"


FAULTS = {
    "bad strengths": (
        "if comm.rank == 1: forces[3] = np.nan",
        "forces",
        "ValueError: strengths must be finite",
    ),
    "no memory": (
        """
if comm.rank == 1:
    def fail(*arguments): raise MemoryError("too little")
    plan._sum.execute = fail
""",
        "forces",
        "MemoryError: too little",
    ),
    "other strengths": (
        "forces = forces + comm.rank",
        "forces",
        "ValueError: strengths must be the same on all ranks",
    ),
    "outside a call": ("assert comm.rank != 1, 'of its own'", "forces", "AssertionError: of its"),
    "ctrl-C": (
        "if comm.rank == 1: os.kill(os.getpid(), 2)",
        "forces",
        "",
    ),
    "lost": ("if comm.rank == 1: os.kill(os.getpid(), 9)", "forces", ""),
}


@by_mpi
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_one_rank_ends_all(fault, tmp_path):
    """With one message, and at once: the others would wait for ever."""
    before, strengths, message = FAULTS[fault]
    program = f"""
points, forces = rng.random((2, 500, 3))
plan = tc.Plan(tc.RegularizedStokeslet(0.05), "direct", comm=comm).set_points(points)
plan.execute(forces)
{before}
start = time.monotonic()
while time.monotonic() < start + 60.0:
    plan.execute({strengths})
"""
    start = time.monotonic()
    said = mpirun(2, program, tmp_path, passes=False, timeout=50)
    assert time.monotonic() - start < 40.0  # of which most is the start
    assert not message or said.count(message) == 1, said


# --- ranks that are threads, which are quicker ---------------------------------------------------


def some(n=1500):
    rng = np.random.default_rng(0)
    return rng.random((n, 3)), rng.standard_normal((n, 3))


@pytest.mark.parametrize("options", TREECODES.values(), ids=TREECODES)
def test_the_same_bits_in_threads(options, on_ranks):
    points, forces = some()
    one = tc.evaluate(KERNEL, points, forces, **options)
    found = on_ranks(3, lambda comm: tc.evaluate(KERNEL, points, forces, **options, comm=comm))
    assert all(np.array_equal(values, one) for values in found)


def test_what_a_plan_of_ranks_tells(on_ranks):
    points, forces = some()
    alone = tc.Plan(KERNEL, "kitc", degree=3, leaf_size=60).set_points(points)
    alone.execute(forces)

    def told(comm):
        plan = tc.Plan(KERNEL, "kitc", degree=3, leaf_size=60, comm=comm).set_points(points)
        plan.execute(forces)
        return plan.info()

    for info in on_ranks(2, told):
        assert info["ranks"] == 2
        assert info["near_pairs"] == alone.info()["near_pairs"]
        assert info["far_pairs"] == alone.info()["far_pairs"]
        assert info["received_bytes"] > 750 * 3 * 8  # values, and expansions
        assert {"sharing", "expansions", "waiting", "communication"} < set(info["seconds"])


def test_an_error_of_one_is_that_of_all(on_ranks):
    """And the ranks go on together after it."""
    points, forces = some()

    def twice(comm):
        plan = tc.Plan(KERNEL, "direct", comm=comm).set_points(points)
        wrong = forces[: 10 + comm.rank] if comm.rank else forces
        with pytest.raises(ValueError, match=r"strengths must have shape \(1500, 3\)") as told:
            plan.execute(wrong)
        return str(told.value), plan.execute(forces).tobytes()

    first, second, third = on_ranks(3, twice)
    assert first[0].endswith("got (11, 3)")  # of the first rank that fails
    assert first == second == third


def test_errors_that_cannot_be_sent(on_ranks):
    """Another rank tells what it can, and shows where it was."""

    class OddError(Exception):
        def __init__(self, one, two):
            super().__init__(f"{one} and {two}")

    def failing(comm):
        plan = tc.Plan(KERNEL, "direct", comm=comm)
        with plan.ranks.together():
            if comm.rank == 1:
                raise OddError("this", "that")

    told, own, _ = on_ranks(3, failing)
    assert isinstance(own, OddError)
    assert isinstance(told, RuntimeError)
    assert str(told) == "OddError: this and that"
    assert "in failing" in str(told.__cause__)


def test_points_must_be_the_same_on_all_ranks(on_ranks):
    """Other numbers, another order, another shape."""
    points, _ = some()
    turned = points[::-1].copy()
    for others in (points + 1e-9, turned, points[:-1]):

        def placed(comm, others=others):
            mine = others if comm.rank == 1 else points
            tc.Plan(KERNEL, "direct", comm=comm).set_points(mine)

        for error in on_ranks(2, placed):
            assert isinstance(error, ValueError)
            assert "sources must be the same on all ranks, got others on rank 1" in str(error)


def test_copies_and_pickles(on_ranks):
    points, forces = some()

    def copied(comm):
        plan = tc.Plan(KERNEL, "direct", comm=comm).set_points(points)
        other = copy.copy(plan)
        with pytest.raises(TypeError, match="cannot be pickled"):
            pickle.dumps(plan)
        return np.array_equal(other.execute(forces), plan.execute(forces))

    assert on_ranks(2, copied) == [True, True]


@pytest.mark.parametrize("comm", [2, "world", object()])
def test_what_is_no_communicator(comm):
    with pytest.raises(TypeError, match="comm must be a communicator of mpi4py"):
        tc.Plan(KERNEL, comm=comm)


def test_neighbours_along_the_curve():
    """An eighth of a cube of points is an octant of it."""
    grid = np.indices((16, 16, 16)).reshape(3, -1).astype(float)
    points = np.random.default_rng(0).permutation(grid, axis=1)
    pieces = np.split(points[:, along_curve(points)], 8, axis=1)
    assert all((np.ptp(piece, axis=1) == 7.0).all() for piece in pieces)
    same = np.ones((3, 5))
    assert np.array_equal(along_curve(same), np.arange(5))
    assert np.array_equal(along_curve(1e-306 * points), along_curve(points))
