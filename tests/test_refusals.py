"""Bad arguments are refused by name before any work; any call ends in that or in a right answer."""

import re
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import treecode as tc
from tests.cases.oracle import BACKENDS, KERNELS, assert_within, exact, rounding, sizes, truncation
from treecode import methods

KERNEL = tc.RegularizedStokeslet(epsilon=0.1)
POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3))
BAD_NUMBERS = [np.nan, np.inf, -np.inf, "0.5", b"1", None, 1j, True, np.True_, [0.5], {}]


def entry(value, row=2):
    """Return good rows but for one entry."""
    rows = POINTS.copy()
    rows[row, 1] = value
    return rows


# Argument, bad value, words that the message must contain besides the name of the argument.
CALLS = [
    *[
        ("backend", value, [*BACKENDS, repr(value)])
        for value in ("fft", "", "KITC", None, 3, ["kitc"])
    ],
    *[
        ("theta", value, ["between 0 and 1", repr(value)])
        for value in (*BAD_NUMBERS, 0, 1, 1.5, -0.5, "a")
        if value is not None
    ],
    *[
        ("degree", value, ["integer from 1 to", repr(value)])
        for value in (0, -1, 2.5, 3.0, True, np.True_, "3", np.nan, 10**6, [3], Decimal(3))
    ],
    *[
        ("leaf_size", value, ["integer from 1 to", repr(value)])
        for value in (0, -1, 2.5, 100.0, True, "3", np.inf, 2**70)
    ],
    *[
        ("precision", value, ["'float64', 'float32'", repr(value)])
        for value in ("single", "", 32, np.float32, ["float32"])
    ],
    *[
        ("kernel", value, ["must", repr(value)])
        for value in (tc.RegularizedStokeslet, tc.Stokeslet, None, "Stokeslet", 3, (), (0.1, 1.0))
    ],
    *[
        (name, value, words)
        for name in ("points", "targets")
        for value, words in [
            (POINTS[0], ["(N, 3)", "(3,)"]),
            (POINTS[:, :2], ["(N, 3)", "(5, 2)"]),
            (POINTS.T, ["(N, 3)", "(3, 5)"]),
            (POINTS[None], ["(N, 3)", "(1, 5, 3)"]),
            (1.0, ["(N, 3)", "()"]),
            ([], ["(N, 3)", "(0,)"]),
            ([[1.0, 2.0, 3.0], [1.0, 2.0]], ["(N, 3)"]),
            (POINTS + 0j, ["real", "complex128"]),
            (POINTS > 0, ["real", "bool"]),
            ([["a", "b", "c"]], ["real"]),
            ([[None, 1.0, 2.0]], ["real"]),
            ([[{}, 1.0, 2.0]], ["real"]),
            (POINTS.astype("M8[s]"), ["real", "datetime64"]),
            (entry(np.nan), ["finite", "nan", "row 2"]),
            (entry(-np.inf), ["finite", "inf", "row 2"]),
            (entry(1e300).astype(np.longdouble) * np.longdouble(1e300), ["finite", "row"]),
            (entry(1.1e60), ["1e+60", "row 2"]),
            (entry(-1e300, row=4), ["1e+60", "row 4"]),
        ]
    ],
    ("points", None, ["real", "object"]),
    *[
        ("strengths", value, words)
        for value, words in [
            (None, ["real", "object"]),
            (POINTS[:4], ["(5, 3)", "(4, 3)"]),
            (POINTS[:, :2], ["(5, 3)", "(5, 2)"]),
            (np.zeros((5, 6)), ["(5, 3)", "(5, 6)"]),
            (POINTS.T, ["(5, 3)", "(3, 5)"]),
            (POINTS.ravel(), ["(5, 3)", "(15,)"]),
            (1.0, ["(5, 3)", "()"]),
            ([[1.0], [1.0, 2.0]], ["(5, 3)"]),
            (POINTS * 1j, ["real", "complex128"]),
            (POINTS.astype(str), ["real"]),
            (POINTS.astype(object), ["real", "object"]),
            (entry(np.nan), ["finite", "nan", "row 2"]),
            (entry(np.inf), ["finite", "inf", "row 2"]),
        ]
    ],
]


def described(value):
    """Return an id for one argument of a test."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}".replace(" ", "")
    return re.sub(r"\W+", "_", str(value)).strip("_")[:30]


def matches(name, words):
    """Return a pattern for a message that begins with `name` and contains all `words`."""
    return rf"(?s)^{name}\b" + "".join(f"(?=.*{re.escape(word)})" for word in words)


@pytest.fixture
def no_work(monkeypatch):
    """Fail if a tree is built."""

    def work(*_):
        raise AssertionError("work was done before the refusal")

    for backend in BACKENDS:
        monkeypatch.setattr(type(methods.get(backend)), "build", work)


@pytest.mark.interpreted
@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(("name", "value", "words"), CALLS, ids=described)
def test_argument_is_refused(name, value, words):
    """`evaluate` names the argument, what it got or what is allowed, and does nothing."""
    call = {"kernel": KERNEL, "points": POINTS, "strengths": POINTS, "targets": POINTS}
    with pytest.raises((TypeError, ValueError), match=matches(name, words)):
        tc.evaluate(**call | {name: value})


@pytest.mark.interpreted
@pytest.mark.parametrize("value", [*BAD_NUMBERS, 0, 0.0, -0.1, 1e-61, 1e61], ids=described)
@pytest.mark.parametrize("name", ["epsilon", "viscosity"])
@pytest.mark.parametrize("kernel", [tc.RegularizedStokeslet, tc.RegularizedStokesletRotlet])
def test_parameter_is_refused(kernel, name, value):
    """A kernel cannot be made with a parameter that is no positive number."""
    with pytest.raises(
        (TypeError, ValueError), match=matches(name, ["1e-60 and 1e+60", repr(value)])
    ):
        kernel(**({"epsilon": 0.1} | {name: value}))


def test_replaced_parameter_is_refused():
    """Nor can one be changed into such a kernel."""
    with pytest.raises(ValueError, match="epsilon"):
        tc.Plan(KERNEL._replace(epsilon=-1.0))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("degree", [0, 10**6])
def test_degrees_of_a_backend(backend, degree):
    """A Taylor polynomial may be a constant, an interpolant has two nodes; neither is endless."""
    if (backend, degree) == ("taylor", 0):
        assert tc.Plan(KERNEL, backend, degree=0).set_points(POINTS).info()["degree"] == 0
    else:
        with pytest.raises(ValueError, match=matches("degree", ["integer from", str(degree)])):
            tc.Plan(KERNEL, backend, degree=degree)


@pytest.mark.parametrize("call", ["execute", "estimate_error", "info"])
def test_points_come_first(call):
    """A plan without points says so."""
    arguments = () if call == "info" else (POINTS,)
    with pytest.raises(RuntimeError, match="set_points"):
        getattr(tc.Plan(KERNEL), call)(*arguments)


@pytest.mark.parametrize("samples", [0, -1, 2.5, True, None, "3", np.nan])
def test_samples_are_refused(samples):
    plan = tc.Plan(KERNEL, "direct").set_points(POINTS)
    with pytest.raises((TypeError, ValueError), match=matches("samples", [repr(samples)])):
        plan.estimate_error(POINTS, samples=samples)


def test_refused_points_leave_the_old_ones():
    """A plan survives what it refuses."""
    plan = tc.Plan(KERNEL, "direct").set_points(POINTS)
    before = plan.execute(POINTS)
    with pytest.raises(ValueError, match=r"^sources must be finite"):
        plan.set_points(entry(np.nan))
    with pytest.raises(ValueError, match="finite"):
        plan.set_points(POINTS[:2], targets=entry(np.nan))
    with pytest.raises(ValueError, match="strengths"):
        plan.execute(POINTS[:2])
    np.testing.assert_array_equal(plan.execute(POINTS), before)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("strength", [1e300, -1.7e308])
def test_overflow_is_reported(backend, strength):
    """A sum beyond the range of doubles is an error, not inf or nan."""
    plan = tc.Plan(tc.RegularizedStokeslet(epsilon=1e-20), backend).set_points(POINTS)
    with pytest.raises(FloatingPointError, match="overflow"):
        plan.execute(np.full((5, 3), strength))


# ---- any call whatever

COUNTS = st.sampled_from([0, 1, 2, 3, 9, 20, 40, 40, 40])
EXTREMES = [0.0, 5e-324, 1e-310, 1e-160, 1e-77, 1e-60, 1e-20, 1e20, 1e60, 1e155, 1e300, 1.7e308]
SPIKES = st.sampled_from([*EXTREMES, -1e60, -1e-160, 1e61]) | st.floats()
NAMES = "kernel|backend|theta|degree|leaf_size|sources|targets|strengths|epsilon|viscosity|the sum"
SPOILED = [
    lambda a: a[:, :-1],
    lambda a: a[1:],
    lambda a: a.T,
    lambda a: a.ravel(),
    lambda a: a[None],
    lambda a: a + 0j,
    lambda a: a.astype(object),
    lambda a: a.astype(str),
    lambda a: a > 0,
    lambda a: [*a.tolist(), [1.0]],
    lambda a: a * np.nan,
    lambda a: np.longdouble(1e300) * a * np.longdouble(1e300),
    lambda a: None,
    lambda a: 1.0,
    lambda a: "points",
    lambda a: {"a": a},
]
FORMS = [
    np.asfortranarray,
    lambda a: a.tolist() if len(a) else a,
    lambda a: np.repeat(a, 2, axis=0)[::2],
    lambda a: a[::-1],
    lambda a: a.astype(">f8"),
    lambda a: np.rint(a).clip(-9, 9).astype(np.int8),
    lambda a: a.clip(-1e30, 1e30).astype(np.float32),
]


def rarely(draw, usual, strange, odds=12):
    """Draw from `usual`, and one time in `odds` from `strange`; return it and whether it did."""
    strangely = draw(st.integers(1, odds)) == odds
    return draw(strange if strangely else usual), strangely


@st.composite
def arrays(draw, count, columns):
    """Return what might be meant as (count, columns) numbers, and whether they are of size one."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    array = rng.uniform(-1.0, 1.0, (count, columns))
    if draw(st.integers(1, 6)) == 6:  # on a coarse grid: coincident points, points on box faces
        array = np.round(2.0 * array) / 2.0
    if draw(st.booleans()):  # two clumps
        array[: count // 2] += 8.0
    scale, wild = rarely(draw, st.just(1.0), st.sampled_from(EXTREMES), odds=6)
    with np.errstate(over="ignore"):
        array *= scale
    if array.size and draw(st.integers(1, 6)) == 6:
        wild = True
        for _ in range(draw(st.integers(1, 3))):
            array[draw(st.integers(0, count - 1)), draw(st.integers(0, columns - 1))] = draw(SPIKES)
    spoil, spoiled = rarely(draw, st.none(), st.sampled_from(SPOILED), odds=40)
    form = spoil or draw(st.none() | st.sampled_from(FORMS)) or (lambda a: a)
    with np.errstate(all="ignore"):
        return form(array), not (wild or spoiled)


def parameter(draw):
    """Return a viscosity or blob size, and whether it is of size one."""
    value, strange = rarely(
        draw,
        st.sampled_from([0.1, 1.0, 2, np.float32(0.5)]) | st.floats(1e-3, 10.0),
        st.sampled_from([1e-59, 1e-30, 1e-8, 1e8, 1e30, 1e59])
        | st.floats(1e-61, 1e61)
        | st.sampled_from([*BAD_NUMBERS, 0, -1.0, 1e61, 5e-324]),
    )
    return value, not strange


@st.composite
def calls(draw):
    """Return the arguments of a call, and whether all of them are good and of size one."""
    name = draw(st.sampled_from([type(kernel).__name__ for kernel in KERNELS]))
    tame = True

    def note(pair):
        nonlocal tame
        tame = tame and pair[1]
        return pair[0]

    parameters = [note(parameter(draw)) for _ in range(2 if "Regularized" in name else 0)]
    options = {}
    for key, usual, strange in [
        ("backend", st.sampled_from(BACKENDS), st.sampled_from(["fmm", None, 1])),
        (
            "theta",
            st.sampled_from([0.3, 0.5, 0.7]) | st.floats(0.01, 0.99),
            st.sampled_from([*BAD_NUMBERS, 0, 1, 1.5, -0.5, 1e-300, 1 - 2**-53]),
        ),
        ("degree", st.sampled_from([1, 1, 1, 2, 3, 7]), st.sampled_from([0, -1, 2.5, True, 20])),
        ("leaf_size", st.sampled_from([1, 2, 8, 2000]), st.sampled_from([0, -1, 2.5, None, 2**63])),
    ]:
        value, strangely = rarely(draw, usual, strange, odds=40)
        options[key] = note((value, not strangely))
    columns = {"Stokeslet": 3, "RegularizedStokeslet": 3, "StokesletStresslet": 9}.get(name, 6)
    count = draw(COUNTS)
    sources = note(draw(arrays(count, 3)))
    strengths = note(draw(arrays(count, columns)))
    targets = None if draw(st.booleans()) else note(draw(arrays(draw(COUNTS), 3)))
    wrapped, strangely = rarely(draw, st.none(), st.sampled_from([type, repr, tuple]), odds=60)
    tame = tame and not strangely
    return (name, parameters, wrapped), options, sources, strengths, targets, tame


def check(call):
    """Assert that `call` is refused with a message that names a culprit, or answered rightly."""
    (name, parameters, wrapped), options, sources, strengths, targets, tame = call
    refusal = None
    try:
        kernel = getattr(tc, name)(*parameters)
        plan = tc.Plan(wrapped(kernel) if wrapped else kernel, **options)
        values = plan.set_points(sources, targets).execute(strengths)
    except (TypeError, ValueError, FloatingPointError) as error:
        refusal = error
    if refusal:
        assert re.match(NAMES, str(refusal))
        assert not tame, refusal
        return
    case = [None if a is None else np.asarray(a, float) for a in (sources, strengths, targets)]
    expected = exact(kernel, *case)
    bound = rounding(kernel, *case)
    if plan.info()["far_pairs"]:
        # A priori for any sources; and 1e-10 for what its rounding is worth.
        factor = truncation(options["backend"], options["theta"], options["degree"])
        bound = bound + sizes(kernel, *case, lambda channel: 1e-10 + factor(channel))
    assert_within(values, expected, bound)


COMMON = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}


@settings(max_examples=300, **COMMON)
@given(calls())
def test_any_call(call):
    """Any call ends in an error that names what is wrong, or in a finite and right answer."""
    check(call)


@pytest.mark.slow
@settings(max_examples=100_000, **COMMON)
@given(calls())
def test_any_call_at_length(call):
    """The same, a hundred thousand times."""
    check(call)
