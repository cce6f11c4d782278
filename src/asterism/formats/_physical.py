"""Labels and positions of a file in; which points are markers on a body, computed by a model, or unnamed, out.

No list of exact names is complete, so families of names decide first (joint centres, segment axes, angles, ...), then geometry.
Computed points keep exact relations that no measured marker keeps: axes of one length stay at right angles, and midpoints stay in
the middle, to the last bit that the file stores. An uncertain point counts as a marker, because a missing marker costs more.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Floats, Ints, canonical, is_unnamed, plain_name, without_subject
from asterism.recording.arrays import nan_median

MARKER, COMPUTED, UNNAMED = "marker", "computed", "unnamed"

OTHER_UNIT = re.compile(
    r"k?n|n[. *-]?m?m|n(m|mm)?/kg|w(/kg)?|m?m/s(2|\^2|²)?|m?g|°|deg(rees?)?|(deg|°|rad)/s|dps|rad|[muµ]?v|a\.?u\.?|[muµ]?t|gauss|%|hz"
)
"""Units of forces, angles, speeds and signals. Seconds are none of them: a time column stands beside positions, too."""

_FRAMES_TESTED = 24
_FEWEST_FRAMES = 5
_EXACT = 1.5e-6
_VERY_EXACT = 3e-7
_RIGHT_ANGLE = 2e-4
_MOST_POINTS = 400
_LARGEST_ANGLE = 0.36
_STILL = 0.002
_ALONE, _ABSURD = 0.8, 20.0

_JOINT = r"(?:hip|knee|ankle|shoulder|elbow|wrist|h|k|a|s|e|w)"
_COMPUTED_NAME = re.compile(
    r".*(?:(?<!tri)(?<!rect)(?<!quadr)angles?|forces?|moments?|powers?|torques?|projections?|scalars?|leglength|archheight|archheightindex|normali[sz]edgrf"
    r"|progress(?:ion)?angles?|velocity|acceleration)\d*"
    r"|.*(?:centreof|centerof)(?:mass|pressure|gravity).*|(?:whole)?body?com|com|com[xyz]|cop|[lr]cop|cop[12lr]"
    rf"|(?:left|right|l|r)?{_JOINT}?joint(?:centre|center)\w*|(?:left|right|l|r)?{_JOINT}jc\w{{0,4}}|jc{_JOINT}?[lr]?|{_JOINT}jc(?:left|right|l|r)"
    r"|(?:left|right|l|r)?(?:hip|knee|ankle|shoulder|elbow|wrist)(?:centre|center)(?:left|right|l|r)?"
    r"|(?:left|right|l|r)?(?:hip|knee|ank(?:le)?|foot|pelvis|trunk|thorax|shoulder|elbow|wrist)"
    r"(?:ang|mom|pow|flex(?:ion)?|ext(?:ension)?|abd(?:uction)?|add(?:uction)?|rot(?:ation)?)[xyz]?\d*(?:left|right|l|r)?"
    r"|proj[lr]\w+|virtual.*|.*computed|[lr]?(?:prox|dist)(?:ff|hf)|[lr]?[fh]fplantar"
    r"|v(?:mid|pel|[lr](?:hi|kn|an|to|he|ha|sh|el|wr))"
)
_VIRTUAL = re.compile(r"v[._ -](?!.*sac).+", re.IGNORECASE)
_AXES = ("OALP", "0123", "OXYZ")
_ORIGINS = "O0"


def kinds_by_name(labels: Sequence[str]) -> list[str]:
    """For each label "marker", "computed" or "unnamed", from the names alone; the prefix of a subject is ignored.

    A name that ends in O, A, L or P (or O, X, Y, Z; or 0 to 3 without a fourth neighbour) is a segment's axis only where the
    whole family is present.
    """
    return list(_kinds_by_name(tuple(labels)))


# Each point of a file is judged more than once, and the trials of a session have the same points.
@lru_cache(maxsize=16)
def _kinds_by_name(labels: tuple[str, ...]) -> tuple[str, ...]:
    bare = [without_subject(label).strip() for label in labels]
    families = _families(bare)
    kinds = []
    for place, label in enumerate(bare):
        if is_unnamed(label):
            kinds.append(UNNAMED)
        elif _COMPUTED_NAME.fullmatch(canonical(label)) or _VIRTUAL.fullmatch(label):
            kinds.append(COMPUTED)
        else:
            # Axes of segments are computed only where the whole family is there: a single LKNEO may be a marker.
            kinds.append(COMPUTED if any(place in family for suffix, family in families if suffix == "OALP") else MARKER)
    return tuple(kinds)


def point_kinds(labels: Sequence[str], positions: Floats | None = None, declared: Collection[str] = ()) -> list[str]:
    """For each point "marker", "computed" or "unnamed".

    labels     (P,) of the file
    positions  (T, P, 3) m, NaN missing; None for rounded ones (integer files): then the names decide
    declared   labels that the file lists as angles, forces, moments, powers, scalars or modelled markers
    """
    listed = {plain_name(label) for label in declared} - {""}
    kinds = kinds_by_name(labels)
    for place, label in enumerate(labels):
        # What the file itself lists as computed needs no guess.
        if kinds[place] != UNNAMED and plain_name(label) in listed:
            kinds[place] = COMPUTED
    # Few frames show no exact relation, and very many points would take long.
    if positions is not None and len(positions) >= _FEWEST_FRAMES and len(labels) <= 20 * _MOST_POINTS:
        _judge_by_geometry([without_subject(label).strip() for label in labels], positions, kinds)
    return kinds


def _families(labels: Sequence[str]) -> list[tuple[str, dict[int, str]]]:
    """Sets of labels that differ in the last letter only and have all of a known set of endings: (endings, place -> ending)."""
    stems: dict[str, dict[str, int]] = {}
    for place, label in enumerate(labels):
        if len(label) >= 3:
            # Short labels have no stem that could tell a family.
            stems.setdefault(label[:-1], {}).setdefault(label[-1].upper(), place)
    found = []
    for endings in _AXES:
        for members in stems.values():
            if all(ending in members for ending in endings):
                found.append((endings, {members[ending]: ending for ending in endings}))
    return found


def _judge_by_geometry(labels: Sequence[str], positions: Floats, kinds: list[str]) -> None:
    points = [p for p, kind in enumerate(kinds) if kind != UNNAMED]
    if not 4 <= len(points) <= 20 * _MOST_POINTS:
        return
    # Relations that hold to the last bit in two dozen frames hold in all.
    frames = np.linspace(0, len(positions) - 1, min(_FRAMES_TESTED, len(positions))).astype(int)
    some = positions[frames]
    # The cheap tests come first and leave fewer points to the costly one.
    _mark_flat_values(some, points, kinds)
    _mark_far_values(some, [p for p in points if kinds[p] == MARKER], kinds)
    candidates = [p for p in points if kinds[p] == MARKER or _may_be_joint(labels[p])][:_MOST_POINTS]
    # Three axes and an origin are the least that can show a frame.
    if len(candidates) < 4:
        return
    wobble, seen = _wobble(some[:, candidates])
    # A diagonal of zeros is exact and says nothing.
    exact = (wobble < _EXACT) & (seen >= _FEWEST_FRAMES)
    np.fill_diagonal(exact, False)
    named = [labels[p] for p in candidates]
    judged = np.array([kinds[p] == COMPUTED for p in candidates])
    frames_found = _orthogonal_frames(named, some[:, candidates], exact, judged)
    _mark_frames(named, frames_found, wobble, seen, judged)
    _mark_twins_and_offsets(named, some[:, candidates], exact, judged)
    # Tips that end in 1 show that the model numbers its axes, so that a lone 0 is an origin.
    if any(named[tip][-1:] == "1" for _, tips in frames_found for tip in tips):
        for place, label in enumerate(named):
            if len(label) > 2 and label[-1] == "0" and not label[-2].isdigit():
                judged[place] |= not any(label[:-1] + digit in named for digit in "123456789")
    _mark_midpoints(some[:, candidates], judged)
    for place, point in enumerate(candidates):
        if judged[place]:
            kinds[point] = COMPUTED


def _may_be_joint(label: str) -> bool:
    return canonical(label).endswith("jc")


def _mark_flat_values(some: Floats, points: list[int], kinds: list[str]) -> None:
    """Powers and scalars: one coordinate, the others zero. Not used where most points lie in a plane."""
    values = some[:, points]
    present = np.isfinite(values[:, :, 0]).sum(axis=0) >= _FEWEST_FRAMES
    # A coordinate that is zero in every frame is one that the value does not have.
    flat = (np.where(np.isfinite(values), values, 0.0) == 0.0).all(axis=0).sum(axis=1) >= 1
    # A planar recording has a flat coordinate in all its points.
    if present.any() and (flat & present).sum() < 0.5 * present.sum():
        for point, is_flat in zip(points, flat & present, strict=True):
            if is_flat:
                kinds[point] = COMPUTED


def _mark_far_values(some: Floats, points: list[int], kinds: list[str]) -> None:
    """Undeclared angles and moments: values that change, far from every marker.

    An angle in degrees, read as millimetres, stays within 360 mm of the laboratory's origin, wherever the body is. A moment in newton
    millimetres is tens of metres away. Points that stay within 0.8 m of a marker, or do not move, stay markers.
    """
    values = some[:, points]
    present = np.asarray(np.isfinite(values[:, :, 0]))
    size = np.where(present, np.abs(values).max(axis=2), 0.0).max(axis=0)
    centre = nan_median(np.where((present.sum(axis=1) > 0)[:, None, None], values, 0.0), axis=1)
    offset = np.where(present, np.abs(values - centre[:, None]).max(axis=2), 0.0)
    # Near the origin wherever the body is, or tens of metres away: no marker is either.
    suspect = (size < _LARGEST_ANGLE) | ((offset > _ABSURD).sum(axis=0) > 0.5 * present.sum(axis=0))
    low = np.where(present[:, :, None], values, np.inf).min(axis=0)
    high = np.where(present[:, :, None], values, -np.inf).max(axis=0)
    # What stands still may be a marker on the floor.
    suspect &= (present.sum(axis=0) >= _FEWEST_FRAMES) & ((high - low).max(axis=1) > _STILL)
    if not suspect.any() or (~suspect).sum() < 4:
        return
    # Angles are told from markers by being alone: near a body a small value proves nothing.
    body = np.where(np.isfinite(values[:, ~suspect]), values[:, ~suspect], np.inf)
    for place in np.nonzero(suspect)[0]:
        with np.errstate(invalid="ignore"):
            nearest = np.linalg.norm(body - values[:, [place]], axis=2).min(axis=1)
        # A fifth of the frames is enough: an angle may pass by a marker now and then.
        if (nearest[present[:, place]] > _ALONE).mean() >= 0.2:
            kinds[points[place]] = COMPUTED


def _wobble(some: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """(P, P) m, the range of the distance of two points; and (P, P) the number of frames in which both are present.

    Where a few frames show that a distance is not exact, its range is that of these frames.
    """
    there: Floats = np.asarray(np.isfinite(some).all(axis=2), dtype=np.float64)
    seen = np.rint(there.T @ there).astype(np.int64)
    range_of = np.full(seen.shape, np.inf)
    one, other = np.triu_indices(len(seen), 1)
    # Three frames rule out nearly all pairs.
    for frames in (some[:: max(1, len(some) // 3)], some):
        low, high = np.full(len(one), np.inf), np.full(len(one), -np.inf)
        for frame in frames:
            # Frame by frame: all pairs in all frames at once would take too much memory.
            x, y, z = (own[one] - own[other] for own in frame.T)
            distance = np.sqrt(x * x + y * y + z * z)
            np.fmin(low, distance, out=low)
            np.fmax(high, distance, out=high)
        apart = np.where(high >= low, high - low, np.inf)
        range_of[one, other] = range_of[other, one] = apart
        left = (apart < _EXACT) | (high < low)
        one, other = one[left], other[left]
    np.fill_diagonal(range_of, 0.0)
    return range_of, seen


def _orthogonal_frames(
    labels: Sequence[str], some: Floats, exact: NDArray[np.bool_], judged: NDArray[np.bool_]
) -> list[tuple[int, tuple[int, int, int]]]:
    """Every (origin, three tips) whose tips stay at right angles and exact distances: a model's segment axes.

    The arms have one length, or the tips one name: a marker may lie on an axis that was defined by it.
    """
    stems = np.array([label[:-1] for label in labels])
    same_name = stems[:, None] == stems
    found = []
    # An origin keeps exact distances from its three tips.
    for origin in np.nonzero(exact.sum(axis=1) >= 3)[0].tolist():
        # More than two dozen exact neighbours are a solved rigid body, not axes.
        around = np.nonzero(exact[origin] & ~judged)[0][:24]
        # Three tips are the least; those of known names are judged already.
        if len(around) < 3:
            continue
        near = np.ix_(around, around)
        # Two frames show of most origins that nothing is square there.
        if _squares(some[:: len(some) - 1], origin, around, exact[near], same_name[near], 0).sum() < 6:
            continue
        square = _squares(some, origin, around, exact[near], same_name[near], _FEWEST_FRAMES)
        # Each pair of square arms once, and the third one square to both.
        for i, j in zip(*np.nonzero(np.triu(square)), strict=True):
            found += [
                (int(origin), (int(around[i]), int(around[j]), int(around[k]))) for k in np.nonzero(square[i] & square[j])[0] if k > j
            ]
    return found


def _squares(
    some: Floats, origin: int, around: Ints, exact: NDArray[np.bool_], same_name: NDArray[np.bool_], fewest: int
) -> NDArray[np.bool_]:
    """(n, n) which of the points around an origin are at right angles there in all frames, `fewest` of which show both."""
    arms = some[:, around] - some[:, [origin]]
    lengths = np.sqrt((arms * arms).sum(axis=2))
    with np.errstate(invalid="ignore", divide="ignore"):
        arms /= lengths[:, :, None]
        cosines = np.abs(arms @ arms.transpose(0, 2, 1))
        longer = np.fmax.reduce(np.abs(lengths[:, :, None] - lengths[:, None, :]), axis=0)
    same_length = ~(longer >= 2 * _EXACT)
    found = np.fmax.reduce(cosines, axis=0)
    return ~(found >= _RIGHT_ANGLE) & (np.isfinite(cosines).sum(axis=0) >= fewest) & exact & (same_length | same_name)


def _mark_frames(
    labels: Sequence[str],
    found: list[tuple[int, tuple[int, int, int]]],
    wobble: Floats,
    seen: NDArray[np.int64],
    judged: NDArray[np.bool_],
) -> None:
    """The tips of axes are computed, and an origin with their name, and a point at exact distances from them that is not an origin."""
    origins = {origin for origin, _ in found}
    for origin, tips in found:
        judged[list(tips)] = True
        # An origin without the tips' name may be a marker that defines the axes.
        judged[origin] |= any(labels[origin][:-1] == labels[tip][:-1] for tip in tips)
    for _, tips in found:
        attached = ((wobble[list(tips)] < _VERY_EXACT) & (seen[list(tips)] >= _FEWEST_FRAMES)).all(axis=0)
        for place in np.nonzero(attached)[0]:
            # Markers may sit at the origin of a frame, so that origins are spared.
            judged[place] |= int(place) not in origins


def _mark_twins_and_offsets(labels: Sequence[str], some: Floats, exact: NDArray[np.bool_], judged: NDArray[np.bool_]) -> None:
    """A copy of a computed point, and a point at an exact distance from one marker, whose name it extends (LANK1 from LANK).

    The name is not used where a point has exact distances from several markers, as on the solved rigid bodies of some systems.
    """
    one, other = np.nonzero(exact)
    # Two thousand pairs at once take little memory, and as little time for each as all would.
    apart = [np.abs(some[:, one[at : at + 2000]] - some[:, other[at : at + 2000]]) for at in range(0, len(one), 2000)]
    twins = np.concatenate([np.empty(0, dtype=bool), *(np.fmax.reduce(part, axis=(0, 2)) < _VERY_EXACT for part in apart)])
    for a, b, same in zip(one.tolist(), other.tolist(), twins.tolist(), strict=True):
        # Exact to one marker only: rigid bodies are exact among all of theirs.
        alone = (exact[b] & ~judged).sum() == 1
        extends = alone and labels[b] != labels[a] and labels[b].startswith(labels[a])
        if extends or (labels[b].upper().endswith("KAX") and labels[a].upper().endswith("KNE")):
            judged[b] = True
        elif same and judged[a] and not labels[a].startswith(labels[b]) and labels[a] != labels[b]:
            judged[b] |= labels[a][-1:] in _ORIGINS and not _is_plain_name(labels[b])


def _is_plain_name(label: str) -> bool:
    """Whether a name is letters without a number; such a marker is kept even where a model puts an origin onto it."""
    return re.fullmatch(r"[A-Za-z.]{2,}", label) is not None


def _mark_midpoints(some: Floats, judged: NDArray[np.bool_]) -> None:
    """A point exactly half-way between two markers in every frame is computed."""
    markers = np.nonzero(~judged & (np.isfinite(some[:, :, 0]).sum(axis=0) >= _FEWEST_FRAMES))[0]
    # Pairs grow with the square: beyond this, names must do.
    if not 3 <= len(markers) <= 150:
        return
    paths = some[:, markers]
    frame = paths[int(np.isfinite(paths[:, :, 0]).sum(axis=1).argmax())]
    i, j = np.triu_indices(len(markers), k=1)
    # One coordinate of one frame rules out nearly all triples, and the frame most others, before all frames are looked at.
    both = frame[i] + frame[j]
    order = np.argsort(both[:, 0])
    begin, end = (np.searchsorted(both[order, 0], 2 * frame[:, 0] + margin) for margin in (-4 * _EXACT, 4 * _EXACT))
    for k in np.flatnonzero(end > begin).tolist():
        near = order[begin[k] : end[k]]
        close = near[np.abs(both[near] - 2 * frame[k]).max(axis=1) < 4 * _EXACT]
        for a, b in zip(i[close], j[close], strict=True):
            error = np.abs(paths[:, a] + paths[:, b] - 2 * paths[:, k]).max(axis=1)
            distance = np.linalg.norm(paths[:, a] - paths[:, b], axis=1)
            seen = np.isfinite(error)
            # Two markers in one place have everything between them.
            if seen.sum() >= _FEWEST_FRAMES and k not in (a, b) and error[seen].max() < 4 * _EXACT and distance[seen].min() > 0.01:
                judged[markers[k]] = True
