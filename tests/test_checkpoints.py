"""Checkpoints: exact to the bit, and one that is intact whatever happens."""

import numpy as np
import pytest

from mrs.output import checkpoint
from tests.cases.killed import kill_at_random

STATE = {
    "time": np.array(0.1),
    "positions": np.random.default_rng(0).standard_normal((50, 3)),
    "integrator/vector": np.array([1e-320, np.inf, -0.0]),
    "integrator/steps": np.array([3, 4]),
    "none": np.empty((0, 3)),
}


def test_checkpoint_is_exact(tmp_path):
    path = tmp_path / "checkpoint.h5"
    random = np.random.Generator(np.random.Philox(3))
    random.random(5)
    attributes = {
        "random": random.bit_generator.state,
        "pcg": np.random.default_rng(2**100).bit_generator.state,
        "integrator": {"h": 0.1, "step": np.int64(3), "name": "rkc", "none": None, "list": [1]},
        "config": "x" * 100_000,
    }
    checkpoint.save(path, STATE, attributes)
    arrays, loaded = checkpoint.load(path)
    assert set(arrays) == set(STATE)
    for name, array in STATE.items():
        assert (arrays[name].dtype, arrays[name].shape) == (array.dtype, array.shape)
        assert arrays[name].tobytes() == array.tobytes()
    assert loaded["integrator"] == attributes["integrator"]
    assert loaded["pcg"] == attributes["pcg"]
    again = np.random.Generator(np.random.Philox())
    again.bit_generator.state = loaded["random"]
    assert again.random() == random.random()


def damaged(path, how):
    content = bytearray(path.read_bytes())
    where = content.find(STATE["positions"].tobytes()[:64])
    if how == "bit":
        content[where + 5] ^= 1
    path.write_bytes({"bit": content, "half": content[:where], "empty": b""}[how])
    if how == "missing":
        path.unlink()


@pytest.mark.parametrize("how", ["bit", "half", "empty"])
def test_checkpoint_falls_back(tmp_path, how):
    path = tmp_path / "checkpoint.h5"
    for step in range(3):
        checkpoint.save(path, STATE, {"step": step})
    damaged(path, how)
    with pytest.warns(UserWarning, match="damaged"):
        assert checkpoint.load(path)[1] == {"step": 1}
    checkpoint.save(path, STATE, {"step": 3})
    damaged(path, how)
    with pytest.warns(UserWarning, match="damaged"):  # the damaged one did not replace step 1
        assert checkpoint.load(path)[1] == {"step": 1}
    damaged(path.with_name("checkpoint.previous.h5"), how)
    with pytest.raises(ValueError, match="no intact checkpoint"):
        checkpoint.load(path)


def test_checkpoint_missing(tmp_path):
    path = tmp_path / "checkpoint.h5"
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        checkpoint.load(path)
    checkpoint.save(path, STATE, {"step": 0})
    checkpoint.save(path, STATE, {"step": 1})
    path.unlink()
    with pytest.warns(UserWarning, match="missing"):
        assert checkpoint.load(path)[1] == {"step": 0}


def test_checkpoint_that_cannot_be_written_leaves_the_last(tmp_path):
    path = tmp_path / "checkpoint.h5"
    checkpoint.save(path, STATE, {"step": 0})
    with pytest.raises(TypeError, match="object"):
        checkpoint.save(path, STATE, {"step": object()})
    with pytest.raises(TypeError):
        checkpoint.save(path, {"bad": np.array([object()])}, {})
    assert checkpoint.load(path)[1] == {"step": 0}
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.h5"]


SAVER = """
from mrs.output import checkpoint
for i in range(int(sys.argv[2]), 100_000):
    checkpoint.save(sys.argv[1], {"a/b": np.full(100_000, float(i))}, {"step": i})
    print(i, flush=True)
"""


@pytest.mark.filterwarnings("ignore:.*is missing")  # killed between two renamings
def test_killed_while_saving(tmp_path):
    path = tmp_path / "checkpoint.h5"
    rng = np.random.default_rng(1)
    program = SAVER.replace("int(sys.argv[2])", "0")
    for _ in range(10):
        done = kill_at_random(program, path, rng)
        arrays, attributes = checkpoint.load(path)
        assert attributes["step"] in (done - 1, done, done + 1)
        np.testing.assert_array_equal(arrays["a/b"], np.full(100_000, attributes["step"]))
