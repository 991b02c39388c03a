"""What numba says about a mistake in a kernel, in a few lines."""

from __future__ import annotations

import linecache
import re
from pathlib import Path
from typing import Any

import numba

_OURS = Path(__file__).parent, Path(numba.__file__).parent
_PLACE = re.compile(r'\b(?:at|from|File) "?((?:(?! at | from )[^"\n(])+?)"?(?: \(|, line )(\d+)')
_HINTS = {
    "mask": "in place of if, and, or and not use treecode.where(condition, a, b)",
    "lanes": "distances and acc are lanes: they take + - * /, whole powers, comparisons, abs, "
    "math.sqrt, and of treecode inverse_sqrt, exp, log, erf and where",
    "Unknown attribute": "compiled code knows of a kernel its fields alone: constants belong in "
    "the module, and functions decorated with numba.jit",
    "": "numba compiles a part of Python: numbers, tuples, loops, and functions decorated with numba.jit",
}


def explain(kernel: Any, error: str) -> str:
    """Return what is wrong with a kernel, where, and what may be used instead.

    Parameters
    ----------
    kernel : Kernel
    error : str
        Of numba: reasons, innermost first, each followed by the line that it belongs to.
    """
    where, end = "", len(error)
    for place in _PLACE.finditer(error):
        path, line = Path(place[1]).resolve(), int(place[2])
        if not any(path.is_relative_to(folder) for folder in _OURS):
            where = f"\n  {path}, line {line}: {linecache.getline(str(path), line).strip()}"
            end = place.start()
            break
    reason = _reason(error[:end])
    hint = next(hint for word, hint in _HINTS.items() if word in reason)
    name = type(kernel).__qualname__
    return f"kernel {name} cannot be compiled: {reason}{where}\n  {hint} (see docs/add-a-kernel.md)"


def _reason(error: str) -> str:
    """Return the last reason: what was called with what, or a sentence of numba's."""
    lines = [line.strip() for line in error.rsplit("Failed in nopython mode", 1)[-1].splitlines()]
    calls = [line[4:] for line in lines if line.startswith(">>> ")]
    if calls:
        return f"there is no {calls[0]}"
    return next((line for line in lines[1:] if line), lines[0]).removesuffix("Raised").strip()[:200]
