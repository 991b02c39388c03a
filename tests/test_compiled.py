"""What the compiler made: vector instructions, cache hits. Both fail without a sign otherwise."""

import os
import re
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

import treecode as tc
from tests.cases.oracle import each_kernel

X86 = llvm.get_process_triple().startswith("x86_64")
ROOT = Path(__file__).parents[1]


def assembly(kernel, folder):
    """Compile the direct driver anew (a cached one has no assembly) and return its assembly."""
    program = f"""
import numpy as np, treecode as tc
from treecode.traversal import evaluate_batches
kernel = tc.{kernel!r}
tc.evaluate(kernel, np.eye(3), np.ones((3, kernel.strength_size)), backend="direct")
print(*evaluate_batches.dispatcher(type(kernel)).inspect_asm().values())
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return run.stdout


@pytest.mark.skipif(not X86, reason="counts x86 instructions")
@each_kernel
def test_pair_loop_is_packed(kernel, tmp_path):
    """The loop over sources works on the widest vectors there are, and never divides."""
    wide = "zmm" if llvm.get_host_cpu_features().get("avx512f") else "[xy]mm"
    loops = re.split(r"\n(?=\.LBB\d+_\d+:)", assembly(kernel, tmp_path))
    packed = re.compile(rf"\tv?(?:fn?m\w+|add|sub|mul)pd\t.*%{wide}\d")
    scalar = re.compile(r"\tv?(?:fn?m\w+|add|sub|mul|div|sqrt)sd\t")
    best = max(loops, key=lambda loop: len(packed.findall(loop)))
    body = best[: best.index("\tj")]  # up to the jump that closes the loop
    assert len(packed.findall(body)) >= 4 * 29  # four vectors, 29 operations each at least
    assert len(scalar.findall(body)) <= 3  # 2 S_xy of the stresslet, once for 32 targets
    assert not re.search(r"\tv?(div|sqrt)[ps]d", body)


COUNT = """
import sys, time
import numpy as np, treecode as tc
from treecode.traversal import evaluate_batches, write_weights
from treecode.tree import _build
from treecode.upward import _fill
kernel = tc.RegularizedStokeslet(epsilon=0.1)
points = np.random.default_rng(0).random((100, 3))
for backend in ("direct", "kitc", "taylor"):
    tc.evaluate(kernel, points, points, backend=backend, degree=2, leaf_size=9)
drivers = [d.dispatcher(type(kernel)) for d in (evaluate_batches, write_weights)]
for dispatcher in (*drivers, _build, _fill):
    stats = dispatcher.stats
    print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def counts(program, folder, cwd=ROOT):
    """Run a program in a new process; return rows of cache hits and misses."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(folder),
        "PYTHONPATH": f"{ROOT}{os.pathsep}{cwd}",
    }
    run = subprocess.run(
        [sys.executable, *program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        cwd=cwd,
    )
    return np.array([line.split() for line in run.stdout.splitlines()], int)


def test_second_process_compiles_nothing(tmp_path):
    first = counts(["-c", COUNT], tmp_path)
    assert first[:, 1].min() > 0
    second = counts(["-c", COUNT], tmp_path)
    assert second[:, 0].min() > 0
    assert second[:, 1].max() == 0


USER = """
from typing import NamedTuple
import numpy as np, treecode as tc
from treecode.traversal import evaluate_batches
class Constant(NamedTuple):
    value: float
    strength_size = 1
    weight_size = 1
    value_size = 1
    value_lengths = (0,)
    def weights(self, q):
        return q
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + FACTOR * self.value * w[0],)
def main():
    out = tc.evaluate(Constant(1.0), np.eye(3), np.ones((3, 1)), backend="direct")
    stats = evaluate_batches.dispatcher(Constant).stats
    print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
    print(round(out[0, 0]), 0)
"""


def test_an_edited_kernel_is_compiled_again(tmp_path):
    """The classical trap: numba keeps the machine code of a function whose callee has changed."""
    script = tmp_path / "kernel.py"
    results = []
    for factor in (1, 1, 2):
        script.write_text(USER.replace("FACTOR", str(factor)))
        program = ["-c", "import kernel; kernel.main()"]
        results.append(counts(program, tmp_path / "cache", tmp_path).tolist())
    assert results == [[[0, 1], [3, 0]], [[1, 0], [3, 0]], [[0, 1], [6, 0]]]


def test_inverse_sqrt_is_accurate_over_the_whole_range():
    """Within two units of the last place of the exact value, from 1e-307 to 1e308."""

    @numba.njit
    def call(x):
        return np.array([tc.inverse_sqrt(value) for value in x])

    rng = np.random.default_rng(0)
    x = np.concatenate([10 ** rng.uniform(-307, 308, 100_000), rng.uniform(1, 4, 100_000)])
    exact = 1 / np.sqrt(x.astype(np.longdouble))
    assert np.abs(call(x) / exact - 1).max() < 4.4e-16


BITS = """
import sys
import numpy as np, treecode as tc
rng = np.random.default_rng(0)
points, forces = rng.uniform(-1, 1, (400, 3)), rng.uniform(-1, 1, (400, 3))
for backend in sys.argv[1:]:
    for epsilon in (1e-3, 0.1):
        kernel, options = tc.RegularizedStokeslet(epsilon), {"degree": 5, "leaf_size": 40}
        values = tc.evaluate(kernel, points, forces, backend=backend, theta=0.6, **options)
        print(backend, epsilon, values.sum().hex(), np.abs(values).sum().hex())
"""


def test_code_that_was_compiled_and_loaded_gives_the_same_bits(tmp_path):
    """In whatever order: a run that goes on in another process must not differ."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    found = []
    for order in (["taylor", "kitc"], ["taylor", "kitc"], ["kitc", "taylor"]):
        command = [sys.executable, "-c", BITS, *order]
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found.append(sorted(run.stdout.splitlines()))
    assert len(found[0]) == 4
    assert found[0] == found[1] == found[2]
