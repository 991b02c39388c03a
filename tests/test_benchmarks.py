"""Benchmarks can be stopped and go on, and the suite is whole. Nothing is timed."""

import json

import pytest

from benchmarks import plots
from benchmarks.__main__ import main
from benchmarks.experiments import ALL, stepping
from benchmarks.rows import Rows


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("name", ALL)
def test_cases_differ(name, quick):
    cases = [json.dumps(case, sort_keys=True) for case in ALL[name].cases(quick)]
    assert len(set(cases)) == len(cases) > 1


@pytest.mark.parametrize("name", ALL)
def test_tables_without_rows_have_a_header(name):
    """It is made of the same functions as the rows."""
    title, rule = ALL[name].table([])
    assert title.count("|") == rule.count("|") > 4


def test_a_stopped_run_goes_on(tmp_path):
    done = []

    def square(x):
        if x == 2 and len(done) == 2:
            raise KeyboardInterrupt
        done.append(x)
        return {"value": x * x}

    def all_of_them():
        rows = Rows(tmp_path / "rows.json")
        for x in range(4):
            if rows.find(square, {"x": x}) is None:
                rows.measure(square, {"x": x})
        return [rows.find(square, {"x": x})["value"] for x in range(4)]

    with pytest.raises(KeyboardInterrupt):
        all_of_them()
    done.append("a break")
    assert all_of_them() == [0, 1, 4, 9]
    assert done == [0, 1, "a break", 2, 3]


def test_rows_of_another_machine_do_not_count(tmp_path, monkeypatch):
    def zero(x):
        return {"value": 0}

    rows = Rows(tmp_path / "rows.json")
    rows.measure(zero, {"x": 1})
    monkeypatch.setattr("benchmarks.rows.machine", lambda: "another")
    again = Rows(tmp_path / "rows.json")
    assert again.find(zero, {"x": 1}) is None
    assert again.find(zero, {"x": 1}, anywhere=True) == rows.find(zero, {"x": 1})


def test_every_integrator_has_a_colour():
    """The short suite does not draw them all."""
    assert set(stepping.METHODS) <= set(plots.COLORS)


def test_envelope():
    """One is beaten in time at the same error, one in both, and one by the direct sum."""
    runs = [(1e-3, 1.0), (1e-3, 2.0), (1e-5, 3.0), (1e-4, 4.0), (1e-6, 9.0), (None, 8.0)]
    rows = [{"error": error, "seconds": seconds} for error, seconds in runs]
    assert plots.envelope(rows) == [rows[0], rows[2], rows[5]]


def test_suite_is_whole(tmp_path, monkeypatch):
    """One experiment with few points, from the sums to its page; a second run measures nothing."""
    command = ["growth", "--quick", "--output", str(tmp_path)]
    main(command)
    growth = ALL["growth"]
    rows = Rows(tmp_path / "rows.json")
    found = [rows.find(growth.measure, case) for case in growth.cases(quick=True)]
    errors = {(row["n"], row.get("degree")): row["error"] for row in found if "degree" in row}
    assert 0.0 < errors[10_000, 7] < 0.1 * errors[10_000, 3] < 0.01
    page = (tmp_path / "growth.md").read_text()
    assert page.startswith(f"# {growth.__doc__.splitlines()[0]}\n")
    assert page.count("\n| ") == len(found) + 1  # the header
    assert "10,000 | kitc | theta 0.7, n 7 |" in page

    def no_more(*_):
        raise AssertionError("measured again")

    monkeypatch.setattr(Rows, "measure", no_more)
    main(command)


def test_unknown_names_are_refused(capsys):
    with pytest.raises(SystemExit):
        main(["growht"])
    assert "growth" in capsys.readouterr().err
