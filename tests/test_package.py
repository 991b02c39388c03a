"""What is installed: the wheel, the version, the scenes that come with it, the oldest versions."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import mrs
import treecode as tc

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel; needs no network."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Return a folder with what the wheel installs: it is pure Python, so its files as they are."""
    folder = tmp_path_factory.mktemp("site-packages")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def run(package, cwd, *arguments):
    """Run Python in a new process that takes the packages from the folder `package`."""
    environment = os.environ | {"PYTHONPATH": str(package)}
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def test_wheel_holds_two_packages(installed):
    """`scenarios`, `tests` and `benchmarks` would be in the way of a user's own of these names."""
    tops = {path.name for path in installed.iterdir() if path.suffix != ".dist-info"}
    assert tops == {"mrs", "treecode"}
    for name in tops:
        assert (installed / name / "py.typed").is_file()
    scenes = {path.stem for path in (installed / "mrs" / "scenarios").glob("*.py")}
    assert scenes == {path.stem for path in (ROOT / "scenarios").glob("*.py")} | {"__init__"}


@pytest.mark.parametrize("installation", ["wheel", "checkout"])
def test_scenes_beside_a_folder_of_the_same_name(installation, request, tmp_path):
    """A package `scenarios` of the user's own is neither used nor in the way, begun or repeated."""
    package = ROOT if installation == "checkout" else request.getfixturevalue("installed")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "__init__.py").write_text("raise AssertionError('of the user')")
    (tmp_path / "scenarios" / "cilia_array.py").write_text("raise AssertionError('of the user')")
    command = ["-m", "mrs", "run", "fibre_in_shear", "--quick", "--set", "t_end=0.01"]
    run(package, tmp_path, *command, "--output", "first")
    assert 'scenario = "fibre_in_shear"' in (tmp_path / "first" / "config.toml").read_text()
    run(package, tmp_path, "-m", "mrs", "run", "first/config.toml", "--output", "second")
    logs = [(tmp_path / name / "log.csv").read_text() for name in ("first", "second")]
    steps = [[row.split(",")[:3] for row in log.splitlines()] for log in logs]
    assert steps[0] == steps[1]
    where = (
        "from mrs.scenarios import cilia_array as a; import mrs; print(mrs.__file__, a.__file__)"
    )
    files = run(package, tmp_path, "-c", where).split()
    assert all(Path(file).is_relative_to(package) for file in files)


def test_one_version(installed, tmp_path):
    """The package, the wheel, the command, and what is cited."""
    assert mrs.__version__ == tc.__version__
    (metadata,) = installed.glob("*.dist-info")
    assert f"\nVersion: {tc.__version__}\n" in (metadata / "METADATA").read_text()
    assert run(installed, tmp_path, "-m", "mrs", "--version") == f"mrs {tc.__version__}\n"
    assert f"\nversion: {tc.__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_what_is_public_is_there():
    """And what a user meets as an argument, a base class or a result can be imported by name."""
    for package in (mrs, tc):
        assert all(hasattr(package, name) for name in package.__all__)
        assert len(set(package.__all__)) == len(package.__all__)
    assert {"Body", "Centerline", "Flow", "Profile", "State"} <= set(mrs.__all__)
    assert {"Kernel", "Choice", "Plan", "ToleranceError"} <= set(tc.__all__)


def bounds(requirements):
    """Return {name: (lower bound, rest)} of "name[extra]>=lower,rest"."""
    found = {}
    for text in requirements:
        name, lower, rest = re.match(r"([\w-]+)(?:\[\w+\])?>=([\d.]+)(.*)", text).groups()
        found[name] = lower, rest
    return found


def test_oldest_versions_are_those_that_are_tested():
    """.ci/oldest.txt holds each lower bound of a run, which .ci/run tests with."""
    lines = (ROOT / ".ci" / "oldest.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    for name, (lower, rest) in bounds(PROJECT["dependencies"]).items():
        if "python_version" not in rest:  # tomli: the machine has another Python
            assert pinned[name] == lower, name


def test_numba_has_an_upper_bound():
    """`_jit` and `_lanes` use what numba may change in any release."""
    assert bounds(PROJECT["dependencies"])["numba"][1].startswith(",<")


def test_ci_runs_tests_that_are_there():
    run = (ROOT / ".ci" / "run").read_text()
    files = set(re.findall(r"tests/\w+\.py", run))
    assert len(files) >= 5
    assert [file for file in files if not (ROOT / file).is_file()] == []
