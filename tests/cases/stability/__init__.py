"""What is asked at the limits, what happened, and the bound: the table of docs/stability.md.

benchmarks/stability.py prints it. Each section of the table is in one module, whose cases are
functions that yield findings, numbers with bounds; their docstrings say why the bounds are what
they are.
"""

from tests.cases.stability import (  # noqa: F401, these register their cases
    cancellation,
    contact,
    degrees,
    epsilons,
    long_runs,
    ring,
    scales,
    shells,
    step_limits,
)
from tests.cases.stability.findings import CASES

CASES.sort(key=lambda case: case.section)
