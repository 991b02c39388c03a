"""How Sphinx makes the site of these pages.

`python -m sphinx -W -b html docs docs/_build/html` needs no network. What is not written by hand
is in docs/generated: pages from outside this folder, the gallery, the reference of the API.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

from treecode import __version__  # noqa: E402

project = "mrs-treecode"
author = project_copyright = "The mrs-treecode developers"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "api_pages",
    "gallery",
    "links",
    "mathml",
]
exclude_patterns = ["_*"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
default_role = "code"

templates_path = ["_templates"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"mrs-treecode {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
