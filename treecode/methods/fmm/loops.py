"""What the fast multipole method does to numbers: loops over points and cubes, one thread each."""

from __future__ import annotations

from typing import Any

import numpy as np

from treecode._jit import Driver, compiled, inlined, wide_vectors
from treecode._lanes import EIGHT, lane_count, load, load_eight, store, store_eight
from treecode.methods.fmm.octree import cell_at
from treecode.methods.fmm.symmetry import find_units
from treecode.pairs import accumulate, accumulate_row

_TOGETHER = 64  # boxes of one product: with 16 or 32 K example 1 is a tenth slower


@inlined
def _legendre(x, values):
    """Write the orthonormal Legendre polynomials at `x`."""
    degree = len(values)
    below, here = 0.0, 1.0
    for k in range(degree):
        values[k] = here * np.sqrt(k + 0.5)
        below, here = here, ((2 * k + 1) * x * here - k * below) / (k + 1)


@inlined
def _products(y, z, polynomials, out):
    """Write the products of polynomials in y and z, those in z running fastest."""
    degree = len(polynomials)
    _legendre(z, polynomials)
    for k in range(degree):
        out[k] = polynomials[k]
    _legendre(y, polynomials)
    for k in range(degree - 1, -1, -1):  # the first row is read until it is replaced
        factor = polynomials[k]
        for j in range(degree):
            out[k * degree + j] = factor * out[j]


@inlined
def _basis(points, i, center, scale, polynomials, products):
    """Write the polynomials in x, and the products of those in y and z, at a point of a cube."""
    y, z = (points[1, i] - center[1]) * scale, (points[2, i] - center[2]) * scale
    _products(y, z, polynomials, products)
    _legendre((points[0, i] - center[0]) * scale, polynomials)


@compiled
def expand_points(points, weights, ranges, centers, half, out):
    """Write the Legendre coefficients of the weights in some cubes (P2M).

    Parameters
    ----------
    points, weights : (3, N) and (channels, N) float64
    ranges : (n, 2) int64
    centers : (n, 3) float64
    half : float
    out : (n, channels, degree, degree^2) float32 or float64
        Overwritten.
    """
    wide_vectors()
    degree = out.shape[2]
    polynomials = np.empty(degree, out.dtype)
    products = np.empty(degree * degree, out.dtype)
    scale = 1.0 / half
    for box in range(len(ranges)):
        sums = out[box]
        for c in range(sums.shape[0]):
            for k in range(degree):
                for j in range(degree * degree):
                    sums[c, k, j] = 0.0
        for i in range(ranges[box, 0], ranges[box, 1]):
            _basis(points, i, centers[box], scale, polynomials, products)
            for c in range(sums.shape[0]):
                weight = weights[c, i]
                for k in range(degree):
                    factor = out.dtype.type(weight * polynomials[k])
                    row = sums[c, k]
                    for j in range(degree * degree):
                        row[j] += factor * products[j]


@compiled
def evaluate_points(coefficients, points, ranges, centers, half, order, values):
    """Add Legendre expansions at the points in some cubes (L2P).

    Parameters
    ----------
    coefficients : (n, channels, degree, degree^2) float32 or float64
    points : (3, M) float64
    ranges, centers, half :
        As for `expand_points`.
    order : (M,) int64
        Row of `values` for each point.
    values : (M, channels) float64
    """
    wide_vectors()
    degree = coefficients.shape[2]
    polynomials = np.empty(degree, coefficients.dtype)
    products = np.empty(degree * degree, coefficients.dtype)
    sums = np.empty(degree * degree, coefficients.dtype)
    scale = 1.0 / half
    for box in range(len(ranges)):
        for i in range(ranges[box, 0], ranges[box, 1]):
            _basis(points, i, centers[box], scale, polynomials, products)
            for c in range(coefficients.shape[1]):
                for j in range(degree * degree):
                    sums[j] = polynomials[0] * coefficients[box, c, 0, j]
                for k in range(1, degree):
                    factor = polynomials[k]
                    row = coefficients[box, c, k]
                    for j in range(degree * degree):
                        sums[j] += factor * row[j]
                total = sums[0] * products[0]
                for j in range(1, degree * degree):
                    total += sums[j] * products[j]
                values[order[i], c] += total


@inlined
def _mirror_images(tree, box, offset, first, stop, images, out):
    """Write where the mirror images of an offset lie, seen from a box; return if anywhere.

    They are rows among the boxes of the level, the number of those where there is no source. Bit b
    of the image mirrors the b-th direction in which the offset is not zero.
    """
    found = False
    for image in range(images):
        dx, dy, dz = offset[0], offset[1], offset[2]
        bits = image
        if dx > 0:
            dx *= 1 - 2 * (bits & 1)
            bits >>= 1
        if dy > 0:
            dy *= 1 - 2 * (bits & 1)
            bits >>= 1
        if dz > 0:
            dz *= 1 - 2 * (bits & 1)
        # A target at +t from the source sees the source at -t.
        source = cell_at(
            tree.octant[box], -dx, -dy, -dz, tree.parent[box], tree.neighbour, tree.child
        )
        if source >= 0 and tree.source[source, 1] > tree.source[source, 0]:
            found = True
            out[image] = source - first
        else:
            out[image] = stop - first
    return found


@inlined
def _nonzero(offset):
    """Return the directions in which an offset is not zero, in bits, and its mirror images."""
    mask, images = 0, 1
    for d in range(3):
        if offset[d] > 0:
            mask |= 1 << d
            images *= 2
    return mask, images


@compiled
def has_far_sources(tree, boxes, offsets):
    """Tell whether anything acts on some boxes of one level by translations."""
    out = np.empty(8, np.int64)
    for box in boxes:
        level = tree.level[box]
        first, stop = tree.first[level], tree.first[level + 1]
        for offset in offsets:
            if _mirror_images(tree, box, offset, first, stop, _nonzero(offset)[1], out):
                return True
    return False


@inlined
def _spread_bits(bits, mask):
    """Put the bits of `bits` where `mask` has ones."""
    out = 0
    for d in range(3):
        if mask >> d & 1:
            out |= (bits & 1) << d
            bits >>= 1
    return out


@inlined
def _split(rows, a, b, change_a, change_b, used, place, out, at):
    """Write the sums of two rows, and the differences, to what each class of values needs."""
    m = rows.shape[1] // 8
    for q in range(8):
        p, r = q ^ change_a, q ^ change_b
        for j in range(0, used, EIGHT):
            x, y = load_eight(rows, a, q * m + j), load_eight(rows, b, q * m + j)
            store_eight(out, p, at + place[p, q] + j, x + y)
            store_eight(out, r, at + place[r, q] + j, x - y)


@inlined
def _combine(expansions, sources, images, used, place, change, rows, out, at):
    """Combine mirror images to what each class of values needs: sums and differences of rows."""
    if images == 2:
        _split(expansions, sources[0], sources[1], 0, change[1], used, place, out, at)
        return
    lanes = lane_count(expansions)
    for image in range(0, images, 2):
        a, b = sources[image], sources[image + 1]
        for j in range(0, expansions.shape[1], lanes):
            x, y = load(expansions, a, j), load(expansions, b, j)
            store(rows, image, j, x + y)
            store(rows, image + 1, j, x - y)
    if images == 8:
        for image in (0, 1, 4, 5):
            for j in range(0, expansions.shape[1], lanes):
                x, y = load(rows, image, j), load(rows, image + 2, j)
                store(rows, image, j, x + y)
                store(rows, image + 2, j, x - y)
    half = images // 2
    for image in range(half):
        b = image + half
        _split(rows, image, b, change[image], change[b], used, place, out, at)


@compiled
def translate(tree, boxes, offsets, matrices, begin, used, expansions, out, pairs):
    """Add what cubes of the same size do in some boxes of one level (M2L).

    For each offset the sources are combined by classes, for some boxes at a time that stay near the
    processor, and multiplied.

    Parameters
    ----------
    tree : Octree
    boxes : (n,) int64
    offsets : (T, 3) int64
    matrices, begin, used :
        See `operators.Level`.
    expansions : (boxes of the level + 1, 8 * m) float32 or float64
        The last row is zero.
    out : (boxes of the level, 8, m) float32 or float64
    pairs : (n,) int64
        Overwritten: offsets that each box has sources at.
    """
    wide_vectors()
    level = tree.level[boxes[0]]
    first, stop = tree.first[level], tree.first[level + 1]
    size = expansions.shape[1]
    rows = np.empty((8, size), expansions.dtype)
    combined = np.empty(8 * _TOGETHER * size, expansions.dtype)
    products = np.empty(_TOGETHER * (size // 8), expansions.dtype)
    sources, columns = np.empty(8, np.int64), np.empty(_TOGETHER, np.int64)
    place, change = np.empty((8, 8), np.int64), np.empty(8, np.int64)
    for i in range(len(pairs)):
        pairs[i] = 0
    for t in range(len(offsets)):
        mask, images = _nonzero(offsets[t])
        depth = images * used[t]
        matrix = matrices[begin[t] : begin[t + 1]].reshape((8, depth, used[t]))
        left = combined[: 8 * _TOGETHER * depth].reshape((8, _TOGETHER * depth))
        for p in range(8):
            meetings = 0
            for q in range(8):
                place[p, q] = meetings * used[t]  # of class q among those that meet p
                meetings += (p ^ q) & ~mask == 0
        for image in range(images):
            change[image] = _spread_bits(image, mask)
        count = 0
        for i in range(len(boxes)):
            if _mirror_images(tree, boxes[i], offsets[t], first, stop, images, sources):
                at = count * depth
                _combine(expansions, sources, images, used[t], place, change, rows, left, at)
                columns[count] = boxes[i] - first
                pairs[i] += 1
                count += 1
            if count == _TOGETHER or (count and i == len(boxes) - 1):
                product = products[: count * used[t]].reshape((count, used[t]))
                for p in range(8):
                    np.dot(left[p, : count * depth].reshape((count, depth)), matrix[p], product)
                    for k in range(count):
                        row = out[columns[k]]
                        for j in range(0, used[t], EIGHT):
                            total = load_eight(row, p, j) + load_eight(product, k, j)
                            store_eight(row, p, j, total)
                count = 0


@inlined
def _gather(points, weights, low, high, shift, at, near, near_weights):
    for i in range(low, high):
        for d in range(3):
            near[d, at] = points[d, i] - shift[d]
        for c in range(weights.shape[0]):
            near_weights[c, at] = weights[c, i]
        at += 1
    return at


@Driver
def near_field(
    kernel, points, weights, source, nodes, node_weights, middles, slot, begin, entries, targets,
    ranges, centers, order, like, values, pairs,
):  # fmt: skip
    """Sum over the neighbours of some leaves.

    Parameters
    ----------
    kernel : Kernel
    points, weights : (3, N) and (weight_size, N) float64
        Sources.
    source : (B, 2) int64
        Sources of each box.
    nodes : (slots, 3, n) float64
        Points that stand for the expansion of a box, seen from its centre.
    node_weights : (slots, weight_size, n) float64
    middles : (slots, 3) float64
        Centres of those boxes.
    slot : (B,) int64
        Of each box in `nodes`.
    begin, entries : int64 arrays
        Boxes that act on each leaf, see `lists.direct_lists`.
    targets : (3, M) float64
    ranges : (n, 2) int64
        Of the targets of each leaf.
    centers : (n, 3) float64
    order : (M,) int64
        Row of `values` for each target.
    like : (0,) array
        Of the precision of the arithmetic. Doubles keep the coordinates as they are, so that the
        closest points stay apart; singles are relative to the leaf's centre.
    values : (M, value_size) float64
        Overwritten.
    pairs : (n,) int64
        Overwritten.
    """
    lanes = lane_count(like)
    zero_shift = np.zeros(3)
    for leaf in range(len(ranges)):
        low, high = ranges[leaf, 0], ranges[leaf, 1]
        count = 0
        stand_ins = 0
        for k in range(begin[leaf], begin[leaf + 1]):
            box = entries[k]
            if box >= 0:
                count += source[box, 1] - source[box, 0]
            else:
                stand_ins += nodes.shape[2]
        out = np.zeros((values.shape[1], high - low))
        block = np.empty((3, high - low), like.dtype)
        near = np.zeros((3, max(count, stand_ins) + lanes), like.dtype)
        near_weights = np.zeros((weights.shape[0], max(count, stand_ins) + lanes), like.dtype)
        for proxy in range(2):
            total = stand_ins if proxy else count
            if total == 0:
                continue
            shift = centers[leaf] if proxy or like.itemsize == 4 else zero_shift
            at = 0
            for k in range(begin[leaf], begin[leaf + 1]):
                box = entries[k]
                if proxy and box < 0:
                    s = slot[~box]
                    w, x = node_weights[s], nodes[s]
                    away = shift - middles[s]  # exact, as the centres are
                    at = _gather(x, w, 0, x.shape[1], away, at, near, near_weights)
                elif not proxy and box >= 0:
                    at = _gather(
                        points,
                        weights,
                        source[box, 0],
                        source[box, 1],
                        shift,
                        at,
                        near,
                        near_weights,
                    )
            for i in range(at, near.shape[1]):
                for d in range(3):
                    near[d, i] = 0.0
                for c in range(weights.shape[0]):
                    near_weights[c, i] = 0.0
            for i in range(high - low):
                for d in range(3):
                    block[d, i] = targets[d, low + i] - shift[d]
            for i in range(high - low):
                accumulate_row(kernel, block, i, near, near_weights, total, out)
        pairs[leaf] = (count + stand_ins) * (high - low)
        for i in range(high - low):
            for c in range(values.shape[1]):
                values[order[low + i], c] = out[c, i]


@Driver
def coarse_field(kernel, points, weights, source, begin, entries, nodes, centers, out):
    """Sum over sources of larger leaves at the nodes of some boxes.

    Parameters
    ----------
    kernel, points, weights, source, begin, entries :
        As for `near_field`.
    nodes : (3, n) float64
        Relative to the centre of a box; more columns follow, see `pairs.accumulate`.
    centers : (boxes, 3) float64
    out : (boxes, value_size, n) float64
        Overwritten.
    """
    for box in range(len(centers)):
        for k in range(begin[box], begin[box + 1]):
            low, high = source[entries[k], 0], source[entries[k], 1]
            near = np.empty((3, high - low))
            near_weights = np.empty((weights.shape[0], high - low))
            _gather(points, weights, low, high, centers[box], 0, near, near_weights)
            accumulate(kernel, nodes, 0, out.shape[2], near, near_weights, 0, high - low, out[box])


@Driver
def _evaluate_few(kernel, sources, weights, out):
    target = np.zeros((3, 1), sources.dtype)
    accumulate_row(kernel, target, 0, sources, weights, sources.shape[1] - 64, out)


def single_serves(kernel: Any, half: float, tol: float) -> bool:
    """Tell whether single precision resolves a kernel in cubes of this size to a tolerance.

    It must agree with doubles, and the kernel must not change over the rounding of a coordinate.
    """
    units = find_units(kernel, half)
    tol *= units.evenness
    rng = np.random.default_rng(0)
    scale = np.append(0.0, half * 2.0 ** -np.arange(24.0))
    for length in scale:
        column = length * rng.uniform(-1.0, 1.0, (3, 1))
        moved = column + half * 2.0**-22 * rng.uniform(-1.0, 1.0, (3, 1))
        for unit in np.eye(kernel.weight_size):
            results = []
            for points, dtype in ((column, np.float64), (column, np.float32), (moved, np.float64)):
                sources = np.zeros((3, 65), dtype)
                weights = np.zeros((len(unit), 65), dtype)
                sources[:, :1], weights[:, 0] = points, unit
                out = np.zeros((kernel.value_size, 1))
                _evaluate_few(kernel, sources, weights, out)
                results.append(out * units.values[:, None])
            exact, single, changed = results
            bound = 0.3 * tol * np.abs(exact).max()
            worst = np.maximum(np.abs(single - exact), np.abs(changed - exact)).max()
            if not worst <= bound:  # true for NaN as well
                return False
    return True
