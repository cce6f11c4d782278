"""Two marker sets in; which marker of the one is which of the other, and a set that has the markers of both, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.recording import NULL, Floats, Ints, MarkerSet, Place
from asterism.recording.place import LIMBS
from asterism.skeleton.build import BONES
from asterism.skeleton.worn import places_of

SAME_PLACE = 0.025
"""m: markers of two sets that are so near on a segment are one. Hands put a marker 6 to 21 mm off (Della Croce et al. 1999), so that nearer
ones cannot be told apart. At half of it an ankle of two sets is two markers; at double, neighbours of a foot are one."""


def counterparts(asked: MarkerSet, other: MarkerSet) -> Ints:
    """For each marker of the set asked for its column in the other one, -1 where that has none: (M,).

    Markers are one where the other set knows the name on the same segment, or else by `SAME_PLACE`, the nearest first. O(M N).
    Raises AsterismError where a set does not say of a marker where it sits.
    """
    mine, theirs = places_of(asked), places_of(other)
    column = {name: i for i, name in enumerate(other.names)}
    found = np.full(len(asked), NULL, dtype=np.int64)
    for m, name in enumerate(asked.names):
        same = other.name_of(name)
        if same is not None and other.places[same].segment == mine[m].segment:
            found[m] = column[same]
    apart = np.linalg.norm(_spots(mine)[:, None] - _spots(theirs), axis=2)
    apart[np.array([[one.segment != each.segment for each in theirs] for one in mine])] = np.inf
    apart[found != NULL] = np.inf
    apart[:, found[found != NULL]] = np.inf
    while apart.size and apart.min() < SAME_PLACE:
        m, n = divmod(int(apart.argmin()), len(other))
        found[m] = n
        apart[m], apart[:, n] = np.inf, np.inf
    return found


def with_markers_of(other: MarkerSet, asked: MarkerSet, columns: Ints) -> tuple[MarkerSet, Ints]:
    """The other set with those markers of the set asked for that it lacks, and their columns (M,) there.

    columns: see `counterparts`. A marker whose name the other set has elsewhere is renamed.
    """
    lacking = [m for m in range(len(asked)) if columns[m] == NULL]
    renamed = {name: name if other.name_of(name) is None else f"{name} of {asked.title}" for name in (asked.names[m] for m in lacking)}
    names, whole = (*other.names, *renamed.values()), columns.copy()
    whole[lacking] = len(other) + np.arange(len(lacking))
    pairs = tuple((renamed[left], renamed[right]) for left, right in asked.pairs if left in renamed and right in renamed)
    places = {**other.places, **{renamed[name]: asked.places[name] for name in renamed}}
    title = f"{other.title} and {asked.title}"
    return replace(other, names=names, title=title, pairs=(*other.pairs, *pairs), places=places), whole


def _spots(places: tuple[Place, ...]) -> Floats:
    """Where markers sit on their segments of a body of 1.70 m: (M, 3) m."""
    spots = np.array([place.at for place in places], dtype=np.float64).reshape(-1, 3)
    spots[:, 2] *= [BONES[place.plain_segment] if place.plain_segment in LIMBS else 1.0 for place in places]
    return spots
