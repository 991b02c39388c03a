"""Results of measurements, kept in a file, so that a run can be stopped and goes on."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.machine import machine
from mrs.output.atomic import replacing

Row = dict[str, Any]
"""A case, its parameters by name, together with its result."""


class Rows:
    """Results by measurement and case; one line of the file each.

    A result counts for the machine and the versions that it was measured with. To measure one
    again, delete its line.

    Parameters
    ----------
    path : Path
        A JSON file, made with the first result.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.machine = machine()
        lines = json.loads(path.read_text()) if path.exists() else []
        self._lines = {self._key(line["measurement"], line["case"]): line for line in lines}

    @staticmethod
    def _key(measurement: str, case: Row) -> str:
        return json.dumps([measurement, case], sort_keys=True)

    @staticmethod
    def _row(line: Row) -> Row:
        return line["case"] | line["result"] | {"machine": line["machine"], "date": line["date"]}

    def find(self, measure: Callable[..., Row], case: Row, *, anywhere: bool = False) -> Row | None:
        """Return a case with its result, None if it is not known on this machine (or `anywhere`).

        `machine` and `date` say where and when it was measured.
        """
        line = self._lines.get(self._key(measure.__name__, case))
        if line is None or not (anywhere or line["machine"] == self.machine):
            return None
        return self._row(line)

    def measure(self, measure: Callable[..., Row], case: Row) -> Row:
        """Measure a case, and `keep` the result before anything else can happen."""
        return self.keep(measure, case, measure(**case))

    def keep(self, measure: Callable[..., Row], case: Row, result: Row) -> Row:
        """Write a result that `measure` has given for a case, and return it with the case."""
        line = self._lines[self._key(measure.__name__, case)] = {
            "measurement": measure.__name__,
            "case": case,
            "result": result,
            "machine": self.machine,
            "date": datetime.date.today().isoformat(),
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = ",\n".join(json.dumps(line) for line in self._lines.values())
        with replacing(self.path) as temporary:
            temporary.write_text(f"[\n{text}\n]\n")
        return self._row(line)
