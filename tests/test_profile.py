"""Where the time goes, and that a scene pays for its own parts only."""

import platform
import sys
from pathlib import Path

import numpy as np
import pytest

import mrs
import treecode as tc
from mrs import profile
from treecode.traversal import acceptance, accepted
from treecode.tree import build_tree

MODULI = {"bending": 1.0, "twisting": 1.0, "shearing": 50.0, "stretching": 50.0}
EULER = mrs.Integrator("euler", dt=1e-4)


class Clock:
    """A clock that goes on by 1, 2, 3, ... at each reading; it keeps the readings."""

    def __init__(self):
        self.readings = [0]

    def perf_counter(self):
        self.readings.append(self.readings[-1] + len(self.readings))
        return self.readings[-1]


@pytest.fixture
def clock(monkeypatch):
    made_up = Clock()
    monkeypatch.setattr(profile, "time", made_up)
    return made_up


def scene(kind, **options):
    """Return swimmers, rods or tracers alone."""
    rng = np.random.default_rng(0)
    if kind == "swimmers":
        x, p = mrs.random_suspension(7, 3.0, 0.5, seed=3)
        bodies, fluid = [mrs.Swimmers(x, p, length=0.4, force=1.0)], mrs.Fluid(epsilon=0.1)
    elif kind == "rods":
        line = mrs.geometry.straight(1.0, 6)
        bodies = [mrs.Rods([line, line.moved([1.0, 0.0, 0.0])], **MODULI)]
        fluid = mrs.Fluid(epsilon=0.1)
    else:
        bodies = [mrs.Tracers(rng.uniform(-1.0, 1.0, (11, 3)))]
        fluid = mrs.Fluid(background=mrs.flows.shear(1.0))
    options = {"backend": "direct", "integrator": EULER} | options
    return mrs.Simulation(fluid, bodies, **options)


def test_time_in_a_stage_within_another_is_the_inner_ones(clock):
    """Between readings 1, 2, ... pass 1, 2, 3, ... units of time."""
    kept = profile.Profile()
    with kept.stage("output"):  # reading 1
        with kept.stage("sums"):  # 2
            kept.divide({"near": 2.5, "far": 0.25}, 10, 20)  # 3
        with kept.stage("forces"), pytest.raises(KeyError), kept.stage("sums"):  # 4; 5, 6
            raise KeyError  # 7; 8
    seconds = {row.stage: row.seconds for row in kept.rows()}  # 9
    sums = (3 - 2.5 - 0.25) + 4 + 7
    expected = {"near": 2.5, "far": 0.25, "sums": sums, "forces": 6 + 8, "output": 2 + 5 + 9}
    assert seconds == expected
    assert kept.pairs == {"near": 10, "far": 20}


@pytest.mark.parametrize("kind", ["swimmers", "rods", "tracers"])
def test_stages_add_up_to_the_run(kind, clock, tmp_path):
    """To all the time between the first and the last reading of the clock, output included."""
    sim = scene(kind, output=mrs.Output(tmp_path / "run", 1e-3)).run(2e-3)
    readings = clock.readings[1:]
    assert len(readings) > 100
    total = sum(row.seconds for row in sim.profile.rows())
    # What treecode measures by the true clock moves between stages, and adds up to nothing.
    assert total == pytest.approx(readings[-1] - readings[0], rel=1e-12)


def test_rows_are_named_and_in_order(tmp_path):
    sim = scene("rods", output=mrs.Output(tmp_path / "run", 1e-3)).run(1e-3)
    rows = sim.profile.rows()
    names = [row.stage for row in rows]
    assert names == [name for name in profile.STAGES if name in names]
    assert set(sim.profile.seconds) <= set(profile.STAGES)
    table = str(sim.profile).splitlines()
    assert [line.split(" | ")[0].removeprefix("| ") for line in table[2:-1]] == names
    lines = sim.profile.csv().splitlines()
    assert [line.split(",")[0] for line in lines] == ["stage", *names]
    assert all(row.seconds > -1e-6 for row in rows)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="no counter of cycles")
@pytest.mark.parametrize("backend", ["direct", "kitc", "taylor"])
def test_a_walk_is_divided_into_near_and_far(backend):
    """As pairs are: there is time in a part if and only if there are pairs in it."""
    points = np.random.default_rng(0).random((2000, 3))
    plan = tc.Plan(tc.RegularizedStokeslet(0.01), backend, degree=2, leaf_size=50)
    plan.set_points(points).execute(points)
    info = plan.info()
    assert set(info["seconds"]) == {"tree", "weights", "near", "far", "walk"}
    assert min(info["seconds"].values()) >= 0.0
    assert (info["seconds"]["near"] > 0.0) == (info["near_pairs"] > 0)
    assert (info["seconds"]["far"] > 0.0) == (info["far_pairs"] > 0)
    assert (info["far_pairs"] == 0) == (backend == "direct")


# kind, points, columns of loads, pairs in an evaluation
ALONE = [("swimmers", 14, 3, 14**2), ("rods", 12, 6, 12**2), ("tracers", 11, 3, 0)]


@pytest.mark.parametrize(("kind", "points", "columns", "pairs"), ALONE)
def test_pairs_of_scenes_alone(kind, points, columns, pairs):
    """Of all evaluations but the first, which is apart: it compiles."""
    sim = scene(kind).run(5e-4)
    assert sim.now.loads.shape == (points, columns)
    again = sim.mobility.evaluations - 1
    assert again >= 5
    assert sim.profile.pairs.get("near", 0) == again * pairs
    assert sim.profile.pairs.get("far", 0) == 0


# Python files that a step goes through, of those that belong to some scenes only
PARTS = {
    "bodies/rods.py", "bodies/swimmers.py", "bodies/tracers.py", "forces/steric.py",
    "fluid/flows.py", "treecode/plan.py",
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "own"),
    [
        ("swimmers", {"bodies/swimmers.py", "treecode/plan.py"}),
        ("rods", {"bodies/rods.py", "treecode/plan.py"}),
        ("tracers", {"bodies/tracers.py", "fluid/flows.py"}),
    ],
)
def test_a_step_goes_through_its_own_parts_only(kind, own):
    sim = scene(kind)
    sim.step(1e-4)
    visited = set()

    def note(frame, event, argument):
        visited.add("/".join(Path(frame.f_code.co_filename).parts[-2:]))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        sim.step(2e-4)
    finally:
        sys.setprofile(before)
    assert visited & PARTS == own


@pytest.mark.parametrize("shift", [0.0, 5.0])
@pytest.mark.parametrize("theta", [0.3, 0.7])
def test_no_cluster_that_a_target_accepts_goes_without_an_expansion(theta, shift):
    """Which targets accept which clusters is tried for each pair of them."""
    rng = np.random.default_rng(0)
    sources, targets = rng.random((3, 500)), rng.random((3, 300)) + shift
    tree, _ = build_tree(sources, 20, shrink=False)
    around, _ = build_tree(targets, 512, shrink=False)
    distance2 = acceptance(tree, theta)
    away2 = ((targets[:, None, :] - tree.center[:, :, None]) ** 2).sum(axis=0)
    needed = (away2 >= distance2[:, None]).any(axis=1)
    kept = accepted(tree, distance2, around)
    assert kept[needed].all()
    assert kept[0] == (shift == 5.0)
