"""The public names: of which modules they are, as users call them."""

import importlib
import types

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


def module_of(name):
    """Return the module that users call, for example, `mrs.geometry`, wherever its file is."""
    package, _, attribute = name.partition(".")
    module = importlib.import_module(package)
    return getattr(module, attribute) if attribute else module


def names_in(module):
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


def things():
    """Return all public things by their first names, such as "mrs.geometry.helix"."""
    first = {}
    for module_name in MODULES:
        module = module_of(module_name)
        for name in names_in(module):
            thing = getattr(module, name)
            first.setdefault(id(thing), (f"{module_name}.{name}", thing))
    return dict(first.values())
