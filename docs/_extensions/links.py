"""Links that lead on within the site, and the pages in its sidebar.

The pages read well in the repository, where a link is a path. Some lead out of docs: to README.md
and its like, to the folder of scenarios, to a module. On the site these are pages in
docs/generated. Other files are copied.
"""

import os
import re
from pathlib import Path

import api_pages
import generated

PAGES = {
    "README.md": "overview.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
}
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")
ITEM = re.compile(r"^\* \[([^\]]+)\]\(([^)]+)\)", re.M)
TOCTREE = "\n:::{{toctree}}{options}\n:hidden:\n:glob:\n\n{pages}\n:::\n"
NOTEBOOK = "\n{{nb-download}}`This page as a notebook, with its outputs <{}.ipynb>`\n"
# Pages below a page in the sidebar.
BELOW = {"decisions/README": "/decisions/[0-9]*", "generated/benchmarks": "/benchmarks/*"}


def on_site(text, folder):
    """Return the text of a page in this folder of the repository, with links of the site."""
    places = PAGES | {"scenarios": "gallery.md"} | api_pages.PLACES

    def moved(match):
        path = (folder / match[1]).resolve()
        page = places.get(path.relative_to(generated.ROOT).as_posix())
        if page:
            return f"/generated/{page}"
        return "/" + Path(os.path.relpath(path, generated.DOCS)).as_posix()

    return LINK.sub(moved, text)


def write_pages(app, config):
    """Write the pages from outside docs into docs/generated."""
    for name, page in PAGES.items():
        path = generated.ROOT / name
        generated.write(page, on_site(path.read_text(encoding="utf-8"), path.parent))


def edit(app, docname, content):
    """Change the links of a page in docs as Sphinx reads it, and say what is below it."""
    path = Path(app.env.doc2path(docname))
    if generated.FOLDER not in path.parents:
        content[0] = on_site(content[0], path.parent)
    if docname.startswith("tutorials/"):
        content[0] += NOTEBOOK.format(path.stem)
    elif docname == app.config.root_doc:
        content[0] += "".join(sidebar(content[0]))
    elif docname in BELOW:
        content[0] += TOCTREE.format(options="", pages=BELOW[docname])


def sidebar(text):
    """Yield the part of the sidebar that a section of the first page is: the links of its list."""
    for section in text.split("\n## ")[1:]:
        caption = f"\n:caption: {section.splitlines()[0]}"
        pages = [f"{title} <{link.rpartition('.')[0]}>" for title, link in ITEM.findall(section)]
        yield TOCTREE.format(options=caption, pages="\n".join(pages))


def setup(app):
    """Connect to the events of a build."""
    app.connect("config-inited", write_pages)
    app.connect("source-read", edit)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
