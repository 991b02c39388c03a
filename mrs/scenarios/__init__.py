"""The scenes that come with the project: one module each, to read and to copy.

An installed package has them in this folder. A checkout has them at its top, where they are easily
found; they are no package of their own there, since a user may have a folder `scenarios` as well.
"""

from pathlib import Path

_HERE = Path(__file__).parent
if len(list(_HERE.glob("*.py"))) == 1:
    __path__ = [str(_HERE.parents[1] / "scenarios")]
