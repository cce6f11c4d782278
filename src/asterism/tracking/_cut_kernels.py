"""Cutting kernels: points and their links, both ways, in; which links are wrong, and which ends belong together, out.

The rules stand in `linking.LinkRules`. The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def departure(xyz, a, b, previous, following):
    """How far point b of a frame is from going on smoothly from point a of the frame before: (m, and its x, y, z).

    The least of three: by the mean of the velocities before a and after b; by that before a alone; by that after b alone (a swap that
    lasts a frame or two spoils one side). Without any velocity: infinity.
    """
    c, d = previous[a], following[b]
    least, vx, vy, vz = np.inf, 0.0, 0.0, 0.0
    for before, after in ((1.0, 0.0), (0.0, 1.0), (0.5, 0.5)):
        if (before > 0.0 and c < 0) or (after > 0.0 and d < 0):
            continue
        x, y, z = xyz[b, 0] - xyz[a, 0], xyz[b, 1] - xyz[a, 1], xyz[b, 2] - xyz[a, 2]
        if before > 0.0:
            x -= before * (xyz[a, 0] - xyz[c, 0])
            y -= before * (xyz[a, 1] - xyz[c, 1])
            z -= before * (xyz[a, 2] - xyz[c, 2])
        if after > 0.0:
            x -= after * (xyz[d, 0] - xyz[b, 0])
            y -= after * (xyz[d, 1] - xyz[b, 1])
            z -= after * (xyz[d, 2] - xyz[b, 2])
        total = x * x + y * y + z * z
        if total < least:
            least, vx, vy, vz = total, x, y, z
    return math.sqrt(least), vx, vy, vz


@kernel
def misfit(xyz, a, b, previous, following):
    """The length of `departure`, in m."""
    return departure(xyz, a, b, previous, following)[0]


@kernel
def claims(xyz, rival, miss, off, own_from, own_to, previous, following, limits):
    """Whether a rival that misses by `rival` is right against a link that misses by `miss`, in the direction `off`.

    It must be better by `clearer` than the link and than the rival point's own link (own_from, own_to), where it has one. Where that
    departs the same way, the two move together, and lie closer than they jerk in a frame: then nothing has swapped.
    """
    rival *= limits.clearer
    if rival >= miss:
        return False
    if own_from < 0 or own_to < 0:
        return miss > 3.0 * limits.quiet
    own, x, y, z = departure(xyz, own_from, own_to, previous, following)
    return rival < own and x * off[0] + y * off[1] + z * off[2] < 0.5 * own * miss


@kernel
def bend(xyz, p, previous, following):
    """How far the point between two others is from going straight on, in m; 0 where there are not two."""
    a, b = previous[p], following[p]
    if a < 0 or b < 0:
        return 0.0
    total = 0.0
    for i in range(3):
        total += (xyz[b, i] - 2.0 * xyz[p, i] + xyz[a, i]) ** 2
    return math.sqrt(total)


@kernel
def restless(xyz, a, b, previous, following):
    """How far the tracks that end in a and begin in b have strayed from straight on within three frames of it, in m."""
    most = 0.0
    p = a
    for _ in range(3):
        p = previous[p]
        if p < 0:
            break
        most = max(most, bend(xyz, p, previous, following))
    p = b
    for _ in range(3):
        p = following[p]
        if p < 0:
            break
        most = max(most, bend(xyz, p, previous, following))
    return most


@kernel
def jumped(xyz, a, b, miss, previous, following, limits):
    """Whether a track broke between a and b although nobody else claims either: it is offset, with the same velocity before and after."""
    c, d = previous[a], following[b]
    if c < 0 or d < 0 or miss < limits.jump:
        return False
    change2 = 0.0
    for i in range(3):
        change2 += (xyz[d, i] - xyz[b, i] - xyz[a, i] + xyz[c, i]) ** 2
    return miss > 3.0 * math.sqrt(change2) and miss > 4.0 * restless(xyz, a, b, previous, following)


@kernel
def find_cuts(xyz, offsets, previous, following, limits, cut):
    """Where links of numbered tracks are wrong. IN links (P,) both ways. OUT cut (P,) whether the link to a point's previous one is wrong.

    A link is wrong where another point goes on with its track, or another track with its point, and `claims` it; or where the track jumped.
    O(P), and O(n) for each link that misses more than `quiet`.
    """
    for t in range(1, len(offsets) - 1):
        before, first, last = offsets[t - 1], offsets[t], offsets[t + 1]
        for b in range(first, last):
            a = previous[b]
            cut[b] = False
            if a < 0:
                continue
            miss, x, y, z = departure(xyz, a, b, previous, following)
            if miss <= limits.quiet or miss == np.inf:
                continue
            wrong, off = jumped(xyz, a, b, miss, previous, following, limits), (x, y, z)
            for other in range(first, last):
                if wrong:
                    break
                if other != b:
                    rival = misfit(xyz, a, other, previous, following)
                    wrong = claims(xyz, rival, miss, off, previous[other], other, previous, following, limits)
            for other in range(before, first):
                if wrong:
                    break
                if other != a:
                    rival = misfit(xyz, other, b, previous, following)
                    wrong = claims(xyz, rival, miss, off, other, following[other], previous, following, limits)
            cut[b] = wrong


@kernel
def count_strays(xyz, offsets, following, farther, least):
    """How many links there are, and how many of them lead past a point that lies `farther` times nearer: (links, strays).

    IN  xyz (P, 3) m; offsets (T + 1,); following (P,) the next frame's point on the same track, -1 for none; least (m): shorter links are
        none to worry about. O(P), and O(n) for each link that is longer.
    """
    links, strays = 0, 0
    for t in range(len(offsets) - 2):
        for a in range(offsets[t], offsets[t + 1]):
            b = following[a]
            if b < 0:
                continue
            links += 1
            length2 = (xyz[b, 0] - xyz[a, 0]) ** 2 + (xyz[b, 1] - xyz[a, 1]) ** 2 + (xyz[b, 2] - xyz[a, 2]) ** 2
            if length2 <= least * least:
                continue
            for c in range(offsets[t + 1], offsets[t + 2]):
                near2 = (xyz[c, 0] - xyz[a, 0]) ** 2 + (xyz[c, 1] - xyz[a, 1]) ** 2 + (xyz[c, 2] - xyz[a, 2]) ** 2
                if near2 * farther * farther < length2:
                    strays += 1
                    break
    return links, strays


@kernel
def mend(xyz, offsets, previous, following, barred, limits):
    """Join a track that ends with one that begins in the next frame, where motion says so clearly and nothing rivals it.

    IN barred (P,) the previous point that a point was cut from, -1 for none. IN/OUT links (P,) both ways. O(ends x beginnings) a frame.
    """
    most = 0
    for t in range(len(offsets) - 1):
        most = max(most, offsets[t + 1] - offsets[t])
    from_, to = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    for t in range(1, len(offsets) - 1):
        ends, starts = 0, 0
        for a in range(offsets[t - 1], offsets[t]):
            if following[a] < 0:
                from_[ends] = a
                ends += 1
        for b in range(offsets[t], offsets[t + 1]):
            if previous[b] < 0:
                to[starts] = b
                starts += 1
        if ends == 0 or starts == 0:
            continue
        miss = np.empty((ends, starts))
        for i in range(ends):
            for j in range(starts):
                miss[i, j] = misfit(xyz, from_[i], to[j], previous, following)
        for i in range(ends):
            j = np.argmin(miss[i])
            a, b = from_[i], to[j]
            # both sides must speak
            if previous[a] < 0 or following[b] < 0 or barred[b] == a:
                continue
            gate = limits.noise + limits.soft + limits.wild * restless(xyz, a, b, previous, following)
            if miss[i, j] > min(gate, limits.noise + limits.hard):
                continue
            rival = limits.clearer * miss[i, j] + limits.apart
            clear = True
            for other in range(starts):
                clear = clear and (other == j or miss[i, other] > rival)
            for other in range(ends):
                clear = clear and (other == i or miss[other, j] > rival)
            if clear:
                following[a], previous[b] = b, a
