"""Pictures in notebooks: those that `render` makes of the same frames."""

import io

import imageio.v3 as iio
import numpy as np
import pytest

import mrs
from mrs.output.render import render


def falling(**options):
    """Return a simulation of two rods that fall."""
    line = mrs.geometry.straight(1.0, 7)
    lines = mrs.geometry.array(line, mrs.geometry.grid((2, 1), 0.5))
    moduli = {"bending": 0.1, "twisting": 0.1, "shearing": 5.0, "stretching": 5.0}
    force = mrs.Gravity(per_length=(0.0, 0.0, -1.0))
    fluid = mrs.Fluid(epsilon=0.3)
    return mrs.Simulation(fluid, [mrs.Rods(lines, **moduli)], forces=[force], **options)


def pixels(picture):
    """Return the pixels of what a notebook would show."""
    return iio.imread(io.BytesIO(picture._repr_png_()))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("run") / "falling"
    sim = falling(output=mrs.Output(directory, interval=0.1)).run(0.3)
    return sim, mrs.open_run(directory)


@pytest.mark.parametrize("frame", [0, -1])
def test_a_frame_of_a_run(run, frame, tmp_path):
    _, opened = run
    path = render(opened, tmp_path / "frame.png", frame=frame, size=(320, 200))
    np.testing.assert_array_equal(pixels(opened.show(frame, size=(320, 200))), iio.imread(path))


def test_the_present_state(run):
    """It is the last frame. Nothing is written to the directory, nor noted as written."""
    sim, opened = run
    before = sorted(opened.directory.rglob("*")), dict(sim.written)
    shown = pixels(sim.show(size=(320, 200)))
    np.testing.assert_array_equal(shown, pixels(opened.show(size=(320, 200))))
    assert (sorted(opened.directory.rglob("*")), dict(sim.written)) == before


def test_a_simulation_without_files():
    assert pixels(falling().show(size=(64, 48))).shape[:2] == (48, 64)
