"""Section 4: points, strengths and scenes in units of any size."""

import itertools
from functools import partial

import numpy as np

import mrs
import treecode as tc
from tests.cases.oracle import BACKENDS, KERNELS, exact, random_case, rounding, sizes, with_epsilon
from tests.cases.stability.findings import Finding, at_most, case
from tests.cases.stability.scenes import rod_of, simulate
from tests.cases.stability.sums import SUMS, TOLERANCE, excess, plan_of, truncation


@case("4. Points at any scale")
def scales():
    """The same points, and epsilon, at scales from denormal numbers to the bound, 1e60, and beyond.

    Sums are right, within theta^(p+1) of the terms' sizes and rounding, or refused. Distances whose
    squares are below the smallest normal number count as none in singular kernels.
    """
    base = random_case(KERNELS[0], 200, 5)[0]
    for scale in (5e-324, 1e-310, 1e-300, 1e-160, 1e-150, 1e-60, 1e-20, 1e20, 1e60):
        shares = []
        for kernel in KERNELS:
            blob = with_epsilon(kernel, min(max(0.1 * scale, 2e-60), 1e59))
            shares += _shares(blob, base * scale, random_case(kernel, len(base), 6)[1])
        yield at_most(f"scale {scale:g}: largest error over its bound", max(shares), 1)
    for scale in (1.1e60, 1e300):
        refused = 0
        for kernel, backend in itertools.product(KERNELS, SUMS):
            points, strengths, _ = random_case(kernel, 10, 7)
            points[0] = 1.0
            refused += _refused(
                partial(tc.evaluate, kernel, points * scale, strengths, backend=backend),
                "points",
                "1e+60",
            )
        asked = f"scale {scale:g}: refusals that name the points and the bound"
        yield Finding(asked, refused, 16, 16)


def _shares(kernel, points, strengths):
    """Return the largest error of each backend in units of what is allowed."""
    given = kernel, points, strengths
    expected, rounded, size = exact(*given), rounding(*given), sizes(*given)
    shares = []
    for backend in BACKENDS:
        with np.errstate(over="ignore"):  # of powers of lengths that this sum does not need
            plan = plan_of(kernel, backend, leaf_size=8).set_points(points)
            error = abs(plan.execute(strengths) - expected)
        allowed = rounded + truncation(backend) * size  # zero where all points count as one
        shares.append(np.divide(error, allowed, out=error.copy(), where=allowed > 0).max())
    return [*shares, excess(TOLERANCE, *given)]


def _refused(call, *words):
    """Return whether a call is refused with a message that contains all words."""
    try:
        call()
    except (ValueError, FloatingPointError, mrs.SimulationError) as error:
        return all(word in str(error) for word in words)
    return False


@case("4. Strengths at any scale")
def strengths_at_any_scale():
    """As for points; where a sum would leave the range of doubles it is refused, never infinite."""
    for scale in (1e-310, 1e-150, 1e150, 1e290):
        shares = []
        for kernel in KERNELS:
            points, strengths, _ = random_case(kernel, 200, 8)
            strengths[:, :6] *= scale  # not the normals, which multiply dipoles
            shares += _shares(kernel, points, strengths)
        yield at_most(f"strengths {scale:g}: largest error over its bound", max(shares), 1)
    refused = 0
    for kernel, backend in itertools.product(KERNELS, SUMS):
        points, strengths, _ = random_case(kernel, 200, 8)
        strengths = np.sign(strengths) * 1e308
        with np.errstate(over="ignore", invalid="ignore"):
            call = partial(tc.evaluate, kernel, points, strengths, backend=backend)
            refused += _refused(call, "float64")
    yield Finding("strengths 1e308: refusals of the sum", refused, 16, 16)


@case("4. Scenes at any scale")
def scenes_at_any_scale():
    """Rods, swimmers and repulsion in units a power of two away: the same run, bit for bit.

    Nothing in the arithmetic but multiplication by powers of two tells them apart, unless an
    absolute length, time or force is hidden somewhere. What is beyond the bounds is refused by
    name.
    """
    for name, sums in (("rkc2", "direct"), ("bs32", "kitc"), ("euler", "kitc")):
        plain = _scaled_scene(0, name, sums)
        for power in (-95, 95):
            scaled = _scaled_scene(power, name, sums)
            moved = scaled.state.positions * 0.5**power - plain.state.positions
            turned = scaled.state.quaternions - plain.state.quaternions
            fastest_rate = scaled.stepper.radius * 4.0**power - plain.stepper.radius
            difference = max(abs(moved).max(), abs(turned).max(), abs(fastest_rate))
            asked = f"{name}, {sums}, lengths times 2^{power}: difference"
            yield Finding(asked, difference, 0.0, 0.0)
    refused = [_refused(call, *words) for call, *words in _beyond()]
    yield Finding("scenes beyond the bounds: refusals", sum(refused), len(refused), len(refused))


def _scaled_scene(power, name, sums):
    """Return a run in units of 2^power; times are as its square, forces of swimmers as they are."""
    unit = 2.0**power
    line = mrs.geometry.helix(0.3, 1.0, 2.0, 12)
    rod = rod_of(line._replace(nodes=unit * line.nodes), unit**2, 10.0)
    x = unit * np.array([[1.0, 0.0, 0.0], [1.3, 0.2, 0.1]])
    swimmers = mrs.Swimmers(x, [[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]], length=unit, force=1.0)
    return mrs.Simulation(
        mrs.Fluid(1.0, 0.25 * unit),
        [rod, swimmers],
        backend=mrs.Backend(sums, degree=1, leaf_size=4),
        integrator=mrs.Integrator(name),
        forces=[mrs.Steric(5.0, 0.15 * unit)],
    ).run(0.25 * unit**2)


def _beyond():
    """Yield calls that ask for what cannot be, and words of their refusal."""
    x, p = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1]]), np.eye(3)[:2]
    line = mrs.geometry.straight(1.0, 8)
    bent = {"strain": (1.0, 0.0, 0.0)}
    swimmers = mrs.Swimmers(x, p, length=1.0, force=1.0)
    yield partial(mrs.Swimmers, 1e300 * x, p, length=1.0, force=1.0), "positions", "1e+60"
    yield partial(mrs.Tracers, 1e300 * x), "positions", "1e+60"
    yield partial(mrs.geometry.straight, 1e-300, 8), "length", "1e-60"
    yield partial(mrs.geometry.straight, 1e300, 8), "length", "1e+60"
    yield partial(rod_of, line._replace(nodes=1e300 * line.nodes), 1.0, 1.0), "centerlines", "1e+60"
    yield partial(simulate, [swimmers], 1e-300), "epsilon", "1e-60"
    yield partial(mrs.Steric, 1.0, 1e-300), "radius", "1e-60"
    # No step is short enough for these: the run ends before it begins.
    stiff = rod_of(line, 1e100, 1.0, **bent)
    short = rod_of(line._replace(nodes=1e-300 * line.nodes), 1.0, 1.0, **bent)
    yield partial(simulate([stiff], 0.3).run, 1.0), "time 0"
    yield partial(simulate([short], 0.3).run, 1.0), "time 0"
