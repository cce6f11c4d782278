"""Sorting on flat arrays, one small function for all kernels: what NumPy's would take seconds to compile."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel

RUN = 8
"""Numbers that are sorted by insertion before runs are merged."""


@kernel
def ascending(values, count):
    """The order that sorts values: a stable merge sort.

    IN  values (n,), the first `count` of which count, without NaN
    Returns order (count,). O(n log n). Twin: np.argsort
    """
    order, spare = np.empty(count, np.int64), np.empty(count, np.int64)
    # Short runs by insertion, which beats merging while they are short.
    for begin in range(0, count, RUN):
        for i in range(begin, min(begin + RUN, count)):
            value, k = values[i], i
            while k > begin and values[order[k - 1]] > value:
                order[k] = order[k - 1]
                k -= 1
            order[k] = i
    width = RUN
    while width < count:
        for begin in range(0, count, 2 * width):
            middle, end = min(begin + width, count), min(begin + 2 * width, count)
            left, right = begin, middle
            for k in range(begin, end):
                # On equal values the left one first: so the sort is stable, and equal scores keep their order.
                if left < middle and (right >= end or values[order[left]] <= values[order[right]]):
                    spare[k] = order[left]
                    left += 1
                else:
                    spare[k] = order[right]
                    right += 1
        # The two arrays change places instead of being copied.
        order, spare = spare, order
        width *= 2
    return order
