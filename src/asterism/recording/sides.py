"""Marker names in; on which side of the body each marker is, out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache

from asterism.recording.marker_set import MarkerSet, canonical, plain_name, shipped_sets, without_subject

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_OTHER_SIDE = {"l": "r", "r": "l", "left": "right", "right": "left"}


def known_set(names: Sequence[str]) -> MarkerSet | None:
    """The smallest shipped marker set that has all these markers, for their pairs and segments."""
    wanted = {plain_name(name) for name in names}
    return next((known for known in _shipped() if wanted <= {canonical(name) for name in known.names}), None)


@cache
def _shipped() -> tuple[MarkerSet, ...]:
    """The shipped sets, the smallest first."""
    return tuple(sorted(shipped_sets().values(), key=len))


def marker_sides(names: Sequence[str], marker_set: MarkerSet | None = None) -> list[str]:
    """For each marker "left", "right" or "middle".

    By the pairs of the marker set, or of a shipped one with these markers; other markers by their names: LKNE beside RKNE, L.Knee,
    KneeOut_L, left_heel.

    >>> marker_sides(["LKNE", "RKNE", "SACR", "left_heel"])
    ['left', 'right', 'middle', 'left']
    """
    # The set says which markers are pairs; names are only asked where it does not.
    known = marker_set if marker_set is not None and marker_set.pairs else known_set(names)
    side: dict[str, str] = {}
    for left, right in known.pairs if known is not None else ():
        side[canonical(left)], side[canonical(right)] = "left", "right"
    plain = [without_subject(name) for name in names]
    every = {canonical(name) for name in plain}
    return [
        side.get(canonical(name)) or side.get(canonical(bare)) or _side_of(bare, every) for name, bare in zip(names, plain, strict=True)
    ]


def mirrored_name(name: str, marker_set: MarkerSet | None = None) -> str | None:
    """What the same marker on the other side of the body is called; None where the name says no side.

    By the pairs of a marker set; other names by the word or the letter that says the side.

    >>> [mirrored_name(name) for name in ("LKNE", "R.Heel", "KneeOut_L", "left_heel", "SACR")]
    ['RKNE', 'L.Heel', 'KneeOut_R', 'right_heel', None]
    """
    for pair in marker_set.pairs if marker_set is not None else ():
        if name in pair:
            return pair[1] if name == pair[0] else pair[0]
    words = list(_WORDS.finditer(name))
    # A whole word says more than a letter, and one at an end more than one within.
    said = [word for word in words if word[0].casefold() in ("left", "right")]
    said += [word for word in words[:1] + words[-1:] if len(words) > 1 and word[0].casefold() in ("l", "r")]
    if said:
        return name[: said[0].start()] + _like(said[0][0], _OTHER_SIDE[said[0][0].casefold()]) + name[said[0].end() :]
    # LKNE and Lknee: the first letter stands before letters of the name.
    if len(name) > 2 and name[0] in "LR" and name[1:3].isalpha():
        return {"L": "R", "R": "L"}[name[0]] + name[1:]
    return None


def _like(word: str, other: str) -> str:
    """Another word in the same letters: LEFT, Left or left."""
    return other.upper() if word.isupper() else other.capitalize() if word[0].isupper() else other


def _side_of(name: str, every: set[str]) -> str:
    """By a name's own words, or because the name with the other side's letter is a marker too; every: all names, canonical."""
    words = [word.casefold() for word in _WORDS.findall(name)]
    plain_name = canonical(name)
    for word in ("left", "right"):
        if word in words or plain_name.startswith(word):
            return word
    # A single letter counts only beside another word: a marker may be called L.
    alone = [word for word in (words[:1] + words[-1:]) if word in ("l", "r")]
    if alone and len(words) > 1:
        return "left" if alone[0] == "l" else "right"
    for at in [0, len(plain_name) - 1, *range(1, len(plain_name) - 1)] if plain_name else ():
        other = _OTHER_SIDE.get(plain_name[at])
        if other is not None and plain_name[:at] + other + plain_name[at + 1 :] in every:
            return "left" if plain_name[at] == "l" else "right"
    return "middle"
