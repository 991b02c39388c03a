"""Imports go one way (ARCHITECTURE.md): read from the sources, so that nothing has to run."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# module -> what it may import of the project
ALLOWED = {
    "treecode._fingerprint": set(),
    "treecode._mistakes": set(),
    "treecode._jit": {"treecode._fingerprint", "treecode._mistakes", "treecode.cache"},
    "treecode.check": set(),
    "treecode.shown": set(),
    "treecode.version": set(),
    "treecode.cache": set(),
    "treecode._lanes": {"treecode._jit"},
    "treecode._elements": {"treecode._jit", "treecode._lanes"},
    "treecode.kernels.base": {"treecode._jit", "treecode._lanes"},
    "treecode.kernels": {"treecode.kernels", "treecode._lanes", "treecode.check"},
    "treecode.kernels.periodic": {"treecode.kernels.base"},
    "treecode.pairs": {"treecode._jit", "treecode._lanes", "treecode.kernels.base"},
    "treecode.memory": set(),
    "treecode.threads": set(),
    "treecode.timing": set(),
    "treecode.locks": set(),
    "treecode.accuracy": {"treecode.kernels.base", "treecode.ranks"},
    "treecode.tree": {"treecode._jit"},
    "treecode.upward": {
        "treecode._jit", "treecode.ranks", "treecode.threads", "treecode.timing", "treecode.tree",
    },
    "treecode.traversal": {
        "treecode._jit", "treecode._lanes", "treecode.kernels.base", "treecode.pairs",
        "treecode.threads", "treecode.tree",
    },
    "treecode.methods.base": {"treecode.check", "treecode.kernels.base", "treecode.ranks"},
    "treecode.methods.registry": {
        "treecode.boundaries.base", "treecode.boundaries.within", "treecode.check",
        "treecode.kernels.base", "treecode.methods.base",
    },
    "treecode.methods.walk": {
        "treecode.kernels.base", "treecode.methods.base", "treecode.ranks", "treecode.threads",
        "treecode.timing", "treecode.traversal", "treecode.tree", "treecode.upward",
    },
    "treecode.methods.treecode": {
        "treecode.check", "treecode.methods.base", "treecode.methods.walk", "treecode.traversal",
        "treecode.tree",
    },
    "treecode.methods.direct": {
        "treecode.kernels.base", "treecode.kernels.periodic", "treecode.methods.base",
        "treecode.methods.ewald", "treecode.methods.registry", "treecode.methods.walk",
        "treecode.tree",
    },
    "treecode.methods.ewald.split": set(),
    "treecode.methods.ewald.cells": {"treecode.kernels.periodic"},
    "treecode.methods.ewald.short_part": {
        "treecode._elements", "treecode._jit", "treecode._lanes", "treecode.pairs",
    },
    "treecode.methods.ewald.long_part": {"treecode._jit", "treecode.methods.ewald.split"},
    "treecode.methods.ewald.tuning": {
        "treecode.methods.ewald.cells", "treecode.methods.ewald.long_part",
        "treecode.methods.ewald.split",
    },
    "treecode.methods.ewald": {
        "treecode.check", "treecode.kernels.base", "treecode.kernels.periodic",
        "treecode.methods.base", "treecode.methods.ewald", "treecode.ranks", "treecode.threads",
        "treecode.timing", "treecode.traversal",
    },
    "treecode.methods.images.wrapping": {"treecode.kernels.periodic"},
    "treecode.methods.images.window": {
        "treecode.methods.ewald.long_part", "treecode.methods.ewald.tuning",
    },
    "treecode.methods.images": {
        "treecode.check", "treecode.kernels.base", "treecode.kernels.periodic",
        "treecode.methods.base", "treecode.methods.ewald", "treecode.methods.fmm",
        "treecode.methods.images", "treecode.ranks", "treecode.threads", "treecode.timing",
    },
    "treecode.methods.kitc": {
        "treecode._jit", "treecode._lanes", "treecode.kernels.base", "treecode.methods.treecode",
        "treecode.pairs", "treecode.tree",
    },
    "treecode.methods.taylor": {
        "treecode._jit", "treecode._lanes", "treecode.check", "treecode.kernels.base",
        "treecode.methods.base", "treecode.methods.treecode", "treecode.tree",
    },
    "treecode.methods.fmm.legendre": set(),
    "treecode.methods.fmm.octree": {"treecode._jit", "treecode.threads", "treecode.tree"},
    "treecode.methods.fmm.symmetry": {"treecode._jit", "treecode.kernels.base", "treecode.pairs"},
    "treecode.methods.fmm.level": {"treecode.methods.fmm.legendre"},
    "treecode.methods.fmm.bases": {
        "treecode.methods.fmm.legendre", "treecode.methods.fmm.level",
        "treecode.methods.fmm.symmetry",
    },
    "treecode.methods.fmm.operators": {
        "treecode.kernels.base", "treecode.methods.fmm.bases", "treecode.methods.fmm.legendre",
        "treecode.methods.fmm.level", "treecode.methods.fmm.symmetry",
    },
    "treecode.methods.fmm.transfer": {
        "treecode.methods.fmm.legendre", "treecode.methods.fmm.level",
    },
    "treecode.methods.fmm.store": {
        "treecode._fingerprint", "treecode._jit", "treecode.cache", "treecode.kernels.base",
        "treecode.methods.fmm.level", "treecode.methods.fmm.operators",
    },
    "treecode.blas": {"treecode._jit"},
    "treecode.methods.fmm.loops": {
        "treecode._jit", "treecode._lanes", "treecode.methods.fmm.octree",
        "treecode.methods.fmm.symmetry", "treecode.pairs",
    },
    "treecode.methods.fmm.lists": {
        "treecode._jit", "treecode.methods.fmm.octree", "treecode.threads",
    },
    "treecode.methods.fmm.sizing": {
        "treecode.kernels.base", "treecode.memory", "treecode.methods.fmm.lists",
        "treecode.methods.fmm.octree", "treecode.threads",
    },
    "treecode.methods.fmm.curve": {
        "treecode._jit", "treecode.curve", "treecode.methods.fmm.octree", "treecode.ranks",
        "treecode.threads",
    },
    "treecode.methods.fmm.partition": {"treecode.curve", "treecode.ranks"},
    "treecode.methods.fmm.ghosts": {
        "treecode.methods.fmm.curve", "treecode.methods.fmm.octree", "treecode.ranks",
    },
    "treecode.methods.fmm": {
        "treecode.blas", "treecode.check", "treecode.kernels.base", "treecode.methods.base",
        "treecode.methods.fmm", "treecode.ranks", "treecode.threads", "treecode.timing",
        "treecode.traversal",
    },
    "treecode.methods": {"treecode.methods"},
    "treecode.ranks": set(),
    "treecode.curve": set(),
    "treecode.shared_sum": {
        "treecode.boundaries.base", "treecode.boundaries.within", "treecode.curve",
        "treecode.kernels.base", "treecode.methods.base",
        "treecode.methods.registry", "treecode.ranks", "treecode.sliced_sum", "treecode.timing",
    },
    "treecode.sliced_sum": {"treecode.methods.base", "treecode.ranks", "treecode.timing"},
    "treecode.choice.model": {"treecode.kernels.base"},
    "treecode.choice.refusals": set(),
    "treecode.choice.sampling": {
        "treecode._lanes", "treecode.accuracy", "treecode.boundaries.base",
        "treecode.kernels.base", "treecode.methods.base",
        "treecode.methods.direct", "treecode.pairs", "treecode.ranks", "treecode.shared_sum",
        "treecode.threads", "treecode.traversal",
    },
    "treecode.choice": {
        "treecode.accuracy", "treecode.boundaries.base", "treecode.choice",
        "treecode.kernels.base", "treecode.methods",
        "treecode.ranks", "treecode.shared_sum",
    },
    "treecode.boundaries": {"treecode.boundaries", "treecode.check", "treecode.kernels"},
    "treecode.boundaries.within": {"treecode.boundaries.base", "treecode.methods.base"},
    "treecode.plan": {"treecode"},
    "treecode": {"treecode"},
    "mrs.check": {"treecode.check"},
    "mrs.describe": set(),
    "mrs.markdown": set(),
    "mrs.profile": {"mrs.markdown", "treecode.shown"},
    "mrs.registry": set(),
    "mrs.rotations": set(),
    "mrs.rigid_motion": {"mrs.rotations"},
    "mrs.stiffness": set(),
    "mrs.krylov": set(),
    "mrs.proxies": {"mrs.fluid", "mrs.rotations", "mrs.stiffness"},
    "mrs.linearization": {
        "mrs.bodies.layout", "mrs.fluid", "mrs.krylov", "mrs.proxies", "mrs.rotations",
        "mrs.stiffness", "mrs.time", "treecode.threads",
    },
    "mrs.resistance_matrix": {
        "mrs.bodies", "mrs.check", "mrs.fluid", "mrs.rigid_motion", "mrs.scene",
    },
    "mrs.time": {"mrs.check", "mrs.krylov", "mrs.registry", "mrs.rotations", "mrs.time"},
    "mrs.time.interrupts": {"mrs.check", "mrs.run.simulation"},  # its type
    "mrs.bodies": {
        "mrs.bodies", "mrs.check", "mrs.describe", "mrs.registry", "mrs.rigid_motion",
        "mrs.stiffness",
        "mrs.rotations", "mrs.time.state", "treecode.shown",
    },
    "mrs.forces": {
        "mrs.bodies", "mrs.check", "mrs.fluid", "mrs.forces", "mrs.registry", "mrs.time.state",
    },
    "mrs.fluid": {"mrs.check", "mrs.fluid", "mrs.registry", "treecode"},  # its boundaries
    "mrs.fluid.mobility": {"mrs.check", "mrs.fluid", "treecode"},  # the one caller of treecode
    "mrs.fluid.blocks": {"mrs.rigid_motion", "mrs.rotations"},
    "mrs.fluid.resistance": {"mrs.fluid", "mrs.rigid_motion", "mrs.rotations"},
    "mrs.scene": {
        "mrs.bodies", "mrs.check", "mrs.fluid", "mrs.forces", "mrs.linearization", "mrs.profile",
        "mrs.rigid_motion",
        "mrs.time.state", "treecode.blas", "treecode.ranks",
    },
    "mrs.observables": {
        "mrs.check", "mrs.fluid", "mrs.observables", "mrs.output", "mrs.registry",
        "mrs.rotations", "mrs.time.state",
        "mrs.run.simulation",  # its type
    },
    "mrs.output": {
        "mrs.bodies", "mrs.check", "mrs.fluid", "mrs.output", "mrs.registry",
        "mrs.time.interrupts", "treecode.shown", "treecode.version",
        "mrs.run.simulation",  # its type
    },
    "mrs.run": {
        "mrs.bodies", "mrs.check", "mrs.describe", "mrs.fluid", "mrs.forces", "mrs.observables",
        "mrs.output", "mrs.profile", "mrs.run", "mrs.scene", "mrs.time", "treecode.blas",
        "treecode.ranks",
        "treecode.shown", "treecode.version",
    },
    "mrs.run.signals": {"treecode.ranks"},
    "mrs.run.my_scene": {"mrs"},  # what `mrs new` writes
    "mrs.scenarios": set(),  # found by name
    "mrs": {"mrs", "treecode.version"},
    "scenarios": {"mrs"},
}  # fmt: skip

SOURCES = [
    p for top in ("treecode", "mrs", "scenarios") for p in sorted((ROOT / top).rglob("*.py"))
]


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                module = ROOT / Path(*full.split("."))
                known = module.with_suffix(".py").exists() or module.is_dir()
                yield full if known else node.module


def rule(name):
    """Return the most specific entry of ALLOWED."""
    while name not in ALLOWED:
        name = name.rpartition(".")[0]
    return ALLOWED[name]


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_imports_go_one_way(path):
    name = name_of(path)
    for imported in imports_of(path):
        if imported.split(".")[0] in ("treecode", "mrs", "scenarios"):
            allowed = rule(name)
            ok = any(imported == a or imported.startswith(a + ".") for a in allowed)
            assert ok, f"{name} imports {imported}"


def test_numba_is_spelled_in_one_file():
    """Only _jit.py names compiler options; _lanes.py and _elements.py emit code besides it."""
    for path in SOURCES:
        text = path.read_text()
        if path.name not in ("_jit.py", "_lanes.py", "_elements.py"):
            for word in ("fastmath", "njit", "error_model", "forceinline"):
                assert word not in text, f"{path} names {word}"
            assert "llvmlite" not in text


def test_mpi_is_spelled_in_one_file():
    """Only treecode/ranks.py imports mpi4py, and only where there are ranks."""
    for path in SOURCES:
        if path != ROOT / "treecode" / "ranks.py":
            assert "mpi4py" not in [name.split(".")[0] for name in imports_of(path)], path
