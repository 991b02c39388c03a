"""The resistance and the mobility of rigid bodies, without a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mrs import check
from mrs.bodies import Body, Rigid
from mrs.fluid import Backend, Fluid
from mrs.rigid_motion import net_loads
from mrs.scene import Scene

_TOLERANCE = 1e-6


@check.spelling
def resistance(
    bodies: Rigid | Sequence[Rigid], fluid: Fluid, *, backend: Backend | None = None
) -> np.ndarray:
    """Return the matrix from the motion of rigid bodies to the loads that they put on the fluid.

    Its inverse is the matrix from loads to motion. In each, a body has six rows: for its velocity
    and its angular velocity, or for its force and its torque about the origin of its axes.

    Parameters
    ----------
    bodies : Rigid or sequence of Rigid
        At time zero. Their motion, force and torque do not matter.
    fluid : Fluid
        Its background does not matter.
    backend : Backend, optional
        By default the tolerance is 1e-6.

    Returns
    -------
    (6 n, 6 n) ndarray
        Of all n bodies in their order.

    Raises
    ------
    ValueError, TypeError
        For other bodies.
    ResistanceError
        If the forces are not found.

    Examples
    --------
    >>> import mrs
    >>> import numpy as np
    >>> ball = mrs.Rigid(mrs.surfaces.sphere(radius=1.0, count=200))
    >>> matrix = mrs.resistance(ball, mrs.Fluid(viscosity=1.0))
    >>> print(round(matrix[0, 0] / (6 * np.pi), 3), round(matrix[3, 3] / (8 * np.pi), 3))
    1.007 1.037
    """
    several = check.instances("bodies", [bodies] if isinstance(bodies, Body) else bodies, Rigid)
    scene = Scene(fluid, several, backend=backend or Backend(tolerance=_TOLERANCE))
    assert scene.resistance is not None, "all points are of rigid bodies"
    state = scene.layout.initial
    points, given = scene.layout.points(0.0, state), scene.layout.given_motion(0.0, state)
    count, arms, frame = len(given.centre), given.arms, given.frame
    still = np.zeros_like(points)
    given = given._replace(velocity=still, free=np.zeros(count, bool))
    columns: list[np.ndarray] = []
    for unit in np.eye(6 * count):
        moving = given._replace(motion=unit.reshape(count, 6))
        # Each unit is a time of its own for what remembers the last solution.
        forces, _ = scene.resistance.solve(float(len(columns)), points, moving, still)
        columns.append(net_loads(forces, arms, frame, count).ravel())
    return np.stack(columns, axis=1)
