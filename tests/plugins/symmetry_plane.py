"""A boundary: the plane z = 0, through which nothing flows and at which the fluid slips."""

import numpy as np

import treecode as tc

MIRROR = np.array([1.0, 1.0, -1.0])


class SymmetryPlane(tc.Boundary):
    """Every load has a mirror image; torques are axial vectors, which turn the other way."""

    def terms(self, kernel):
        turns = np.concatenate([MIRROR, -MIRROR])[: kernel.strength_size]
        image = tc.Term(
            kernel, lambda points: points * MIRROR, lambda points, strengths: strengths * turns
        )
        return tc.Term(kernel), image
