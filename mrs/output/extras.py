"""Packages that are not installed with this one, unless an extra asks for them."""

from __future__ import annotations

import importlib
from types import ModuleType


def extra(name: str) -> ModuleType:
    """Return a package of the extra "analysis".

    Parameters
    ----------
    name : str

    Raises
    ------
    ImportError
        If it is not installed; the message says what to install.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        raise ImportError(
            f"{name} is not installed: python -m pip install 'mrs-treecode[analysis]', or {name}"
        ) from None
