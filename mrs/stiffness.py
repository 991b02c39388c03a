"""How the loads of a body change with its coordinates: what makes its motion stiff."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Stiffness(NamedTuple):
    """The derivative of the loads of a body with a triad at each of its n points.

    Attributes
    ----------
    matrix : (6 n, 6 n) scipy.sparse.csr_array
        Row 6 k + i is the force of point k on the fluid for i < 3, else its torque; column 6 k + i
        its position, else its rotation vector.
    held : int ndarray
        Points whose motion does not follow from that of the fluid.
    pieces : (n,) int ndarray
        The piece of each point: loads of one piece do not depend on the others.
    """

    matrix: Any
    held: np.ndarray
    pieces: np.ndarray
