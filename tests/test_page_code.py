"""The commands and the code of the pages run, with smaller numbers; as they stand, they are slow.

A block that cannot run says why beside its language, as in ```bash (installs).
"""

import os
import re
import subprocess
import sys

import pytest

from tests.test_docs import PAGES, ROOT

BLOCK = re.compile(r"^```(\w*)(?: \((\w+)\))?\n(.*?)^```$", re.M | re.S)
REASONS = {
    "installs": "in an empty environment, as .ci/run does",
    "hours": "of benchmarks",
    "elsewhere": "with a program that the tests do not install",
    "extra": "with packages that not all have, as in tests/test_open_run.py",
    "ranks": "in several processes, as in tests/test_ranks.py",
}
RUN = {"bash", "python", "toml"}
# page: commands that it builds on
BEFORE = {
    "docs/pictures.md": "mrs run swimmer_suspension --quick --set interval=0.002 --set t_end=0.03 "
    "--output outputs/pullers",
}
# page: what stands there, and what takes its place; each must be there
SMALLER = {
    "docs/pictures.md": {
        "--output film.mp4 ": "--output film.mp4 --frame 0:3 --size 320,240",
        "film.gif --frame 10:60:2": "film.gif --frame 10:14:2 --size 320,240",
        "--size 2400,1500": "--size 240,150",
        "--resolution 60": "--resolution 6",
    },
    "README.md": {
        "--set count=300": "--set count=20 --quick --set t_end=0.1",
        "--t-end 20": "--t-end 0.2",
        "swimmer_suspension --profile": "swimmer_suspension --profile --quick --set t_end=0.1",
        "--resolution 20": "--resolution 5",
        "--frame 10:60:2": "--frame 0:3:2",
        "t_end = 2.0": "t_end = 0.1",
        "sim.run(2.0)": "sim.run(0.002)",
        "100_000": "3_000",
    },
}


# Code that a page calls the whole of a file with a name.
FILE = re.compile(r"whole file `([\w.]+)`:\n\n```\w+\n(.*?)^```$", re.M | re.S)


def name_of(page):
    return page.relative_to(ROOT).as_posix()


def blocks(page):
    """Return language, reason not to run or "", and code of the blocks of a page."""
    return [match.groups(default="") for match in BLOCK.finditer(page.read_text())]


def programs(page):
    """Yield what to run in order: blocks of bash; then the Python of the page, and its scenes."""
    found = {name: [] for name in RUN}
    if name_of(page) in BEFORE:
        found["bash"].append(BEFORE[name_of(page)])
    for language, reason, code in blocks(page):
        if language in RUN and not reason:
            found[language].append(code)
    for code in found["bash"]:
        yield "bash", code
    if found["python"]:
        yield "python", "\n".join(found["python"])
    for code in found["toml"]:
        yield "toml", code


def smaller(page, code):
    for old, new in SMALLER.get(name_of(page), {}).items():
        code = code.replace(old, new)
    return code


@pytest.fixture
def run(tmp_path):
    """Return a function that runs a program in an empty folder, where `mrs` is this package."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, command in {"python": "", "mrs": "-m mrs"}.items():
        (programs / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {command} "$@"\n')
        (programs / name).chmod(0o755)
    environment = os.environ | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }

    def run_in_folder(language, code):
        name = {"bash": "commands.sh", "python": "my_program.py", "toml": "my_scene.toml"}[language]
        (tmp_path / name).write_text(code)
        command = {
            "bash": ["bash", "-euo", "pipefail", name],
            "python": ["python", "-W", "error", name],
            "toml": ["mrs", "run", name],
        }[language]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{code}\n{done.stdout}\n{done.stderr}"

    return run_in_folder


WITH_CODE = [page for page in PAGES if any(programs(page))]


@pytest.mark.parametrize("size", [pytest.param("as it stands", marks=pytest.mark.slow), "smaller"])
@pytest.mark.parametrize("page", WITH_CODE, ids=name_of)
def test_code_runs(page, size, run, tmp_path):
    for name, code in FILE.findall(page.read_text()):
        (tmp_path / name).write_text(code)
    for language, code in programs(page):
        run(language, code if size == "as it stands" else smaller(page, code))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_code_that_does_not_run_says_why(page):
    for language, reason, code in blocks(page):
        assert language in {*RUN, "", "text"}, code
        assert reason in {"", *REASONS}, code
    assert len(blocks(page)) == len(re.findall(r"^```", page.read_text(), flags=re.M)) / 2


@pytest.mark.parametrize("page", SMALLER)
def test_what_is_made_smaller_is_there(page):
    text = (ROOT / page).read_text()
    assert [old for old in SMALLER[page] if old not in text] == []


def test_readme_is_run():
    """The extraction finds what it is for: both commands, a scene and both programs of README."""
    found = blocks(ROOT / "README.md")
    assert [reason for _, reason, _ in found].count("installs") == 2
    ran = [language for language, _ in programs(ROOT / "README.md")]
    assert ran == ["bash", "python", "toml"]
