"""A run that goes on is the run: its files are looked at first, and what was changed is said."""

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

import mrs
from mrs.describe import described, differences
from mrs.output import pvd, run_directory, vtkhdf
from mrs.run import cli
from mrs.run.resuming import scenario_of
from tests.test_runs import assert_equal_runs, trajectories

OPTIONS = ["nodes=21", "tracers=30", "interval=0.1", 'formats=["vtkhdf","pvd"]', "t_end=0.6"]
ARGUMENTS = ["run", "fibre_in_shear", *(word for o in OPTIONS for word in ("--set", o)), "--output"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run to 0.6, and the same run gone on with to 0.8."""
    folder = tmp_path_factory.mktemp("runs")
    assert cli.main([*ARGUMENTS, str(folder / "first")]) == 0
    shutil.copytree(folder / "first", folder / "second")
    assert cli.main(["resume", str(folder / "second"), "--t-end", "0.8"]) == 0
    return folder


@pytest.fixture
def run(runs, tmp_path):
    """A copy of the first run, to be spoiled."""
    return Path(shutil.copytree(runs / "first", tmp_path / "run"))


def contents(directory):
    """Return the bytes of all files."""
    paths = (path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in paths}


def shortened(path):
    """Leave frames out at the end, as an older copy of the file."""
    if path.suffix == ".vtkhdf":
        vtkhdf.cut(path, 0.35)
    elif path.suffix == ".csv":
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-3]))
    else:
        pvd.cut(path, 0.35)


def of_another_scene(path):
    """Put a file of another body in its place."""
    other = {
        "fibre.vtkhdf": "tracers.vtkhdf",
        "tracers.vtkhdf": "fibre.vtkhdf",
        "fibre.pvd": "tracers.pvd",
        "log.csv": "config.toml",
    }
    shutil.copy(path.with_name(other[path.name]), path)


DAMAGES = {
    "missing": (lambda path: path.unlink(), "is missing"),
    "half": (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]), ""),
    "empty": (lambda path: path.write_bytes(b""), ""),
    "old": (shortened, "ends at t = 0.3, but was written to t = 0."),
    "other": (of_another_scene, "is of another scene|is no log of a run"),
}


@pytest.mark.parametrize("name", ["fibre.vtkhdf", "tracers.vtkhdf", "fibre.pvd", "log.csv"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_and_nothing_is_touched(runs, run, capsys, name, damage):
    """Put back, the run ends as if nothing had been; begun anew, the other files are whole."""
    do, said = DAMAGES[damage]
    before = contents(run)
    do(run / name)
    spoiled = contents(run)
    assert cli.main(["resume", str(run), "--t-end", "0.8"]) == 1
    message = capsys.readouterr().err
    found = [line for line in message.splitlines() if line.startswith(f"  {run / name} ")]
    assert len(found) == 1, message
    if said:
        assert any(part in found[0] for part in said.split("|")) or pytest.fail(found[0])
    assert "--renew-files" in message
    assert contents(run) == spoiled
    (run / name).write_bytes(before[name])
    for file, data in before.items():  # those that a shortened list has lost
        (run / file).write_bytes(data)
    assert cli.main(["resume", str(run), "--t-end", "0.8"]) == 0
    assert_equal_runs(runs / "second", run)


@pytest.mark.parametrize("damage", ["missing", "half"])
def test_files_are_begun_anew_when_told(runs, run, damage):
    DAMAGES[damage][0](run / "tracers.vtkhdf")
    spoiled = contents(run)
    assert cli.main(["resume", str(run), "--t-end", "0.8", "--renew-files"]) == 0
    found, whole = trajectories(run), trajectories(runs / "second")
    np.testing.assert_equal(found["fibre.vtkhdf"], whole["fibre.vtkhdf"])
    times, frames = whole["tracers.vtkhdf"]
    np.testing.assert_equal(found["tracers.vtkhdf"], (times[6:], frames[6:]))
    assert times[6] == 0.6
    kept = run / "tracers.vtkhdf.damaged1"
    assert kept.exists() == (damage == "half")
    if kept.exists():
        assert kept.read_bytes() == spoiled["tracers.vtkhdf"]
    assert contents(run)["tracers.pvd"] == contents(runs / "second")["tracers.pvd"]


def test_a_lost_list_of_live_frames(runs, run):
    """Frames that nothing lists stay, and the new ones count on after them."""
    (run / "fibre.pvd").unlink()
    before = contents(run)
    assert cli.main(["resume", str(run), "--t-end", "0.8", "--renew-files"]) == 0
    after = contents(run)
    frames = [f"fibre/{i:06d}.vtp" for i in range(10)]
    assert sorted(name for name in after if name.startswith("fibre/")) == frames
    assert all(after[name] == before[name] for name in frames[:7])
    whole = contents(runs / "second")
    assert [after[name] for name in frames[7:]] == [whole[name] for name in frames[6:9]]


def test_a_live_frame_that_is_missing(run, capsys):
    (run / "fibre" / "000003.vtp").unlink()
    assert cli.main(["resume", str(run), "--t-end", "0.8"]) == 1
    assert "fibre.pvd lists fibre/000003.vtp, which is missing" in capsys.readouterr().err


def test_a_frame_at_the_checkpoint_goes_to_the_file_that_lacks_it(runs, run):
    """As after a kill between two files."""
    vtkhdf.cut(run / "tracers.vtkhdf", 0.55)
    before = contents(run)
    sim = mrs.restart(scenario_of(run).simulation(run))
    sim.run(0.6)
    np.testing.assert_equal(trajectories(run), trajectories(runs / "first"))
    same = {name for name, data in contents(run).items() if before[name] == data}
    assert same >= {"fibre.vtkhdf", "log.csv", "fibre.pvd"}


def test_a_log_that_another_program_has_saved(runs, run):
    """With a byte-order mark, its line ends, and fifteen digits."""
    log = run / "log.csv"
    rows = log.read_text().replace("0.30000000000000004", "0.3").replace("\n", "\r\n")
    log.write_bytes(b"\xef\xbb\xbf" + rows.encode())
    assert cli.main(["resume", str(run), "--t-end", "0.8"]) == 0
    found = log.read_bytes()
    assert b"\r" not in found
    assert not found.startswith(b"\xef\xbb\xbf")
    times = [line.split(",")[1] for line in found.decode().splitlines()]
    whole = (runs / "second" / "log.csv").read_text().splitlines()
    expected = [line.split(",")[1].replace("0.30000000000000004", "0.3") for line in whole]
    assert times == expected


def test_the_second_call_of_run_looks_too(tmp_path):
    sim = script(tmp_path / "run").run(0.1)
    (tmp_path / "run" / "tracers.vtkhdf").unlink()
    with pytest.raises(mrs.SimulationError, match=r"tracers\.vtkhdf is missing"):
        sim.run(0.2)
    sim.run(0.2, renew_files=True)
    assert list(trajectories(tmp_path / "run")["tracers.vtkhdf"][0]) == [0.1, 0.2]


# --- what was changed --------------------------------------------------------------------------


def edit(run, **options):
    """Change options in config.toml."""
    content = run_directory.read(run)
    for name, value in options.items():
        group = content["options"]
        *path, last = name.split("__")
        for part in path:
            group = group[part]
        group[last] = value
    run_directory._write(run, content)


def test_without_changes_nothing_is_said(run):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mrs.resume(run, 0.7)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"backend__name": "kitc", "backend__degree": 5}, ["backend.name: 'auto' became 'kitc'",
                                                           "backend.degree: nothing became 5"]),
        ({"backend__tolerance": 1e-6}, ["backend.tolerance: 0.0001 became 1e-06"]),
        ({"integrator__tolerance": 1e-3}, ["integrator.tolerance: 0.0001 became 0.001"]),
        ({"interval": 0.05, "formats": ["vtkhdf"]}, ["output.interval: 0.1 became 0.05",
                                     "output.formats: ['vtkhdf', 'pvd'] became ['vtkhdf']"]),
    ],
)  # fmt: skip
def test_numerics_are_taken_up_and_said(run, options, said):
    """The state is that of the checkpoint; the way to compute is the new one from there on."""
    edit(run, **options)
    sim = scenario_of(run).simulation(run)
    with pytest.warns(UserWarning, match=r"from t = 0\.6") as told:
        mrs.restart(sim)
    assert len(told) == 1
    lines = str(told[0].message).splitlines()[1:]
    assert sorted(line.strip() for line in lines) == sorted(said)
    section = said[0].partition(".")[0]
    fresh = scenario_of(run).simulation().mobility.history()
    assert (sim.mobility.history() == fresh) == (section == "backend")
    assert (sim.stepper.h is None) == (section == "integrator")
    assert sim.stepper.steps > 0
    sim.run(0.7)
    if section == "backend":
        assert {choice.backend for choice in sim.mobility.choices} <= {"kitc", "direct"}


def test_other_physics_is_refused_until_it_is_meant(run, capsys):
    before = contents(run)
    edit(run, bending=3.0)
    assert cli.main(["resume", str(run), "--t-end", "0.7"]) == 1
    message = capsys.readouterr().err
    assert "bodies.fibre.bending: 1.0 became 3.0" in message
    assert "options.bending: 1.0 became 3.0" in message
    assert "--changes" in message
    after = contents(run)
    assert {name for name in before if before[name] != after[name]} == {"config.toml"}
    with pytest.warns(UserWarning, match=r"bodies\.fibre\.bending: 1\.0 became 3\.0"):
        sim = mrs.resume(run, 0.7, changes=True)
    assert sim.time == 0.7
    with warnings.catch_warnings():  # the next checkpoint is of the changed scene
        warnings.simplefilter("error")
        mrs.resume(run, 0.8)


def test_other_numbers_of_points_are_always_refused(run):
    edit(run, tracers=31)
    with pytest.raises(ValueError, match=r"other numbers of points") as refused:
        mrs.resume(run, 0.7, changes=True)
    assert "options.tracers: 30 became 31" in str(refused.value)


def script(directory, *, rate=1.0, bending=1.0, names=("fibre", "tracers"), beat=None, forces=()):
    """A simulation of a script of one's own."""
    fibre = mrs.Rods(
        mrs.geometry.straight(1.0, 11),
        bending=bending,
        twisting=1.0,
        shearing=50.0,
        stretching=50.0,
        beat=beat,
        name=names[0],
    )
    tracers = mrs.Tracers(np.random.default_rng(0).random((20, 3)), name=names[1])
    fluid = mrs.Fluid(epsilon=0.2, background=mrs.flows.shear(rate))
    output = mrs.Output(directory, interval=0.1)
    return mrs.Simulation(fluid, [fibre, tracers], forces=forces, output=output)


def wave(amplitude):
    """Return a beat that keeps its amplitude to itself."""
    return lambda s, t: np.outer(np.sin(s - t), [amplitude, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rate": 5.0}, "fluid.background.gradient"),
        ({"bending": [[1.0, 2.0]]}, r"bodies.fibre.bending: 1.0 became \[\[1.0, 2.0\]\]"),
        ({"beat": wave(0.2)}, "bodies.fibre.beat.values.amplitude: 0.1 became 0.2"),
        ({"beat": lambda s, t: np.zeros((len(s), 3))}, "bodies.fibre.beat"),
        ({"forces": [mrs.Steric(1.0, 0.1)]}, "forces"),
        ({"names": ("rod", "tracers")}, "bodies.rod"),
    ],
)
def test_a_script_that_was_changed(tmp_path, changed, said):
    same = {"beat": wave(0.1)}
    script(tmp_path / "run", **same).run(0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mrs.restart(script(tmp_path / "run", beat=wave(0.1)))
    sim = script(tmp_path / "run", **same | changed)
    with pytest.raises(ValueError, match=f"(?s)not that of the checkpoint.*{said}"):
        mrs.restart(sim)
    with pytest.warns(UserWarning, match=said):
        mrs.restart(sim, changes=True)
    assert sim.time == 0.1


class Bead(mrs.bodies.Body):
    """A body of a user's own class."""

    kind = name = "bead"
    length_scale = 1.0

    def __init__(self, weight):
        self.weight = weight
        self.positions, self.quaternions = np.zeros((1, 3)), np.empty((0, 4))


class Heavier(Bead):
    def loads(self, time, state):
        return np.full((1, 3), 2.0 * self.weight), None


def test_bodies_of_ones_own_describe_themselves():
    one = Bead(1.0).parameters()
    assert differences(one, Bead(1.0).parameters()) == []
    assert [str(d) for d in differences(one, Bead(2.0).parameters())] == ["weight: 1.0 became 2.0"]
    assert [d.place for d in differences(one, Heavier(1.0).parameters())] == ["code"]


def test_descriptions_are_what_json_holds_and_rounding_is_no_difference():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((1000, 3))
    value = {"points": points, "f": wave(0.3), "none": None, "rods": [{"a": 1.0}, {"a": 2}]}
    value["many"] = [{"nodes": rng.random((9, 3)), "closed": False} for _ in range(100)]
    one = json.loads(json.dumps(described(value)))
    assert differences(one, described(value)) == []
    rounded = value | {"points": points * (1.0 + 1e-15), "f": wave(0.1 + 0.2)}
    assert differences(one, described(rounded)) == []
    for i in range(3):
        moved = points.copy()
        moved[500, i] += 1e-6
        (found,) = differences(one, described(value | {"points": moved}))
        assert str(found) == "points: array (1000, 3) became one with other numbers"
    (found,) = differences(one, described(value | {"rods": [{"a": 1.0}, {"a": 3}]}))
    assert str(found) == "rods.1.a: 2 became 3"
    value["many"][50]["closed"] = True
    assert differences(one, described(value))
