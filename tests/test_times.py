"""Frames at counted times: the start, the multiples of the interval, and always the end."""

import csv
import warnings
from fractions import Fraction
from math import floor
from types import SimpleNamespace

import numpy as np
import pytest

import mrs
from mrs.output.trajectory import Trajectory
from mrs.time.interrupts import next_stop


def stops(intervals, t_end, start=0.0):
    """Return the times at which a run with such interrupts stops, and which of them are due."""
    interrupts = [mrs.Interval(interval) for interval in intervals]
    times, due = [start], [[] for _ in interrupts]
    while times[-1] < t_end:
        times.append(next_stop(interrupts, times[-1], t_end))
        before, now = (mrs.Moment(time, 0, 0.0) for time in times[-2:])
        for interrupt, own in zip(interrupts, due, strict=True):
            if interrupt.due(before, SimpleNamespace(moment=now)):
                own.append(times[-1])
    return times, due


def expected(t_end, interval):
    """Return how many multiples there are up to the end, by exact arithmetic of what was typed."""
    return floor(Fraction(repr(t_end)) / Fraction(repr(interval)))


def random_times(count):
    """Return ends and intervals as people type them: some digits, often multiples."""
    rng = np.random.default_rng(0)
    for _ in range(count):
        interval = float(
            f"{rng.choice([1, 2, 3, 5, 7, 25, 0.3]) * 10.0 ** rng.integers(-4, 2):.6g}"
        )
        if rng.random() < 0.5:
            t_end = float(f"{rng.integers(1, 500) * interval:.12g}")
        else:
            t_end = float(f"{interval * rng.uniform(0.1, 200.0):.5g}")
        yield t_end, interval


def test_every_multiple_and_the_end_is_a_stop_once():
    for t_end, interval in random_times(1000):
        times, (due,) = stops([interval], t_end)
        multiples = expected(t_end, interval)
        rest = Fraction(repr(t_end)) != multiples * Fraction(repr(interval))
        assert len(times) == 1 + multiples + rest, (t_end, interval)
        assert len(due) == multiples, (t_end, interval)
        assert times[-1] == t_end
        assert min(np.diff(times)) > 1e-6 * interval, "a step that is a rounding error long"
        assert np.allclose(times[1 : 1 + multiples], interval * np.arange(1, multiples + 1), 1e-14)


@pytest.mark.parametrize("t_end", [0.3, 0.6, 1.2, 0.94, 30.0])
def test_trackers_of_several_intervals_meet_at_common_multiples(t_end):
    times, due = stops([0.1, 0.3, 0.02], t_end)
    for interval, own in zip((0.1, 0.3, 0.02), due, strict=True):
        assert len(own) == expected(t_end, interval)
    assert len(times) == 1 + len(due[2]) + len([t for t in due[0] if round(t * 50) % 5])
    assert min(np.diff(times)) > 0.019


@pytest.mark.parametrize("moment", [0.3, 0.1 + 0.2, 0.7, 1e6 + 0.1])
def test_going_on_from_a_multiple_does_not_stop_there_again(moment):
    times, (due,) = stops([0.1], moment + 0.5, start=moment)
    assert len(due) == 5
    assert min(np.diff(times)) > 0.0999


def tracer(t_end, interval, tmp_path, **options):
    """Run one tracer in shear flow and return the simulation."""
    sim = mrs.Simulation(
        mrs.Fluid(background=mrs.flows.shear(1.0)),
        [mrs.Tracers([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])],
        output=mrs.Output(tmp_path, interval, **options),
    )
    return sim.run(t_end)


def frames_and_rows(tmp_path):
    """Return the times of frames and of rows of the log."""
    with Trajectory(tmp_path / "tracers.vtkhdf") as file:
        frames, last = file.times.tolist(), file.points(-1)
    with (tmp_path / "log.csv").open() as file:
        rows = [float(row["t"]) for row in csv.DictReader(file)]
    return frames, rows, last


@pytest.mark.parametrize(
    ("t_end", "interval", "frames"),
    [(0.3, 0.1, 4), (0.6, 0.2, 4), (1.2, 0.1, 13), (0.94, 0.02, 48), (0.25, 0.1, 4), (0.3, 7.0, 2)],
)
def test_the_last_state_is_a_frame_and_a_row(tmp_path, t_end, interval, frames):
    sim = tracer(t_end, interval, tmp_path, formats=["vtkhdf", "pvd"])
    times, rows, last = frames_and_rows(tmp_path)
    assert times == rows
    assert len(times) == frames
    assert times[-1] == t_end == sim.time
    np.testing.assert_array_equal(last, sim.state.positions.astype(last.dtype))
    assert len(list((tmp_path / "tracers").glob("*.vtp"))) == frames


def test_going_on_from_an_end_keeps_the_step_size(tmp_path):
    sim = tracer(0.3, 0.1, tmp_path)
    wanted = sim.stepper.h
    sim.run(0.6)
    times, rows, _ = frames_and_rows(tmp_path)
    assert times == rows
    np.testing.assert_allclose(times, 0.1 * np.arange(7), atol=1e-15)
    assert sim.stepper.h >= wanted


class Counting(mrs.Tracker):
    """Notes when it is called."""

    def __init__(self, when):
        self.when = when
        self.times, self.ended = [], False

    def handle(self, sim):
        self.times.append(sim.time)

    def finalize(self, sim):
        self.ended = True


def circling(period=1.0, **options):
    """Return a simulation of one tracer on a circle about the origin."""
    flow = mrs.flows.QuadraticFlow(2.0 * np.pi / period * np.cross(np.eye(3), [0.0, 0.0, -1.0]))
    radius = options.pop("radius", 1.0)
    bodies = [mrs.Tracers([[radius, 0.0, 0.0]])]
    return mrs.Simulation(mrs.Fluid(background=flow), bodies, **options)


def test_a_tracker_is_called_at_its_interval_and_at_the_end():
    slow, every = Counting(mrs.Interval(0.25)), Counting(mrs.Steps())
    sim = circling(trackers=[slow, every], integrator=mrs.Integrator("rk4", dt=0.05)).run(0.6)
    assert slow.times == [0.25, 0.5, 0.6]
    assert len(every.times) == sim.stepper.steps >= 12


@pytest.mark.parametrize("interval", [0, -1.0, np.nan, "0.1"])
def test_an_interval_that_is_none_is_refused(interval):
    with pytest.raises((TypeError, ValueError), match="interval must be a number"):
        mrs.Interval(interval)


def test_a_tracker_without_an_interrupt_is_refused():
    with pytest.raises(TypeError, match=r"Counting\.when must be mrs\.Interrupt, got 0\.1"):
        circling(trackers=[Counting(0.1)]).run(0.1)


def test_trackers_are_trackers():
    with pytest.raises(TypeError, match=r"trackers\[0\] must be mrs\.Tracker"):
        circling(trackers=[print])


def test_a_finalizer_that_fails_leaves_none_out():
    class Failing(Counting):
        def finalize(self, sim):
            raise OSError("no room")

    before, after = (Counting(mrs.Interval(0.1)) for _ in range(2))
    sim = circling(trackers=[before, Failing(mrs.Interval(0.1)), after])
    with pytest.raises(mrs.SimulationError, match=r"Failing\.finalize: no room"):
        sim.run(0.2)
    assert before.ended
    assert after.ended
    assert sim.time == 0.2


def test_a_finalizer_that_fails_does_not_hide_why_a_run_stopped():
    class Failing(Counting):
        def handle(self, sim):
            raise KeyboardInterrupt

        def finalize(self, sim):
            raise OSError("no room")

    after = Counting(mrs.Interval(0.1))
    with (
        pytest.warns(UserWarning, match=r"Failing\.finalize: no room"),
        pytest.raises(KeyboardInterrupt),
    ):
        circling(trackers=[Failing(mrs.Interval(0.1)), after]).run(0.2)
    assert after.ended


@pytest.mark.parametrize("name", ["bs32", "rkc2"])
@pytest.mark.parametrize("radius", [1e-9, 1e-3, 1.0, 1e9])
def test_one_tracer_goes_round_alike_in_any_unit(name, radius):
    """A point without a length: the error of each step is judged by the way it goes."""
    integrator = mrs.Integrator(name, tolerance=1e-4)
    sim = circling(radius=radius, integrator=integrator).run(1.0)
    off = np.linalg.norm(sim.state.positions[0] / radius - [1.0, 0.0, 0.0])
    assert off < 2.0 * np.pi * 1e-4 * sim.stepper.steps**0.5
    assert sim.stepper.steps == circling(integrator=integrator).run(1.0).stepper.steps


@pytest.mark.parametrize("name", ["euler", "heun", "rk4"])
def test_steps_of_a_tracer_without_error_estimate_follow_the_flow(name):
    steps = {
        circling(radius=radius, period=period, integrator=name).run(period).stepper.steps
        for radius in (1e-6, 1.0, 1e6)
        for period in (1e-6, 1.0)
    }
    assert len(steps) == 1
    assert 60 <= steps.pop() <= 130  # a tenth of the length over which velocities change


def test_a_tracer_at_rest_at_the_origin_stays_there():
    still = mrs.Simulation(
        mrs.Fluid(background=mrs.flows.shear(1.0)), [mrs.Tracers([[0.0, 0.0, 0.0]])]
    )
    assert not still.run(1.0).state.positions.any()


def scaled_fibre(length, time):
    """Return a bent rod in shear with a tracer, in other units of length and time."""
    rod = mrs.Rods(
        mrs.geometry.helix(0.2 * length, 1.0 * length, 2.0 * length, 21),
        bending=length**4 / time,
        twisting=length**4 / time,
        shearing=100.0 * length**2 / time,
        stretching=100.0 * length**2 / time,
        intrinsic_curvature=(0.5 / length, 0.0, 0.0),
    )
    fluid = mrs.Fluid(epsilon=0.2 * length, background=mrs.flows.shear(1.0 / time))
    bodies = [rod, mrs.Tracers([[0.0, 0.0, 3.0 * length]])]
    return mrs.Simulation(fluid, bodies, forces=[mrs.Steric(4.0 * length**2 / time, 0.05 * length)])


@pytest.mark.parametrize(("length", "time"), [(2.0**-20, 1.0), (2.0**20, 2.0**-10), (1.0, 2.0**16)])
def test_a_scene_is_the_same_in_any_unit(length, time):
    """Powers of two change no digit, so that what is scaled back must be equal to the bit."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim, other = scaled_fibre(1.0, 1.0).run(0.25), scaled_fibre(length, time).run(0.25 * time)
    assert other.stepper.steps == sim.stepper.steps
    np.testing.assert_array_equal(other.state.positions / length, sim.state.positions)
    np.testing.assert_array_equal(other.state.quaternions, sim.state.quaternions)


def falling_apart(dt, **options):
    """Return a stiff rod at a step that may be beyond its limit."""
    rod = mrs.Rods(
        mrs.geometry.straight(1.0, 21),
        bending=1.0,
        twisting=1.0,
        shearing=1e4,
        stretching=1e4,
        intrinsic_curvature=(1.0, 0.0, 0.0),
    )
    integrator = mrs.Integrator("euler", dt=dt)
    return mrs.Simulation(mrs.Fluid(epsilon=0.1), [rod], integrator=integrator, **options)


@pytest.mark.filterwarnings("ignore:dt")
def test_a_run_stops_before_it_writes_a_rod_torn_apart(tmp_path):
    sim = falling_apart(2e-3, output=mrs.Output(tmp_path, 2e-3))
    with pytest.raises(mrs.SimulationError, match=r"node \d+ of 'rods' would move by .* lengths"):
        sim.run(1.0)
    extent = np.ptp(sim.state.positions, axis=0).max()
    assert extent < 3.0
    with Trajectory(tmp_path / "rods.vtkhdf") as file:
        assert len(file) > 1
        assert np.abs(file.points(-1)).max() < 3.0
        assert file.times[-1] == pytest.approx(sim.time)


def test_a_rod_that_is_carried_far_in_one_step_is_sound():
    flow = mrs.flows.QuadraticFlow(constant=[1e6, 0.0, 0.0])
    rod = mrs.Rods(
        mrs.geometry.straight(1.0, 5), bending=1e-9, twisting=1e-9, shearing=1e-9, stretching=1e-9
    )
    sim = mrs.Simulation(
        mrs.Fluid(epsilon=0.5, background=flow), [rod], integrator=mrs.Integrator("euler", dt=1.0)
    )
    sim.run(2.0)
    np.testing.assert_allclose(sim.state.positions[:, 0], 2e6)
