"""What the plugins have registered when they were imported: other tests must not meet it."""

import mrs
from tests.plugins import adams_bashforth, pull, weights, xyz

__all__ = ["NAMES", "PARTS", "adams_bashforth", "pull", "weights", "xyz"]

NAMES = (
    (mrs.BODIES, "weights"),
    (mrs.FORCES, "pull"),
    (mrs.FORMATS, "xyz"),
    (mrs.INTEGRATORS, "ab2"),
)
PARTS = [registry.pop(name) for registry, name in NAMES]
