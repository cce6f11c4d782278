"""Chain kernels: links of both directions in; those that count, and the chains that they form, out.

The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel
def sort_frames(xyz, offsets, order, axes, sign):
    """Sort each frame's points by three axes, the first one times `sign`: (0, 1, 2) and 1 for by x, then y, then z.

    IN xyz (P, 3) m; offsets (T + 1,). IN/OUT order (P,) points, frame by frame. O(n^2) a frame at worst.
    """
    a, b, c = axes
    for t in range(len(offsets) - 1):
        for p in range(offsets[t], offsets[t + 1]):
            # Insertion sort: frames are short, and nearly sorted from one to the next.
            where = p
            while where > offsets[t]:
                q = order[where - 1]
                if sign * xyz[q, a] < sign * xyz[p, a] or (
                    xyz[q, a] == xyz[p, a] and (xyz[q, b] < xyz[p, b] or (xyz[q, b] == xyz[p, b] and xyz[q, c] <= xyz[p, c]))
                ):
                    break
                order[where] = q
                where -= 1
            order[where] = p


@kernel
def link_numbers(numbers, frame, newest, links):
    """Link each point to the last one of its number, if that is in the frame before.

    IN     numbers (P,), -1 for none; frame (P,), not decreasing
    IN/OUT newest (numbers,): all -1; the last point of each
    OUT    links: see `Links`. O(P).
    """
    links.previous[:], links.following[:] = -1, -1
    for p in range(len(numbers)):
        number = numbers[p]
        if number < 0:
            continue
        before = newest[number]
        # A number that comes back after a gap may be another marker.
        if before >= 0 and frame[p] - frame[before] == 1:
            links.previous[p], links.following[before] = before, p
        newest[number] = p


@kernel
def combine_directions(forward, backward, previous, following):
    """The links that both directions found, or that one found and the other could not judge: its track had fewer than three points yet.

    IN  forward (P,) previous point of each; backward (P,) next point of each, -1 for none
    OUT previous, following (P,), -1 for none. O(P).
    """
    count = len(forward)
    age, age_back = np.ones(count, dtype=np.int64), np.ones(count, dtype=np.int64)
    previous[:], following[:] = -1, -1
    continued = np.full(count, -1, dtype=np.int64)
    # Ages tell whether a direction could judge: with fewer than three points a track has no acceleration.
    for p in range(count):
        if forward[p] >= 0:
            continued[forward[p]] = p
            age[p] = age[forward[p]] + 1
    # Ages of the way back are counted from the end.
    for p in range(count - 1, -1, -1):
        if backward[p] >= 0:
            age_back[p] = age_back[backward[p]] + 1
    origin = np.full(count, -1, dtype=np.int64)
    for p in range(count):
        if backward[p] >= 0:
            origin[backward[p]] = p
    for q in range(count):
        p = forward[q]
        # Both directions agree, or the other one was too young to judge.
        if p >= 0 and (backward[p] == q or (backward[p] < 0 and origin[q] < 0 and age_back[q] < 3)):
            following[p], previous[q] = q, p
        p = origin[q]
        if p >= 0 and continued[p] < 0 and forward[q] < 0 and age[p] < 3:
            following[p], previous[q] = q, p


@kernel
def number_chains(previous, of_point):
    """Number the chains of linked points, in the order of their first points. OUT of_point (P,). Returns how many. O(P)."""
    count = 0
    # Points are in the order of frames, so that the point before has its number already.
    for p in range(len(previous)):
        if previous[p] >= 0:
            of_point[p] = of_point[previous[p]]
        else:
            of_point[p] = count
            count += 1
    return count
