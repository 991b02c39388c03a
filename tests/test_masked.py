"""What is masked is no number: NumPy drops the mask, and the sum would take what is below it."""

import numpy as np
import pytest

import mrs
import treecode as tc

KERNEL = tc.RegularizedStokeslet(epsilon=0.1)
POINTS = np.random.default_rng(0).random((5, 3))


def masked(values, row=2):
    """Return values with one entry masked."""
    hidden = np.zeros(np.shape(values), bool)
    hidden[row] = True
    return np.ma.array(values, mask=hidden)


CALLS = {
    "points": lambda bad: tc.evaluate(KERNEL, bad, POINTS),
    "strengths": lambda bad: tc.evaluate(KERNEL, POINTS, bad),
    "targets": lambda bad: tc.evaluate(KERNEL, POINTS, POINTS, bad),
    "sources": lambda bad: tc.Plan(KERNEL).set_points(bad),
    "positions": mrs.Tracers,
}


@pytest.mark.parametrize("form", [masked, lambda values: list(masked(values))])
@pytest.mark.parametrize("name", CALLS)
def test_masked_entries_are_refused_by_name(name, form):
    """Whole arrays, and lists of rows of which some are masked."""
    with pytest.raises(ValueError, match=f"^{name} must not have masked entries"):
        CALLS[name](form(POINTS))


def swimmers(**options):
    return mrs.Swimmers(POINTS, POINTS, **{"length": 0.1, "force": 1.0} | options)


def rods(*lines, **options):
    moduli = dict.fromkeys(("bending", "twisting", "shearing", "stretching"), 1.0)
    return mrs.Rods(lines or [mrs.geometry.straight(1.0, 6)], **moduli | options)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("orientations", lambda: mrs.Swimmers(POINTS, masked(POINTS), length=0.1, force=1.0)),
        ("length", lambda: swimmers(length=masked(np.ones(5)))),
        ("epsilon", lambda: swimmers(epsilon=masked(np.ones(5)))),
        ("bending", lambda: rods(bending=masked([1.0, 1.0], 1))),
        ("intrinsic_curvature", lambda: rods(intrinsic_curvature=masked([0.0, 1.0, 2.0]))),
        ("beat", lambda: rods(beat=lambda s, t: masked(np.zeros((len(s), 3))))),
        ("shift", lambda: mrs.geometry.straight(1.0, 6).moved(masked([0.0, 1.0, 2.0]))),
        ("gradient", lambda: mrs.flows.QuadraticFlow(gradient=masked(np.eye(3)))),
        (
            r"centerlines\[0\]\.nodes",
            lambda: rods(
                mrs.geometry.Centerline(
                    masked(mrs.geometry.straight(1.0, 5).nodes),
                    mrs.geometry.straight(1.0, 5).quaternions,
                )
            ),
        ),
    ],
)
def test_masked_numbers_of_bodies_and_flows_are_refused_by_name(name, make):
    with pytest.raises(ValueError, match=f"^{name} must not have masked entries"):
        make()


def test_a_mask_of_nothing_is_no_mask():
    exact = tc.evaluate(KERNEL, POINTS, POINTS)
    open_mask = np.ma.array(POINTS, mask=False)
    assert np.array_equal(tc.evaluate(KERNEL, open_mask, list(open_mask)), exact)
