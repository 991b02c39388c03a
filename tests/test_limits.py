"""What is asked at the limits is found within its bound: the table of docs/stability.md."""

from pathlib import Path

import pytest

from tests.cases.stability import CASES

TABLE = Path(__file__).parents[1] / "docs" / "stability.md"


@pytest.mark.parametrize(
    "asked", [pytest.param(c, id=c.name, marks=[pytest.mark.slow] * c.slow) for c in CASES]
)
def test_case(asked):
    findings = asked.findings()
    assert findings
    assert not [finding for finding in findings if not finding.holds()]


def test_table_is_of_these_cases():
    """Each has its section in docs/stability.md, in this order, and all that was found holds."""
    table = TABLE.read_text()
    headings = [line.removeprefix("## ") for line in table.splitlines() if line.startswith("## ")]
    assert headings == [c.heading for c in CASES]
    assert "**" not in table
