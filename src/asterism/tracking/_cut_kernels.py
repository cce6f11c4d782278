"""Cut and repair kernels: points and their links in; which links are wrong, and which ends belong together, out.

The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def prediction_error(xyz, a, b, links):
    """How far point b of a frame lies from the smooth continuation of point a of the frame before.

    The least of three errors: by the mean of the velocities before a and after b; by that before a alone; by that after b alone (a swap
    that lasts a frame or two spoils one side). Infinite where neither velocity is known.
    IN  xyz (P, 3) m; a, b points; links Links. Returns the error in m, and its x, y, z. O(1).
    """
    c, d = links.previous[a], links.following[b]
    least, vx, vy, vz = np.inf, 0.0, 0.0, 0.0
    # A swap that lasts a frame or two spoils the velocity on one side, so that each side counts alone, too.
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
def error_length(xyz, a, b, links):
    """Returns the length of `prediction_error`, in m. O(1)."""
    return prediction_error(xyz, a, b, links)[0]


@kernel
def rival_wins(xyz, rival, error, direction, from_, to, links, limits):
    """Whether a rival link is right, and a link with a larger prediction error therefore wrong.

    The rival must be better by `ratio_test` than the link, and than the link from_ -> to that the rival's point has, if any. Where that one
    errs in the same direction, both tracks move together, and closer than they jerk in a frame: then nothing has swapped.
    IN  rival, error m; direction (3,) m, the error's x, y, z; from_, to the rival point's own link, -1 where it has none. O(1).
    """
    rival *= limits.ratio_test
    if rival >= error:
        return False
    # A rival without a link of its own may be a ghost: it must be far better to cut for it.
    if from_ < 0 or to < 0:
        return error > 3.0 * limits.no_cut_below
    its_error, x, y, z = prediction_error(xyz, from_, to, links)
    # Both tracks err in the same direction where they move together: nothing has swapped.
    return rival < its_error and x * direction[0] + y * direction[1] + z * direction[2] < 0.5 * its_error * error


@kernel
def second_difference(xyz, p, links):
    """The length of a track's second difference at a point.

    IN xyz (P, 3) m; p point; links Links. Returns m, 0 at a track's ends. O(1).
    """
    a, b = links.previous[p], links.following[p]
    if a < 0 or b < 0:
        return 0.0
    total = 0.0
    for i in range(3):
        total += (xyz[b, i] - 2.0 * xyz[p, i] + xyz[a, i]) ** 2
    return math.sqrt(total)


@kernel
def recent_jerk(xyz, a, b, links):
    """The largest second difference, in m, within three frames before a and after b, of the tracks that end in a and begin in b.

    IN xyz (P, 3) m; a, b points; links Links. Returns m. O(1).
    """
    most = 0.0
    p = a
    for _ in range(3):
        # Near the cut the tracks are already wrong: how they jerk is taken from before it.
        p = links.previous[p]
        if p < 0:
            break
        most = max(most, second_difference(xyz, p, links))
    p = b
    for _ in range(3):
        p = links.following[p]
        if p < 0:
            break
        most = max(most, second_difference(xyz, p, links))
    return most


@kernel
def has_jumped(xyz, a, b, error, links, limits):
    """Whether a track broke between a and b without any rival: it is offset, with the same velocity before and after.

    IN error m, of the link. Returns bool. O(1).
    """
    c, d = links.previous[a], links.following[b]
    # Both velocities must be known to tell an offset from a sudden move.
    if c < 0 or d < 0 or error < limits.jump:
        return False
    # The same velocity on both sides of an offset: a body cannot move so, a number that passes to another marker can.
    change2 = 0.0
    for i in range(3):
        change2 += (xyz[d, i] - xyz[b, i] - xyz[a, i] + xyz[c, i]) ** 2
    # The same velocity on both sides, and an offset far beyond what the track does elsewhere.
    return error > 3.0 * math.sqrt(change2) and error > 4.0 * recent_jerk(xyz, a, b, links)


@kernel
def find_cuts(xyz, offsets, links, limits, cut):
    """Where links along track numbers are wrong.

    A link is wrong where another point continues its track better, or another track continues in its point better (`rival_wins`), or where
    the track jumped (`has_jumped`).
    IN  xyz (P, 3) m; offsets (T + 1,); links Links; limits LinkLimits
    OUT cut (P,) bool, whether the link from a point to its previous one is wrong
    O(P), and O(n) for each link with an error above `no_cut_below`.
    """
    for t in range(1, len(offsets) - 1):
        before, first, last = offsets[t - 1], offsets[t], offsets[t + 1]
        for b in range(first, last):
            a = links.previous[b]
            cut[b] = False
            if a < 0:
                continue
            error, x, y, z = prediction_error(xyz, a, b, links)
            # Small errors are noise, and an unknown one cannot be judged.
            if error <= limits.no_cut_below or error == np.inf:
                continue
            wrong, direction = has_jumped(xyz, a, b, error, links, limits), (x, y, z)
            # First the points that could continue the track better,
            for other in range(first, last):
                if wrong:
                    break
                if other != b:
                    rival = error_length(xyz, a, other, links)
                    wrong = rival_wins(xyz, rival, error, direction, links.previous[other], other, links, limits)
            # then the tracks that could continue better in this point.
            for other in range(before, first):
                if wrong:
                    break
                if other != a:
                    rival = error_length(xyz, other, b, links)
                    wrong = rival_wins(xyz, rival, error, direction, other, links.following[other], links, limits)
            cut[b] = wrong


@kernel
def count_strays(xyz, offsets, following, ratio, least):
    """How many links there are, and how many of them pass by a point that lies `ratio` times nearer: (links, strays).

    IN  xyz (P, 3) m; offsets (T + 1,); following (P,) the next frame's point on the same track, -1 for none; least (m): shorter links are
        never strays. O(P), and O(n) for each longer link.
    """
    links, strays = 0, 0
    for t in range(len(offsets) - 2):
        for a in range(offsets[t], offsets[t + 1]):
            b = following[a]
            if b < 0:
                continue
            links += 1
            length2 = (xyz[b, 0] - xyz[a, 0]) ** 2 + (xyz[b, 1] - xyz[a, 1]) ** 2 + (xyz[b, 2] - xyz[a, 2]) ** 2
            # Short links pass by nothing: markers lie farther apart.
            if length2 <= least * least:
                continue
            for c in range(offsets[t + 1], offsets[t + 2]):
                near2 = (xyz[c, 0] - xyz[a, 0]) ** 2 + (xyz[c, 1] - xyz[a, 1]) ** 2 + (xyz[c, 2] - xyz[a, 2]) ** 2
                if near2 * ratio * ratio < length2:
                    strays += 1
                    break
    return links, strays


@kernel
def repair_links(xyz, offsets, links, forbidden, limits):
    """Join a track that ends with one that begins in the next frame, where the motion on both sides agrees and no rival comes near.

    IN     xyz (P, 3) m; offsets (T + 1,); forbidden (P,) the previous point that a point was cut from, -1 for none; limits LinkLimits
    IN/OUT links Links
    O(P), and O(ends x beginnings) a frame.

    Bounds: a frame has no more ends, or beginnings, than points: `most` of the fullest frame.
    """
    most = 0
    for t in range(len(offsets) - 1):
        most = max(most, offsets[t + 1] - offsets[t])
    from_, to = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    for t in range(1, len(offsets) - 1):
        # Only loose ends can be joined.
        ends, starts = 0, 0
        for a in range(offsets[t - 1], offsets[t]):
            if links.following[a] < 0:
                from_[ends] = a
                ends += 1
        for b in range(offsets[t], offsets[t + 1]):
            if links.previous[b] < 0:
                to[starts] = b
                starts += 1
        if ends == 0 or starts == 0:
            continue
        error = np.empty((ends, starts))
        for i in range(ends):
            for j in range(starts):
                error[i, j] = error_length(xyz, from_[i], to[j], links)
        for i in range(ends):
            j = np.argmin(error[i])
            a, b = from_[i], to[j]
            # the velocity must be known on both sides
            if links.previous[a] < 0 or links.following[b] < 0 or forbidden[b] == a:
                continue
            # What the track has jerked lately is how far its prediction may be off.
            gate = limits.noise + limits.usual_change + limits.residual_gain * recent_jerk(xyz, a, b, links)
            if error[i, j] > min(gate, limits.noise + limits.max_change):
                continue
            # A rival must be clearly farther, on both sides.
            least = limits.ratio_test * error[i, j] + limits.rival_gap
            unrivalled = True
            for other in range(starts):
                unrivalled = unrivalled and (other == j or error[i, other] > least)
            for other in range(ends):
                unrivalled = unrivalled and (other == i or error[other, j] > least)
            if unrivalled:
                links.following[a], links.previous[b] = b, a
