"""Every public name has an example in its docstring, and the example gives what it shows."""

import doctest
import inspect

import numba
import public
import pytest

from mrs.registry import Registry
from treecode.methods import registry

THINGS = public.things()
REGISTRIES = [thing for thing in THINGS.values() if isinstance(thing, Registry)]


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """A working directory with nothing in it; what an example registers is forgotten."""
    monkeypatch.chdir(tmp_path)
    registries = [*REGISTRIES, registry._methods]
    before = [dict(known) for known in registries]
    yield tmp_path
    for known, things in zip(registries, before, strict=True):
        known.clear()
        known.update(things)


@pytest.mark.parametrize("name", THINGS)
def test_example(name, fresh, monkeypatch):
    """It imports all that it uses, since it has no globals."""
    if name.startswith("treecode.cache."):  # examples that may delete what is there
        monkeypatch.setattr(numba.config, "CACHE_DIR", str(fresh))
    text = inspect.getdoc(THINGS[name])
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert test.examples, f"{name} must have an example in its docstring"
    told = []
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=told.append)
    assert not result.failed, "".join(told)
