"""The log of a run as columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mrs import check
from mrs.output import log
from mrs.output.extras import extra
from treecode.shown import Shown

if TYPE_CHECKING:
    import pandas as pd


class LogTable(Shown, Mapping[str, np.ndarray]):
    """Columns of a log by name: integers or floats, nan where a row has none; else texts.

    Parameters
    ----------
    path : Path
        Of a log. Without a file there are no columns.

    Raises
    ------
    DamagedError
        If it is not a log; the message names the line.
    """

    def __init__(self, path: Path) -> None:
        log.times(path)  # the rows are whole
        header, *rows = log.complete_lines(path) or [[]]
        self._columns = {
            name: _column([row[i] if i < len(row) else "" for row in rows])
            for i, name in enumerate(header)
        }

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[check.key("column", name, self._columns)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def to_pandas(self) -> pd.DataFrame:
        """Return the same as a table of pandas, which must be installed.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return extra("pandas").DataFrame(self._columns)

    def shown(self) -> dict[str, Any]:
        rows = max(map(len, self._columns.values()), default=0)
        return {"rows": rows, "columns": " ".join(self)}


def _column(cells: Sequence[str]) -> np.ndarray:
    """Return cells as integers if all of them are, or as floats, or as they are."""
    for kind, given in ((np.int64, cells), (np.float64, [cell or "nan" for cell in cells])):
        try:
            return np.array(given, dtype=str).astype(kind)
        except (OverflowError, ValueError):
            continue
    return np.array(cells, dtype=str)
