"""A scene that is run: time, files, trackers."""

from __future__ import annotations

import time as clock
import warnings
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mrs import check
from mrs.bodies import Body
from mrs.describe import described, differences
from mrs.fluid import Backend, Fluid, Mobility
from mrs.forces import Force
from mrs.output import run_directory
from mrs.output.options import Output
from mrs.output.trackers import Tracker
from mrs.profile import Profile
from mrs.run import signals
from mrs.run.failures import SimulationError, explained, require_whole, require_whole_files
from mrs.scene import Evaluation, Scene
from mrs.time.interrupts import Interrupt, Moment, next_stop
from mrs.time.state import Arrays, State, below
from mrs.time.stepper import Integrator, Stepper
from mrs.time.system import System, Watched
from treecode.blas import blas_of_one_thread
from treecode.ranks import OneRank
from treecode.shown import Shown

if TYPE_CHECKING:
    from mrs.output.inline import Picture

_CORRECT_EVERY = 50  # steps, after which the error of the sums is sampled
_INTEGRATOR = "integrator/"  # before the names of the stepper's arrays
_SCENE = "scene/"  # before the names of the scene's arrays
_NUMERICS = ("backend", "integrator", "output")  # of a description; the rest is physics
_WRITING = ("interval", "checkpoint_seconds", "formats", "columns")
# Of the options of a scenario.
_SAID_ELSEWHERE = ("t_end", "backend", "integrator", "plugins", "observables", *_WRITING)


@check.spelling
class Simulation(Shown):
    """Bodies in a viscous fluid, and their motion in time.

    Parameters
    ----------
    fluid : Fluid
    bodies : sequence of Body
        `Rods`, `Swimmers`, `Tracers`, in any number; their names must differ.
    forces : sequence of Force, optional
        Besides those of the bodies: `Steric`, `Gravity`, `Springs`, `UserForce`, your own.
    backend : str or Backend, optional
        How velocities are summed.
    integrator : str or Integrator, optional
        How time is stepped.
    output : Output, optional
        Run directory; nothing is written without.
    trackers : sequence of Tracker, optional
        Your own, besides the trackers of `output`.
    recipe : dict, optional
        Scenario and options, kept in config.toml, from which `mrs.resume` builds it again.
    comm : mpi4py.MPI.Comm, optional
        Ranks of MPI that share the sums. All of them build the same simulation and make the same
        calls; rank 0 writes files and calls trackers. See docs/mpi.md.

    Attributes
    ----------
    scene : Scene
        The physics.
    time : float
    state : State
        Positions and quaternions of all bodies.
    stepper : Stepper
    moment : Moment
        Time, steps and seconds of the last step.

    Raises
    ------
    ValueError, TypeError
        The message names the argument and the allowed values.

    Examples
    --------
    >>> import mrs
    >>> pusher = mrs.Swimmers([[0, 0, 0]], [[0, 0, 1]], length=1.0, force=1.0, epsilon=0.1)
    >>> sim = mrs.Simulation(mrs.Fluid(viscosity=1.0), [pusher]).run(1.0)
    >>> print(sim.state.positions.round(3))  # its speed is (1/0.1 - 1/sqrt(1.01)) / (4 pi)
    [[0.    0.    0.717]]
    """

    def __init__(
        self,
        fluid: Fluid,
        bodies: Sequence[Body],
        *,
        forces: Sequence[Force] = (),
        backend: str | Backend = "auto",
        integrator: str | Integrator = "auto",
        output: Output | None = None,
        trackers: Iterable[Tracker] = (),
        recipe: dict[str, Any] | None = None,
        comm: Any = None,
    ) -> None:
        check.instance("fluid", fluid, Fluid)
        bodies = check.instances("bodies", bodies, Body)
        forces = check.instances("forces", forces, Force)
        if not isinstance(backend, Backend):
            backend = Backend(check.one_of("backend", backend, Backend.names()))
        if not isinstance(integrator, Integrator):
            integrator = Integrator(check.one_of("integrator", integrator, Integrator.names()))
        self.integrator = integrator
        self.output = check.instance("output", output, Output, type(None))
        trackers = check.instances("trackers", trackers, Tracker)
        self.recipe = recipe
        self.scene: Scene = Scene(fluid, bodies, forces, backend, comm)
        self.time: float = 0.0
        self.state: State = self.scene.layout.initial
        self.stepper: Stepper = Stepper(integrator, self.scene.longest_step)
        self.moment: Moment = Moment(0.0, 0, 0.0)
        self._corrected = 0  # steps after which the error of the sums was sampled
        self.trackers = [*([] if output is None else output.trackers(self)), *trackers]
        self.resumed = False
        self.written: dict[str, list[float]] = {}  # the last two times in each file of the run

    @property
    def fluid(self) -> Fluid:
        """The fluid of the scene."""
        return self.scene.fluid

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies of the scene."""
        return self.scene.bodies

    @property
    def backend(self) -> Backend:
        """How velocities are summed."""
        return self.scene.backend

    @property
    def mobility(self) -> Mobility:
        """The sums of the scene."""
        return self.scene.mobility

    @property
    def profile(self) -> Profile:
        """Where the time has gone; print it."""
        return self.scene.profile

    @property
    def ranks(self) -> OneRank:
        """The processes that share the sums."""
        return self.scene.ranks

    @property
    def now(self) -> Evaluation:
        """All that follows from the present state; it is computed once."""
        return self.scene.evaluate(self.time, self.state)

    def energy(self) -> float:
        """Return the elastic energy of all bodies and of the springs between them."""
        return self.scene.energy(self.time, self.state)

    def body_state(self, body: Body) -> State:
        """Return the positions and quaternions of one body."""
        return self.scene.layout.part(body).state(self.state)

    def velocity(self, points: ArrayLike) -> np.ndarray:
        """Return the velocity of the fluid at points, (N, 3).

        Its relative error over these points is the tolerance of the backend, of the motion that
        bodies cause there; see `Mobility.velocity`.

        Parameters
        ----------
        points : (N, 3) array_like

        Raises
        ------
        ValueError
            If a point is not in the fluid: there is no flow behind a wall.
        """
        return self.scene.velocity(check.points("points", points), self.now)

    def frame(self, body: Body) -> tuple[np.ndarray, Arrays, Arrays]:
        """Return the content of a frame of one body: points, arrays at points and at cells."""
        return self.scene.frame(body, self.now)

    def show(self, **options: Any) -> Picture:
        """Return a picture of the present state, which a notebook shows.

        Parameters
        ----------
        **options
            Those of `mrs.output.render.render` for a picture, such as `color_by` and `camera`.
        """
        from mrs.output.inline import picture_now

        return picture_now(self, **options)

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the rest of the run depends on: arrays, and values that JSON can hold."""
        arrays, history = self.stepper.history()
        arrays = {_INTEGRATOR + name: array for name, array in arrays.items()}
        of_scene, evaluation = self.scene.history()
        arrays |= {_SCENE + name: array for name, array in of_scene.items()}
        values = {
            "time": self.time,
            "integrator": history,
            "evaluation": evaluation,
            "written": dict(self.written),
            "corrected": self._corrected,
            "scene": self.description,
        }
        return arrays | self.state._asdict(), values

    @cached_property
    def description(self) -> dict[str, Any]:
        """The scene, its numerics and its output as plain values."""
        options = (self.recipe or {}).get("options", {})
        written = () if self.output is None else _WRITING
        return described(
            {
                "options": {k: v for k, v in options.items() if k not in _SAID_ELSEWHERE},
                "fluid": self.fluid,
                "bodies": {body.name: body.parameters() for body in self.bodies},
                "order": [body.name for body in self.bodies],
                "forces": list(self.scene.forces),
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
            Whether fluid, bodies or forces may differ from the snapshot.

        Raises
        ------
        ValueError
            If it is of another number of points; or of another fluid, other bodies or other
            forces, without `changes`. The message names each difference.

        Warns
        -----
        UserWarning
            Of each difference that is accepted: in the physics, backend, integrator and output.

        Notes
        -----
        Another backend chooses its sums anew, another integrator its step size, other physics both.
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
        self._corrected = values["corrected"]
        if changed <= {"backend"}:
            self.stepper.restore(below(arrays, _INTEGRATOR), values["integrator"])
        else:
            self.stepper.restore_counts(values["integrator"])
        if changed <= {"integrator"}:
            self.scene.restore(below(arrays, _SCENE), values["evaluation"])

    def shown(self) -> dict[str, Any]:
        reached = {"t": f"{self.time:g}", "steps": self.stepper.steps}
        names = " ".join(body.name for body in self.bodies)
        scene = {"bodies": names, "points": self.scene.layout.count}
        numerics = {"backend": self.backend.name, "integrator": self.integrator.name}
        return reached | scene | numerics | {"output": self.output and self.output.directory}

    def step(self, stop: float) -> None:
        """Take one accepted step, not beyond time `stop`.

        Raises
        ------
        SimulationError
            If the state would not be finite; it is left as it was.
        """
        self._step(self.scene, stop)

    def _step(self, system: System, stop: float, end: float | None = None) -> None:
        with self.mobility.lock:
            self._advance(system, stop, end)

    def _advance(self, system: System, stop: float, end: float | None) -> None:
        before, of_scene = self.stepper.history(), self.scene.history()
        try:
            steps = self.stepper.steps
            if steps >= self._corrected + _CORRECT_EVERY:
                self.scene.correct(self.time, self.state)
                self._corrected = steps - steps % _CORRECT_EVERY
            ignoring = np.errstate(over="ignore", invalid="ignore")
            # With more threads of BLAS bits would depend on their number.
            with self.profile.stage("integrator"), ignoring, blas_of_one_thread:
                time, state = self.stepper.step(system, self.time, self.state, stop, end)
            require_whole(self, state)
            state = self.scene.kicked(time, state, self.stepper.taken, self.stepper.steps)
        except BaseException as error:  # ctrl-C as well: a checkpoint is of one moment
            told = explained(self, error)
            self.stepper.restore(*before)
            if self.scene.history()[1] != of_scene[1]:
                self.scene.restore(*of_scene)
            raise told from None
        self.time, self.state = time, state

    def run(
        self, t_end: float, *, max_walltime: float | None = None, renew_files: bool = False
    ) -> Simulation:
        """Go on to time `t_end`.

        Parameters
        ----------
        t_end : float
        max_walltime : float, optional
            Seconds after which the run stops in good order, before `t_end`, after a step or more.
        renew_files : bool, optional
            For a resumed run: begin a new file in place of each that is missing, cut short or of
            another scene, instead of refusing to go on. The old files are kept beside the new.

        Returns
        -------
        Simulation
            Itself.

        Raises
        ------
        SimulationError
            If the state, or a user's function, would not be finite: the last good state is in the
            checkpoint. If a file of a resumed run is missing or damaged: nothing is changed.
        FileExistsError
            If the directory holds a run, or a file of a name that the run would write.
        KeyboardInterrupt
            After ctrl-C, or another signal that ends runs (docs/running.md), with a checkpoint. A
            script goes on with ``mrs.restart(sim).run(t_end)``.
        """
        self.t_end = check.number("t_end", t_end, 0.0, 1e300)
        if t_end < self.time:
            raise ValueError(f"t_end must be at least the present time {self.time:g}, got {t_end}")
        if max_walltime is not None:
            check.number("max_walltime", max_walltime, 0.0, np.inf, low_inclusive=True)
        for tracker in self.trackers:
            check.instance(f"{type(tracker).__name__}.when", tracker.when, Interrupt)
        with ExitStack() as stack:
            stopping = stack.enter_context(signals.stopping(self.ranks))
            stack.enter_context(self.profile.stage("remainder"))
            if self.output is not None:
                self.ranks.lead(self.scene, partial(self._enter, self.output, renew_files, stack))
            self._run(max_walltime, stopping)
        return self

    def _enter(self, output: Output, renew_files: bool, stack: ExitStack) -> None:
        """Take the run directory."""
        directory = Path(output.directory)
        stack.enter_context(run_directory.held(directory))
        files = [file for tracker in self.trackers for file in tracker.output_files(self)]
        if self.resumed:
            require_whole_files(self, directory, renew_files)
            run_directory.extend(directory, self.t_end, files)
        else:
            self.written.clear()
            run_directory.begin(
                directory, self.recipe, self.t_end, files, overwrite=output.overwrite
            )
            stack.callback(self._discard_unstarted, directory)

    def _discard_unstarted(self, directory: Path) -> None:
        """Leave nothing of a start that failed before its first checkpoint and frame."""
        if not self.written and not (directory / run_directory.CHECKPOINT).exists():
            run_directory.discard(directory)

    def _run(self, max_walltime: float | None, stopping: signals.Stopping) -> None:
        begun: list[Tracker] = []
        try:
            try:
                with self.ranks.together():
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

        def seconds() -> float:
            return self.ranks.first(clock.monotonic() - start)

        self.moment = Moment(self.time, self.stepper.steps, 0.0)
        with self.profile.stage("output"):
            self.ranks.lead(self.scene, partial(self._initialize, begun))
        interrupts = [tracker.when for tracker in self.trackers]
        system = Watched(self.scene, stopping.check)
        while self.time < self.t_end:
            before = self.moment
            end = None if self.scene.layout.noisy else self.t_end
            self._step(system, next_stop(interrupts, self.time, self.t_end), end)
            self.moment = Moment(self.time, self.stepper.steps, seconds())
            with self.profile.stage("output"):
                self.ranks.lead(self.scene, partial(self._handle, before))
            stopping.check()
            if max_walltime is not None and seconds() >= max_walltime:
                break

    def _initialize(self, begun: list[Tracker]) -> None:
        for tracker in self.trackers:
            begun.append(tracker)
            tracker.initialize(self)

    def _handle(self, before: Moment) -> None:
        for tracker in self.trackers:
            if self.time >= self.t_end or tracker.when.due(before, self):
                tracker.handle(self)

    def _finalize(self, trackers: list[Tracker]) -> list[SimulationError]:
        """Let all trackers end their work; return the failures, which do not stop the others."""

        def finalize() -> list[SimulationError]:
            failures = []
            for tracker in trackers:
                try:
                    tracker.finalize(self)
                except Exception as error:
                    failure = SimulationError(f"{type(tracker).__name__}.finalize: {error}")
                    failure.__cause__ = error
                    failures.append(failure)
            return failures

        with self.profile.stage("output"):
            failures = self.ranks.lead(self.scene, finalize)
        self.resumed = True  # a second call goes on
        return failures
