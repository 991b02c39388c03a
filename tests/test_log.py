"""The log of a run: rows that are whole, and cut where a run goes on."""

import csv

import pytest

from mrs.output import log


def test_log(tmp_path):
    path = tmp_path / "log.csv"
    assert log.cut(path, 1.0) is None
    assert log.last(path) == {}
    times = [0.1 * i for i in range(5)]
    for i, t in enumerate(times):
        log.append(path, {"step": i, "t": t, "note": "a,b" if i else ""})
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["t"]) for row in rows] == times
    assert log.last(path) == {"step": 4, "t": 0.4, "note": "a,b"}
    with pytest.raises(ValueError, match="columns"):
        log.append(path, {"step": 5})
    with path.open("a") as file:
        file.write("5,0.5")  # killed while writing
    assert log.last(path)["step"] == 4
    assert log.cut(path, times[3]) == times[3]
    log.append(path, {"step": 4, "t": 0.45, "note": ""})
    assert path.read_text().splitlines()[-2:] == [f'3,{times[3]!r},"a,b"', "4,0.45,"]
    assert path.read_text().count("step") == 1
    assert log.cut(path, -1.0) is None


def test_log_with_half_a_header(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("step,t")
    assert log.cut(path, 1.0) is None
    log.append(path, {"step": 0, "t": 0.0})
    assert path.read_text() == "step,t\n0,0.0\n"
