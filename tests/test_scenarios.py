"""The checks of the scenarios: each number is due to hydrodynamic interaction, and to nothing else.

In place of the fluid, each point may be moved by its own force alone, and turned by its own torque.
No constants of such a local drag may pass for the fluid.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from mrs.fluid import blocks
from mrs.run import scenario_files

each_scenario = pytest.mark.parametrize("name", scenario_files.known())


class Drag(NamedTuple):
    """Velocity by unit force, and angular velocity by unit torque, at every point."""

    velocity: float
    spin: float

    def replace(self, mobility, monkeypatch):
        """Stand in for a class of mobility; the fluid between the points is at rest."""

        def motion(mobility, points, loads, boundary):
            return loads * np.repeat(self, 3)[: loads.shape[1]]

        def matrix(mobility, rows, places, boundary):
            width = 6 if mobility._torqued[rows].any() else 3
            return np.diag(np.tile(np.repeat(self, 3)[:width], len(rows)))

        def velocity(mobility, points, loads, targets, boundary):
            return np.zeros_like(targets)

        def inverse(viscosity, epsilons, points):
            return np.eye(points.size) / self.velocity

        monkeypatch.setattr(mobility, "__call__", motion)
        monkeypatch.setattr(mobility, "matrix", matrix)
        monkeypatch.setattr(mobility, "velocity", velocity)
        monkeypatch.setattr(blocks, "_inverse", inverse)  # where forces follow from velocities


@cache
def finished(name):
    """Return the quick version of a scenario and its simulation at the end, in the true fluid."""
    scene = scenario_files.make(name, {}, quick=True)
    return scene, scene.simulation().run(scene.t_end)


def alone(sim):
    """Return the motion of a blob alone in the fluid, physics.md 2."""
    epsilon, viscosity = sim.scene.epsilons[0], sim.fluid.viscosity
    return Drag(
        1.0 / (4.0 * np.pi * viscosity * epsilon), 5.0 / (16.0 * np.pi * viscosity * epsilon**3)
    )


def slender(sim):
    """Return the motion of a piece of a slender rod across itself, and about its axis.

    Per length 4 pi mu / (ln(L/a) + 1/2) and 4 pi mu a^2 (Cox 1970, J. Fluid Mech. 44, 791), with
    the radius of physics.md 3. The two points of a swimmer share its length.
    """
    body = sim.bodies[0]
    pieces = body.pieces().max() + 1
    length = body.length_scale
    piece = length * pieces / sim.scene.layout.point_count(body)
    radius = sim.scene.epsilons[0] / np.sqrt(np.e)
    across = 4.0 * np.pi * sim.fluid.viscosity / (np.log(length / radius) + 0.5)
    about = 4.0 * np.pi * sim.fluid.viscosity * radius**2
    return Drag(1.0 / (across * piece), 1.0 / (about * piece))


def fitted(sim):
    """Return what comes nearest to the motion at the end of the run, in least squares.

    Neither constant may be negative: in a fluid, points may turn against their own torques.
    """
    now = sim.now
    motion = now.motion.copy()
    if sim.fluid.background is not None:
        motion[:, :3] -= sim.fluid.flow("velocity", now.points, sim.time)
        motion[:, 3:] -= 0.5 * sim.fluid.flow("vorticity", now.points, sim.time)
    force, torque = now.loads[:, :3], now.loads[:, 3:]
    along = np.vdot(force, motion[:, :3]) / np.vdot(force, force)
    about = np.vdot(torque, motion[:, 3:]) / np.vdot(torque, torque) if torque.size else 0.0
    return Drag(max(float(along), 0.0), max(float(about), 0.0))


@each_scenario
def test_the_fluid_gives_the_number(name):
    scene, sim = finished(name)
    result = scene.check(sim)
    assert result.passed, str(result)
    assert result.expected != 0.0


@pytest.mark.parametrize("drag", [alone, slender, fitted], ids=lambda drag: drag.__name__)
@each_scenario
def test_no_local_drag_gives_the_number(name, drag, monkeypatch):
    """Neither these constants nor others: the number is nothing but rounding."""
    scene, sim = finished(name)
    constants = drag(sim)
    assert min(constants) >= 0.0
    constants.replace(type(sim.mobility), monkeypatch)
    result = scene.check(scene.simulation().run(scene.t_end))
    assert not result.passed, str(result)
    assert abs(result.value) < 1e-6 * abs(result.expected)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("helical_swimmer", {"t_end": 0.01}),
        ("helical_swimmer", {"t_end": 0.3, "curvature": 1.0}),
        ("sedimenting_fibre", {"t_end": 0.01, "nodes": 30}),
        ("sedimenting_fibre", {"t_end": 1.0, "bending": 0.02}),
        ("fibre_in_shear", {"t_end": 0.01}),
        ("fibre_in_shear", {"t_end": 0.5, "angle": 1.0}),
        ("fibre_in_shear", {"t_end": 3.0, "bending": 0.05}),
        ("fibre_in_shear", {"t_end": 0.1, "tracers": 0}),
        ("rod_relaxation", {"t_end": 0.01, "nodes": 27, "twist": 0.0}),
        ("swimmer_suspension", {"t_end": 0.02, "count": 300}),  # many touch
        ("swimmer_suspension", {"t_end": 0.02, "stroke": "puller"}),
        ("swimmer_suspension", {"t_end": 0.02, "count": 1, "periodic": False}),
        ("swimmer_at_wall", {"t_end": 0.1, "stroke": "puller"}),
        ("swimmer_at_wall", {"t_end": 0.1, "angle": 1.5, "height": 10.0}),  # repelled
        ("rod_above_wall", {"t_end": 1e-3, "height": 3.0}),
        ("dragged_bodies", {"t_end": 0.1, "arrangement": "triangle"}),
        ("dragged_bodies", {"t_end": 0.1, "arrangement": "line", "distance": 6.0}),
        ("dragged_bodies", {"t_end": 0.1, "arrangement": "through"}),
        ("helical_swimmer_with_head", {"t_end": 2e-4, "flagellum": "elastic"}),
        ("helical_swimmer_with_head", {"t_end": 1e-3, "rate": -100.0, "head_length": 1.0}),
        ("swimmer_suspension", {"t_end": 0.02, "periodic": False, "tracers": 0}),
        ("cilia_array", {"t_end": 0.02, "rows": 1}),
        ("cilia_array", {"t_end": 0.02, "rows": 5, "metachronal_wavelength": 6.0}),
        ("cilia_array", {"t_end": 0.02, "wall": False}),
        ("prescribed_cilia", {"t_end": 0.02, "rows": 1, "columns": 1, "tracers": 0}),
        ("prescribed_cilia", {"t_end": 0.02, "metachronal_wavelength": 8.0}),
    ],
)
def test_other_options_give_their_numbers(name, options):
    """Also a run that ends while everything is still bending."""
    scene = scenario_files.make(name, options, quick=True)
    result = scene.check(scene.simulation().run(scene.t_end))
    assert result.passed, str(result)
