"""Where the time of a run goes."""

from __future__ import annotations

import csv
import io
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

from mrs import markdown
from treecode.shown import Shown

STAGES = {
    "start": "the first evaluation: compiling, or loading compiled code; choosing backends",
    "partition": "points brought to the ranks that own them",
    "tree": "points sorted into boxes",
    "ghosts": "cubes and points that ranks need of each other",
    "operators": "of the fast multipole method, built or read",
    "weights": "strengths in tree order; of treecodes also the expansions of clusters",
    "expansions": "of clusters, from the other ranks",
    "upward": "expansions of cubes, from points and from their children",
    "translations": "from cubes to cubes",
    "downward": "from cubes to their children",
    "near": "points to points",
    "far": "expansions to points",
    "waves": "of periodic sums: strengths to waves, and waves to points",
    "walk": "the rest of the walk down the tree; all of it without a counter of cycles",
    "sharing": "targets divided among ranks",
    "waiting": "for the slowest rank",
    "communication": "values from other ranks; of the fast multipole method what it needs of them",
    "gathering": "values of the fast multipole method, from the other ranks",
    "sums": "the rest of the sums: copies, checks",
    "resistance": "forces where motion is given: iterations, with the sums in them",
    "forces": "of the bodies, and their motion from the motion of the fluid",
    "background": "flow without the bodies",
    "linearization": "an approximate Jacobian, for implicit steps",
    "integrator": "local coordinates, combinations of stages, step sizes",
    "error samples": "the sums compared with direct ones at a few targets",
    "output": "trajectories, log, checkpoints, progress, and trackers of one's own",
    "remainder": "everything else between begin and end of the run",
}


class Row(NamedTuple):
    """One stage of a profile."""

    stage: str
    seconds: float
    pairs: int | None


class Profile(Shown):
    """Seconds by stage (`STAGES`), of all that a simulation has done so far.

    Stages may be open within others. The time of the inner one does not count for the outer one
    too, so that all together give the time during which any was open: in `Simulation.run`, all of
    it.

    Attributes
    ----------
    seconds : dict
        By stage.
    pairs : dict
        Pairs summed "near", and terms of expansions "far"; for "fmm" cubes and translations.

    Examples
    --------
    >>> import mrs
    >>> dust = mrs.Tracers([[0.0, 0.0, 1.0]])
    >>> sim = mrs.Simulation(mrs.Fluid(background=mrs.flows.shear(1.0)), [dust]).run(1.0)
    >>> {"background", "integrator"} <= {row.stage for row in sim.profile.rows()}
    True
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self.pairs: defaultdict[str, int] = defaultdict(int)
        self._open: list[str] = []
        self._noted = 0.0
        self._thread = 0  # that opened the outermost stage

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside for one stage.

        Parameters
        ----------
        name : str
            One of `STAGES`.
        """
        if self._elsewhere():
            yield
            return
        self._thread = threading.get_ident()
        self._note()
        self._open.append(name)
        try:
            yield
        finally:
            self._note()
            self._open.pop()

    def divide(self, seconds: Mapping[str, float], near: int, far: int) -> None:
        """Give parts of the time of the innermost stage, measured there, to others; count pairs.

        Parameters
        ----------
        seconds : dict of float
            By stage.
        near, far : int
            Pairs, and terms of expansions.
        """
        if self._elsewhere():
            return
        self._note()
        for name, part in seconds.items():
            self.seconds[name] += part
            self.seconds[self._open[-1]] -= part
        self.pairs["near"] += near
        self.pairs["far"] += far

    def _elsewhere(self) -> bool:
        """Tell whether another thread has stages open."""
        return bool(self._open) and self._thread != threading.get_ident()

    def _note(self) -> None:
        """Give the time since the last note to the innermost stage."""
        now = time.perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._noted
        self._noted = now

    def rows(self) -> list[Row]:
        """Return the stages that there were, in the order of `STAGES`."""
        self._note()
        done = [name for name in STAGES if name in self.seconds]
        return [Row(name, self.seconds[name], self.pairs.get(name)) for name in done]

    def __str__(self) -> str:
        """Return a Markdown table."""
        rows = self.rows()
        total = sum(row.seconds for row in rows)
        lines = []
        for row in rows:
            pairs = "" if row.pairs is None else f"{row.pairs:.3g}"
            share = 100.0 * row.seconds / total if total else 0.0
            cells = [row.stage, f"{row.seconds:.3f}", f"{share:.1f}", pairs, STAGES[row.stage]]
            lines.append(cells)
        lines.append(["all", f"{total:.3f}", "100.0", "", ""])
        return "\n".join(markdown.table(("stage", "seconds", "%", "pairs", "meaning"), lines))

    def shown(self) -> dict[str, str]:
        return {row.stage: f"{row.seconds:.3g} s" for row in self.rows()}

    def csv(self) -> str:
        """Return the same for programs: stage, seconds, pairs."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([Row._fields, *self.rows()])
        return text.getvalue()
