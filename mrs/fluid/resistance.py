"""Velocities to forces: the loads of points whose motion is given, and the motion of free frames.

A regularized Stokeslet at each point, R. Cortez, SIAM J. Sci. Comput. 23, 1204 (2001); with free
bodies, R. Cortez, L. Fauci & A. Medovikov, Phys. Fluids 17, 031504 (2005).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from mrs import rotations
from mrs.fluid.blocks import Blocks, IllConditionedError, PlacedBlocks
from mrs.fluid.mobility import Boundary, Mobility
from mrs.rigid_motion import GivenMotion, carried

_MOST = 200  # iterations
_SLOWER = 4  # iterations more than with new blocks, after which they are renewed
_SAME = 1e-9  # of the size of the points: blocks are for points that have moved by less


class ResistanceError(ArithmeticError):
    """Loads that were not found; the message says what to change."""


class Solution(NamedTuple):
    """Loads of points and motion of frames at a time.

    Attributes
    ----------
    time : float
    points : (n, 3) ndarray
    inside : (n, 3) ndarray
        Forces on the fluid, in the axes of the frames.
    motion : (k, 6) ndarray
        Velocities and angular velocities of the frames.
    """

    time: float
    points: np.ndarray
    inside: np.ndarray
    motion: np.ndarray


_OF_SOLUTION = Solution._fields[1:]  # its arrays


class Memory(NamedTuple):
    """All on which the next solution depends, besides its arguments."""

    solution: Solution | None = None
    local: np.ndarray | None = None
    """Points for which the blocks are, (n, 3)."""
    iterations: int = 0
    """Of the last solution."""
    least: int = 0
    """Of the first solution with these blocks."""


class Resistance:
    """Forces at points that give them their velocities, by iterations over fast sums.

    With M the mobility, K the motion of points with their frames and U the motion of free frames,
    M f - K U = w and K^T f = F (Cortez, Fauci & Medovikov 2005). It is solved by GMRES (scipy's)
    from the last solution. The preconditioner solves the same equations with the patches of each
    body alone (`Blocks`), so that the second one always holds to rounding.

    Parameters
    ----------
    mobility : Mobility
        Of these points, from forces to velocities.
    viscosity : float
    epsilons : (n,) ndarray
        Blob sizes.
    tolerance : float
        Of the velocities, relative to their norm.
    name : callable
        Names a point for a message.

    Attributes
    ----------
    memory : Memory
    """

    def __init__(
        self,
        mobility: Mobility,
        viscosity: float,
        epsilons: np.ndarray,
        tolerance: float,
        name: Callable[[int], str],
    ) -> None:
        self.mobility, self._tolerance, self._name = mobility, tolerance, name
        self._viscosity, self._epsilons = viscosity, epsilons
        self._blocks: Blocks | None = None
        self.memory = Memory()

    def solve(
        self,
        time: float,
        points: np.ndarray,
        given: GivenMotion,
        flow: np.ndarray,
        boundary: Boundary | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces on the fluid, (n, 3), and the motion of all frames, (k, 6).

        Parameters
        ----------
        time : float
        points : (n, 3) ndarray
        given : GivenMotion
        flow : (n, 3) ndarray
            Velocities of the fluid there without these forces.
        boundary : Boundary, optional
            Where that of the mobility has moved to.

        Raises
        ------
        ResistanceError
            If the iterations do not converge.
        """
        last = self.memory.solution
        turn = given.quaternion[given.frame]
        if last is None or last.time != time or not np.array_equal(last.points, points):
            blocks = self._placed(given)
            wanted = given.velocity + carried(given.motion, given.arms, given.frame) - flow
            guess = None if last is None else rotations.rotate(turn, last.inside)
            flow_of = partial(self.mobility, points, boundary=boundary)
            solved = self._iterate(flow_of, given, blocks, wanted, guess)
            if solved is None:
                raise ResistanceError(self._advice(f"not be found in {_MOST} iterations", points))
            forces, motion, iterations = solved
            inside = rotations.rotate(rotations.conjugate(turn), forces)
            last = Solution(time, points, inside, given.motion + motion)
            least = iterations if self.memory.iterations < 0 else self.memory.least
            self.memory = self.memory._replace(solution=last, iterations=iterations, least=least)
        return rotations.rotate(turn, last.inside), last.motion

    def _placed(self, given: GivenMotion) -> PlacedBlocks:
        """Return the blocks of the points; new ones if the old ones serve badly."""
        old = self.memory
        slow = old.iterations > old.least + _SLOWER
        if old.local is None or (slow and _moved(old.local, given.local)):
            self.memory = old._replace(local=given.local, iterations=-1)
            self._blocks = None
        assert self.memory.local is not None
        if self._blocks is None or self._blocks.local is not self.memory.local:
            arguments = self._viscosity, self._epsilons, self.memory.local, given.frame
            try:
                self._blocks = Blocks(*arguments)
            except IllConditionedError:
                points = given.centre[given.frame] + given.arms
                raise ResistanceError(self._advice("not be found", points)) from None
        return self._blocks.place(given)

    def _iterate(
        self,
        flow_of: Callable[[np.ndarray], np.ndarray],
        given: GivenMotion,
        blocks: PlacedBlocks,
        wanted: np.ndarray,
        guess: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, int] | None:
        """Return forces, motion of the free frames, and the number of iterations, if they end."""
        count, iterations = wanted.size, 0
        arms, frame, still = given.arms, given.frame, np.zeros_like(given.load)

        def residual_of(forces: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, float]:
            flow = flow_of(forces)
            size = max(np.linalg.norm(flow), np.linalg.norm(wanted))
            return wanted - flow + carried(motion, arms, frame), float(size)

        def applied(velocities: np.ndarray) -> np.ndarray:
            nonlocal iterations
            iterations += 1
            forces, motion = blocks.solve(velocities.reshape(-1, 3), still)
            return (flow_of(forces) - carried(motion, arms, frame)).ravel()

        forces = np.zeros_like(wanted) if guess is None else guess
        before = wanted if guess is None else residual_of(guess, still)[0]
        step, motion = blocks.solve(before, given.load - blocks.net_loads(forces))
        forces = forces + step
        residual, size = residual_of(forces, motion)
        enough = self._tolerance * size
        if np.linalg.norm(residual) > enough:
            # Without a dtype scipy would find it by one more sum.
            operator = scipy.sparse.linalg.LinearOperator((count, count), applied, dtype=float)
            solved, failed = scipy.sparse.linalg.gmres(
                operator, residual.ravel(), rtol=0.0, atol=enough, restart=_MOST, maxiter=1
            )
            if failed:
                return None
            step, turned = blocks.solve(solved.reshape(-1, 3), still)
            forces, motion = forces + step, motion + turned
        return forces, motion, iterations

    def _advice(self, what: str, points: np.ndarray) -> str:
        """Return a message with the spacing of the points, on which the condition depends."""
        distances, _ = scipy.spatial.cKDTree(points).query(points, k=min(2, len(points)))
        spacing = np.reshape(distances, (len(points), -1))[:, -1] / self._epsilons
        row = int(np.argmin(spacing))
        return (
            f"forces that give {self._name(row)} and its like their velocities could {what}: that "
            f"point is {spacing[row]:.3g} epsilon from the next. Points less than a third of "
            "epsilon apart have nearly the same flow: keep bodies apart, take fewer points or a "
            f"smaller epsilon, or a smaller tolerance of the sums than {self._tolerance:g}"
        )

    def history(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all on which the next solution depends: arrays, and values that JSON can hold."""
        solution, local, iterations, least = self.memory
        values = {"iterations": iterations, "least": least, "sums": self.mobility.history()}
        arrays = {} if local is None else {"local": local}
        if solution is not None:
            values["time"] = solution.time
            arrays |= {name: getattr(solution, name) for name in _OF_SOLUTION}
        return arrays, values

    def restore(self, arrays: dict[str, np.ndarray], values: dict[str, Any]) -> None:
        """Take up a history."""
        solution = None
        if "time" in values:
            solution = Solution(values["time"], *(arrays[name] for name in _OF_SOLUTION))
        self.memory = Memory(solution, arrays.get("local"), values["iterations"], values["least"])
        self.mobility.restore(values["sums"])


def _moved(old: np.ndarray, new: np.ndarray) -> bool:
    """Tell whether points have another shape than before."""
    return bool(np.abs(new - old).max() > _SAME * np.abs(old).max())
