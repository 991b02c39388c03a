"""A choice that has been written down sums to the same bits, on any number of threads."""

import json

import numba
import numpy as np

import treecode as tc


def assert_choice_keeps_bits(plan, points, q):
    """Of a plan of periodic sums with these points; it goes through JSON, and to other points."""
    values = plan.execute(q)
    again = tc.Plan(plan.kernel)
    again.use(tc.Choice(**json.loads(json.dumps(plan.choice.as_dict()))))
    before = numba.get_num_threads()
    try:
        for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
            numba.set_num_threads(threads)
            again.set_points(points + 0.3).execute(q)
            assert np.array_equal(again.set_points(points).execute(q), values)
    finally:
        numba.set_num_threads(before)
