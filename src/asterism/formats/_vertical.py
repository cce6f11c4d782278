"""The vertical, from positions and names: (frames, points, 3) in, how likely each axis points up out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Floats, plain_name
from asterism.recording.arrays import nan_mean, nan_median, nan_quantile

SAMPLED_FRAMES = 2_000
"""Frames, evenly spread, that tell the vertical of a recording, however long it is: `info` and the reader of long files see the same."""

_MOST_FRAMES = 100
"""Frames, evenly spread, in which the signs are looked for. With four times as many the same axis is the likeliest in each of 135 files."""
_PELVIS = 2
_FLOOR = 0.03
"""Thickness of a floor in sizes of what a frame shows: 6 cm for a person. At half of it the heels of some sets miss it, at double the
ankles are on it."""

_AT_ZERO = 0.05
"""Distance of a floor from zero height, in such sizes, at which zero is no sign any more: 10 cm for a person."""

_WEIGHTS = {"level": 0.7, "many": 2.25, "zero": 5.0, "travel": 1.4, "extent": 1.5, "still": 2.2, "named": 1.2}
"""Log odds for one unit of each sign of `signs_of`. Fitted as one conditional logit over the six axes, to recordings of other people than
those that judge it: whole, cut to 0.3 to 3 s and to one frame, with half of the markers, without names, in pieces, moved in the room, and
two people merged. At half of them or double nearly the same axes win; what changes is how sure they are."""

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

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
"""(6, 3) the directions that may point up."""

_HALVING = 3.0
"""Points of a frame that halve the chance that they are no body but a thing, of which the signs say nothing: 0.5 for three points, 0.03 for
fifteen. At half of it five points of a wand turn a declaration over, at double the fifteen of a walker do not."""

_LYING = 0.02
"""Share of recordings in which somebody lies or crawls most of the time, so that names and length say nothing of up: 3 of 143. At half of
it more people who lie are stood up against their file; at double more standing ones stay as a wrong file has them. Both are told."""
_OF_POSTURE = ("named", "extent")

LIKELIER = 0.5
"""Probability from which an axis is taken: it is likelier than all others together."""


@dataclass(frozen=True)
class VerticalEvidence:
    """What is said for each of `AXES`, nats: by all signs (6,), and by names alone (6,); zeros where nothing is."""

    total: Floats
    named: Floats


def vertical_from_positions(positions: Floats, labels: Sequence[str] = ()) -> Floats | None:
    """The axis that points up, from how a body stands and moves, or None where that does not show.

    positions  (T, P, 3) in any one unit, NaN missing: physical markers only
    labels     (P,) names, as far as there are any

    Returns a unit vector along one of the six axis directions, never a tilted one. See `vertical_evidence`.
    """
    chances = chances_of(vertical_evidence(positions, labels).total)
    return AXES[chances.argmax()].copy() if chances.max() >= LIKELIER else None


def vertical_evidence(positions: Floats, labels: Sequence[str] = ()) -> VerticalEvidence:
    """What positions and names say for each of `AXES` pointing up.

    positions (T, P, 3) in any one unit, NaN missing; labels (P,), or none. The signs are those of a body under gravity: many of its points
    touch one floor, and touch it again over time; points on the floor do not move up and down; a body travels along the floor; it is
    longest upwards; laboratories put zero on the floor; and heads are above feet, where names tell them. O(frames * points), of at most
    200 frames.
    """
    positions = np.asarray(positions, dtype=np.float64)
    signs = {name: _WEIGHTS[name] * sign for name, sign in signs_of(positions, labels).items()}
    if not signs:
        return VerticalEvidence(np.zeros(6), np.zeros(6))
    points = np.isfinite(positions[:: max(1, len(positions) // _MOST_FRAMES), :, 0]).sum(axis=1)
    thing = 0.5 ** (float(nan_median(points[points >= 3].astype(np.float64), axis=0)) / _HALVING) if (points >= 3).any() else 1.0
    upright = chances_of(np.sum(list(signs.values()), axis=0))
    lying = chances_of(np.sum([sign for name, sign in signs.items() if name not in _OF_POSTURE], axis=0))
    total = np.log((1.0 - thing) * 6.0 * ((1.0 - _LYING) * upright + _LYING * lying) + thing)
    return VerticalEvidence(total, signs.get("named", np.zeros(6)))


def signs_of(positions: Floats, labels: Sequence[str] = ()) -> dict[str, Floats]:
    """Each sign of `vertical_evidence`, (6,) for `AXES`, before it is weighted; none where the positions show no body."""
    positions = np.asarray(positions, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[0] == 0 or positions.shape[1] < 3:
        # Fewer than three points show no body.
        return {}
    some = positions[:: max(1, len(positions) // SAMPLED_FRAMES)]
    first = np.arange(0, max(1, len(some) - 1), max(1, len(some) // _MOST_FRAMES))
    now, then = some[first], some[np.minimum(first + 1, len(some) - 1)]
    # Infinite coordinates are no places.
    now = np.where(np.isfinite(now).all(axis=2, keepdims=True), now, np.nan)
    then = np.where(np.isfinite(then).all(axis=2, keepdims=True), then, np.nan)
    shows = (~np.isnan(now[:, :, 0])).sum(axis=1) >= 3
    now, then = now[shows], then[shows]
    if not len(now):
        return {}
    # Columns without a point in these frames give NaN, and NumPy would warn of each.
    with np.errstate(divide="ignore", invalid="ignore"):
        signs = _by_place(now, then)
        if signs and len(labels) == positions.shape[1]:
            signs["named"] = _by_names(now, labels)
    return {name: np.nan_to_num(sign) for name, sign in signs.items()}


def chances_of(evidence: Floats, before: Floats | None = None) -> Floats:
    """(6,) the probability of each of `AXES`, from evidence (6,) nats and probabilities before it (6,); all alike by default."""
    total = evidence if before is None else evidence + np.log(before)
    likely = np.exp(total - total.max())
    return np.asarray(likely / likely.sum())


def axis_of(vertical: Floats) -> int:
    """The place in `AXES` of the axis that is nearest to a direction."""
    return int((AXES @ vertical).argmax())


def _by_place(now: Floats, then: Floats) -> dict[str, Floats]:
    """Each sign of up but the names', (6,) for `AXES`; none where all points are in one place.

    now, then  (T, P, 3) some frames, and the one after each
    """
    high, low, middle = nan_quantile(now, [0.97, 0.03, 0.5], axis=1)
    extent = nan_median(high - low, axis=0)
    size = float(np.linalg.norm(extent))
    if not size > 0:
        return {}
    travel = np.subtract(*nan_quantile(middle, [0.95, 0.05], axis=0)) / size
    step = np.linalg.norm(then - now, axis=2)
    # In frames in which nobody moves, nothing can stand still.
    moving = nan_median(step, axis=1) > 0.001 * size
    both = [_along(sign * now[:, :, axis], then[:, :, axis] - now[:, :, axis], moving, size) for axis in range(3) for sign in (1.0, -1.0)]
    signs = {name: np.array([one[name] for one in both]) for name in both[0]}
    signs["travel"] = np.repeat(-np.log1p(travel), 2)
    signs["extent"] = np.repeat(np.log(extent / size + 0.05), 2)
    return signs


def _along(height: Floats, rise: Floats, moving: NDArray[np.bool_], size: float) -> dict[str, float]:
    """The signs of one direction. height, rise (T, P) along it; moving (T,) bool."""
    low, top = np.fmin.reduce(height, axis=1), np.fmax.reduce(height, axis=1)
    # A tenth of the frames may be below: jumps down from something, and ghosts.
    floor, late = nan_quantile(low, [0.1, 0.9], axis=0)
    # The lowest of each frame that reaches the floor: who travels passes any place with all points.
    near = (height < low[:, None] + _FLOOR * size) & (np.abs(low - floor) < _FLOOR * size)[:, None]
    seen = np.isfinite(height)
    of_points = near.sum(axis=0)
    shares = of_points[of_points > 0] / of_points.sum()
    place = (height - low[:, None]) / (top - low)[:, None]
    known = seen & np.isfinite(rise) & np.isfinite(place) & moving[:, None]
    down = known & (place < 0.15)
    still = 0.0
    # A few samples say nothing of what stands still.
    if down.sum() >= 20:
        noise = 0.0003 * size
        ratio = (float(nan_median(np.abs(rise[known]), axis=0)) + noise) / (
            float(nan_quantile(np.abs(rise[down]), 0.25, axis=0)[0]) + noise
        )
        still = float(np.clip(np.log(ratio), -2.0, 3.0) * moving.mean())
    return {
        # the lowest point of each frame stays at one height
        "level": -float(np.log((late - floor) / size + 0.01)),
        # entropy: how many points take part, also where each is in many pieces
        "many": -float((shares * np.log(shares)).sum()),
        "zero": float(np.exp(-0.5 * (floor / (_AT_ZERO * size)) ** 2)),
        "still": still,
    }


def _by_names(now: Floats, labels: Sequence[str]) -> Floats:
    """(6,) the mean cosine between each axis and the way from low to high parts of the body; zeros where names tell none."""
    levels = np.array([level_of(label) for label in labels])
    known = [level for level in range(len(_LEVELS)) if (levels == level).any()]
    # Two levels above the pelvis are too near to each other to tell up from ahead.
    if len(known) < 2 or known[0] > _PELVIS:
        return np.zeros(6)
    heights = [nan_mean(now[:, levels == level], axis=1) for level in known]
    # Each pair of levels votes with the distance between them, so that far ones count more.
    rise = np.nansum(np.stack([high - low for i, low in enumerate(heights) for high in heights[i + 1 :]]), axis=0)
    length = np.linalg.norm(rise, axis=1, keepdims=True)
    if not (length > 0).any():
        return np.zeros(6)
    cosine = (rise / np.where(length > 0, length, np.inf)).mean(axis=0) * (len(length) / (length > 0).sum())
    # Without the pelvis two levels may be a bent limb.
    return np.asarray(-np.log(1.0 - AXES @ cosine + 0.05) * (1.0 if len(known) > 2 or _PELVIS in known else 0.6))


def level_of(label: str) -> int:
    """The level of the body that a label names: 0 foot, 1 knee, 2 pelvis, 3 shoulder, 4 head; -1 none."""
    name = plain_name(label)
    return next((level for level, pattern in enumerate(_LEVEL_PATTERNS) if pattern.fullmatch(name)), -1)
