"""The reference of the API: a page for each module, which lists its public names, from `__all__`.

Sphinx's autosummary makes the page of each name from its docstring. A name without one is an error.
"""

import inspect
import re

import generated
import public
from sphinx.errors import ExtensionError

PLACES = {file: f"api/{name}.rst" for name, file in public.MODULES.items()}
BAR = re.compile(r"\|(?=(?:[^`]*`[^`]*`)*[^`]*$)")  # outside of code
PAGE = """{name}
{underline}

{description}

.. autosummary::
   :toctree: names

{names}

{also}
"""


def write_pages(app, config):
    """Write a page for each module; a thing that has several names is described under the first.

    Raises
    ------
    ExtensionError
        If public names have no docstring.
    """
    first = {id(thing): name for name, thing in public.things().items()}
    for module_name in public.MODULES:
        module = public.module_of(module_name)
        own, also = [], []
        for name in public.names_in(module):
            whole, thing = f"{module_name}.{name}", getattr(module, name)
            if not inspect.getdoc(thing):
                raise ExtensionError(f"{whole} must have a docstring, as all public names")
            if first[id(thing)] == whole:
                own.append(f"   {whole}")
            else:
                also.append(f"* `{whole}` is :doc:`names/{first[id(thing)]}`.")
        page = PAGE.format(
            name=module_name,
            underline="=" * len(module_name),
            description=inspect.getdoc(module),
            names="\n".join(own),
            also="\n".join(also),
        )
        generated.write(f"api/{module_name}.rst", page)
    for path in (generated.FOLDER / "api" / "names").glob("*.rst"):
        if path.stem not in first.values():  # of an earlier build
            path.unlink()


def require_descriptions(app, env):
    """Look at what came of the pages: a page that is read as another language describes nothing.

    Raises
    ------
    ExtensionError
        With the names that are not described.
    """
    missing = [name for name in public.things() if name not in env.get_domain("py").objects]
    if missing:
        raise ExtensionError(f"not in the reference: {', '.join(missing)}")


def skip_fields(app, what, name, obj, skip, options):
    """Leave out the fields of named tuples, which their class describes."""
    return skip or type(obj).__name__ == "_tuplegetter"


def escape_bars(app, what, name, obj, options, lines):
    """Keep the bars of absolute values, which are marks of substitutions in reStructuredText."""
    lines[:] = [BAR.sub(r"\\|", line) for line in lines]


def setup(app):
    """Write the pages before Sphinx looks for pages, and look at them when it has read all."""
    app.connect("config-inited", write_pages)
    app.connect("env-check-consistency", require_descriptions)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("autodoc-skip-member", skip_fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
