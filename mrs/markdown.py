"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield the lines of a table, each as soon as its row is there.

    Parameters
    ----------
    header : iterable of str
        Titles of the columns.
    rows : iterable of iterable of str
        The cells of each row, as many as there are columns.
    """
    header = list(header)
    yield _line(header)
    yield "|" + "---|" * len(header)
    yield from map(_line, rows)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
