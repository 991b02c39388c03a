"""Section 3: blobs from far below to far above the spacing of the points."""

import numpy as np

from tests.cases.oracle import (
    BACKENDS,
    KERNELS,
    UNIT,
    exact,
    random_case,
    rounding,
    sizes,
    with_epsilon,
)
from tests.cases.stability.findings import at_most, case
from tests.cases.stability.sums import excess, name_of, plan_of, truncation


@case("3. Epsilon from 1e-8 to 1e3 of the spacing")
def epsilons():
    """Targets among the sources and at some of them.

    The error stays within theta^(p+1) of the terms' sizes and rounding. A blob moves the
    singularities of a kernel away from the points, so that no epsilon may be much worse than the
    smallest: twice, since sizes change with it as well. The widest blobs leave only rounding.
    """
    for kernel in KERNELS[:2]:
        points, strengths, others = random_case(kernel, 1000, 4, 30)
        targets = np.concatenate([points[:30], others])
        spacing = 2.0 * len(points) ** (-1 / 3)
        shares, errors = {b: [] for b in BACKENDS}, {b: [] for b in BACKENDS}
        for exponent in range(-8, 4):
            blob = with_epsilon(kernel, spacing * 10.0**exponent)
            given = blob, points, strengths, targets
            expected, size, rounded = exact(*given), sizes(*given), rounding(*given)
            for backend in BACKENDS:
                plan = plan_of(blob, backend, leaf_size=50).set_points(points, targets)
                error = abs(plan.execute(strengths) - expected)
                shares[backend].append((error / (rounded + truncation(backend) * size)).max())
                errors[backend].append((error / size).max())
        for backend in BACKENDS:
            where = f"{name_of(kernel)}, {backend}"
            yield at_most(f"{where}: largest error over its bound", max(shares[backend]), 1)
            if backend != "direct":
                error = np.array(errors[backend])
                found = error.max() / error[0]
                yield at_most(f"{where}: largest error over that of the smallest blob", found, 2)
                yield at_most(f"{where}: roundings with the widest", error[-1] / UNIT, 32)


@case("3. Epsilon from 1e-8 to 1e3 of the spacing, by fmm", slow=True, tol=1e-4)
@case("3. Epsilon from 1e-8 to 1e3 of the spacing, by fmm", tol=1e-2)
def epsilons_by_fmm(tol):
    """The same points: whatever a blob is beside the cubes, the tolerance is kept."""
    for kernel in KERNELS[:2]:
        points, strengths, _ = random_case(kernel, 1000, 4)
        spacing = 2.0 * len(points) ** (-1 / 3)
        found = [
            excess(tol, with_epsilon(kernel, spacing * 10.0**exponent), points, strengths)
            for exponent in range(-8, 4)
        ]
        yield at_most(f"{name_of(kernel)}: largest error over the tolerance", max(found), 1)
