"""What is kept on disk for later processes is told, cleared and bounded; other files are spared."""

import os
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from treecode import cache

ROOT = Path(__file__).parents[1]
OLD, NEW = "0123456789abcdef", "fedcba9876543210"
FOREIGN = [f"mine_{'0' * 40}/f.nbc", f"{OLD}/notes.txt", "operators/notes.txt", "a/b.npz"]


def keep(root, name, size, used):
    """Write a file of `size` bytes that was used last at the hour `used`."""
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size))
    os.utime(path, (3600.0 * used, 3600.0 * used))
    return path


@pytest.fixture
def root(monkeypatch, tmp_path):
    """Return a cache with two versions, operators, and files of other programs."""
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    keep(tmp_path, f"{OLD}/treecode_0/f.nbi", 1, used=1)  # as earlier versions did
    keep(tmp_path, f"{OLD}/treecode_0/f.1.nbc", 20, used=2)
    keep(tmp_path, f"{NEW}/f.0.nbc", 300, used=5)
    keep(tmp_path, f"{NEW}/g.0.nbc", 4000, used=4)
    keep(tmp_path, "operators/level.npz", 50_000, used=3)
    keep(tmp_path, "operators/level.npz.0.part", 600_000, used=0)  # of a process that was killed
    for name in FOREIGN:
        keep(tmp_path, name, 7, used=0)
    return tmp_path


def left(root):
    """Return the names of all files."""
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def test_contents(root):
    found = [(kept.path.name, kept.kind, kept.bytes, kept.used) for kept in cache.contents()]
    hours = [datetime.fromtimestamp(3600.0 * hour) for hour in (5, 3, 2)]
    assert found == [
        (NEW, "compiled code", 4300, hours[0]),
        ("operators", "operators", 650_000, hours[1]),
        (OLD, "compiled code", 21, hours[2]),
    ]


def test_clear_spares_what_others_keep(root):
    assert cache.clear() == 654_321
    assert left(root) == set(FOREIGN)
    assert not (root / NEW).exists()
    assert cache.contents() == []
    assert cache.clear() == 0


def test_compiled_code_that_was_not_used_for_longest_goes(root, monkeypatch):
    """To a bound in bytes; folders that are empty then go as well."""
    before = left(root)
    monkeypatch.setattr(cache, "COMPILED_BYTES", 4320)
    cache.prune_compiled()
    assert before - left(root) == {f"{OLD}/treecode_0/f.nbi"}
    monkeypatch.setattr(cache, "COMPILED_BYTES", 1)  # what was used last stays
    cache.prune_compiled()
    compiled = {name for name in before if name.startswith((OLD, NEW))} - set(FOREIGN)
    assert before - left(root) == compiled - {f"{NEW}/f.0.nbc"}
    assert not (root / OLD / "treecode_0").exists()


def test_use_counts(root, monkeypatch):
    """An old version that is used again outlives a newer one."""
    cache.mark_used(root / OLD / "treecode_0" / "f.1.nbc")
    monkeypatch.setattr(cache, "COMPILED_BYTES", 320)
    cache.prune_compiled()
    assert {f"{OLD}/treecode_0/f.1.nbc", f"{NEW}/f.0.nbc"} <= left(root)
    assert f"{NEW}/g.0.nbc" not in left(root)


def test_no_folder(monkeypatch, tmp_path):
    for place in (None, tmp_path / "missing"):
        monkeypatch.setattr(cache, "folder", lambda place=place: place)
        assert cache.contents() == []
        assert cache.clear() == 0


PROGRAM = """
import treecode as tc
from treecode._jit import compiled

def twice(x):
    return 2.0 * x

print(compiled(twice)(4.0), tc.cache.folder())
"""


def test_compiling_prunes_and_loading_marks(tmp_path):
    """In a process of its own: what no version uses any more goes once a newer one compiles."""
    unused = keep(tmp_path, f"{OLD}/f.0.nbc", 0, used=1)
    os.truncate(unused, cache.COMPILED_BYTES)
    os.utime(unused, (3600.0, 3600.0))
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    for _ in ("compiles", "loads"):
        command = [sys.executable, "-c", PROGRAM]
        out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert out.stdout == f"8.0 {tmp_path}\n"
        assert not unused.parent.exists()
        (file,) = tmp_path.rglob("*.nbc")
        assert file.stat().st_mtime > 3600.0
        os.utime(file, (3600.0, 3600.0))
