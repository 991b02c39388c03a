"""The gallery: a picture of the quick version of each scenario, drawn by the command `mrs`.

A picture is kept in docs/generated until the file of its scenario, or the version, changes.
"""

import ast
import hashlib
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import generated
from sphinx.errors import ExtensionError
from sphinx.util import logging

import mrs
import mrs.scenarios
from mrs.run.scenario_files import known

logger = logging.getLogger(__name__)

TOP = """# Gallery

Each scenario is one file, to read and to copy. The pictures show the last frame of its quick
version. [Running](/running.md) says how a scenario gets other options.
"""
ENTRY = """
## {name}

{description}

![{title}](/generated/gallery/{picture})

<details><summary>The whole file</summary>

:::{{literalinclude}} /../scenarios/{name}.py
:language: python
:::

</details>
"""


def write_page(app, config):
    """Write the page, and draw the pictures that are missing."""
    sources = [Path(folder, f"{name}.py") for folder in mrs.scenarios.__path__ for name in known()]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # processes of one thread each
        generated.write("gallery.md", TOP + "".join(pool.map(entry, sources)))


def entry(source):
    """Return the section of a scenario: what its file says of itself, its picture, the file."""
    description = ast.get_docstring(ast.parse(source.read_text()))
    return ENTRY.format(
        name=source.stem,
        title=description.splitlines()[0],
        description=description,
        picture=picture_of(source),
    )


def picture_of(source):
    """Return the name of the picture of a scenario, after drawing it if there is none yet."""
    key = hashlib.sha256(source.read_bytes() + mrs.__version__.encode()).hexdigest()[:12]
    path = generated.FOLDER / "gallery" / f"{source.stem}-{key}.png"
    if not path.exists():
        logger.info("drawing %s", source.stem)
        for old in path.parent.glob(f"{source.stem}-*.png"):
            old.unlink()
        draw(source.stem, path)
    return path.name


def draw(name, path):
    """Run the quick version of a scenario, and move its picture to `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        run = [sys.executable, "-m", "mrs", "run", name, "--quick", "--picture", "--output", "run"]
        environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
        done = subprocess.run(
            run, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise ExtensionError(f"{' '.join(run)}\n{done.stdout}{done.stderr}")
        (picture,) = Path(folder, "run").glob("*.png")
        picture.replace(path)


def setup(app):
    """Write the page before Sphinx looks for pages."""
    app.connect("config-inited", write_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
