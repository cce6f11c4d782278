"""Labels over some time in; whether they leave so much over that another marker set may be worn, out: the same from every door.

Who wears fewer markers than a set has leaves no points over, and ghosts leave no marker out: only a wrong set, or wrong labels, do both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.findings import Finding, Severity
from asterism.recording import Clouds, Floats, Ints, MarkerSet
from asterism.session.worn.find import evidence_of, nearest_sets, set_instead

_SEEN = 0.05
"""Share of the frames in which a marker has a label at least, or it has none but by chance. At half and at double the same 60 recordings of
`movement` and virtual people are told."""
_SHARE, _FEWEST = 0.125, 4
"""Of the set's markers, and how many at least, that are nowhere while as many points have no label. Of the recordings that showed the right
set it is 0.08 at most (somebody who lies, live), of those that showed another one 0.15 and more. At half people who lie are told; at double
half of the wrong sets pass. Three hidden markers beside three ghosts are usual in any set."""


_REACH = 0.3
"""m about the box of the points that have a label, in which a point is on the body: the length of a forearm. At half, a limb without labels
is held for reflections; at double, reflections beside a person are held for markers."""


def left_on_body(points: Floats, indices: Ints) -> int:
    """How many points (n, 3) m of a frame have no label and are on the body; indices (M,) the point of each marker, -1 for none."""
    given = points[indices[indices >= 0]]
    if not len(given):
        return len(points)
    inside = (points >= given.min(axis=0) - _REACH) & (points <= given.max(axis=0) + _REACH)
    return int(inside.all(axis=1).sum()) - len(given)


@dataclass(frozen=True)
class LeftOver:
    """What labels of a set leave over: of `markers` those that have a label in hardly any frame, and points on the body without one."""

    markers: int
    unseen: int
    points: int

    @classmethod
    def of(cls, shown: ArrayLike, points: ArrayLike) -> LeftOver:
        """From the share of the frames (M,) in which each marker has a label, and the points (T,) of each that `left_on_body` counts."""
        share, left = np.asarray(shown), np.asarray(points)
        # ghosts come and go: what three frames of four have over counts
        return cls(len(share), int((share < _SEEN).sum()), int(np.quantile(left, 0.25)) if len(left) else 0)

    @property
    def tells(self) -> bool:
        """Whether another set may be worn."""
        return min(self.unseen, self.points) >= max(_SHARE * self.markers, _FEWEST)

    def sentence(self, where: str, names: str) -> str:
        """In words, of a set or of several."""
        return f"{self._counts(where, names)}: another set is worn, or the labels are not right."

    def note(self, where: str, names: str) -> Finding:
        """What is said where the points are most like the set that was asked for, so that no other one is worn."""
        sentence = f"{self._counts(where, names)}: the set is the right one, and these markers were hidden or their labels are missing."
        mend = "Check the labels with `asterism review`; a model of this person labels more."
        return Finding("label-left-over", Severity.NOTE, where, sentence, mend)

    def _counts(self, where: str, names: str) -> str:
        counted = f"{self.unseen} of {self.markers} markers of {names} have no label in any frame"
        return f"{where}: {counted}, and {self.points} points on the body have none"


def set_worn_instead(clouds: Clouds, asked: Sequence[str]) -> str:
    """That points surely show another shipped set than that of these markers, in words; "" where they do not. Takes a second.

    So is told where most markers of both sets sit alike, so that nothing is left over. As many markers must be none of the other set's as
    must be unseen elsewhere to tell a wrong set: where that has all markers of the asked one, and more, the labels are right.
    """
    evidence = evidence_of(clouds)
    found = None if evidence is None else set_instead(evidence, asked)
    if found is None or found[1] < max(_SHARE * len(asked), _FEWEST):
        return ""
    return f"the points are those of {found[0]}, which lacks {found[1]} of the {len(asked)} markers of the set"


def sets_to_name(clouds: Clouds, asked: Sequence[str]) -> tuple[bool, str]:
    """Whether points are most like the set of these markers, and which shipped sets they are like, as a person is told who asked for it.

    False and "" where they show no body. Takes a second.
    """
    evidence = evidence_of(clouds)
    if evidence is None:
        return False, ""
    near = nearest_sets(evidence)
    if MarkerSet.load(next(iter(near))).names == tuple(asked):
        return True, "The points themselves are most like this set: its virtual people may not know the posture."
    others = {name: found for name, found in near.items() if MarkerSet.load(name).names != tuple(asked)}
    few = ", ".join(f"{name} ({seen} of {size} markers)" for name, (seen, size) in others.items())
    return False, f"The points are most like {few}; name the set that is worn with --markers."
