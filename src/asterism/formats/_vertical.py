"""The vertical, from positions alone: (frames, points, 3) in, a unit vector or None out."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats, canonical, without_subject
from asterism.recording.arrays import nan_median, nan_quantile

_MOST_FRAMES = 400
_FRAMES_AT_ONCE = 10_000
_SURE_SHARE = 0.85
_LIKELY_SHARE = 0.6
_PELVIS = 2

_SIDE = r"(?:left|right|l|r|v|m)?"
_TAIL = r"(?:left|right|lat|med|tip|sup|l|r|m|\d)*"
_LEVELS = (
    r"toe|bigtoe|toetip|heel|hee|ank|ankle|mal|malleolus|latmal|medmal|lmal|mmal|llmal|lmmal|malllat|mall|mallm|latankle|medankle|mt|mtp|meta|5meta|"
    r"calc|cal|hlx|p1m|p5m|d5m|p1mt|p5mt|mfoot|foot|midfoot|midfootsup|midfootlat|cca|lca|stl|hindfoot|ajc|mh|mfh|spm|sph|tt",
    r"kne|knee|kneel|kneem|lfe|mfe|lfc|mfc|latknee|medknee|kneelat|kneemed|pat|kjc|epicondyle",
    r"asi|asis|psi|psis|sacr|sacral|sacrum|sac|s2|pelvis|iliac|iliaccrest|ilcrest|icr|ic|waist|fwt|bwt|fwaist|bwaist|trochanter|troc|gtroc|hip",
    r"sho|shoulder|acr|acrom|acromion|c7|clav|clavicle|t1|t2|strn|ster|stern|sternum|sternnotch|manubrium|man|xiph|str|sel|sup",
    r"fhd|bhd|head|headl|headr|headfront|hv|occ|temp|glab|tophead|fronthead|rearhead|backhead|headback|headtop|nose|chin",
)
_LEVEL_PATTERNS = tuple(re.compile(f"{_SIDE}(?:{cores}){_TAIL}") for cores in _LEVELS)


@dataclass(frozen=True)
class VerticalEstimate:
    """What the positions show of the vertical: a unit vector or None, and whether two independent signs agree on it."""

    vector: Floats | None
    certain: bool = False


def vertical_from_positions(positions: Floats, labels: Sequence[str] = ()) -> Floats | None:
    """The axis that points up, from how a body stands and moves, or None where that does not show.

    positions  (T, P, 3) in any one unit, NaN missing: physical markers only
    labels     (P,) names, as far as there are any

    Returns a unit vector along one of the six axis directions, never a tilted one. See `estimate_vertical`.
    """
    return estimate_vertical(positions, labels).vector


def estimate_vertical(positions: Floats, labels: Sequence[str] = ()) -> VerticalEstimate:
    """`vertical_from_positions`, and whether two signs agree.

    Three signs: recognised names (head, shoulder, pelvis, knee, foot) vote by the majority of the frames; the floor is where
    everything lies above zero and often just above it; a body is longest upwards, and its end on the floor stands still
    from time to time. Where names contradict the floor (a person who lies), the result is None.
    """
    positions = np.asarray(positions, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[0] == 0 or positions.shape[1] < 3:
        # Fewer than three points show no body.
        return VerticalEstimate(None)
    if np.isinf(positions).any():
        positions = np.where(np.isfinite(positions), positions, np.nan)
    if np.isnan(positions).all():
        return VerticalEstimate(None)
    # Frames without a point give NaN, and NumPy would warn of each.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        named, share = _by_names(positions, labels) if len(labels) == positions.shape[1] else (None, 0.0)
        above, floored = _by_floor(positions)
        shaped = _by_shape(positions)
        # Names say most, but the floor must not contradict them: a person may lie.
        if named is not None and share >= _SURE_SHARE:
            if above is not None and above != named:
                return VerticalEstimate(None)
            return VerticalEstimate(_unit(*named), certain=named == above)
        # The floor alone is sure only with a second sign.
        if floored is not None:
            return VerticalEstimate(_unit(*floored), certain=floored == above and floored in (shaped, named))
        if named is not None and share >= _LIKELY_SHARE:
            return VerticalEstimate(_unit(*named))
        if shaped is not None:
            return VerticalEstimate(_unit(*shaped))
        # All above zero is the weakest sign: a laboratory may be above zero in several directions.
        return VerticalEstimate(_unit(*above) if above is not None and _long_axis(positions) in (None, above[0]) else None)


def _by_names(positions: Floats, labels: Sequence[str]) -> tuple[tuple[int, bool] | None, float]:
    """The direction from low to high parts of the body in most frames, and the share of the frames that agree."""
    levels = np.array([_level(label) for label in labels])
    known = [level for level in range(len(_LEVELS)) if (levels == level).any()]
    # Two levels above the pelvis are too near to each other to tell up from ahead.
    if len(known) < 2 or known[0] > _PELVIS:
        return None, 0.0
    some = _sampled(positions)
    heights = [np.nanmean(some[:, levels == level], axis=1) for level in known]
    # Each pair of levels votes with the distance between them, so that far ones count more.
    steps = np.stack([high - low for i, low in enumerate(heights) for high in heights[i + 1 :]])
    rise = np.nansum(steps, axis=0)
    rise = rise[np.linalg.norm(rise, axis=1) > 0]
    if len(rise) == 0:
        return None, 0.0
    axis = np.abs(rise).argmax(axis=1)
    votes = np.zeros((3, 2))
    np.add.at(votes, (axis, (rise[np.arange(len(rise)), axis] < 0).astype(int)), 1)
    best = np.unravel_index(votes.argmax(), votes.shape)
    share = float(votes[best] / len(rise))
    # Without the pelvis two levels may be a bent limb, which is never sure.
    return (int(best[0]), bool(best[1])), share if len(known) > 2 or _PELVIS in known else min(share, _LIKELY_SHARE)


def _by_floor(positions: Floats) -> tuple[tuple[int, bool] | None, tuple[int, bool] | None]:
    """The only direction in which all lies above zero, and the only one in which it also rests on a floor at zero; None for several."""
    ends = nan_quantile(_sampled(positions).reshape(-1, 3), [0.005, 0.05, 0.95, 0.995], axis=0)
    above, resting = [], []
    for axis in range(3):
        for down in (False, True):
            # Down is up for the negated coordinate, its ends in reverse.
            low, lowish, _, high = -ends[::-1, axis] if down else ends[:, axis]
            reach = high - low
            # A little below zero is noise of the floor; far above is no floor at all.
            if reach > 0 and -0.03 * reach <= low <= reach:
                above.append((axis, down))
                # Many points just above the lowest are feet that rest.
                if low <= 0.2 * reach and lowish - low <= 0.06 * reach:
                    resting.append((axis, down))
    return (above[0] if len(above) == 1 else None), (resting[0] if len(resting) == 1 else None)


def _long_axis(positions: Floats) -> int | None:
    some = _sampled(positions)
    high, low = nan_quantile(some, [0.97, 0.03], axis=1)
    extents = nan_median(high - low, axis=0)
    order = np.argsort(extents)[::-1]
    # An axis that is hardly longer than the next one is no sign: a person may bend.
    return int(order[0]) if extents[order[0]] > 1.15 * extents[order[1]] else None


def _by_shape(positions: Floats) -> tuple[int, bool] | None:
    """The axis along which a frame's points extend furthest; its lower end is at zero height, or where points stand still."""
    axis = _long_axis(positions)
    if axis is None:
        return None
    along = positions[:, :, axis]
    bottom, lowish, highish, top = nan_quantile(along.ravel(), [0.01, 0.05, 0.95, 0.99], axis=0)
    length = top - bottom
    # Only one end at zero says which way the floor is.
    at_floor = abs(bottom) < 0.12 * length, abs(top) < 0.12 * length
    if at_floor[0] != at_floor[1]:
        return axis, bool(at_floor[1])
    # Points gather at the floor, and thin out at the head.
    sharpness = (lowish - bottom) / length, (top - highish) / length
    if (bottom > 0 or top < 0) and sharpness[int(top < 0)] <= 0.06:
        return axis, bool(top < 0)
    speed = np.empty(along[1:].shape)
    # In parts: the speeds of an hour at once would double the memory.
    for start in range(0, len(speed), _FRAMES_AT_ONCE):
        some = positions[start : start + _FRAMES_AT_ONCE + 1]
        speed[start : start + _FRAMES_AT_ONCE] = np.linalg.norm(np.diff(some, axis=0), axis=2)
    place = (along[:-1] - np.nanmin(along[:-1], axis=1, keepdims=True)) / length
    seen = np.isfinite(speed) & np.isfinite(place)
    ends = speed[seen & (place < 0.15)], speed[seen & (place > 0.85)]
    # A few samples say nothing of who stands still.
    if min(map(len, ends)) < 20:
        return None
    still = [float(nan_quantile(end, 0.25, axis=0)[0]) for end in ends]
    # Feet stand still between steps, hands and head hardly ever.
    return (axis, bool(still[1] < still[0])) if max(still) > 1.3 * min(still) else None


def _level(label: str) -> int:
    name = canonical(without_subject(label))
    return next((level for level, pattern in enumerate(_LEVEL_PATTERNS) if pattern.fullmatch(name)), -1)


def _sampled(positions: Floats) -> Floats:
    return positions[:: max(1, len(positions) // _MOST_FRAMES)]


def _unit(axis: int, downwards: bool) -> Floats:
    vector = np.zeros(3)
    vector[axis] = -1.0 if downwards else 1.0
    return vector
