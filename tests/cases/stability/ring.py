"""Section 11: a ring that buckles out of its plane."""

import math

import numpy as np

import mrs
from tests.cases.linearization import jacobian
from tests.cases.stability.findings import Finding, at_least, at_most, case
from tests.cases.stability.scenes import kicked, rod_of, simulate

CRITICAL = 2.0 * np.pi * math.sqrt(3.0)  # Michell, Zajac: a1 = a3


@case("11. A ring with twist")
def twisted_ring():
    """A rod without intrinsic curvature, closed to a ring that is twisted (Michell, Zajac).

    Its second mode begins to grow at 2 pi sqrt(3) in the continuum; on a lattice that is off by
    ds^2, which two resolutions take away, and by a / (b R^2) = 1/1600 for shear: 0.3 % with what
    is left. A displacement in that mode grows or decays as exp(rate t), to 5 % once the other modes
    have died, and its growth ends: the ring is inextensible but for a / (b R^2).
    """
    thresholds = []
    for nodes in (16, 32):
        a, b = CRITICAL, 1.04 * CRITICAL
        rate_a, rate_b = _growth(_ring(nodes, a)), _growth(_ring(nodes, b))
        # Where they vanish: rates are linear in the square of the twist, over so short a way.
        thresholds.append(math.sqrt(a**2 - (b**2 - a**2) * rate_a / (rate_b - rate_a)))
    coarse, fine = thresholds
    yield Finding("16 nodes: threshold over 2 pi sqrt(3)", coarse / CRITICAL, 1.0, 1.05)
    yield Finding("32 nodes: threshold over 2 pi sqrt(3)", fine / CRITICAL, 1.0, 1.0125)
    limit = (4.0 * fine - coarse) / 3.0 / CRITICAL
    yield Finding("limit of fine lattices over 2 pi sqrt(3)", limit, 0.997, 1.003)
    for share in (0.9, 1.1):
        sim = _ring(32, share * fine)
        rate, at = _growth(sim), 2.0 * np.pi * np.arange(32) / 32
        z = np.zeros((64, 3))
        z[:32, 2] = 1e-3 * np.cos(2.0 * at)
        kicked(sim, z)
        begin = sim.time
        heights = [_height(sim.run(begin + t)) for t in (5.0, 15.0)]
        asked = f"twist {share} of the threshold: growth in a time of 10"
        found, expected = heights[1] / heights[0], math.exp(10.0 * rate)
        yield Finding(asked, found, 0.95 * expected, 1.05 * expected)
        if share < 1.0:
            yield at_most(f"{asked}, at most a half", found, 0.5)
        else:
            yield at_least(f"{asked}, at least twice", found, 2.0)
            sim.run(begin + 60.0)
            length = np.linalg.norm(
                sim.state.positions - np.roll(sim.state.positions, 1, 0), axis=1
            )
            yield at_least("out of the plane in the end", _height(sim), 0.1)
            yield Finding("length in the end", length.sum() / (2.0 * np.pi), 0.98, 1.02)


def _ring(nodes, twist):
    """Return a ring of radius 1 that a twist, in all, strains, at rest in its plane."""
    strain = (0.0, 0.0, -twist / (2.0 * np.pi))  # straight at rest, and turned the other way
    rod = rod_of(mrs.geometry.ring(1.0, nodes), 1.0, 1600.0, strain)
    return simulate([rod], 0.3, mrs.Integrator("rkc2", tolerance=1e-5)).run(2.0)


def _growth(sim):
    """Return the largest rate of shape: seven are zero, of rigid motion and of turning in place."""
    rates = np.linalg.eigvals(jacobian(sim))
    return rates[np.argsort(abs(rates))[7:]].real.max()


def _height(sim):
    return np.ptp(sim.state.positions[:, 2])
