"""A run directory holds a run's files and the user's: what is deleted, refused, named, left."""

import json
import subprocess
import sys
import threading
from importlib import metadata
from pathlib import Path

import h5py
import numpy as np
import pytest

import mrs
from mrs.fluid.mobility import Mobility
from mrs.output import checkpoint, export, run_directory
from mrs.output.atomic import temporary_name
from mrs.output.trajectory import Trajectory
from mrs.run import cli
from tests.test_going_on import contents, script
from tests.test_runs import assert_equal_runs, swim, trajectories


def test_overwriting_deletes_the_files_of_the_run_and_no_others(tmp_path):
    """Frames of live files, exports and pictures go; what the user put there stays."""
    run = tmp_path / "run"
    arguments = [*swim(run, 0.1), "--set", 'formats=["vtkhdf","pvd"]']
    assert cli.main(arguments) == 0
    run_directory.note(run, *export.export(run, "vtu"))
    noted = [run / "picture.png", run / "vtp" / "deep" / "a.vtp"]
    run_directory.note(run, *noted, tmp_path / "elsewhere.png", run / ".." / "elsewhere.png")
    foreign = ["mine.vtkhdf", "notes.txt", "mine.pvd", "vtu/mine.vtu", "flagellum/mine.vtp"]
    foreign = [run / name for name in foreign] + [tmp_path / "elsewhere.png"]
    for path in (*noted, *foreign, temporary_name(run / "flagellum.vtkhdf")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    assert cli.main([*swim(run, 0.05), "--overwrite"]) == 0
    assert all(path.read_text() == "mine" for path in foreign)
    left = {name for name in contents(run) if run / name not in foreign}
    assert left == {
        "checkpoint.h5",
        "checkpoint.previous.h5",
        "config.toml",
        "files.txt",
        "flagellum.vtkhdf",
        "log.csv",
        "paraview/open_in_paraview.py",
    }
    assert not (run / "vtp").exists()
    assert not (run / ".flagellum.partial.vtkhdf").exists()


def test_all_that_a_run_writes_is_noted(tmp_path):
    run = tmp_path / "run"
    arguments = [*swim(run, 0.1), "--set", 'formats=["vtkhdf","pvd"]', "--profile"]
    assert cli.main(arguments) == 0
    assert {run / name for name in contents(run)} <= set(run_directory.noted(run))
    run_directory.discard(run)
    assert list(run.iterdir()) == []


def test_a_list_that_a_killed_process_left_half_a_name_in(tmp_path):
    run_directory.note(tmp_path, tmp_path / "a.png")
    with (tmp_path / "files.txt").open("a") as listing:
        listing.write("b.p")
    run_directory.note(tmp_path, tmp_path / "c.png", tmp_path / "c.png")
    assert [path.name for path in run_directory.noted(tmp_path)][-1] == "c.png"
    assert len(run_directory.noted(tmp_path)) == len(set(run_directory.noted(tmp_path)))


@pytest.mark.parametrize("lists", ["elsewhere/thesis.tex", "../elsewhere/thesis.tex"])
def test_a_list_never_leads_out_of_the_directory(tmp_path, lists):
    """Not through a link that came later, nor by its text."""
    run, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    assert cli.main(swim(run, 0.05)) == 0
    elsewhere.mkdir()
    (elsewhere / "thesis.tex").write_text("mine")
    (run / "elsewhere").symlink_to(elsewhere)
    with (run / "files.txt").open("a") as listing:
        listing.write(f"{lists}\n{elsewhere / 'thesis.tex'}\n")
    assert cli.main([*swim(run, 0.05), "--overwrite"]) == 0
    assert (elsewhere / "thesis.tex").read_text() == "mine"


def test_a_directory_of_the_users_own(tmp_path):
    """Other files do no harm, and none is touched."""
    (tmp_path / "scene.py").write_text("mine")
    (tmp_path / "data").mkdir()
    assert cli.main(swim(tmp_path, 0.05)) == 0
    assert cli.main([*swim(tmp_path, 0.05), "--overwrite"]) == 0
    assert cli.main(["resume", str(tmp_path), "--t-end", "0.1"]) == 0
    assert (tmp_path / "scene.py").read_text() == "mine"


@pytest.mark.parametrize(
    "name", ["config.toml", "files.txt", "log.csv", "flagellum.vtkhdf", "checkpoint.h5"]
)
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]])
def test_a_file_of_the_users_own_is_never_replaced(tmp_path, capsys, name, overwrite):
    (tmp_path / name).write_text("mine\nlog.csv\n")
    before = contents(tmp_path)
    assert cli.main([*swim(tmp_path, 0.05), *overwrite]) == 1
    assert f"{tmp_path / name} is there already" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_a_run_is_named_with_what_to_do(tmp_path, capsys):
    run = tmp_path / "run"
    assert cli.main(swim(run, 0.05)) == 0
    before = contents(run)
    assert cli.main(swim(run, 0.05)) == 1
    message = capsys.readouterr().err
    assert "holds a run" in message
    assert "--overwrite (overwrite=True)" in message
    assert f"`mrs resume {run}`" in message
    assert contents(run) == before


def fail(*_):
    raise RuntimeError("no memory")


@pytest.mark.filterwarnings("ignore:Checkpoints.finalize. no memory")  # the second attempt to save
def test_a_start_that_fails_leaves_nothing(tmp_path, monkeypatch):
    """Neither a lock nor folders, whatever it is that fails before the first checkpoint."""
    deep = tmp_path / "a" / "b" / "c"
    for module, name in [
        (run_directory, "_write"),
        (run_directory, "note"),
        (checkpoint, "save"),
    ]:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, fail)
            with pytest.raises(RuntimeError, match="no memory"):
                script(deep).run(0.1)
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine.txt").write_text("mine")
    with monkeypatch.context() as patch:
        patch.setattr(run_directory, "_write", fail)
        with pytest.raises(RuntimeError, match="no memory"):
            script(tmp_path).run(0.1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    script(deep).run(0.1)


def test_a_run_that_fails_at_the_start_is_gone_on_with_or_overwritten(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Mobility, "__call__", fail)
        for name in "ab":
            with pytest.raises(RuntimeError, match="no memory"):
                script(tmp_path / name).run(0.1)
    with pytest.raises(FileExistsError, match=r"mrs resume .*overwrite=True"):
        script(tmp_path / "a").run(0.1)
    mrs.restart(script(tmp_path / "a")).run(0.1)
    sim = script(tmp_path / "b")
    sim.output = mrs.Output(tmp_path / "b", 0.1, overwrite=True)
    sim.run(0.1)
    script(tmp_path / "c").run(0.1)
    assert_equal_runs(tmp_path / "a", tmp_path / "c")
    assert_equal_runs(tmp_path / "b", tmp_path / "c")


LOCKED = """
import sys, time, mrs.output.run_directory
with mrs.output.run_directory.held(sys.argv[1]):
    print("held", flush=True)
    time.sleep(99)
"""


def test_a_lock_that_a_killed_process_left_does_not_block(tmp_path):
    run = tmp_path / "run"
    with subprocess.Popen(
        [sys.executable, "-c", LOCKED, str(run)], stdout=subprocess.PIPE
    ) as child:
        child.stdout.readline()
        with pytest.raises(FileExistsError, match="a run is going on in it"):
            script(run).run(0.1)
        child.kill()
    assert (run / ".lock").exists()
    script(run).run(0.1)
    assert not (run / ".lock").exists()


@pytest.mark.parametrize("below", ["", "run"])
def test_a_file_where_the_directory_should_be(tmp_path, capsys, below):
    (tmp_path / "thesis").write_text("mine")
    assert cli.main(swim(tmp_path / "thesis" / below, 0.05)) == 1
    message = capsys.readouterr().err
    assert f"{tmp_path / 'thesis'} is not a directory" in message
    assert "Errno" not in message
    assert (tmp_path / "thesis").read_text() == "mine"


def test_a_second_export_leaves_no_frames_of_a_longer_run(tmp_path):
    """Also in a folder that is not the run's; other files there stay."""
    run, there = tmp_path / "run", tmp_path / "there"
    assert cli.main(swim(run, 0.2)) == 0
    for suffix in ("vtu", "vtp"):
        export.export(run, suffix, there)
    mine = there / "flagellum_thesis.vtu"
    mine.write_text("mine")
    assert cli.main([*swim(run, 0.05), "--overwrite"]) == 0
    export.export(run, "vtu", there)
    numbers = {path.name for path in there.glob("*.vtu")} - {mine.name}
    assert numbers == {"flagellum_000000.vtu", "flagellum_000001.vtu"}
    assert mine.read_text() == "mine"
    export.export(run, "vtu", there, frames=[1])
    assert not (there / "flagellum_000000.vtu").exists(), "the folder holds what the list names"


def test_a_working_copy_that_is_not_installed(monkeypatch):
    def missing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    found = run_directory.versions.__wrapped__()
    assert (found["mrs-treecode"], found["numpy"]) == (mrs.__version__, "unknown")


def test_scenes_with_a_byte_order_mark_and_capitals(tmp_path):
    text = Path(__file__).parents[1].joinpath("docs", "scene.toml").read_text()
    scene = tmp_path / "S.TOML"
    scene.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    arguments = ["run", str(scene), "--set", "t_end=0.01", "--set", "interval=0.01"]
    assert cli.main([*arguments, "--output", str(tmp_path / "run")]) == 0
    assert cli.main(["resume", str(tmp_path / "run"), "--t-end", "0.02"]) == 0


# --- looking on --------------------------------------------------------------------------------


def test_info_beside_a_run_never_fails_and_tells_the_frames(tmp_path):
    """Looked at all the time, with the temporary files that a killed process leaves."""
    run, told = tmp_path / "run", []
    over = threading.Event()

    def look():
        while not over.is_set():
            if (run / "config.toml").exists():
                told.append(mrs.info(run))

    class Mess(mrs.Tracker):
        def initialize(self, sim):
            temporary_name(run / "other.vtkhdf").write_bytes(b"")

    sim = script(run)
    sim.trackers.append(Mess())
    thread = threading.Thread(target=look)
    thread.start()
    try:
        sim.run(2.0)
    finally:
        over.set()
        thread.join()
    assert len(told) > 20
    times = [info["time"] for info in told]
    assert times == sorted(times)
    assert all("error" not in file for info in told for file in info["files"].values())
    assert set(told[-1]["files"]) == {"fibre.vtkhdf", "tracers.vtkhdf"}


def test_info_tells_the_checkpoint_and_the_frames_apart(tmp_path, capsys, monkeypatch):
    run = tmp_path / "run"
    monkeypatch.setattr(checkpoint.Checkpoints, "finalize", lambda *_: None)  # killed
    script(run).run(0.3)
    found = mrs.info(run)
    assert (found["time"], found["checkpoint"]) == (0.3, {"time": 0.0, "steps": 0})
    assert found["files"]["fibre.vtkhdf"] == {"frames": 4, "points": 11, "time": 0.3}
    assert found["steps"] > 0
    assert cli.main(["info", str(run)]) == 0
    printed = capsys.readouterr().out
    assert "t = 0.3 of 0.3" in printed
    assert "checkpoint at t = 0" in printed
    assert "fibre.vtkhdf: 4 frames of 11 points, the last at t = 0.3" in printed


@pytest.mark.parametrize("spoil", [lambda b: b[:3000], lambda b: b"", lambda b: b"mine" * 999])
def test_a_damaged_trajectory_is_named_with_the_remedy(tmp_path, capsys, spoil):
    run = tmp_path / "run"
    script(run).run(0.1)
    path = run / "tracers.vtkhdf"
    path.write_bytes(spoil(path.read_bytes()))
    assert cli.main(["info", str(run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["files"]["fibre.vtkhdf"]["frames"] == 2
    assert "--renew-files" in found["files"]["tracers.vtkhdf"]["error"]
    assert cli.main(["info", str(run)]) == 0
    assert "tracers.vtkhdf: is " in capsys.readouterr().out
    for command in ("export", "render"):
        assert cli.main([command, str(run)]) == 1
        message = capsys.readouterr().err
        assert f"{path} is " in message
        assert "--renew-files" in message


def test_info_of_a_damaged_checkpoint_and_log(tmp_path, capsys):
    run = tmp_path / "run"
    script(run).run(0.1)
    for name in ("checkpoint.h5", "checkpoint.previous.h5", "log.csv"):
        (run / name).write_bytes(b"\xff\xfe")
    assert cli.main(["info", str(run)]) == 0
    printed = capsys.readouterr().out
    assert "no intact checkpoint" in printed
    assert "log.csv: is " in printed
    assert "fibre.vtkhdf: 2 frames" in printed


@pytest.mark.parametrize("locking", ["TRUE", "FALSE", "BEST_EFFORT"])
def test_readers_in_the_same_process_stop_nothing(tmp_path, monkeypatch, locking):
    """By h5py with its locks, and by Trajectory, opened before, between and after frames."""
    monkeypatch.setenv("HDF5_USE_FILE_LOCKING", locking)
    plain, read = tmp_path / "plain", tmp_path / "read"
    script(plain).run(2.5)

    class Reader(mrs.Tracker):
        def initialize(self, sim):
            self.held = []

        def handle(self, sim):
            path = read / "fibre.vtkhdf"
            self.held.append((sim.time, h5py.File(path, "r"), Trajectory(path)))

    sim, reader = script(read), Reader()
    sim.trackers.append(reader)
    sim.run(2.5)
    assert_equal_runs(plain, read)
    expected = trajectories(plain)["fibre.vtkhdf"][1]
    for time, file, trajectory in reader.held:
        known = int(np.searchsorted(trajectory.times, time + 1e-9))
        assert known >= 1
        np.testing.assert_array_equal(trajectory.points(known - 1), expected[known - 1][0])
        np.testing.assert_array_equal(file["VTKHDF/Points"][:11], expected[0][0])
        file.close()
        trajectory.close()


def test_positions_far_from_the_origin_are_stored_exactly(tmp_path):
    """A million boxes away, where single precision moves points by 0.03."""
    place = np.array([1e6, -1e6, 1e6])
    points = place + np.random.default_rng(0).random((50, 3))
    tracers = mrs.Tracers(points)
    options = {"output": mrs.Output(tmp_path / "run", interval=1.0)}
    mrs.Simulation(mrs.Fluid(), [tracers], **options).run(1.0)
    with Trajectory(tmp_path / "run" / "tracers.vtkhdf") as file:
        assert file.points(0).dtype == np.float64
        np.testing.assert_array_equal(file.points(0), points)
