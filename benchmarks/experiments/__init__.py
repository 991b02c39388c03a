"""One experiment a module: `cases`, how to `measure` one, a `table` and a `plot` of the rows.

The docstring is the head of its page.
"""

from benchmarks.experiments import (
    boundaries,
    carpet,
    curve,
    epsilon,
    growth,
    memory,
    prescribed,
    ranks,
    rods,
    stepping,
    taylor,
    threads,
    uneven,
)

ALL = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        curve, growth, rods, taylor, uneven, epsilon, threads, ranks, memory, stepping, carpet,
        boundaries, prescribed,
    )
}  # fmt: skip
