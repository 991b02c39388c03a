"""How Sphinx makes the site of these pages.

`python -m sphinx -W -b html docs docs/_build/html` needs no network. What is not written by hand
is in docs/generated: pages from outside this folder, the gallery, the reference of the API.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

from treecode import __version__  # noqa: E402

project = "mrs-treecode"
author = project_copyright = "The mrs-treecode developers"
release = version = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "api_pages",
    "gallery",
    "links",
    "mathml",
]
exclude_patterns = ["_*"]
# The first is the suffix of the pages that autosummary writes, as it does not know myst-nb's.
source_suffix = {".rst": "restructuredtext", ".md": "myst-nb"}
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
default_role = "code"

# The tutorials are run, each in an empty folder; their errors and warnings stop the build.
nb_execution_in_temp = True
nb_execution_timeout = 300  # seconds for a cell
nb_execution_raise_on_error = True
nb_output_stderr = "warn"
nb_merge_streams = True
# pyvista imports tqdm's progress bars for notebooks, and these ask for a package that no one needs.
os.environ["PYTHONWARNINGS"] = "ignore:IProgress not found"

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
