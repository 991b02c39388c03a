"""Observables in runs: columns of the log are what the files of the run give."""

import csv

import numpy as np
import pytest

import mrs
from mrs import observables as obs
from mrs.output import vtkhdf
from mrs.output.topology import Topology
from mrs.run import scenario_files

BINS = [0.0, 1.0, 2.0]
PLANE = {"corner": [0.0, -1.0, -1.0], "sides": [[0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], "order": 6}
TABLES = {
    "Q": {"kind": "flux", **PLANE},
    "u": {"kind": "velocity_profile", "heights": [0.0, 0.5], **PLANE},
    "msd": {"kind": "mean_square_displacement", "body": "swimmers"},
    "memory": {"kind": "orientation_memory", "body": "swimmers"},
    "g": {"kind": "pair_distribution", "body": "swimmers", "bins": BINS},
    "C": {"kind": "orientation_correlation", "body": "swimmers", "bins": BINS},
}
OPTIONS = {
    "count": 20,
    "size": 4.0,
    "periodic": False,
    "interval": 0.1,
    "observables": TABLES,
}


def rows_of(directory):
    with (directory / "log.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """A run that was stopped and resumed, so that its columns go on as well."""
    path = tmp_path_factory.mktemp("run") / "swimmers"
    scenario = scenario_files.make("swimmer_suspension", OPTIONS | {"t_end": 0.2})
    scenario.simulation(path).run(0.2)
    mrs.resume(path, 0.4)
    return path


def test_log_has_what_the_files_give(directory):
    """Positions in files are doubles; directions and forces are singles, so 1e-6."""
    rows, frames = rows_of(directory), range(5)
    times, positions, directions, cell = obs.tracks(directory, "swimmers")
    assert cell is None
    np.testing.assert_array_equal([float(row["t"]) for row in rows], times)

    def column(name):
        return np.array([float(row[name]) for row in rows])

    def close(name, values, rtol):
        np.testing.assert_allclose(column(name), values, rtol=rtol, atol=1e-14)

    close("msd", obs.mean_square_displacement(times, positions, "first"), 1e-12)
    close("memory", obs.orientation_memory(times, directions, "first"), 1e-6)
    assert column("msd")[-1] > column("msd")[1] > column("msd")[0] == 0.0
    assert column("memory")[-1] < column("memory")[0] == pytest.approx(1.0)
    for bin_, label in enumerate(["0.5", "1.5"]):
        g = [obs.pair_distribution(points, BINS)[bin_] for points in positions]
        close(f"g[{label}]", g, 1e-12)
        pairs = zip(positions, directions, strict=True)
        found = [obs.orientation_correlation(*pair, BINS)[bin_] for pair in pairs]
        np.testing.assert_allclose(column(f"C[{label}]"), found, atol=1e-6)
    velocities = [mrs.frame_velocity(directory, frame)[1] for frame in frames]
    rectangle = obs.Rectangle(**PLANE)
    profiles = [obs.velocity_profile(u, rectangle, [0.0, 0.5])[:, 0] for u in velocities]
    scale = np.abs(profiles).max()
    np.testing.assert_allclose(column("u[0]"), np.array(profiles)[:, 0], atol=1e-6 * scale)
    np.testing.assert_allclose(column("u[0.5]"), np.array(profiles)[:, 1], atol=1e-6 * scale)
    close("Q", 4.0 * column("u[0]"), 1e-12)


def test_loads_of_a_frame(directory):
    """Each swimmer pushes with 1 at its body and -1 at its flagellum, beside contact forces."""
    points, loads = (array[:40] for array in obs.frame_loads(directory, 0))
    positions, directions = (array[0] for array in obs.tracks(directory, "swimmers")[1:3])
    np.testing.assert_array_equal(points[:20], positions)
    np.testing.assert_allclose(points[20:], positions - directions, atol=1e-6)
    np.testing.assert_allclose(loads[:, :3].sum(axis=0), 0.0, atol=1e-5)
    np.testing.assert_array_equal(loads[:, 3:], 0.0)


def test_tracks_are_unwrapped(tmp_path):
    """Points of a periodic run are stored in the cell, with the numbers of its images."""
    cell = np.array([[2.0, 0.0, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 3.0]])
    path = tmp_path / "tracers.vtkhdf"
    meta = {"boundary kind": "periodic", "boundary cell": cell}
    vtkhdf.create(path, Topology(np.arange(2), []), meta=meta)
    unwrapped = np.random.default_rng(4).uniform(-9.0, 9.0, (3, 2, 3))
    for time, points in enumerate(unwrapped):
        image = np.floor(points @ np.linalg.inv(cell)).astype(int)
        vtkhdf.append(path, float(time), points - image @ cell, {"image": image})
    found = obs.tracks(tmp_path, "tracers")
    np.testing.assert_allclose(found.positions, unwrapped, rtol=1e-13)
    np.testing.assert_array_equal(found.cell, cell)
    np.testing.assert_array_equal(found.times, [0.0, 1.0, 2.0])
    assert found.directions is None


def test_directions_of_rods_are_those_of_their_nodes(tmp_path):
    rods = mrs.Rods(
        mrs.geometry.straight(1.0, 5, direction=(0.0, 0.6, 0.8)),
        bending=1.0, twisting=1.0, shearing=1.0, stretching=1.0, epsilon=0.2,
    )  # fmt: skip
    output = mrs.Output(tmp_path, 1e-3, columns={"memory": obs.OrientationMemory("rods")})
    mrs.Simulation(mrs.Fluid(), [rods], output=output).run(1e-3)
    found = obs.tracks(tmp_path, "rods")
    np.testing.assert_allclose(found.directions[0], np.tile([0.0, 0.6, 0.8], (5, 1)), atol=1e-7)
    assert float(rows_of(tmp_path)[-1]["memory"]) == pytest.approx(1.0)


def test_pumped_flux_in_the_log(tmp_path):
    """The column is the function of the loads; a scene without a wall is refused before it runs."""
    swimmers = mrs.Swimmers(
        [[0.0, 0.0, 1.0]], [[0.6, 0.0, 0.8]], length=0.5, force=2.0, epsilon=0.1
    )
    columns = {"Q": obs.PumpedFlux()}
    fluid = mrs.Fluid(viscosity=3.0, boundary=mrs.Wall())
    output = mrs.Output(tmp_path / "run", 0.01, columns=columns)
    mrs.Simulation(fluid, [swimmers], output=output).run(0.01)
    # 2 p at height 1, and -2 p at 1 - 0.5 p_z
    expected = 1.2 * (1.0 - 0.6) / (3.0 * np.pi)
    assert float(rows_of(tmp_path / "run")[0]["Q"]) == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ValueError, match=r"columns\['Q'\]: the fluid must have a wall .*FreeSpace"):
        mrs.Simulation(mrs.Fluid(), [swimmers], output=output)
    side = mrs.Wall([-9.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r"columns\['Q'\]: direction must be along the wall"):
        mrs.Simulation(mrs.Fluid(boundary=side), [swimmers], output=output)


@mrs.OBSERVABLES.register
class Twice:
    """Two numbers; as many as its labels if `count` is 2."""

    kind = "twice"
    labels = ("a", "b")

    def __init__(self, count: int = 2):
        self.count = count

    def __call__(self, sim):
        return [sim.time] * self.count


def test_observables_of_ones_own(tmp_path):
    options = {"t_end": 0.1, "count": 2, "observables": {"mine": {"kind": "twice"}}}
    scenario = scenario_files.make("swimmer_suspension", options)
    scenario.simulation(tmp_path).run(0.1)
    assert rows_of(tmp_path)[-1]["mine[a]"] == rows_of(tmp_path)[-1]["mine[b]"] == "0.1"
    tracers = mrs.Tracers([[0.0, 0.0, 0.0]])
    for columns, message in (
        ({"mine": Twice(3)}, r"columns\['mine'\] must give 2 numbers, one a label, got \[0.0"),
        ({"mine": Twice(), "mine[a]": len}, r"different headings, got twice \['mine\[a\]'\]"),
    ):
        output = mrs.Output(tmp_path / "other", 0.1, columns=columns, overwrite=True)
        with pytest.raises(ValueError, match=message):
            mrs.Simulation(mrs.Fluid(), [tracers], output=output).run(0.1)


# --- refusals ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "observables: x: kind must be one of .*'flux'.*got None"),
        ({"kind": "flux", **PLANE, "ordr": 3}, "x: Flux has no argument 'ordr'; .*'order'"),
        ({"kind": "flux", **PLANE, "order": 0}, "x: order must be an integer from 1"),
        ({"kind": "pair_distribution", "body": "a", "bins": [1]}, "x: bins must be at least two"),
        ({"kind": "flux"}, "x: .*corner"),
    ],
)
def test_refusals_of_options(table, message):
    with pytest.raises(mrs.ScenarioError, match=message):
        scenario_files.make("swimmer_suspension", {"observables": {"x": table}})


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (obs.MeanSquareDisplacement("dust"), "body must be one of 'tracers', got 'dust'"),
        (obs.OrientationMemory("tracers"), "body must have directions, 'tracers' has none"),
    ],
)
def test_refusals_of_scenes(column, message, tmp_path):
    output = mrs.Output(tmp_path / "run", 0.1, columns={"x": column})
    with pytest.raises(ValueError, match=rf"columns\['x'\]: {message}"):
        mrs.Simulation(mrs.Fluid(), [mrs.Tracers([[0.0, 0.0, 0.0]])], output=output)
    assert not (tmp_path / "run").exists()


def test_refusals_of_stored_runs(directory, tmp_path):
    with pytest.raises(ValueError, match="body must be one of 'swimmers', 'tracers', got 'rods'"):
        obs.tracks(directory, "rods")
    with pytest.raises(FileNotFoundError, match="no trajectories"):
        obs.tracks(tmp_path, "rods")
