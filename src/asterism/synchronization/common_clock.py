"""Blobs of cameras that are not triggered together in; blobs at common instants out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.recording.arrays import Floats, Ints
from asterism.recording.blobs import Blobs
from asterism.synchronization.known_paths import check_times


@dataclass(frozen=True)
class ClockRules:
    """How blobs of one camera are linked and interpolated.

    longest_gap  frame periods between two frames of a camera across which blobs are still interpolated; allows one lost image
    same         frame periods: a frame taken so near an instant is taken at it
    clear        a blob's successor must be nearer than this share of the next candidate's distance
    near_px      px, and `spreads` times the median: how far a link may be from where the motion leads
    spreads      see `near_px`

    Checked on the simulated cameras that take turns of tests/test_clock.py.
    """

    longest_gap: float = 2.5
    same: float = 1e-3
    clear: float = 0.5
    near_px: float = 4.0
    spreads: float = 8.0


RULES = ClockRules()


def to_common_clock(blobs: Blobs) -> Blobs:
    """Blobs of all cameras at the same instants, each interpolated along its own path through the images.

    Where the cameras' times of a frame differ by less than a frame period, frames keep their numbers and the instant of each is the mean of
    its times; else the instants are evenly spaced through the time that all cameras share, at the rate that half of the cameras have or
    exceed, and frames are numbered anew. In each camera
    blobs of neighbouring frames are linked where it is clear which belongs to which (nearest to where its motion leads, both ways, no
    second one near); linked blobs are interpolated by the cubic through four frames, by a line at the ends of a path. Blobs without a link
    are left out unless their frame was taken at the instant; so are those of frames without a time. Result: `times` has equal columns;
    sizes are interpolated too. Blobs whose times are None or equal come back as they are.

    Raises AsterismError where a camera's times do not increase, or the cameras share no time.

    >>> frame, camera = np.repeat(np.arange(5), 2), np.tile([0, 1], 5)
    >>> times = np.arange(5)[:, None] / 100 + [0.0, 0.004]  # the second camera is 4 ms late
    >>> xy = np.column_stack([1000 * times.ravel(), np.full(10, 50.0)])  # both see 1 px per ms
    >>> common = to_common_clock(Blobs.from_rows(frame, camera, xy, ("a", "b"), rate=100.0, times=times))
    >>> common.xy[common.frame_of == 2].round(6).tolist()
    [[22.0, 50.0], [22.0, 50.0]]
    """
    if blobs.times is None:
        return blobs
    times = blobs.times
    check_times(blobs)
    steps = [np.diff(column[np.isfinite(column)]) for column in times.T]
    periods = [float(np.median(own)) if len(own) else np.nan for own in steps]
    if np.isnan(periods).all():
        return blobs
    # Half of the cameras are as fast as this or faster: a few slow ones must not thin out what the others saw.
    period = float(np.nanquantile(periods, 0.5, method="lower"))
    periods = [period if np.isnan(own) else own for own in periods]
    instants, anew = _instants(blobs, times, period)
    frame_of, camera_of = blobs.frame_of, blobs.camera_of
    parts = []
    for c in range(len(blobs.cameras)):
        # A frame without a time has no place on any clock.
        taken = np.flatnonzero(np.isfinite(times[:, c]))
        mine = np.flatnonzero((camera_of == c) & np.isfinite(times[frame_of, c]))
        order = np.searchsorted(taken, frame_of[mine])
        frame, xy, sizes = _at(instants, times[taken, c], order, blobs.xy[mine], blobs.sizes[mine], periods[c])
        parts.append((frame, np.full(len(frame), c), xy, sizes))
    frame, camera, xy, sizes = (np.concatenate(column) for column in zip(*parts, strict=True))
    same = np.repeat(instants[:, None], len(blobs.cameras), axis=1)
    rate = 1.0 / period if anew else blobs.rate
    common = Blobs.from_rows(frame, camera, xy, blobs.cameras, rate=rate, sizes=sizes, frames=len(instants), times=same)
    return replace(common, first_frame=0 if anew else blobs.first_frame)


def _instants(blobs: Blobs, times: Floats, period: float) -> tuple[Floats, bool]:
    """The instants (T,) s to interpolate to, and whether they are no longer the frames that they were."""
    known = np.isfinite(times)
    some = known.any(axis=1)
    middle = np.full(len(times), np.nan)
    middle[some] = np.nanmedian(times[some], axis=1)
    if np.nanmax(np.abs(times - middle[:, None])) < period:
        # A camera that took no frame must not pull the mean: what it is ahead or behind on average is taken off first.
        offsets = np.array([np.median((times[:, c] - middle)[known[:, c]]) if known[:, c].any() else 0.0 for c in range(times.shape[1])])
        centred = times - offsets + np.mean(offsets[known.any(axis=0)])
        mean = np.full(len(times), np.nan)
        mean[some] = np.nanmean(centred[some], axis=1)
        if (np.nanmax(times[some], axis=1) == np.nanmin(times[some], axis=1)).all():
            mean = middle
        return np.interp(np.arange(len(times)), np.flatnonzero(some), mean[some]), False
    seen = [column[np.isfinite(column)] for column in times.T]
    # Only the time that all cameras share, since a point needs more than one of them.
    start, end = max(column[0] for column in seen if len(column)), min(column[-1] for column in seen if len(column))
    if end < start:
        first = min((column[-1], name) for column, name in zip(seen, blobs.cameras, strict=True) if len(column))[1]
        raise AsterismError(f"camera {first} ends before another one starts; give times by one clock for all cameras.")
    return start + period * np.arange(int((end - start) / period + 1e-6) + 1), True


def _at(instants: Floats, when: Floats, order: Ints, xy: Floats, sizes: Floats, period: float) -> tuple[Ints, Floats, Floats]:
    """One camera's blobs at the instants: frame (N,), xy (N, 2) px, sizes (N,) px.

    when (F,) s: its frames' times; order (n,): which of these frames each blob belongs to, ascending.
    """
    starts = np.searchsorted(order, np.arange(len(when) + 1))
    following = link(when, order, xy, RULES.longest_gap * period)
    left = np.searchsorted(when, instants - RULES.same * period, side="right") - 1
    nearest = np.clip(left + np.array([[0], [1]]), 0, len(when) - 1)
    nearest = np.where(np.abs(when[nearest[0]] - instants) <= np.abs(when[nearest[1]] - instants), nearest[0], nearest[1])
    # A blob taken at the instant needs no path, so that a triggered camera loses none.
    exact = np.abs(when[nearest] - instants) <= RULES.same * period

    at = np.flatnonzero(exact)
    there, blobs = _pairs(at, starts[nearest[at]], starts[nearest[at] + 1])
    at = np.flatnonzero(~exact & (left >= 0) & (left < len(when) - 1))
    between, start = _pairs(at, starts[left[at]], starts[left[at] + 1])
    linked = following[start] >= 0
    between, start = between[linked], start[linked]
    end = following[start]
    share = (instants[between] - when[order[start]]) / (when[order[end]] - when[order[start]])
    return (
        np.concatenate([there, between]),
        np.concatenate([xy[blobs], _between(instants[between], when, order, xy, start, following)]),
        np.concatenate([sizes[blobs], (1 - share) * sizes[start] + share * sizes[end]]),
    )


def _pairs(frames: Ints, starts: Ints, ends: Ints) -> tuple[Ints, Ints]:
    """Each frame with each of its blobs, those from start to end."""
    counts = ends - starts
    first = np.repeat(starts - np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else starts, counts)
    return np.repeat(frames, counts), first + np.arange(int(counts.sum()))


def _between(instants: Floats, when: Floats, order: Ints, xy: Floats, start: Ints, following: Ints) -> Floats:
    """Where linked blobs are at an instant between their frames: on the polynomial through four blobs of their path, fewer at its ends."""
    before = np.full(len(xy), -1)
    before[following[following >= 0]] = np.flatnonzero(following >= 0)
    end = following[start]
    path = np.stack([before[start], start, end, following[end]])
    known = path >= 0
    knots = when[order[path]]
    # Lagrange's weights over those of the four blobs that the path has.
    weights = known.astype(np.float64)
    for k in range(4):
        for other in range(4):
            if other != k:
                both = known[k] & known[other]
                apart = np.where(both, knots[k] - knots[other], 1.0)
                weights[k] *= np.where(both, (instants - knots[other]) / apart, 1.0)
    placed: Floats = np.einsum("kn,kni->ni", weights, xy[path])
    return placed


def link(when: Floats, order: Ints, xy: Floats, longest: float) -> Ints:
    """Which blob of the next frame each blob of one camera becomes, -1 where none or where that is not clear: (n,).

    when (F,) s; order (n,) frame of each blob, ascending; xy (n, 2) px; longest s between frames that are linked. First by the nearest
    blob, then by the nearest to where each would be at the speed that the first links tell. Costs two searches in a tree: n log n.
    """
    following = _nearest(when, order, xy, np.zeros_like(xy), longest)
    speed = np.zeros_like(xy)
    count = np.zeros(len(xy))
    here = np.flatnonzero(following >= 0)
    moved = (xy[following[here]] - xy[here]) / (when[order[following[here]]] - when[order[here]])[:, None]
    for end in (here, following[here]):
        speed[end] += moved
        count[end] += 1
    return _nearest(when, order, xy, speed / np.maximum(count, 1)[:, None], longest)


def _nearest(when: Floats, order: Ints, xy: Floats, speed: Floats, longest: float) -> Ints:
    from scipy.spatial import cKDTree

    following = np.full(len(xy), -1)
    if len(xy) < 2:
        return following
    # Frames lie so far apart in a third coordinate that one tree answers for all frames at once.
    far = 10.0 * (np.ptp(xy) + 1.0)
    tree = cKDTree(np.column_stack([xy, far * order]))
    step = np.diff(when, append=np.inf)

    def look(toward: int) -> tuple[Ints, Floats]:
        """The blob of the next (1) or last (-1) frame nearest to each one's way, -1 where none; how far it is, inf where not clear."""
        took = step[order] if toward > 0 else np.concatenate([[np.inf], step[:-1]])[order]
        open_ = took <= longest
        way = np.where(open_[:, None], toward * speed * np.where(open_, took, 0.0)[:, None], 0.0)
        distance, nearest = tree.query(np.column_stack([xy + way, far * (order + toward)]), k=2, distance_upper_bound=0.5 * far)
        found = open_ & np.isfinite(distance[:, 0])
        distance[~found | ~(distance[:, 0] < RULES.clear * distance[:, 1]), 0] = np.inf
        return np.where(found, nearest[:, 0], -1), distance[:, 0]

    (ahead, miss), (back, _) = look(1), look(-1)
    clear = (ahead >= 0) & np.isfinite(miss)
    # Both must choose each other: where two markers cross, one of them is left open rather than wrong.
    clear[clear] = back[ahead[clear]] == np.flatnonzero(clear)
    # What moved much further than most did is another marker that happened to be the only one near.
    if clear.any():
        clear &= miss <= RULES.near_px + RULES.spreads * np.median(miss[clear])
    following[clear] = ahead[clear]
    return following
