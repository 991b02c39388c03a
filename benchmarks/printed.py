"""The numbers that the papers print: seconds, errors and megabytes, on their machines.

"K" is Wang, Krasny and Tlupova (2020): icpc -O2 on a Xeon E5-2680 v3 at 2.5 GHz, theta 0.7, n = 7.
"T" is Wang, Tlupova and Krasny (2019): orders 0, 2, ..., 10.
"""

from __future__ import annotations

from typing import NamedTuple

from benchmarks.methods import DIRECT, KITC, TAYLOR

ORDERS = (0, 2, 4, 6, 8, 10)
DEGREES = (1, 3, 5, 7, 9)


class Printed(NamedTuple):
    """Seconds of a direct sum and of a treecode, and the error of the latter."""

    direct: float
    treecode: float
    error: float


# K table 1, by N
K1 = {
    10_000: Printed(0.54, 0.51, 2.25e-6),
    80_000: Printed(34.01, 9.78, 1.44e-5),
    640_000: Printed(2248.93, 149.14, 3.17e-5),
    5_120_000: Printed(157_542.13, 1892.57, 1.62e-5),
    40_960_000: Printed(10_082_696.32, 20_966.04, 7.06e-6),
}

# K table 2, megabytes by N: of a direct sum, and of the treecode for each of DEGREES
K2 = {
    10_000: (0.88, (0.89, 0.91, 0.98, 1.16, 1.44)),
    80_000: (7.04, (7.09, 7.27, 7.74, 8.66, 10.16)),
    640_000: (56.36, (56.74, 58.17, 61.96, 69.28, 81.32)),
    5_120_000: (450.60, (453.69, 465.09, 495.37, 553.96, 650.30)),
}

# K table 3, errors by epsilon, N = 640K
K3 = {0.005: 7.68e-6, 0.01: 2.08e-5, 0.02: 3.17e-5, 0.04: 2.78e-5, 0.08: 1.93e-5}

# K tables 4 (organisms, 640K) and 5 (80 x 80 rods) by cores, T table 5 (cube, 1000K, theta 0.5,
# p = 6) by processes: seconds of a direct sum and of the treecode
K4_CORES = {
    1: (2249.71, 149.75),
    2: (1123.72, 75.01),
    4: (569.58, 38.83),
    8: (311.50, 21.44),
    12: (215.49, 16.34),
    24: (108.22, 10.19),
}
K5_CORES = {
    1: (15651.61, 720.87),
    2: (7907.10, 371.91),
    4: (3962.36, 191.89),
    8: (2120.36, 110.88),
    12: (1424.27, 80.35),
    24: (742.85, 43.63),
}
T5_PROCESSES = {
    1: (9707.0, 336.6),
    2: (4911.4, 176.3),
    4: (2451.2, 86.6),
    8: (1345.6, 48.1),
    16: (702.0, 25.6),
    32: (350.7, 13.6),
}

# T table 6, weak scaling of the same: seconds by processes, 125K points for each
T6_PROCESSES = {
    1: (145.5, 23.7),
    2: (291.7, 27.2),
    4: (610.3, 32.9),
    8: (1345.7, 48.1),
    16: (2804.9, 56.7),
    32: (5565.9, 67.7),
}


class Scaling(NamedTuple):
    """A table of seconds by cores or processes."""

    name: str
    points: str
    size: int
    treecode: str
    seconds: dict[int, tuple[float, float]]

    def of(self, backend: str) -> dict[int, float]:
        """Return the seconds of a method, {} of one that is not in the table."""
        if backend not in (DIRECT, self.treecode):
            return {}
        return {cores: both[backend == self.treecode] for cores, both in self.seconds.items()}


STRONG = (
    Scaling("K table 4", "organisms", 640_000, KITC, K4_CORES),
    Scaling("K table 5", "rods", 80, KITC, K5_CORES),
    Scaling("T table 5", "cube", 1_000_000, TAYLOR, T5_PROCESSES),
)
WEAK = Scaling("T table 6", "cube", 125_000, TAYLOR, T6_PROCESSES)

# K figure 5 and table 5, by rods on a side
K5 = {80: Printed(15651.61, 720.87, 2.24e-5)}

# T tables 1 (by level of the sphere) and 3 (by N of the cube), and theta: how many times faster
# than the direct sum, and the error, for each of ORDERS. None: a value printed twice by mistake.
T_DIRECT = {6: 112.0, 7: 1824.0, 8: 31267.0, 125_000: 150.0, 1_000_000: 9873.0}
T: dict[tuple[int, float], tuple[tuple[float | None, ...], tuple[float, ...]]] = {
    (6, 0.2): (
        (1.03, 1.05, 1.04, 1.00, 0.97, 0.90),
        (8.3e-04, 2.2e-05, 7.3e-07, 2.9e-08, 1.1e-09, 4.2e-11),
    ),
    (6, 0.5): (
        (6.12, 5.69, 4.68, 3.50, 2.50, 1.74),
        (8.9e-03, 1.2e-03, 2.2e-04, 5.2e-05, 1.2e-05, 2.9e-06),
    ),
    (6, 0.8): (
        (14.75, 13.32, 10.87, 7.65, 5.19, 3.61),
        (2.3e-02, 8.2e-03, 4.5e-03, 2.5e-03, 1.5e-03, 9.3e-04),
    ),
    (7, 0.2): (
        (4.38, 4.11, 3.48, 2.69, 1.97, 1.41),
        (1.4e-03, 3.2e-05, 9.8e-07, 3.6e-08, 1.3e-09, 5.1e-11),
    ),
    (7, 0.5): (
        (26.59, 22.75, 16.79, 11.15, 7.23, 4.18),
        (7.4e-03, 1.1e-03, 2.4e-04, 5.4e-05, 1.3e-05, 3.2e-06),
    ),
    (7, 0.8): (
        (67.63, 56.52, None, 25.66, 16.29, 10.49),
        (2.0e-02, 8.8e-03, 4.7e-03, 2.7e-03, 1.7e-03, 1.1e-03),
    ),
    (125_000, 0.2): (
        (1.14, 1.13, 1.11, 1.08, 1.02, 0.95),
        (1.1e-02, 2.2e-04, 4.4e-06, 1.1e-07, 3.2e-09, 9.6e-11),
    ),
    (125_000, 0.5): (
        (5.50, 5.28, 4.79, 4.17, 3.40, 2.64),
        (1.1e-01, 8.2e-03, 1.1e-03, 1.7e-04, 3.0e-05, 5.5e-06),
    ),
    (125_000, 0.8): (
        (16.94, 15.85, 13.81, 11.32, 8.77, 6.40),
        (2.1e-01, 4.3e-02, 1.4e-02, 5.4e-03, 2.4e-03, 1.1e-03),
    ),
    (1_000_000, 0.5): (
        # p = 6: 21.13 in table 3, which contradicts the 336.6 s of table 5
        (33.89, 31.39, 26.86, 9873.0 / 336.6, 13.77, 11.28),
        (1.5e-01, 1.6e-02, 2.0e-03, 3.3e-04, 5.7e-05, 1.0e-05),
    ),
    (1_000_000, 0.8): (
        (123.78, 111.61, 90.79, 67.34, 47.13, 32.54),
        (2.7e-01, 7.0e-02, 2.3e-02, 9.0e-03, 4.1e-03, 1.9e-03),
    ),
}

# T tables 2 (sphere, by level) and 4 (cube, by N), megabytes: of a direct sum, and of the
# treecode for each of ORDERS
T_MEMORY = {
    5: (3.3, (3.3, 3.4, 3.7, 4.3, 5.4, 7.6)),
    6: (13.1, (13.1, 13.2, 13.6, 14.2, 15.2, 16.6)),
    7: (52.4, (52.6, 53.0, 54.2, 56.6, 60.6, 66.6)),
    125_000: (11.0, (14.0, 14.1, 14.3, 14.6, 15.0, 15.8)),
    1_000_000: (88.0, (112.4, 112.8, 114.0, 116.4, 120.4, 126.3)),
}


def taylor(size: int, theta: float, order: int) -> tuple[float | None, float | None]:
    """Return seconds and error of T tables 1 and 3, None where they print none.

    The seconds follow from the seconds of the direct sum and the ratio.
    """
    if (size, theta) not in T or order not in ORDERS:
        return None, None
    ratios, errors = T[size, theta]
    ratio, error = ratios[ORDERS.index(order)], errors[ORDERS.index(order)]
    return None if ratio is None else T_DIRECT[size] / ratio, error


def strong(points: str, size: int, backend: str) -> dict[int, float]:
    """Return the seconds of K tables 4 and 5 and T table 5 by cores, {} where they print none."""
    for table in STRONG:
        if (table.points, table.size) == (points, size):
            return table.of(backend)
    return {}
