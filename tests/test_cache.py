"""Compiled code and operators on disk: never needed, never stale."""

import enum
import json
import math
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import treecode as tc
from treecode import _jit, cache
from treecode._fingerprint import fingerprint
from treecode.methods.fmm import store

ROOT = Path(__file__).parents[1]


def add_one(x):
    return x + 1.0


def add_two(x):
    return x + 2.0


def counts(function=add_one):
    """Call a function that is compiled as in a new process; return cache hits and misses."""
    compiled = _jit.compiled(function)
    assert compiled(1.0) == function(1.0)
    return sum(compiled.stats.cache_hits.values()), sum(compiled.stats.cache_misses.values())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty cache folder that is used."""
    monkeypatch.setattr(_jit._CONFIG, "CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


HIT, MISS = (1, 0), (0, 1)


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data[:-1],
        lambda data: data[:500] + bytes([data[500] ^ 1]) + data[501:],
        lambda data: bytes(len(data)),
    ],
    ids=["empty", "half", "cut", "one bit", "zeros"],
)
def test_a_damaged_file_is_compiled_again_and_mended(folder, damage):
    assert [counts(), counts()] == [MISS, HIT]
    (file,) = folder.rglob("*.nbc")
    file.write_bytes(damage(file.read_bytes()))
    assert [counts(), counts()] == [MISS, HIT]


def test_each_version_has_a_file(folder):
    """Entered in an index, versions of two processes that start together could be exchanged."""
    for _ in range(2):
        compiled = _jit.compiled(add_one)
        assert (compiled(1.0), compiled(np.float32(1.0)), compiled(1)) == (2.0, 2.0, 2.0)
    assert len(list(folder.rglob("*.nbc"))) == 3
    files = sorted(folder.rglob("*.nbc"))
    files[0].write_bytes(files[1].read_bytes())  # sound, but another version
    compiled = _jit.compiled(add_one)
    assert (compiled(1.0), compiled(np.float32(1.0)), compiled(1)) == (2.0, 2.0, 2.0)


def test_a_folder_that_cannot_be_written(folder):
    """Said once, for all functions, with the folder, the reason and the remedy."""
    folder.write_text("a file in its place")
    with pytest.warns(RuntimeWarning) as said:
        assert [counts(), counts(add_two), counts()] == [MISS, MISS, MISS]
    assert len(said) == 1
    assert re.search(rf"{re.escape(str(folder))} \(.+\): .*NUMBA_CACHE_DIR", str(said[0].message))


@pytest.mark.parametrize("call", ["open", "replace", "mkdir"])
def test_a_full_disk(folder, call, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, call, full)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert counts() == MISS
    monkeypatch.undo()
    assert not list(folder.rglob("*.part"))


def test_files_of_another_owner(folder, monkeypatch):
    def denied(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    assert counts() == MISS
    monkeypatch.setattr(Path, "read_bytes", denied)
    monkeypatch.setattr(Path, "replace", denied)
    with pytest.warns(RuntimeWarning, match="Permission denied"):
        assert counts() == MISS


def no_home(*arguments, **options):
    raise RuntimeError("could not determine the home directory")


@pytest.mark.parametrize("answer", [no_home, lambda *a, **k: "~/.cache/treecode"])
def test_no_home(answer, folder, monkeypatch, tmp_path):
    """A user without one; older platformdirs answer with a folder "~"."""
    monkeypatch.setattr(_jit._CONFIG, "CACHE_DIR", "")
    monkeypatch.setattr(cache, "_warned", set())
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", answer)
    monkeypatch.chdir(tmp_path)
    with pytest.warns(RuntimeWarning, match=r"no home folder.*NUMBA_CACHE_DIR"):
        assert [counts(), counts()] == [MISS, MISS]
    assert list(tmp_path.iterdir()) == []
    assert store.folder() is None


def test_import_with_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "file" / "cache"),
        "PYTHONPATH": str(ROOT),
    }
    subprocess.run([sys.executable, "-c", "import treecode, mrs"], env=environment, check=True)


# --- operators ---


@pytest.fixture
def built(tmp_path, monkeypatch):
    """Keep operators in an empty folder; return a list that grows when some are built."""
    monkeypatch.setattr(store, "folder", lambda: tmp_path)
    calls = []
    build = store.build_level

    def build_level(*arguments):
        calls.append(arguments)
        return build(*arguments)

    monkeypatch.setattr(store, "build_level", build_level)
    return calls


def get_level():
    """Get operators as a new process does."""
    store._memory.clear()
    return store.get_level(tc.Stokeslet(), 1.0, 0.1, None, np.float32)


def test_operators_that_cannot_be_touched_are_used(built, monkeypatch):
    def denied(*arguments):
        raise PermissionError(1, "Operation not permitted")

    first = get_level()
    monkeypatch.setattr(os, "utime", denied)
    assert np.array_equal(get_level().matrices, first.matrices)
    assert len(built) == 1


def test_damaged_operators_are_built_again(built, tmp_path):
    first = get_level()
    (file,) = tmp_path.glob("*.npz")
    data = file.read_bytes()
    for place in (0, 60, len(data) // 2, len(data) - 40):
        wrong = bytes(byte ^ 255 for byte in data[place : place + 30])
        file.write_bytes(data[:place] + wrong + data[place + 30 :])
        assert np.array_equal(get_level().matrices, first.matrices)
    count = len(built)
    file.write_bytes(data[:100])
    get_level()
    get_level()
    assert len(built) == count + 1


def test_operators_on_a_full_disk(built, tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_jit._CONFIG, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(np, "savez", full)
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        get_level()
    assert list(tmp_path.iterdir()) == []


# --- keys ---


class Table(NamedTuple):
    """A kernel with an array as a parameter."""

    values: np.ndarray


@pytest.mark.interpreted
def test_arrays_count_in_full():
    """Printed, an array is rounded, and its middle left out."""
    one, other, close = np.arange(3000.0), np.arange(3000.0), np.arange(3000.0)
    other[1500], close[1] = -1.0, 1.0 + 1e-12
    assert repr(Table(one)) == repr(Table(other)) == repr(Table(close))
    assert fingerprint(Table(one)) == fingerprint(Table(one.copy()))
    assert len({fingerprint(Table(values)) for values in (one, other, close)}) == 3


@pytest.mark.interpreted
def test_what_may_differ_elsewhere_has_no_fingerprint():
    for value in (object(), np.array([object()]), (1, [object()]), sys.stdout):
        assert fingerprint(value) is None
    assert fingerprint(-0.0) != fingerprint(0.0)
    assert fingerprint((1,), 2) != fingerprint((1, 2))


def make(factor, table=((1, 2), 3)):
    local = [factor]

    def function(x):
        return x * local[0] + table[1]

    return function


@pytest.mark.interpreted
def test_closures_and_defaults_count():
    assert fingerprint(make(1.0)) == fingerprint(make(1.0))
    assert fingerprint(make(1.0)) != fingerprint(make(2.0))
    assert fingerprint(make) == fingerprint(make)


class Parts(enum.Enum):
    SMALL = 1.0
    LARGE = 2.0


class Scale:
    factor = 2.0
    other = object()  # not read


def all_sorts(x, *, shift=1j):
    if x in {"one", "two"}:
        return Parts.LARGE.value * Scale.factor + np.sqrt(x) + math.pi * np.float64(3.0) + shift
    return (lambda y: y * os.path.sep)(x)


@pytest.mark.interpreted
def test_what_a_function_reads_counts(monkeypatch):
    """Classes and modules by what is read of them, known packages by name."""
    before = fingerprint(all_sorts)
    assert before == fingerprint(all_sorts) is not None
    assert fingerprint({"a": {1, 2}}, [frozenset("ab")]) == fingerprint({"a": {2, 1}}, [{"b", "a"}])
    monkeypatch.setattr(Scale, "other", object())
    assert fingerprint(all_sorts) == before
    monkeypatch.setattr(Scale, "factor", 3.0)
    assert fingerprint(all_sorts) != before
    monkeypatch.undo()
    monkeypatch.setattr(os.path, "sep", "|")
    assert fingerprint(all_sorts) != before
    assert fingerprint(lambda: Scale.other) is None


# What a kernel can be made of, each in a file of its own; one number in each is edited.
FILES = {
    "base.py": """
from typing import NamedTuple
class Base(NamedTuple):
    size: float = 1.0
    strength_size = 1
    weight_size = 1
    value_size = 1
    value_lengths = (1,)
    def weights(self, q):
        return q
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + NUMBER * w[0],)
""",
    "constants.py": "FACTOR = NUMBER\n",
    "inner/__init__.py": "from inner import numbers\n",
    "inner/numbers.py": "FACTOR = NUMBER\n",
    "helpers.py": """
import numba
@numba.njit(fastmath={"contract", "nsz", "arcp"})
def scaled(x):
    return NUMBER * x
""",
    "registered.py": """
from numba.extending import register_jitable
@register_jitable
def scaled(x):
    return NUMBER * x
""",
    "stub.py": "def scaled(x):\n    raise NotImplementedError\n",
    "overload.py": """
import stub
from numba.extending import overload
@overload(stub.scaled)
def _(x):
    return lambda x: NUMBER * x
""",
    "made.py": """
from base import Base
def make(factor):
    class Made(Base):
        def pair(self, dx, dy, dz, w, acc):
            return (acc[0] + factor * w[0],)
    return Made
""",
    "table.json": "[NUMBER]",
    "kernels.py": """
import json
from pathlib import Path
import numpy as np
import constants, helpers, inner, made, overload, registered, stub
from base import Base
from constants import FACTOR
TABLE = np.array(json.loads(Path(__file__).with_name("table.json").read_text()), float)
class Inherited(Base):
    pass
class Global(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + FACTOR * w[0],)
class OfModule(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + constants.FACTOR * w[0],)
class OfInnerModule(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + inner.numbers.FACTOR * w[0],)
class Helper(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + helpers.scaled(w[0]),)
class Registered(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + registered.scaled(w[0]),)
class Overloaded(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + stub.scaled(w[0]),)
class FromData(Base):
    def pair(self, dx, dy, dz, w, acc):
        return (acc[0] + TABLE[0] * w[0],)
Closed = made.make(FACTOR)
Closed.__module__, Closed.__qualname__ = __name__, "Closed"
KERNELS = [Inherited, Global, OfModule, OfInnerModule, Helper, Registered, Overloaded, FromData,
    Closed]
""",
    "driver.py": """
import json
from treecode._jit import Driver
from treecode.kernels.base import pair
import kernels
@Driver
def one(kernel):
    return pair(kernel, 1.0, 2.0, 3.0, (1.0,), (0.0,))[0]
def main():
    rows = {}
    for kernel in kernels.KERNELS:
        value, stats = one(kernel()), one.dispatcher(kernel).stats
        rows[kernel.__name__] = [value, sum(stats.cache_hits.values())]
    print(json.dumps(rows))
""",
}


def test_an_edit_is_seen_wherever_it_is_made(tmp_path):
    """In new processes: an answer follows, and code that has not changed is not compiled again."""

    def answers(number):
        for name, text in FILES.items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(text.replace("NUMBER", str(number)))
        done = subprocess.run(
            [sys.executable, "-B", "-c", "import driver; driver.main()"],
            env=os.environ
            | {
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
                "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}",
            },
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        rows = json.loads(done.stdout)
        assert len(rows) == 9
        return rows

    def every(row):
        return dict.fromkeys(first, row)

    first = answers(2)
    assert first == every([2.0, 0])
    assert answers(2) == every([2.0, 1])
    assert answers(5) == every([5.0, 0])
    assert answers(2) == every([2.0, 1])


GLOBAL = 1.0


@pytest.mark.interpreted
def test_a_global_that_changes_in_the_process_is_refused(monkeypatch):
    class Reads(tc.Stokeslet):
        def weights(self, q):
            return GLOBAL * q[0], q[1], q[2]

    tc.Plan(Reads(), "direct")
    tc.Plan(Reads(), "direct")
    monkeypatch.setitem(globals(), "GLOBAL", 2.0)
    with pytest.raises(RuntimeError, match=r"Reads, or a global that it reads, has changed"):
        tc.Plan(Reads(), "direct")


def test_a_class_defined_anew_is_another_kernel():
    """As in a notebook; an id, by which operators were kept, can be that of one that is gone."""

    def define(factor):
        class Same(tc.Stokeslet):
            def weights(self, q):
                return factor * q[0], factor * q[1], factor * q[2]

        return Same()

    values = [
        tc.evaluate(define(factor), np.eye(3), np.ones((3, 3)), backend="direct")
        for factor in (1.0, 2.0)
    ]
    assert np.allclose(values[1], 2.0 * values[0], rtol=1e-15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _jit.kernel_key(type(define(3.0))) is None
