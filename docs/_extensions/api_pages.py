"""The reference of the API: a page for each module, which lists its public names, from `__all__`.

Sphinx's autosummary makes the page of each name from its docstring. A name without one is an error.
"""

import importlib
import inspect
import re
import types

import generated
from sphinx.errors import ExtensionError

# Modules by the names that users call them, and the files in which the repository has them.
MODULES = {
    "mrs": "mrs/__init__.py",
    "mrs.geometry": "mrs/bodies/geometry.py",
    "mrs.surfaces": "mrs/bodies/surfaces.py",
    "mrs.flows": "mrs/fluid/flows.py",
    "mrs.observables": "mrs/observables/__init__.py",
    "mrs.rotations": "mrs/rotations.py",
    "treecode": "treecode/__init__.py",
    "treecode.methods": "treecode/methods/__init__.py",
    "treecode.cache": "treecode/cache.py",
}
PLACES = {file: f"api/{name}.rst" for name, file in MODULES.items()}
BAR = re.compile(r"\|(?=(?:[^`]*`[^`]*`)*[^`]*$)")  # outside of code
PAGE = """{name}
{underline}

{description}

.. autosummary::
   :toctree: names

{names}

{also}
"""


def public_names(module):
    """Return the names in `__all__`, or of what it defines; no modules, and constants last."""
    here = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    ]
    names = [
        name
        for name in getattr(module, "__all__", here)
        if not name.startswith("__") and not isinstance(getattr(module, name), types.ModuleType)
    ]
    return sorted(names, key=str.isupper)


def module_of(name):
    """Return the module that users call, for example, `mrs.geometry`, wherever its file is."""
    package, _, attribute = name.partition(".")
    module = importlib.import_module(package)
    return getattr(module, attribute) if attribute else module


def write_pages(app, config):
    """Write a page for each module; a thing that has several names is described under the first.

    Raises
    ------
    ExtensionError
        If public names have no docstring.
    """
    first = {}  # the first name of each thing, by its identity
    for module_name in MODULES:
        module = module_of(module_name)
        own, also = [], []
        for name in public_names(module):
            whole, thing = f"{module_name}.{name}", getattr(module, name)
            if not inspect.getdoc(thing):
                raise ExtensionError(f"{whole} must have a docstring, as all public names")
            if first.setdefault(id(thing), whole) == whole:
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


def skip_fields(app, what, name, obj, skip, options):
    """Leave out the fields of named tuples, which their class describes."""
    return skip or type(obj).__name__ == "_tuplegetter"


def escape_bars(app, what, name, obj, options, lines):
    """Keep the bars of absolute values, which are marks of substitutions in reStructuredText."""
    lines[:] = [BAR.sub(r"\\|", line) for line in lines]


def setup(app):
    """Write the pages before Sphinx looks for pages."""
    app.connect("config-inited", write_pages)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("autodoc-skip-member", skip_fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
