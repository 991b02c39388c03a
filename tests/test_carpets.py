"""Cilia and a swimming rod over a wall: what they pump, and how fast they swim."""

from functools import cache

import numpy as np
import pytest

import mrs
from mrs.scenarios.cilia_array import CiliaArray
from mrs.scenarios.rod_above_wall import RodAboveWall

BEAT = 8  # times in a beat of period 1 at which the flux is taken


@cache
def pumped(lag, amplitude=1.0):
    """Return the flux along x of three straight cilia in its second beat, (BEAT,).

    They bend in the plane of x and z, each `lag` periods later than its neighbour in x.
    """
    cilium = mrs.geometry.straight(1.2, 7, origin=(0.0, 0.0, 0.1))
    places = np.arange(-1.0, 2.0)
    cilia = mrs.Rods(
        mrs.geometry.array(cilium, np.outer(places, [1.0, 0.0, 0.0])),
        bending=20.0, twisting=20.0, shearing=200.0, stretching=200.0, base="clamped", epsilon=0.3,
        beat=mrs.TravellingWave((0.0, amplitude, 0.0), 3.0, 1.0), delay=lag * places,
    )  # fmt: skip
    integrator = mrs.Integrator(tolerance=1e-3)
    fluid = mrs.Fluid(boundary=mrs.Wall())
    sim = mrs.Simulation(fluid, [cilia], backend="direct", integrator=integrator)
    flux = mrs.observables.PumpedFlux()
    return np.array([flux(sim.run(1.0 + k / BEAT)) for k in range(1, BEAT + 1)])


def test_the_mirror_image_of_a_carpet_pumps_the_other_way():
    """A reflection in x reverses the metachronal wave and the bending; at all times."""
    np.testing.assert_allclose(pumped(-0.2, -1.0), -pumped(0.2), rtol=0, atol=1e-6)


def test_a_metachronal_wave_pumps_and_a_symmetric_beat_does_not():
    """Bending the other way is bending half a beat later.

    In the mean over a beat cilia in phase therefore pump nothing. Those in a metachronal wave pump,
    and as much the other way if it is reversed. What is left of the start is 5e-4 of the peak.
    """
    together, wave, reversed_wave = pumped(0.0), pumped(0.2), pumped(-0.2)
    peak = np.abs(together).max()
    assert abs(together.mean()) < 1e-3 * peak
    assert abs(wave.mean()) > 0.03 * peak
    assert reversed_wave.mean() == pytest.approx(-wave.mean(), abs=1e-3 * peak)


def flux_per_cilium(count):
    """Return the flux of count x count cilia in phase after a quarter of the first beat."""
    options = {"rows": count, "columns": count, "nodes": 13, "height": 3.0, "epsilon": 0.4}
    carpet = CiliaArray(**options, metachronal_wavelength=1e9)
    return mrs.observables.PumpedFlux()(carpet.simulation().run(0.25)) / count**2


def test_the_flux_of_a_carpet_per_area_converges_with_its_size():
    """Neighbours hinder each other, and each further row of them less."""
    flux = np.array([flux_per_cilium(count) for count in (1, 2, 3, 4)])
    losses = -np.diff(flux)
    assert (losses > 0.0).all()
    assert (np.diff(losses) < 0.0).all()


def swimming_speed(height, nodes):
    """Return the mean speed of the rod against its wave over the first beat."""
    rod = RodAboveWall(height=height, nodes=nodes, epsilon=2.0, integrator={"tolerance": 1e-4})
    return -rod.simulation().run(rod.period).state.positions[:, 0].mean() / rod.period


def test_a_planar_wave_swims_faster_near_a_wall():
    """By as much with twice the nodes, to their error of second order."""
    far, middle, near = (swimming_speed(height, 41) for height in (1e4, 10.0, 5.0))
    assert far < middle < near
    finer = swimming_speed(10.0, 81) / swimming_speed(1e4, 81)
    assert middle / far == pytest.approx(finer, rel=0.01)
