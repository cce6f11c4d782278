"""Recordings of one person in; markers whose names differ between them, as stiff groups laid on each other show, out.

A head, a plate, a foot keep their shape. Laid on the same person's other recording (least squares, without a mirror image), it fits as
named, or it fits under other names: then one of the two recordings carries wrong ones throughout. Neither posture nor movement, nor
anybody else's body takes part in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import best_rotation
from asterism.recording import Floats, Ints

STIFF = 0.012
"""m by which the distance of two markers of a stiff part varies at most, from the 10th to the 90th of a hundred frames. Skin moves by 5 to
10 mm: at half of it most thighs have no group, at double forearms that turn get one."""
NEAREST = 0.5
"""m between two markers of a group at most: the length of a thigh. At half, legs have no group; at double, trunk and head would be one."""
LARGEST = 5
"""Markers of a group: all 120 orders are tried. Six have 720, and tell no more."""
SHARE, CLEARLY = 0.3, 0.003
"""Other names must bring the misfit to this share, and by so many metres less. Real pairs of names left 2 to 25 % of it (4 to 107 mm as
named); of 30 people with right names none came below 45 %. At half of the share heads would be missed, at double skin would tell."""
OTHERS = 6
"""Recordings that each one is compared with at most: with 2 a wrong one could tie, with 12 the time doubles and no answer changed."""
FRAMES = 200
"""Frames of a recording that are compared, evenly spread: shapes are means."""


@dataclass(frozen=True)
class OtherNames:
    """What a group of markers says of two recordings.

    group     places of its markers
    order     for each of them the marker whose name it carries in the second recording, where the first is right; or the other way round
    named     m, root mean square misfit as named
    exchanged m, under the other names
    """

    group: tuple[int, ...]
    order: tuple[int, ...]
    named: float
    exchanged: float

    @property
    def moved(self) -> frozenset[int]:
        """Markers that carry another's name; empty where all fit as named."""
        return frozenset(a for a, b in zip(self.group, self.order, strict=True) if a != b)

    @property
    def gain(self) -> float:
        """nats by which the other names explain the group better."""
        return 3.0 * len(self.group) * float(np.log(self.named / max(self.exchanged, 1e-4)))

    def cycles(self) -> list[tuple[int, ...]]:
        """The markers that pass their names round among each other, those of two first."""
        following, found = dict(zip(self.group, self.order, strict=True)), list[tuple[int, ...]]()
        left = set(self.moved)
        while left:
            cycle, at = list[int](), min(left)
            while at in left:
                left.remove(at)
                cycle.append(at)
                at = following[at]
            found.append(tuple(sorted(cycle)))
        return sorted(found, key=lambda cycle: (len(cycle), cycle))


def compared(one: Floats, other: Floats) -> list[OtherNames]:
    """What every stiff group says of two recordings (T, M, 3) m of one person; the clearest of those that say that names differ come first.

    O(M^2 F) for the groups, and up to 120 least squares for each.
    """
    if len(one) == 0 or len(other) == 0:
        return []
    found = []
    for group in _groups([one, other]):
        shape, shape_of_other = _shape(one[:, group]), _shape(other[:, group])
        if shape is None or shape_of_other is None:
            continue
        orders = np.array(list(permutations(range(len(group)))))
        misfits = _misfits(shape, shape_of_other[orders])
        best = int(np.argmin(misfits))
        # The first order is that of the names as they are.
        clearly = misfits[best] < SHARE * misfits[0] and misfits[0] - misfits[best] > CLEARLY
        order = orders[best] if clearly else orders[0]
        found.append(OtherNames(group, tuple(group[place] for place in order), float(misfits[0]), float(misfits[best])))
    return sorted(found, key=lambda one: (not one.moved, -one.gain, one.group))


@dataclass(frozen=True)
class Contradiction:
    """Names that differ between recordings of one person.

    recordings  those that carry the wrong names, by the count; or all that take part, where the count does not tell
    certain     whether it tells
    names       what differs
    """

    recordings: tuple[int, ...]
    certain: bool
    names: OtherNames


@dataclass(frozen=True)
class LaidOnEachOther:
    """What the stiff groups of one person's recordings say of each other, by pairs (i, j) of recordings."""

    said: dict[tuple[int, int], list[OtherNames]]
    recordings: int

    def contradictions(self) -> list[Contradiction]:
        """A recording is wrong where it contradicts more than half of those that it is compared with in these markers."""
        told: dict[frozenset[int], dict[tuple[int, int], OtherNames]] = {}
        for pair, groups in self.said.items():
            taken: set[int] = set()
            for one in groups:
                # A marker has one name: the clearest group that moves it says which.
                if one.moved and not one.moved & taken:
                    taken |= one.moved
                    told.setdefault(one.moved, {})[pair] = one
        found = []
        for moved, pairs in told.items():
            able = [pair for pair, groups in self.said.items() if any(moved <= set(one.group) for one in groups)]
            against, compared_with = (
                np.bincount(np.ravel(some).astype(np.int64), minlength=self.recordings) for some in (list(pairs), able)
            )
            wrong = np.nonzero(2 * against > compared_with)[0]
            # Of two recordings each contradicts all others, so that the count tells nothing.
            certain = bool(0 < len(wrong) < np.count_nonzero(compared_with))
            chosen = wrong if certain else np.nonzero(against)[0]
            found.append(Contradiction(tuple(chosen.tolist()), certain, max(pairs.values(), key=lambda one: one.gain)))
        return sorted(found, key=lambda one: (-one.names.gain, one.recordings))

    def settled(self, number: int, pairs: Ints) -> NDArray[np.bool_]:
        """(P,) whether both markers of a pair lie in a stiff group of this recording and another one."""
        groups = [set(one.group) for pair, some in self.said.items() if number in pair for one in some]
        return np.array([any({a, b} <= group for group in groups) for a, b in pairs.tolist()], dtype=bool).reshape(len(pairs))


def laid_on_each_other(frames: Sequence[Floats]) -> LaidOnEachOther:
    """Recordings (T, M, 3) m of one person, each compared with `OTHERS` others at most."""
    count = len(frames)
    pairs = {tuple(sorted((i, (i + step) % count))) for i in range(count) for step in range(1, OTHERS // 2 + 1)}
    return LaidOnEachOther({(i, j): compared(frames[i], frames[j]) for i, j in sorted(pairs) if i != j}, count)


def stiff_pairs(recordings: Sequence[Floats]) -> tuple[NDArray[np.bool_], Floats]:
    """(M, M) pairs of markers that keep their distance in each of some recordings (T, M, 3) m, and (M, M) m how far apart they are."""
    markers = recordings[0].shape[1]
    varies, apart = np.zeros((markers, markers)), np.zeros((markers, markers))
    for recording in recordings:
        some = recording[np.unique(np.linspace(0, len(recording) - 1, FRAMES).round().astype(np.int64))] if len(recording) else recording
        distance = np.linalg.norm(some[:, :, None] - some[:, None], axis=3)
        enough = (~np.isnan(distance)).sum(axis=0) >= 3
        low, high = np.zeros((markers, markers)), np.full((markers, markers), np.inf)
        if enough.any():
            low[enough], high[enough] = np.nanpercentile(distance[:, enough], (10, 90), axis=0)
        varies, apart = np.maximum(varies, high - low), np.maximum(apart, high)
    return (varies < STIFF) & (apart < NEAREST), apart


def _groups(recordings: Sequence[Floats]) -> list[tuple[int, ...]]:
    """The markers nearest to each one that keep their distances to it and to each other, four at least."""
    stiff, apart = stiff_pairs(recordings)
    markers = len(stiff)
    groups: dict[tuple[int, ...], None] = {}
    for marker in range(markers):
        group: list[int] = []
        for mate in np.argsort(apart[marker], kind="stable").tolist():
            if len(group) < LARGEST and (mate == marker or stiff[mate, marker]) and stiff[mate, group].all():
                group.append(mate)
        if len(group) >= 4 and marker in group:
            groups[tuple(sorted(group))] = None
    return list(groups)


def _shape(points: Floats) -> NDArray[np.float64] | None:
    """The mean shape (K, 3) m of a stiff group (F, K, 3) about its middle; None where fewer than three frames show all of it."""
    points = points[~np.isnan(points).any(axis=(1, 2))]
    points = points[:: max(1, len(points) // FRAMES)]
    if len(points) < 3:
        return None
    points = points - points.mean(axis=1, keepdims=True)
    mean = points[0]
    # Each round turns all frames onto the mean of the last one; three suffice for a part that is stiff.
    for _ in range(3):
        mean = (points @ _turns(points, mean)).mean(axis=0)
    return np.asarray(mean)


def _turns(points: Floats, onto: Floats) -> Floats:
    """The rotations (F, 3, 3), no mirror image among them, that lay shapes (F, K, 3) onto one (K, 3) or as many."""
    return best_rotation(np.swapaxes(points, 1, 2) @ onto)


def _misfits(shape: Floats, others: Floats) -> Floats:
    """m, root mean square distance of shapes (N, K, 3) laid on one (K, 3): (N,)."""
    laid = others @ _turns(others, shape)
    return np.asarray(np.sqrt(((laid - shape) ** 2).sum(axis=2).mean(axis=1)))
