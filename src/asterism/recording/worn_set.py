"""The labels of a file in; the shipped marker set that the person in it wears, with what is missing and what is extra, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from asterism.recording.marker_set import canonical, is_unnamed, plain_name, shipped_sets


@dataclass(frozen=True)
class WornSetRules:
    """When a file is said to wear a marker set. Chosen on the 60 lists of labels that the files of ../shared/data hold.

    found     share of the set's markers that the file has at least
    spelling  what a marker counts that the file calls by an alias, against one by the set's own name: sets share places on the body,
              and a laboratory's spelling tells which of them was meant
    """

    found: float = 0.8
    spelling: float = 0.8


@dataclass(frozen=True)
class WornSet:
    """A shipped marker set, held against the labels of a file.

    name     of the set
    found    its markers that the file has, in the set's order
    missing  its markers that the file lacks
    extra    labels of the file that are no markers of the set
    """

    name: str
    found: tuple[str, ...]
    missing: tuple[str, ...]
    extra: tuple[str, ...]


def worn_marker_sets(labels: Sequence[str], rules: WornSetRules | None = None) -> tuple[WornSet, ...]:
    """The shipped marker sets that a file with these labels wears, the best first; empty where it wears none.

    labels: of markers; labels that only number a point count for nothing. The best set has most of its own markers among the labels,
    and leaves fewest of them over.

    >>> from asterism.recording import MarkerSet
    >>> labels = [*MarkerSet.load("helen-hayes").names, "C7"]
    >>> best = worn_marker_sets(labels)[0]
    >>> best.name, best.missing, best.extra
    ('helen-hayes', (), ('C7',))
    """
    rules = rules or WornSetRules()
    named = list(dict.fromkeys(label for label in labels if not is_unnamed(label)))
    scored = []
    for name, marker_set in shipped_sets().items():
        marker_of = {label: marker_set.name_of(label) for label in named}
        held = set(marker_of.values())
        found = tuple(marker for marker in marker_set.names if marker in held)
        # A few common names prove nothing: heads and pelvises are called alike in all sets.
        if not found or len(found) < rules.found * len(marker_set):
            continue
        own = {marker for label, marker in marker_of.items() if marker and plain_name(label) == canonical(marker)}
        extra = tuple(label for label in named if marker_of[label] is None)
        missing = tuple(marker for marker in marker_set.names if marker not in held)
        # A laboratory's own spelling tells which of similar sets was meant.
        weight = len(own) + rules.spelling * (len(found) - len(own))
        # Markers left over speak against a set as missing ones do.
        scored.append((weight / (len(marker_set) + len(extra)), WornSet(name, found, missing, extra)))
    # Of equals the larger set, then the name: the order never depends on the files.
    scored.sort(key=lambda pair: (-pair[0], -len(pair[1].found), pair[1].name))
    return tuple(worn for _, worn in scored)
