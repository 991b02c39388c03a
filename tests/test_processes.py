"""Threads, forks and other processes: sums go on, with the same bits, and leave no thread."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

HEAD = """
import multiprocessing, os, sys, threading
from concurrent.futures import ThreadPoolExecutor
import numba, numpy as np, treecode as tc
BACKENDS = {"direct": {}, "kitc": {"degree": 3, "leaf_size": 50}, "taylor": {"degree": 3,
    "leaf_size": 50}, "fmm": {"tol": 1e-3, "leaf_size": 60}}
points, forces = np.random.default_rng(0).random((2, 3000, 3))
def total(backend):
    kernel = tc.RegularizedStokeslet(epsilon=0.01)
    return tc.evaluate(kernel, points, forces, backend=backend, **BACKENDS[backend]).tobytes()
def in_child(backend):
    product = np.ones((500, 500)) @ np.ones((500, 500))  # BLAS with its threads
    assert (product == 500.0).all()
    return total(backend)
"""


def run(program, tmp_path, **environment):
    """Run a program from a file, so that other processes can import it; return its output."""
    script = tmp_path / "program.py"
    script.write_text(f"{HEAD}{program}")
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", script],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


POOL = """
if __name__ == "__main__":
    before = [total(backend) for backend in BACKENDS]
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        assert pool.map_async(in_child, BACKENDS).get(timeout=240) == before
    assert [total(backend) for backend in BACKENDS] == before
    print("same")
"""


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
@pytest.mark.parametrize("threads", [1, 4])
def test_a_pool_after_a_sum(method, threads, tmp_path):
    program = POOL.replace("sys.argv[1]", repr(method))
    assert run(program, tmp_path, NUMBA_NUM_THREADS=str(threads)) == "same\n"


def test_a_fork_while_another_thread_sums(tmp_path):
    program = """
expected = total("kitc")
going = True
def keep_on():
    while going:
        assert total("kitc") == expected
with ThreadPoolExecutor(1) as pool:
    other = pool.submit(keep_on)
    for _ in range(20):
        child = os.fork()
        if child == 0:
            os._exit(0 if total("kitc") == expected else 1)
        assert os.waitpid(child, 0)[1] == 0
    going = False
    other.result()
print("same")
"""
    assert run(program, tmp_path, NUMBA_NUM_THREADS="2") == "same\n"


@pytest.mark.parametrize("backend", ["kitc", "fmm"])
def test_a_fork_while_another_thread_has_the_plan(backend, tmp_path):
    """The child has not the thread that would give it back."""
    program = f"""
plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), {backend!r}, **BACKENDS[{backend!r}])
expected = plan.set_points(points).execute(forces).tobytes()
going = True
def keep_on():
    while going:
        assert plan.execute(forces).tobytes() == expected
with ThreadPoolExecutor(1) as pool:
    other = pool.submit(keep_on)
    for _ in range(20):
        child = os.fork()
        if child == 0:
            os._exit(0 if plan.execute(forces).tobytes() == expected else 1)
        assert os.waitpid(child, 0)[1] == 0
    going = False
    other.result()
with plan.lock:  # held by the thread that forks, it stays so
    child = os.fork()
if child == 0:
    os._exit(0 if plan.execute(forces).tobytes() == expected else 1)
assert os.waitpid(child, 0)[1] == 0
print("same")
"""
    assert run(program, tmp_path, NUMBA_NUM_THREADS="2") == "same\n"


def test_a_fork_waits_for_the_compiler(tmp_path):
    """Otherwise the child would wait for ever for a lock that its parent's thread holds."""
    program = """
import time
from numba.core.compiler_lock import global_compiler_lock
held = threading.Event()
def hold():
    with global_compiler_lock:
        held.set()
        time.sleep(1.0)
with ThreadPoolExecutor(1) as pool:
    other = pool.submit(hold)
    held.wait()
    child = os.fork()
    if child == 0:
        os._exit(numba.njit(lambda x: x)(7))
    assert other.done()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert run(program, tmp_path) == "7\n"


def test_a_fork_after_a_progress_bar(tmp_path):
    """A bar has a thread of its own, and locks."""
    program = """
def shown():
    plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), "direct", progress=True)
    return plan.set_points(points).execute(forces).tobytes()
expected = shown()
child = os.fork()
if child == 0:
    os._exit(0 if shown() == expected else 1)
assert os.waitpid(child, 0)[1] == 0
print("same")
"""
    assert run(program, tmp_path) == "same\n"


def test_no_thread_is_left_behind(tmp_path):
    """Neither ours nor those of numba, which would not survive a fork."""
    program = """
from numba.np.ufunc import parallel
for backend in BACKENDS:
    total(backend)
plan = tc.Plan(tc.RegularizedStokeslet(epsilon=0.01), "direct").set_points(points)
print(threading.active_count(), parallel._is_initialized, plan.info()["threads"])
numba.set_num_threads(1)
print(plan.info()["threads"])
"""
    assert run(program, tmp_path, NUMBA_NUM_THREADS="3") == "1 False 3\n1\n"


def test_simulations_in_two_threads(tmp_path):
    """numba's own layer of threads ended the process."""
    program = """
import mrs
def simulate(seed):
    placed = mrs.random_suspension(300, size=4.0, spacing=0.1, seed=seed)
    simulation = mrs.Simulation(
        mrs.Fluid(epsilon=0.05),
        [mrs.Swimmers(*placed, length=0.2, force=1.0)],
        backend=mrs.Backend("kitc", degree=2, leaf_size=40),
        integrator=mrs.Integrator("euler", dt=1e-2),
    )
    simulation.run(0.05)
    return simulation.state.positions.tobytes()
expected = [simulate(seed) for seed in (1, 2)]
with ThreadPoolExecutor(2) as pool:
    for _ in range(3):
        assert list(pool.map(simulate, (1, 2))) == expected
print("same")
"""
    assert run(program, tmp_path, NUMBA_NUM_THREADS="4") == "same\n"
