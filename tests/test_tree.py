"""The tree keeps its promises for any points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treecode.tree import build_tree


def point_sets():
    rng = np.random.default_rng(0)
    spread = rng.random((300, 3))
    clumps = np.concatenate([spread, spread + 1e8])
    geometric = 2.0 ** -np.arange(60)[:, None] * np.ones(3)
    return {
        "cube": spread,
        "slab": spread * [8.0, 8.0, 1.0],
        "plane": spread * [1.0, 1.0, 0.0],
        "line": spread * [0.0, 1.0, 0.0],
        "equal": np.ones((300, 3)),
        "clumps": clumps,
        "lattice": np.stack(np.meshgrid(*[np.arange(7.0)] * 3), -1).reshape(-1, 3),
        "geometric": geometric,
        "neighbours": 1.0 + np.arange(200)[:, None] * [np.finfo(float).eps] * np.ones(3),
        "tiny": spread * 1e-60,
        "huge": spread * 1e60,
        "smallest doubles": np.round(4 * spread - 2) * 5e-324,
        "one": spread[:1],
        "none": spread[:0],
    }


SETS = point_sets()


def check_tree(points, leaf_size, shrink):
    """Every promise of the docstring of `build_tree`."""
    sorted_points = np.ascontiguousarray(points.T)
    tree, order = build_tree(sorted_points, leaf_size, shrink)
    assert np.array_equal(np.sort(order), np.arange(len(points)))
    assert np.array_equal(sorted_points, points.T[:, order])
    leaves = tree.children == 0
    # Leaves cover every point once.
    covered = np.sort(
        np.concatenate(
            [np.arange(a, b) for a, b in zip(tree.start[leaves], tree.stop[leaves], strict=True)]
            or [np.arange(0)]
        )
    )
    assert np.array_equal(covered, np.arange(len(points)))
    assert len(tree.radius) <= max(0, 2 * leaves.sum() - 1)
    for c in range(len(tree.radius)):
        inside = sorted_points[:, tree.start[c] : tree.stop[c]]
        scale = np.abs(tree.center[:, c]) + tree.half[:, c]
        reach = np.abs(inside - tree.center[:, c, None]).max(axis=1)
        assert np.all(reach <= tree.half[:, c] + 4e-16 * scale + 5e-324)  # half of that is zero
        assert tree.radius[c] == pytest.approx(np.linalg.norm(tree.half[:, c]), rel=1e-14)
        if shrink:
            assert np.allclose(reach, tree.half[:, c], rtol=1e-9, atol=4e-16 * scale.max() + 5e-324)
        if leaves[c]:
            same_place = np.all(inside == inside[:, :1])
            assert tree.stop[c] - tree.start[c] <= leaf_size or same_place
        else:
            kids = np.arange(tree.child[c], tree.child[c] + tree.children[c])
            assert tree.children[c] in range(2, 9)
            assert tree.start[kids[0]] == tree.start[c]
            assert tree.stop[kids[-1]] == tree.stop[c]
            assert np.array_equal(tree.start[kids[1:]], tree.stop[kids[:-1]])
            assert np.all(tree.level[kids] == tree.level[c] + 1)
    return tree


@pytest.mark.interpreted
@pytest.mark.parametrize("shrink", [False, True], ids=["bisected", "shrunk"])
@pytest.mark.parametrize("leaf_size", [1, 7, 1000])
@pytest.mark.parametrize("name", SETS)
def test_promises(name, leaf_size, shrink):
    points = SETS[name] if leaf_size > 1 else SETS[name][:70]
    check_tree(points, leaf_size, shrink)


@pytest.mark.interpreted
def test_only_long_sides_are_bisected():
    """K section 6: sides longer than the longest over sqrt(2); the slab's first split is 2 x 2."""
    tree = check_tree(SETS["slab"], 100, False)
    assert tree.children[0] == 4
    longest, shortest = 2 * tree.half.max(axis=0), 2 * tree.half.min(axis=0)
    assert np.all(shortest[tree.level == 3] > longest[tree.level == 3] / 4)


def test_depth_is_bounded_for_adversarial_clustering():
    """Points at 2^-1, 2^-2, ..., 2^-60: one level each at most, whatever the empty space."""
    tree = check_tree(SETS["geometric"], 1, False)
    assert tree.depth <= 59
    clumps = check_tree(SETS["clumps"], 8, False)
    assert clumps.depth <= 8  # the 27 bisections that separate nothing are not levels


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_promises_of_random_sets(data):
    coordinate = st.floats(-1e60, 1e60) | st.sampled_from([0.0, 1.0, 1e-300, -1e60])
    rows = data.draw(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=30))
    points = np.array(rows, float).reshape(-1, 3)
    check_tree(points, data.draw(st.integers(1, 10)), data.draw(st.booleans()))
