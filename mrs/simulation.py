"""Fluid and bodies put together, and run."""

from __future__ import annotations

import time as clock
import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrs import check, rundir, signals
from mrs.bodies import Body
from mrs.describe import described, differences
from mrs.flows import Flow
from mrs.mobility import Backend, Mobility
from mrs.profile import Profile
from mrs.state import State
from mrs.stepper import METHODS, Integrator, NotFiniteError, Stepper, StepSizeError
from mrs.steric import Steric
from mrs.trackers import Output, Tracker, next_stop, standard_trackers

_CORRECT_EVERY = 50  # steps, after which the error of the sums is sampled
_NUMERICS = ("backend", "integrator", "output")  # of a description; the rest is physics
_WRITING = ("interval", "checkpoint_seconds", "live")
_SAID_ELSEWHERE = ("t_end", "backend", "integrator", *_WRITING)  # of the options of a scenario
_PERTURBATION = 1e-3  # of positions in blob sizes and of triads in radians, to estimate eigenvalues


@check.spelling
@dataclass(frozen=True)
class Fluid:
    """The fluid.

    Parameters
    ----------
    viscosity : float
    epsilon : float, optional
        Blob size of bodies that do not set their own.
    background : Flow, optional
        What it does without bodies: one of `mrs.flows`, or an object with their methods `velocity`
        and, for rods, `vorticity`.
    """

    viscosity: float = 1.0
    epsilon: float | None = None
    background: Flow | None = None

    def __post_init__(self) -> None:
        check.positive("viscosity", self.viscosity)
        if self.epsilon is not None:
            check.positive("epsilon", self.epsilon)
        flow = self.background
        if flow is not None and not callable(getattr(flow, "velocity", None)):
            raise TypeError(
                "background must be a flow such as mrs.flows.shear(rate=1.0), or "
                f"mrs.flows.UserFlow(function), got {flow!r}"
            )

    def flow(
        self,
        what: str,
        points: np.ndarray,
        time: float,
        name: Callable[[int], str] = "row {}".format,
    ) -> np.ndarray:
        """Return the background's "velocity" or "vorticity" at points, (N, 3); `name` names one."""

        def where(row: int) -> str:
            return f"at {name(row)}, {points[row]}, and time {time:g}"

        value = getattr(self.background, what)(points, time)
        return check.vectors(f"background {what}", value, len(points), where)


class Evaluation(NamedTuple):
    """All that follows from one state."""

    time: float
    state: State
    points: np.ndarray
    """Where forces act and velocities are known, (N, 3)."""
    loads: np.ndarray
    """Forces, and torques if any body has them, (N, 3 or 6)."""
    motion: np.ndarray
    """Velocities, and angular velocities if any body wants them, (N, 3 or 6)."""
    rates: np.ndarray
    """Those of positions and triads, (P + Q, 3)."""


class _Part(NamedTuple):
    """Where one body lives in the flat arrays."""

    body: Body
    positions: slice
    quaternions: slice
    points: slice

    def state(self, state: State) -> State:
        return State(state.positions[self.positions], state.quaternions[self.quaternions])


class SimulationError(RuntimeError):
    """A run that cannot go on; the message says where and why."""


@check.spelling
class Simulation:
    """Bodies in a viscous fluid.

    Parameters
    ----------
    fluid : Fluid
    bodies : sequence of Body
        `Rods`, `Swimmers`, `Tracers`, in any number; their names must differ.
    backend : str or Backend, optional
        How velocities are summed.
    integrator : str or Integrator, optional
        How time is stepped.
    steric : Steric, optional
        Repulsion between all points that carry forces.
    output : Output, optional
        Run directory; nothing is written without.
    trackers : sequence of Tracker, optional
        One's own, besides those of `output`.
    recipe : dict, optional
        What builds this simulation again, kept in config.toml for `mrs.resume`.

    Attributes
    ----------
    profile : Profile
        Where the time has gone; print it.

    Raises
    ------
    ValueError, TypeError
        The message names the argument and says what is allowed.
    """

    def __init__(
        self,
        fluid: Fluid,
        bodies: Sequence[Body],
        *,
        backend: str | Backend = "auto",
        integrator: str | Integrator = "rkc2",
        steric: Steric | None = None,
        output: Output | None = None,
        trackers: Iterable[Tracker] = (),
        recipe: dict[str, Any] | None = None,
    ) -> None:
        self.fluid = check.instance("fluid", fluid, Fluid)
        self.bodies = check.instances("bodies", bodies, Body)
        self.backend = (
            backend
            if isinstance(backend, Backend)
            else Backend(check.one_of("backend", backend, Backend.names()))
        )
        self.integrator = (
            integrator
            if isinstance(integrator, Integrator)
            else Integrator(check.one_of("integrator", integrator, METHODS))
        )
        self.steric = check.instance("steric", steric, Steric, type(None))
        self.output = check.instance("output", output, Output, type(None))
        self.recipe = recipe
        self.time = 0.0
        self.profile = Profile()
        self._assemble()
        self.stepper = Stepper(self.integrator)
        self.trackers = [
            *standard_trackers(output),
            *check.instances("trackers", trackers, Tracker),
        ]
        self.resumed = False
        self.written: dict[str, list[float]] = {}  # the last two times in each file of the run

    def _assemble(self) -> None:
        """Lay the bodies out in flat arrays."""
        names = [body.name for body in self.bodies]
        if not self.bodies or len(set(names)) < len(names):
            raise ValueError(f"bodies must be at least one, with different names, got {names}")
        self.state = State(
            np.concatenate([body.positions for body in self.bodies]),
            np.concatenate([body.quaternions for body in self.bodies]),
        )
        if not len(self.state.positions):
            raise ValueError("bodies must have at least one point")
        initial = [body.points(State(body.positions, body.quaternions)) for body in self.bodies]
        places = zip(
            self.bodies,
            _slices(len(body.positions) for body in self.bodies),
            _slices(len(body.quaternions) for body in self.bodies),
            _slices(len(points) for points in initial),
            strict=True,
        )
        self._parts = [_Part(*place) for place in places]
        self._count = sum(map(len, initial))
        sizes = [len(points) for points in initial]

        def at_points(values: Iterable[Any]) -> np.ndarray:
            return np.repeat(list(values), sizes)

        forced = at_points(body.has_force for body in self.bodies)
        torqued = at_points(body.has_torque for body in self.bodies)
        spinning = at_points(body.has_spin for body in self.bodies)
        numbers = at_points(range(len(self.bodies)))
        self._width = 6 if torqued.any() or spinning.any() else 3
        background = self.fluid.background
        if background is not None and spinning.any() and not hasattr(background, "vorticity"):
            raise ValueError("background must have a vorticity, since it turns the triads of rods")
        self._epsilons = epsilons = np.concatenate(
            [self._blob_sizes(body, size) for body, size in zip(self.bodies, sizes, strict=True)]
        )
        self.mobility = Mobility(
            self.fluid.viscosity, epsilons, forced, torqued, spinning, numbers, self.backend
        )
        self._scale(epsilons[forced])
        self._label(forced)
        self._evaluation: Evaluation | None = None

    def _blob_sizes(self, body: Body, size: int) -> np.ndarray:
        if not body.has_force:
            return np.ones(size)
        default = self.fluid.epsilon
        if default is not None:
            return body.epsilons(default)
        epsilons = body.epsilons(np.nan)
        if np.isnan(epsilons).any():
            raise ValueError(f"epsilon must be set, by the fluid or by {body.name!r}")
        return epsilons

    def _scale(self, epsilons: np.ndarray) -> None:
        """Set the units of errors, and of perturbations, of the local coordinates.

        Points without a length of their own take the smallest of the others'; in a scene without
        any length the unit is 0, and the stepper takes one from the motion.
        """
        turns = np.ones(len(self.state.quaternions))
        known = [body.length_scale for body in self.bodies if body.length_scale > 0.0]
        least, largest = min(known, default=0.0), max(known, default=0.0)
        lengths = [np.full(len(b.positions), b.length_scale or least) for b in self.bodies]
        smallest = np.full(len(self.state.positions), epsilons.min(initial=largest))
        self.error_scale = np.concatenate([*lengths, turns])[:, None]
        self.perturbation = _PERTURBATION * np.concatenate([smallest, turns])[:, None]

    def _label(self, forced: np.ndarray) -> None:
        """Number the connected pieces of all bodies, for the steric repulsion."""
        labels, before = [], 0
        for body in self.bodies:
            if body.has_force and self.steric is not None:
                piece, *along = body.contact_labels()
                labels.append((piece + before, *along))
                before += int(piece.max(initial=-1)) + 1
        self._touching = np.flatnonzero(forced) if labels else np.empty(0, int)
        self._labels = [np.concatenate(column) for column in zip(*labels, strict=True)]

    # --- physics -------------------------------------------------------------------------------

    def evaluate(self, time: float, state: State) -> Evaluation:
        """Return forces and motion in a state; the last answer is kept."""
        with self.mobility.lock:
            last = self._evaluation
            if last is None or last.time != time or not last.state.equals(state):
                with self.profile.stage("forces"):
                    last = self._evaluation = self._evaluate(time, state)
            return last

    def rates(self, time: float, state: State) -> np.ndarray:
        """Return velocities and angular velocities of the coordinates, (P + Q, 3)."""
        return self.evaluate(time, state).rates

    def _evaluate(self, time: float, state: State) -> Evaluation:
        points = np.concatenate([part.body.points(part.state(state)) for part in self._parts])
        loads = self._loads(time, state, points)
        if not check.computable(points, loads):  # the stepper rejects the step, or stops
            lost = np.full_like(loads, np.nan)
            return Evaluation(time, state, points, loads, lost, self._rates(time, state, lost))
        motion = self._sum(points, loads)
        if self.fluid.background is not None:
            with self.profile.stage("background"):
                motion[:, :3] += self.fluid.flow("velocity", points, time, self._node)
                if self._width == 6:
                    motion[:, 3:] += 0.5 * self.fluid.flow("vorticity", points, time, self._node)
        return Evaluation(time, state, points, loads, motion, self._rates(time, state, motion))

    def _sum(self, points: np.ndarray, loads: np.ndarray) -> np.ndarray:
        if not self.mobility.evaluations:
            with self.profile.stage("start"):
                return self.mobility(points, loads)
        with self.profile.stage("sums"):
            motion = self.mobility(points, loads)
            for info in self.mobility.infos():
                self.profile.divide(info["seconds"], info["near_pairs"], info["far_pairs"])
        return motion

    def _loads(self, time: float, state: State, points: np.ndarray) -> np.ndarray:
        loads = np.zeros((self._count, self._width))
        for part in self._parts:
            if part.body.has_force:
                force, torque = part.body.loads(time, part.state(state))
                loads[part.points, :3] = force
                if torque is not None:
                    loads[part.points, 3:] = torque
        if self.steric is not None and len(self._touching):
            touching = points[self._touching]
            loads[self._touching, :3] += self.steric.forces(touching, *self._labels)
        return loads

    def _rates(self, time: float, state: State, motion: np.ndarray) -> np.ndarray:
        velocities, spins = [], []
        for part in self._parts:
            own = motion[part.points]
            spin = own[:, 3:] if part.body.has_spin else None
            velocity, turning = part.body.rates(time, part.state(state), own[:, :3], spin)
            velocities.append(velocity)
            spins.append(turning)
        return np.concatenate([*velocities, *spins])

    def _part(self, body: Body) -> _Part:
        return next(part for part in self._parts if part.body is body)

    def energy(self) -> float:
        """Return the elastic energy of all bodies."""
        return sum(part.body.energy(self.time, part.state(self.state)) for part in self._parts)

    def body_state(self, body: Body) -> State:
        """Return the positions and quaternions of one body."""
        return self._part(body).state(self.state)

    def constant_fields(self, body: Body) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return arrays of one body at points and at cells that are the same in all frames.

        With the blob sizes, since the velocity of the fluid follows from them.
        """
        epsilons = self._epsilons[self._part(body).points]
        at_points, at_cells = body.constant_fields(epsilons)
        return at_points | ({"epsilon": epsilons} if body.has_force else {}), at_cells

    def point_count(self, body: Body) -> int:
        """Return how many points one body has."""
        points = self._part(body).points
        return points.stop - points.start

    def frame(self, body: Body) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return what a file shows of one body: its points, arrays at points and at cells."""
        part = self._part(body)
        now = self.evaluate(self.time, self.state)
        at_points = {"velocity": now.motion[part.points, :3]}
        if body.has_force:
            at_points["force"] = now.loads[part.points, :3]
        if body.has_torque:
            at_points["torque"] = now.loads[part.points, 3:]
        if body.has_spin:
            at_points["angular_velocity"] = now.motion[part.points, 3:]
        fields = body.fields(self.time, part.state(self.state), **at_points)
        return now.points[part.points], *fields

    def velocity(
        self,
        points: ArrayLike,
        time: float | None = None,
        sources: np.ndarray | None = None,
        loads: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the velocity of the fluid at points, (N, 3).

        Its relative error over these points is that of the backend's tolerance, of what bodies do
        to them; see `Mobility.velocity`.

        Parameters
        ----------
        points : (N, 3) array_like
        time, sources, loads : optional
            Of another state, such as a stored frame: its time, points, and their forces and
            torques; the present ones by default.
        """
        points = check.points("points", points)
        if sources is None or loads is None or time is None:
            now = self.evaluate(self.time, self.state)
            time, sources, loads = now.time, now.points, now.loads
        with self.mobility.lock:
            velocity = self.mobility.velocity(sources, loads[:, : self._width], points)
        if self.fluid.background is not None:
            velocity += self.fluid.flow("velocity", points, time)
        return velocity

    # --- storage -------------------------------------------------------------------------------

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the rest of the run depends on: arrays, and values that JSON can hold."""
        arrays, history = self.stepper.history()
        arrays = {f"integrator/{name}": array for name, array in arrays.items()}
        values = {
            "time": self.time,
            "integrator": history,
            "backends": self.mobility.history(),
            "written": dict(self.written),
            "scene": self.description,
        }
        return arrays | self.state._asdict(), values

    @cached_property
    def description(self) -> dict[str, Any]:
        """What the scene is made of, and how it is computed and written, as plain values."""
        options = (self.recipe or {}).get("options", {})
        written = () if self.output is None else _WRITING
        return described(
            {
                "options": {k: v for k, v in options.items() if k not in _SAID_ELSEWHERE},
                "fluid": self.fluid,
                "bodies": {body.name: body.parameters() for body in self.bodies},
                "order": [body.name for body in self.bodies],
                "steric": self.steric,
                "backend": self.backend,
                "integrator": self.integrator,
                "output": {name: getattr(self.output, name) for name in written},
            }
        )

    def restore(
        self, arrays: dict[str, np.ndarray], values: dict[str, Any], *, changes: bool = False
    ) -> None:
        """Take up a snapshot of the same scene.

        Parameters
        ----------
        arrays, values : dict
            From `snapshot`.
        changes : bool, optional
            Whether fluid, bodies or steric repulsion may be others than those of the snapshot.

        Raises
        ------
        ValueError
            If it is of another number of points; or of another fluid, other bodies or another
            repulsion, without `changes`. The message names each difference.

        Warns
        -----
        UserWarning
            Of each difference that is taken up: those, and of backend, integrator and output.

        Notes
        -----
        Another backend chooses anew how to sum, another integrator begins with a new step size,
        and after a change of the physics both do.
        """
        found = differences(values["scene"], self.description)
        physics = [d for d in found if d.place.partition(".")[0] not in _NUMERICS]
        said = "".join(f"\n  {difference}" for difference in found)
        state = State(arrays["positions"], arrays["quaternions"])
        for name, mine, other in zip(State._fields, self.state, state, strict=True):
            if mine.shape != other.shape:
                raise ValueError(
                    f"checkpoint: {name} have shape {other.shape}, the scene's {mine.shape}; a run "
                    f"cannot go on with other numbers of points{said}"
                )
        if physics and not changes:
            raise ValueError(
                f"the scene is not that of the checkpoint:{said}\n"
                "put this back; or, if the run is to go on with the change, say so with "
                "`mrs resume DIRECTORY --changes` (changes=True)"
            )
        if found:
            warnings.warn(f"from t = {values['time']:g} on:{said}", stacklevel=3)
        changed = {d.place.partition(".")[0] for d in found} - {"output"}
        self.time, self.state, self.resumed = values["time"], state, True
        self.written = dict(values["written"])
        prefix = "integrator/"
        own = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
        if changed <= {"backend"}:
            self.stepper.restore(own, values["integrator"])
        else:
            self.stepper.restore_counts(values["integrator"])
        if changed <= {"integrator"}:
            self.mobility.restore(values["backends"])

    # --- time ----------------------------------------------------------------------------------

    def step(self, stop: float) -> None:
        """Take one accepted step, not beyond time `stop`.

        Raises
        ------
        SimulationError
            If the state would not be finite; it is left as it was.
        """
        with self.mobility.lock:
            self._step(stop)

    def _step(self, stop: float) -> None:
        before, backends = self.stepper.history(), self.mobility.history()
        try:
            steps = self.stepper.steps
            if steps and steps % _CORRECT_EVERY == 0:  # at the first one they were just chosen
                self._correct()
            ignoring = np.errstate(over="ignore", invalid="ignore")
            with self.profile.stage("integrator"), ignoring:
                time, state = self.stepper.step(self, self.time, self.state, stop)
            self._require_sound(state)
        except BaseException as error:  # ctrl-C as well: a checkpoint is of one moment
            told = self._explained(error)
            self.stepper.restore(*before)
            if self.mobility.history() != backends:
                self.mobility.restore(backends)
                self._evaluation = None
            raise told from None
        self.time, self.state = time, state

    def _require_sound(self, state: State) -> None:
        """Refuse a step that tears a body apart: frames of it would show nothing but the tearing.

        A node is compared with the mean motion of its piece, since a whole rod may be carried far.
        """
        for part in self._parts:
            if not part.body.has_force:
                continue
            own = state.positions[part.positions] - self.state.positions[part.positions]
            length = part.body.length_scale
            if np.abs(own).max(initial=0.0) <= 0.5 * length:
                continue
            pieces = part.body.pieces()
            count = np.bincount(pieces)[:, None]
            mean = np.column_stack([np.bincount(pieces, column) for column in own.T]) / count
            distance = np.linalg.norm(own - mean[pieces], axis=1)
            node = int(np.argmax(distance))
            if distance[node] > length:
                raise SimulationError(
                    f"node {node} of {part.body.name!r} would move by "
                    f"{distance[node] / length:.3g} lengths of its body in the step "
                    f"{self._place()}"
                )

    def _explained(self, error: BaseException) -> BaseException:
        """Return what to tell the user."""
        if isinstance(error, NotFiniteError):
            return SimulationError(self._where(error.row))
        if isinstance(error, StepSizeError):
            return SimulationError(
                f"at time {self.time:g} no step is small enough for tolerance "
                f"{self.integrator.tolerance:g}; allow a larger one, or look for forces, "
                "lengths or times out of scale"
            )
        if isinstance(error, (FloatingPointError, check.FunctionError)):
            return SimulationError(f"at time {self.time:g}: {error}")
        return error

    def _correct(self) -> None:
        """Let the sums meet their tolerance again."""
        now = self.evaluate(self.time, self.state)
        with self.profile.stage("error samples"):
            if self.mobility.correct(now.points, now.loads):
                self._evaluation = None

    def _where(self, row: int) -> str:
        """Say which coordinate is not finite."""
        count = len(self.state.positions)
        for part in self._parts:
            first, last = part.positions.start, part.positions.stop
            what = "position"
            if row >= count:
                first, last = (count + i for i in (part.quaternions.start, part.quaternions.stop))
                what = "triad"
            if first <= row < last:
                return (
                    f"the {what} of node {row - first} of {part.body.name!r} is not finite "
                    f"{self._place()}"
                )
        raise AssertionError(row)

    def _node(self, row: int) -> str:
        """Name a point."""
        part = next(part for part in self._parts if part.points.start <= row < part.points.stop)
        return f"node {row - part.points.start} of {part.body.name!r}"

    def _place(self) -> str:
        """Say where the run is, and what to do about steps that are too long."""
        return (
            f"after time {self.time:g} (step {self.stepper.steps}, dt {self.stepper.taken:g}, "
            f"dt x lambda_max {self.stepper.h_lambda:.3g}); use a smaller dt, dt='auto' or "
            "the integrator 'rkc2'"
        )

    def run(
        self, t_end: float, *, max_walltime: float | None = None, renew_files: bool = False
    ) -> Simulation:
        """Go on to time `t_end`.

        Parameters
        ----------
        t_end : float
        max_walltime : float, optional
            Seconds after which the run stops in good order, before `t_end`; at least one step is
            taken.
        renew_files : bool, optional
            When an earlier run goes on: begin anew those of its files that are missing, cut short
            or of another scene, instead of refusing to go on. What was there is kept beside.

        Returns
        -------
        Simulation
            Itself.

        Raises
        ------
        SimulationError
            If the state, or what a user's function gives, would not be finite; the last good state
            is in the checkpoint. If a file of the run that goes on is missing or damaged; nothing
            is changed then.
        FileExistsError
            If the directory holds a run, or a file of a name that the run would write.
        KeyboardInterrupt
            After ctrl-C, or a signal that would end the process (SIGTERM, SIGHUP, SIGUSR1, SIGUSR2,
            SIGXCPU), with a checkpoint written, which further signals do not interrupt. A script
            goes on with ``mrs.restart(sim).run(t_end)``.
        """
        self.t_end = check.number("t_end", t_end, 0.0, 1e300)
        if t_end < self.time:
            raise ValueError(f"t_end must be at least the present time {self.time:g}, got {t_end}")
        if max_walltime is not None:
            check.number("max_walltime", max_walltime, 0.0, np.inf, low_inclusive=True)
        for tracker in self.trackers:
            if tracker.interval is not None:
                check.positive(f"{type(tracker).__name__}.interval", tracker.interval)
        with ExitStack() as stack:
            stopping = stack.enter_context(signals.stopping())
            stack.enter_context(self.profile.stage("remainder"))
            if self.output is not None:
                self._enter(self.output, renew_files, stack)
            self._run(max_walltime, stopping)
        return self

    def _enter(self, output: Output, renew_files: bool, stack: ExitStack) -> None:
        """Take the run directory."""
        directory = Path(output.directory)
        stack.enter_context(rundir.held(directory))
        files = [file for tracker in self.trackers for file in tracker.output_files(self)]
        if self.resumed:
            self._require_whole_files(directory, renew_files)
            rundir.extend(directory, self.t_end, files)
        else:
            self.written.clear()
            rundir.begin(directory, self.recipe, self.t_end, files, overwrite=output.overwrite)
            stack.callback(self._discard_unstarted, directory)

    def _discard_unstarted(self, directory: Path) -> None:
        """Leave nothing of a start that failed before its first checkpoint and frame."""
        if not self.written and not (directory / rundir.CHECKPOINT).exists():
            rundir.discard(directory)

    def _require_whole_files(self, directory: Path, renew_files: bool) -> None:
        """Look at all files before any of them is touched."""
        damaged: dict[Path, str] = {}
        for tracker in self.trackers:
            damaged |= tracker.damaged_files(self)
        if damaged and not renew_files:
            lines = [f"{path} {fault}" for path, fault in damaged.items()]
            raise SimulationError(
                f"the run cannot go on from t = {self.time:g}; nothing was changed\n  "
                + "\n  ".join(lines)
                + "\nput back what is missing or wrong, or let it begin anew from here with "
                f"`mrs resume {directory} --renew-files` (run(..., renew_files=True)); damaged "
                "files are then kept beside the new ones"
            )
        for path in damaged:
            rundir.set_aside(path)
            self.written.pop(path.name, None)

    def _run(self, max_walltime: float | None, stopping: signals.Stopping) -> None:
        begun: list[Tracker] = []
        try:
            try:
                self._go(max_walltime, begun, stopping)
            finally:
                stopping.hold()  # before anything is finalized, whatever ends the loop
        except BaseException:
            for failure in self._finalize(begun):
                warnings.warn(str(failure), stacklevel=3)
            raise
        for failure in self._finalize(begun):
            raise failure

    def _go(
        self, max_walltime: float | None, begun: list[Tracker], stopping: signals.Stopping
    ) -> None:
        """Begin with all trackers, which go to `begun`, and step until the end."""
        start = clock.monotonic()
        with self.profile.stage("output"):
            for tracker in self.trackers:
                begun.append(tracker)
                tracker.initialize(self)
        while self.time < self.t_end:
            before = self.time
            self.step(next_stop(self.trackers, before, self.t_end))
            with self.profile.stage("output"), stopping.writing():
                for tracker in self.trackers:
                    if tracker.due(before, self.time) or self.time >= self.t_end:
                        tracker.handle(self)
            if max_walltime is not None and clock.monotonic() - start >= max_walltime:
                break

    def _finalize(self, trackers: list[Tracker]) -> list[SimulationError]:
        """Let all trackers end their work; return what failed, which does not stop the others."""
        failures = []
        with self.profile.stage("output"):
            for tracker in trackers:
                try:
                    tracker.finalize(self)
                except Exception as error:
                    failure = SimulationError(f"{type(tracker).__name__}.finalize: {error}")
                    failure.__cause__ = error
                    failures.append(failure)
        self.resumed = True  # a second call goes on
        return failures


def _slices(sizes: Iterable[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]
