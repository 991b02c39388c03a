"""Pages of the project that are not in docs: README.md and others, with links that lead on.

In the repository a link to such a page is a path. On the site, the page is in docs/generated. A
link to the folder of scenarios leads to the gallery. Other links lead to files, which are copied.
"""

import os
import re
from pathlib import Path

import generated

PAGES = {
    "README.md": "overview.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "scenarios": "gallery.md",
}
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")


def on_site(text, folder):
    """Return a page's text in which relative links, from its folder, lead on within the site."""

    def moved(match):
        path = (folder / match[1]).resolve()
        name = path.relative_to(generated.ROOT).as_posix()
        if name in PAGES:
            return f"/generated/{PAGES[name]}"
        return "/" + Path(os.path.relpath(path, generated.DOCS)).as_posix()

    return LINK.sub(moved, text)


def write_pages(app, config):
    """Write the pages into docs/generated."""
    for name, page in PAGES.items():
        path = generated.ROOT / name
        if path.is_file():
            generated.write(page, on_site(path.read_text(), path.parent))


def relink(app, docname, content):
    """Change the links of a page in docs, when Sphinx reads it."""
    path = Path(app.env.doc2path(docname))
    if generated.FOLDER not in path.parents:
        content[0] = on_site(content[0], path.parent)


def setup(app):
    """Connect both to the events of a build."""
    app.connect("config-inited", write_pages)
    app.connect("source-read", relink)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
