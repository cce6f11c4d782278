"""Limbs that were found from the motion of their points in; what a person would call them, by the markers on them, out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from asterism.files.text import some_of
from asterism.recording import canonical, plain_name, shipped_sets

if TYPE_CHECKING:
    from asterism.motion.analysis import JointAngles, MotionAnalysis

_MAIN = 0.3
"""Share of a limb's known markers from which a segment names it: three at most do. At half, a stray marker would; at double, one alone."""
_SHOWN = 3
"""Points that name a limb whose segment nobody knows: a heading has room for so many."""


def limb_names(analysis: MotionAnalysis) -> list[str]:
    """A name for each limb: the one that was given, the segments of a shipped marker set that its markers are on, or its first points."""
    labels = analysis.recording.labels
    plain = [plain_name(label) for label in labels]
    segment_of = _segments(plain)
    names: list[str] = []
    for limb, given in enumerate(analysis.names):
        points = [n for n, one in enumerate(analysis.limb_of) if one == limb]
        # numbers are what the search for limbs gives
        name = given
        if re.fullmatch(r"limb \d+", given):
            counts = Counter(segment_of[plain[n]] for n in points if plain[n] in segment_of)
            main = [segment for segment, count in counts.most_common(3) if count >= _MAIN * counts.total()]
            name = _joined(main) or some_of([labels[n] for n in points], _SHOWN)
        # Two limbs of one segment are told apart by their points.
        names.append(name if name not in names else f"{name} ({some_of([labels[n] for n in points], _SHOWN)})")
    return names


def joint_name(joint: JointAngles, limbs: Sequence[str]) -> str:
    """A joint by the names of the limbs that it joins."""
    return f"{limbs[joint.parent]} / {limbs[joint.child]}"


def _segments(plain: Sequence[str]) -> dict[str, str]:
    """The segment of each marker, by the shipped set that knows the most of them; the smallest of several."""
    known = min(shipped_sets().values(), key=lambda one: (-len({canonical(name) for name in one.names} & set(plain)), len(one)))
    return {canonical(marker): segment for segment, markers in known.segments.items() for marker in markers}


def _joined(segments: Sequence[str]) -> str:
    """One, one and another, or one, another and a third; "" for none."""
    first = ", ".join(segments[:-1])
    return " and ".join(filter(None, (first, *segments[-1:]))).replace("_", " ")
