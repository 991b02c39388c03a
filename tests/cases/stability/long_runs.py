"""Section 6: a free rod over many steps."""

import math

import numpy as np

import mrs
from tests.cases.linearization import spectral_radius
from tests.cases.oracle import UNIT
from tests.cases.stability.findings import Finding, at_least, at_most, case
from tests.cases.stability.scenes import imbalance, kicked, rod_of, simulate


@case("6. A free rod at rest", slow=True, steps=100_000)
@case("6. A free rod at rest", steps=2_000)
def rod_at_rest(steps):
    """Forward Euler near its limit; a straight rod becomes a helix in the first quarter.

    Loads: 64 roundings of the largest and of the sums of some nodes. Triads are orthonormal if
    quaternions have length 1; each step normalises them, to 8 roundings. At rest the forces are
    roundings; a step moves by as much as coordinates are rounded, and there are as many steps.
    """
    rod = rod_of(mrs.geometry.straight(1.0, 6), 0.02, 0.4, (1.0, 0.0, 2.0))
    dt = 0.8 * 2.0 / spectral_radius(simulate([rod], 0.3))
    sim = simulate([rod], 0.3, mrs.Integrator("euler", dt))
    kicked(sim, 0.05 * np.random.default_rng(0).normal(size=36))
    size = np.ptp(sim.state.positions, axis=0).max()
    balance, triads, centers, lengths = [], [], [], []
    for part in range(1, 101):
        while sim.time < part * steps // 100 * dt * (1.0 - 1e-9):
            sim.step(part * steps // 100 * dt)
        balance.append(imbalance(sim))
        triads.append(_skew(sim))
        centers.append(sim.state.positions.mean(axis=0))
        lengths.append(_length(sim))
    yield Finding("steps", sim.stepper.steps, steps, steps)
    yield at_most("net force and torque of elastic loads, in roundings", max(balance), 64)
    yield at_most("squared lengths of quaternions less one, in roundings", max(triads), 8)
    bound = steps * size
    drift = np.ptp(centers[25:], axis=0).max() / UNIT
    yield at_most("drift of the centroid at rest, in roundings", drift, bound)
    yield at_most("change of length at rest, in roundings", np.ptp(lengths[25:]) / UNIT, bound)
    found = abs(lengths[-1] - 1.0) / UNIT
    yield at_most("length at rest less the intrinsic one, in roundings", found, 64)


@case("6. A free rod that beats", slow=True, periods=2_000)
@case("6. A free rod that beats", periods=60)
def beating_rod(periods):
    """Forward Euler, 50 steps a period, a rod that swims off by a travelling wave.

    Once the start is forgotten, every period is the same but for a rigid motion, so that length
    and distance swum have no drift: only the roundings of coordinates, two a step and component.
    """
    wave = mrs.TravellingWave(amplitude=(3.0, 0.0, 0.0), wavelength=1.0, period=1.0)
    rod = rod_of(mrs.geometry.straight(1.0, 6), 0.5, 10.0, (0.5, 0.0, 1.0), beat=wave)
    sim = simulate([rod], 0.3, mrs.Integrator("euler", 1 / 50))
    balance, triads, centers, lengths = [], [], [], []
    for period in range(1, periods + 1):
        while sim.time < period:
            sim.step(period)
        balance.append(imbalance(sim))
        triads.append(_skew(sim))
        centers.append(sim.state.positions.mean(axis=0))
        lengths.append(_length(sim))
    swum = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    settled = slice(periods // 4, None)
    yield Finding("steps", sim.stepper.steps, 50 * periods, 50 * periods)
    yield at_most("net force and torque of elastic loads, in roundings", max(balance), 64)
    yield at_most("squared lengths of quaternions less one, in roundings", max(triads), 8)
    yield at_least("distance swum in a period", swum[settled].min(), 0.05)
    bound = 2 * 50 * math.sqrt(3.0) * abs(np.array(centers)).max()
    found = np.ptp(swum[settled]) / UNIT
    yield at_most("change of the distance swum in a period, in roundings", found, bound)
    found = np.ptp(lengths[periods // 4 :]) / UNIT
    yield at_most("change of length, in roundings", found, bound)


def _skew(sim):
    """Return how far triads are from orthonormal: their quaternions from length 1, in roundings."""
    return abs((sim.state.quaternions**2).sum(axis=1) - 1.0).max() / UNIT


def _length(sim):
    return np.linalg.norm(np.diff(sim.state.positions, axis=0), axis=1).sum()
