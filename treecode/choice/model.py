"""The fitted model: seconds and errors of sums by each method, for each kernel.

`costs.json` holds it, as ``benchmarks/fit_costs.py`` has measured it. The code of each method
explains its own numbers.
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

from treecode.kernels.base import Kernel

COSTS = Path(__file__).with_name("costs.json")


class Model:
    """Seconds on one thread, and errors in units of the error of the probe, of one kernel.

    Attributes
    ----------
    usual_error : float
        Of the probe, for random strengths in a cube.
    """

    def __init__(self, kernel: Kernel) -> None:
        size = kernel.weight_size * kernel.value_size
        costs = _costs()
        # A user's own kernel has the costs of the one that is most like it in size.
        alike = min(costs, key=lambda name: abs(math.log(costs[name]["size"] / size)))
        self._fitted = costs.get(type(kernel).__name__, costs[alike])
        self.usual_error: float = self._fitted["probe"]

    def fitted(self, method: str) -> dict[str, Any] | None:
        """Return the numbers of a method; None where nothing was fitted."""
        return self._fitted.get(method)


@cache
def _costs() -> dict[str, Any]:
    return dict(json.loads(COSTS.read_text()))
