"""A method of summation is one object in one registry: whoever registers one has it everywhere."""

import ast
import json
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

import mrs
import treecode as tc
from tests.cases import grid_method
from tests.cases.grid_method import Grid, MergedSum
from tests.cases.tolerance import achieved
from tests.test_refusals import matches
from treecode import methods
from treecode.choice import search
from treecode.methods import registry
from treecode.methods.base import KEYWORDS, Method, Offer

ROOT = Path(__file__).parents[1]
KERNEL = tc.RegularizedStokeslet(epsilon=0.01)
PERIODIC = tc.PeriodicKernel(KERNEL, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


@pytest.fixture(autouse=True)
def _own_registry(monkeypatch):
    """Methods of one test are not those of others."""
    monkeypatch.setattr(registry, "_methods", dict(registry._methods))


def far_case(n=4000, m=300, distance=30.0):
    """Return sources in a unit cube, random forces, and targets far away."""
    rng = np.random.default_rng(0)
    targets = rng.random((m, 3)) + np.array([distance, 0.0, 0.0])
    return rng.random((n, 3)), rng.standard_normal((n, 3)), targets


# --- a method from outside --------------------------------------------------------------------


def test_by_name_it_converges():
    """Twice as many cells halve the error, in the mean over forces: where in a cell they act."""
    methods.register(Grid())
    points, _, targets = far_case(distance=4.0)
    forces = np.random.default_rng(3).standard_normal((60, len(points), 3))
    direct = tc.Plan(KERNEL, tc.EXACT.backend).set_points(points, targets)
    exact = np.array([direct.execute(q) for q in forces])
    errors = []
    for cells in (2, 4, 8, 16):
        plan = tc.Plan(KERNEL, "grid", degree=cells).set_points(points, targets)
        errors.append(tc.relative_error(np.array([plan.execute(q) for q in forces]), exact))
        assert str(plan.choice) == f"grid({cells})"
        assert plan.info()["near_pairs"] <= cells**3 * len(targets)
    assert np.diff(np.log2(errors)) == pytest.approx(-1.0, abs=0.25)


def test_by_name_it_keeps_a_tolerance():
    """Its default is sampled first; where that is not enough its offers are; or it is refused."""
    methods.register(Grid())
    points, q, targets = far_case()
    plan = tc.Plan(KERNEL, "grid", tol=1e-2).set_points(points, targets)
    assert achieved_at(points, q, targets, plan.execute(q)) <= 1e-2
    assert plan.choice.parameters["degree"] == 8
    fewer = tc.Plan(KERNEL, "grid", degree=2, tol=4e-3).set_points(points, targets)
    assert achieved_at(points, q, targets, fewer.execute(q)) <= 4e-3
    assert fewer.choice.parameters["degree"] > 2
    with pytest.raises(tc.ToleranceError, match=r"^tol must be at least .*'grid'.*got 1e-09"):
        tc.Plan(KERNEL, "grid", tol=1e-9).set_points(points, targets).execute(q)


@pytest.mark.parametrize("value", [0, 101, 2.5, "3"])
def test_its_parameters_are_checked_by_what_it_declares(value):
    methods.register(Grid())
    with pytest.raises((TypeError, ValueError), match=r"^degree must be an integer from 1 to 100"):
        tc.Plan(KERNEL, "grid", degree=value)
    with pytest.raises((TypeError, ValueError), match=r"^choice.degree must be an integer from 1"):
        tc.Plan(KERNEL).use(tc.Choice("grid", degree=value))
    with pytest.raises(ValueError, match=r"^choice.degree must be given for backend 'grid'"):
        tc.Plan(KERNEL).use(tc.Choice("grid"))


def test_in_auto_the_cheapest_offer_wins():
    methods.register(Grid())
    points, q, targets = far_case()
    plan = tc.Plan(KERNEL, tol=1e-2).set_points(points, targets)
    assert achieved_at(points, q, targets, plan.execute(q)) <= 1e-2
    assert plan.choice.backend == "grid"
    near = tc.Plan(KERNEL, tol=1e-2).set_points(points)
    assert achieved(KERNEL, points, q, near.execute(q)) <= 1e-2
    assert near.choice.backend != "grid"


def achieved_at(points, q, targets, values):
    exact = tc.evaluate(KERNEL, points, q, targets, backend=tc.EXACT.backend)
    return tc.relative_error(values, exact)


class Undecided(Grid):
    """Has no default."""

    name = "undecided"
    parameters: ClassVar = {"degree": Grid.parameters["degree"]._replace(default=None)}


def test_what_has_no_default_must_be_given():
    methods.register(Undecided())
    with pytest.raises(ValueError, match=r"^degree must be given for backend 'undecided', got {}"):
        tc.Plan(KERNEL, "undecided")
    assert tc.Plan(KERNEL, "undecided", degree=3).choice == tc.Choice("undecided", degree=3)


class Boastful(Grid):
    """Promises a sum that costs nothing and has no error, and does not keep it."""

    name = "boastful"
    made = 0

    def offers(self, case, given):
        return [Offer({"degree": 1}, 1e-12, 1e-12)]

    def make(self, kernel, parameters, progress=False):
        Boastful.made += 1
        return MergedSum(kernel, parameters, progress)


def test_in_auto_an_offer_that_is_not_kept_is_dropped(monkeypatch):
    """It is sampled, and something else is taken."""
    monkeypatch.setattr(search, "FEW", 0)
    monkeypatch.setattr(Boastful, "made", 0)
    methods.register(Boastful())
    points, q, _ = far_case(3000)
    plan = tc.Plan(KERNEL, tol=1e-4).set_points(points)
    assert achieved(KERNEL, points, q, plan.execute(q)) <= 1e-4
    assert Boastful.made == 1
    assert plan.choice.backend != "boastful"


class Choosy(Grid):
    """Takes no points at all."""

    name = "choosy"

    def offers(self, case, given):
        return [Offer({"degree": 1}, 1e-12, 1e-12)]

    def make(self, kernel, parameters, progress=False):
        sum_ = MergedSum(kernel, parameters, progress)
        sum_.set_points = self._refuse
        return sum_

    def _refuse(self, sources, targets):
        raise ValueError("sources must be others")


def test_points_that_a_method_refuses_are_left_to_others(monkeypatch):
    """By name the refusal is told."""
    monkeypatch.setattr(search, "FEW", 0)
    methods.register(Choosy())
    points, q, _ = far_case(2000)
    plan = tc.Plan(KERNEL, tol=1e-2).set_points(points)
    assert achieved(KERNEL, points, q, plan.execute(q)) <= 1e-2
    assert plan.choice.backend != "choosy"
    with pytest.raises(ValueError, match=r"^sources must be others"):
        tc.Plan(KERNEL, "choosy").set_points(points)


class Demanding(Grid):
    """Asks more of a kernel than others."""

    name = "demanding"
    members = (*Method.members, "charm")


def test_demands_on_a_kernel():
    methods.register(Demanding())
    with pytest.raises(TypeError, match=r"kernel must have charm for backend 'demanding'"):
        tc.Plan(KERNEL, "demanding")
    assert "demanding" not in [method.name for method in registry.able(KERNEL)]


def test_in_a_simulation():
    """By the name in `mrs.Backend`; the choices of a checkpoint are taken up bitwise."""
    methods.register(Grid())
    rng = np.random.default_rng(1)
    swimmers = mrs.Swimmers(
        rng.random((20, 3)), rng.standard_normal((20, 3)), length=0.1, force=1.0
    )
    far = mrs.Tracers(rng.random((10, 3)) + 50.0)
    sim, exact = (
        mrs.Simulation(mrs.Fluid(1.0, 0.05), [swimmers, far], backend=backend)
        for backend in (mrs.Backend("grid", degree=60), tc.EXACT.backend)
    )
    motion, expected = (s.now.motion[-10:] for s in (sim, exact))
    assert 0.0 < tc.relative_error(motion, expected) < 0.2
    history = json.loads(json.dumps(sim.mobility.history()))
    assert {choice["backend"] for choice in history} == {"grid"}
    again = mrs.Simulation(mrs.Fluid(1.0, 0.05), [swimmers, far], backend=mrs.Backend("grid"))
    again.mobility.restore(history)
    assert np.array_equal(again.now.motion[-10:], motion)
    assert again.mobility.choices == sim.mobility.choices


# --- the registry -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call",
    [
        lambda: tc.Plan(KERNEL, "nope"),
        lambda: mrs.Backend("nope"),
        lambda: mrs.Simulation(mrs.Fluid(), [mrs.Tracers(np.zeros((1, 3)))], backend="nope"),
        lambda: methods.get("nope"),
        lambda: tc.Plan(KERNEL).use(tc.Choice("nope")),
    ],
)
def test_an_unknown_name_is_answered_with_all_names(call):
    methods.register(Grid())
    words = [repr(name) for name in (*methods.names(), "grid", "nope")]
    with pytest.raises(ValueError, match=matches("(?:backend|name|choice.backend)", words)):
        call()


def test_what_cannot_be_registered():
    class Nameless(Method):
        pass

    class Taken(Method):
        name = tc.EXACT.backend

    class Auto(Method):
        name = registry.AUTO

    for wrong in (Grid, None, "grid", Nameless()):
        with pytest.raises(TypeError, match=r"method must be an instance of a treecode\.Method"):
            methods.register(wrong)
    for name in (Taken, Auto):
        with pytest.raises(ValueError, match=r"name of a method must be none of 'auto', 'direct'"):
            methods.register(name())
    for _ in range(2):  # as in a notebook whose cells are run again
        methods.register(Grid())
    assert methods.names().count("grid") == 1


@pytest.mark.parametrize("name", methods.names())
def test_defaults_are_what_is_declared(name):
    """They are in their range, and make a choice that a plan takes."""
    method = methods.get(name)
    values = method.complete({})
    for key, value in values.items():
        assert method.parameters[key].check(key, value) == value
    choice = tc.Choice(name, **values)
    plan = tc.Plan(KERNEL if method.takes(KERNEL) else PERIODIC)
    plan.use(choice)
    points = np.random.default_rng(2).random((20, 3))
    plan.set_points(points)
    assert plan.choice.backend == name
    assert values.items() <= plan.choice.parameters.items()
    assert not set(KEYWORDS).isdisjoint(method.parameters)


# --- choices ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choice", "text"),
    [
        (tc.EXACT, "direct"),
        (tc.Choice("direct", precision="float32"), "direct float32"),
        (tc.Choice("kitc", theta=0.7, degree=7, leaf_size=2000), "kitc(0.7/7)"),
        (
            tc.Choice("taylor", theta=0.65, degree=0, leaf_size=1, precision="float32"),
            "taylor(0.65/0 float32)",
        ),
        (tc.Choice("fmm", tol=1e-5, width=1.0 / 3.0), "fmm(1e-05)"),
        (tc.Choice("fmm", tol=10.0**-2.5, degree=4), "fmm(0.0032)"),
        (tc.Choice("ewald", tol=1e-5, xi=1.0 / 3.0), "ewald(1e-05)"),
    ],
)
def test_a_choice_goes_through_json(choice, text):
    again = tc.Choice(**json.loads(json.dumps(choice.as_dict())))
    assert again == choice
    assert hash(again) == hash(choice)
    assert str(again) == text
    assert repr(again) == repr(choice)


def test_choices_are_compared_by_what_is_given():
    assert tc.Choice("kitc", degree=3, theta=None) == tc.Choice("kitc", degree=3)
    assert tc.Choice("kitc", degree=3) != tc.Choice("kitc", degree=4)
    assert tc.Choice("kitc", degree=3) != tc.Choice("taylor", degree=3)
    assert tc.Choice("kitc", degree=3) != "kitc"


# --- names ------------------------------------------------------------------------------------


def literals(path):
    """Yield the texts in a module, and where they stand."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value, f"{path.relative_to(ROOT)}:{node.lineno}"


def test_names_are_spelled_where_the_methods_are():
    """All else asks the registry."""
    names = methods.names()
    sources = [p for top in ("treecode", "mrs", "benchmarks") for p in (ROOT / top).rglob("*.py")]
    others = [p for p in sources if ROOT / "treecode" / "methods" not in p.parents]
    assert len(others) > 50
    spelled = [place for path in others for text, place in literals(path) if text in names]
    assert not spelled


def test_page_shows_the_tested_file():
    page = ROOT / "docs" / "add-a-method.md"
    source = Path(grid_method.__file__).read_text()
    assert f"```python\n{source}```" in page.read_text()
