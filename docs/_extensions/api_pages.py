"""The reference of the API: a page for each module, which lists its public names, from `__all__`.

Sphinx's autosummary makes the page of each name from its docstring. A name without one is an error.
"""

import importlib
import inspect
import types

import generated
from sphinx.errors import ExtensionError

MODULES = (
    "mrs",
    "mrs.geometry",
    "mrs.surfaces",
    "mrs.flows",
    "mrs.observables",
    "mrs.rotations",
    "treecode",
    "treecode.methods",
    "treecode.cache",
)
PAGE = """{name}
{underline}

{description}

.. autosummary::
   :toctree: names

"""


def public_names(module):
    """Return the public names of a module that are no modules: `__all__`, or what it defines."""
    here = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", "") == module.__name__
    ]
    return [
        name
        for name in getattr(module, "__all__", here)
        if not name.startswith("__") and not isinstance(getattr(module, name), types.ModuleType)
    ]


def module_of(name):
    """Return the module that users call `mrs.geometry`, wherever its file is."""
    package, _, attribute = name.partition(".")
    module = importlib.import_module(package)
    return getattr(module, attribute) if attribute else module


def write_pages(app, config):
    """Write a page for each module.

    Raises
    ------
    ExtensionError
        If public names have no docstring.
    """
    mute = []
    for module_name in MODULES:
        module = module_of(module_name)
        names = public_names(module)
        mute += [f"{module_name}.{n}" for n in names if not inspect.getdoc(getattr(module, n))]
        page = PAGE.format(
            name=module_name,
            underline="=" * len(module_name),
            description=inspect.getdoc(module),
        )
        generated.write(
            f"api/{module_name}.rst", page + "".join(f"   {module_name}.{n}\n" for n in names)
        )
    if mute:
        raise ExtensionError(f"public names must have a docstring, got none in {', '.join(mute)}")


def skip_fields(app, what, name, obj, skip, options):
    """Leave out the fields of named tuples, which their class describes."""
    return skip or type(obj).__name__ == "_tuplegetter"


def setup(app):
    """Write the pages before Sphinx looks for pages."""
    app.connect("config-inited", write_pages)
    app.connect("autodoc-skip-member", skip_fields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
