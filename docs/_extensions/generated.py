"""The folder docs/generated, which holds what a build makes and no one edits."""

from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
FOLDER = DOCS / "generated"


def write(name, text):
    """Write a page there, unless it is there already: Sphinx reads changed pages only."""
    path = FOLDER / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
