"""Sections 9 and 10: repulsion of swimmers that meet, and of a rod that touches itself."""

from functools import partial

import numpy as np
from scipy.optimize import brentq

import mrs
from tests.cases import rod_oracle
from tests.cases.stability.findings import Finding, at_least, at_most, case
from tests.cases.stability.scenes import imbalance, rod_of, simulate

STERIC = mrs.Steric(strength=10.0, radius=0.15, chi=1.25)
CONTACT, REACH = 0.3, 0.375


def repulsion(r):
    """Return the force at distance r of physics.md 5, away from each other."""
    nearness = max((REACH**2 - r**2) / (REACH**2 - CONTACT**2), 0.0)
    return STERIC.strength / CONTACT * nearness**4 * r


@case("9. Swimmers that meet head on")
def head_on():
    """Pushers and pullers of force 1 and blob 0.1, of which spheres touch at 0.3.

    On one axis they stop where repulsion and thrust balance, by the oracle: approached from above,
    since a motion along a line cannot pass its rest. Off axis a push of 10 at contact parts two
    bodies faster than the thrusts of eight swimmers, each at most 1/(4 pi 0.3) a unit of force,
    bring them together; of pullers flagella meet, softer, and at the axis softest.
    """
    for stroke, sign in (("pusher", 1.0), ("puller", -1.0)):
        stop = brentq(partial(_approach, sign), REACH / 3.0, REACH)  # from the largest force
        free, _ = _met(stroke, 1, 0.0, [])
        yield at_most(f"two {stroke}s on an axis, no repulsion: least distance", free, 0.02)
        least, end = _met(stroke, 1, 0.0, [STERIC])
        yield at_least(f"two {stroke}s on an axis: least distance", least, stop * (1 - 1e-3))
        asked = f"two {stroke}s on an axis: distance in the end"
        yield Finding(asked, end, stop * (1 - 1e-3), stop * (1 + 1e-3))
        contact = CONTACT if stroke == "pusher" else stop
        for count, aside in ((1, 1e-3), (4, 1e-3), (4, 0.1)):
            least, _ = _met(stroke, count, aside, [STERIC])
            asked = f"{2 * count} {stroke}s, {aside} off axis: least distance"
            yield at_least(asked, least, contact)


def _met(stroke, count, aside, forces):
    """Return the least distance of particles on the way, and that in the end."""
    y = 0.7 * np.arange(count)
    left = np.column_stack([np.full(count, -1.5), y, 0.0 * y])
    x = np.concatenate([left, left * [-1.0, 1.0, 1.0] + [0.0, aside, 0.0]])
    p = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], count, axis=0)
    if stroke == "puller":
        x -= p  # the flagella, before the bodies, meet
    swimmers = mrs.Swimmers(x, p, length=1.0, force=1.0, stroke=stroke)
    integrator = mrs.Integrator("bs32", tolerance=1e-5)
    sim = simulate([swimmers], 0.1, integrator, forces=forces)
    distances = [_apart(sim)]
    while sim.time < 5.0:
        sim.step(5.0)
        distances.append(_apart(sim))
    return min(distances), distances[-1]


def _apart(sim):
    """Return the least distance of particles of different swimmers."""
    points = sim.bodies[0].points(sim.time, sim.state)
    number = np.tile(np.arange(len(points) // 2), 2)
    distances = np.linalg.norm(points[:, None] - points, axis=-1)
    return distances[number[:, None] != number].min()


def _approach(sign, distance):
    """Return how fast two swimmers on one axis, tips at `distance`, draw apart (rod_oracle)."""
    bodies = 0.5 * distance + (0.0 if sign > 0.0 else 1.0)
    x = np.array([[-bodies, 0.0, 0.0], [bodies, 0.0, 0.0]])
    p = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    one, blobs = np.ones(2), np.full(4, 0.1)
    points = rod_oracle.swimmer_points(x, p, one, sign)
    push = np.zeros((4, 3))
    push[0 if sign > 0.0 else 2 :, 0][:2] = [-repulsion(distance), repulsion(distance)]

    def extra(targets):
        return rod_oracle.flow(points, blobs, push, np.zeros_like(push), targets)[0]

    velocity, _ = rod_oracle.swimmer_rates(x, p, one, one, sign, blobs, extra=extra)
    return velocity[1, 0] - velocity[0, 0]


@case("10. A rod that touches itself")
def self_contact():
    """A straight rod that wants to be a circle, one and a half times round, and hardly a helix.

    In Stokes flow the energy, elastic and of the repulsion, falls in every step. A push of 20 at
    contact is twice the force a1 k^2 that bends the rod, so that nodes stay farther apart than
    contact; without repulsion they do not.
    """
    steric, length, nodes = mrs.Steric(20.0, 0.1, 1.25), 3.0, 61
    k = 2.0 * np.pi * 1.5 / length
    rod = rod_of(mrs.geometry.straight(length, nodes), 1.0, 40.0, (k, 0.0, 1e-2 * k))
    i, j = np.triu_indices(nodes, 1)
    reach = 2.0 * steric.chi * steric.radius
    i, j = np.array([i, j])[:, (j - i) * length / (nodes - 1) > reach * (1.0 + 1e-9)]
    for with_steric in (True, False):
        sim = simulate([rod], 0.1, forces=[steric] if with_steric else [])
        least, balance, energy = [], [], []
        while sim.time < 4.0:
            sim.step(4.0)
            X = sim.state.positions
            least.append(np.linalg.norm(X[i] - X[j], axis=1).min())
            balance.append(imbalance(sim))
            energy.append(sim.energy() + with_steric * _potential(steric, X[i] - X[j]))
        if with_steric:
            yield at_least("least distance of nodes", min(least), 2.0 * steric.radius)
            rise = np.diff(energy).max() / energy[0]
            yield at_most("largest rise of the energy in a step, over the first", rise, 0.0)
            yield at_most("net force and torque, in roundings", max(balance), 64)
        else:
            yield at_most("least distance without repulsion", min(least), 1.6 * steric.radius)


def _potential(steric, between):
    """Return the energy of the repulsion: its force is strength / 2a nearness^4 r."""
    contact, reach = 2.0 * steric.radius, 2.0 * steric.chi * steric.radius
    r2 = (between**2).sum(axis=1)
    fifth = np.maximum(reach**2 - r2, 0.0) ** 5 / (reach**2 - contact**2) ** 4
    return steric.strength / (10.0 * contact) * fifth.sum()
