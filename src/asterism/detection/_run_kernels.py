"""Connected components of bright pixels: a grey image and its levels in; runs of pixels by component out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel

STEP = 64
"""Pixels that are tested for being dark at once."""


class Runs(NamedTuple):
    """Runs of bright pixels in rows: row, first and last column of each, and the first run of its component; (capacity,) int32 each."""

    rows: np.ndarray
    firsts: np.ndarray
    lasts: np.ndarray
    parents: np.ndarray


class Components(NamedTuple):
    """Runs by component: those of component i are order[starts[i]:starts[i + 1]].

    rows, firsts, lasts  as in Runs
    order                (runs,) numbers of runs
    starts               (components + 1,)
    """

    rows: np.ndarray
    firsts: np.ndarray
    lasts: np.ndarray
    order: np.ndarray
    starts: np.ndarray


@kernel
def find_root(parents, i):
    """Returns the first member of the group of i. OUT parents: the path to it is halved. O(log n), amortised."""
    while parents[i] != i:
        # Each visit leads to the grandparent instead, so that long ways become short without a second walk.
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def _is_dark(image, level, row, start):
    """Returns whether none of the next STEP pixels is above its level. O(STEP).

    Without a branch or an index that could be negative, so that the processor takes many pixels at once.
    """
    here, limit = image[row, start : start + STEP], level[row, start : start + STEP]
    above = False
    for k in range(STEP):
        above |= here[k] > limit[k]
    return not above


@kernel
def find_runs(image, level, reach, runs):
    """Runs of pixels above their level, row by row, joined where they touch.

    IN  image, level (H, W) of the same unsigned type; reach 1 joins diagonal neighbours too (8-connected), 0 does not (4-connected)
    OUT runs Runs, with room for H * ((W + 1) // 2)
    Returns how many runs there are. O(H W), dark stretches skipped; no allocation. Twin: cv2.connectedComponentsWithStats

    Bounds: two runs of a row are apart by a pixel, so a row of W pixels has (W + 1) // 2 at most.
    """
    rows, firsts, lasts, parents = runs.rows, runs.firsts, runs.lasts, runs.parents
    height, width = image.shape
    count = above_start = above_end = 0
    for row in range(height):
        # The runs of this row begin here; those of the row above are above_start to above_end.
        here = count
        column = 0
        while column < width:
            # Most of an image is dark, so that it is passed over in steps.
            if column + STEP <= width and _is_dark(image, level, row, column):
                column += STEP
                continue
            stop = min(column + STEP, width)
            # A run may go on beyond the step; then the next step begins behind it.
            while column < stop:
                if image[row, column] > level[row, column]:
                    rows[count], firsts[count], parents[count] = row, column, count
                    column += 1
                    while column < width and image[row, column] > level[row, column]:
                        column += 1
                    lasts[count] = column - 1
                    count += 1
                column += 1
        # Both rows are in order of columns, so one walk along the row above serves all runs of this one.
        other = above_start
        for run in range(here, count):
            while other < above_end and lasts[other] + reach < firsts[run]:
                other += 1
            # The next run may touch the same one above, which is why `other` stays behind.
            touching = other
            while touching < above_end and firsts[touching] <= lasts[run] + reach:
                a, b = find_root(parents, run), find_root(parents, touching)
                # The smaller number wins, so that a component's root is its first run and components come in reading order.
                parents[max(a, b)] = min(a, b)
                touching += 1
        above_start, above_end = here, count
    # The root comes before its members and was done before them: one step is enough.
    for run in range(count):
        parents[run] = parents[parents[run]]
    return count


@kernel
def group_runs(runs, count):
    """Runs by their components.

    IN  runs, the first `count` of which count, with the first run of the component as parent
    Returns Components. O(count).
    """
    parents = runs.parents
    number = np.empty(count, np.int64)
    components = 0
    for run in range(count):
        # A root comes before its members, so that its number is known when they ask.
        if parents[run] == run:
            number[run] = components
            components += 1
        else:
            number[run] = number[parents[run]]
    # Counting sort: sizes, then where each component begins, then each run to its place. It keeps the runs' order.
    starts = np.zeros(components + 1, np.int64)
    for run in range(count):
        starts[number[run] + 1] += 1
    for i in range(components):
        starts[i + 1] += starts[i]
    place = starts[:-1].copy()
    order = np.empty(count, np.int64)
    for run in range(count):
        order[place[number[run]]] = run
        place[number[run]] += 1
    return Components(runs.rows, runs.firsts, runs.lasts, order, starts)
