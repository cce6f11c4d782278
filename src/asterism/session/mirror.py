"""A labelled recording in; whether it shows the mirror image of a person, as far as markers and names tell, out.

A person's mirror image is a person: only what differs between left and right tells it. That are markers worn on one side alone, such as
that on the right shoulder blade, and names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from asterism.findings import Finding, Severity
from asterism.labelling.recording_labeller import RecordingLabeller
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.recording import Clouds, Disagreement, Labelling, MarkerSet
from asterism.session.upright import fullest

_HALF = 0.5
"""Share of the frames from which a marker counts as found: with a label in most of them, each weighted by its confidence."""

_EXCHANGED = 0.8
"""Share of the names of pairs that must be exchanged to say so of all: a few are always wrong, or hidden. At half of it one leg is enough;
nothing is at double."""


def one_sided(marker_set: MarkerSet) -> list[str]:
    """The markers that a mirror image shows on the other side, where nobody wears any: without a pair, and clearly off the middle.

    >>> one_sided(MarkerSet.load("plug-in-gait")), one_sided(MarkerSet.load("helen-hayes"))
    (['RBAK'], [])
    """
    paired = {name for pair in marker_set.pairs for name in pair}
    # without pairs the set does not say what belongs together
    alone = [name for name in marker_set.names if paired and name not in paired and name in marker_set.places]

    def aside(name: str) -> bool:
        place = marker_set.places[name]
        # two standard deviations off the middle: a hand that means the middle hardly ever puts it there
        return place.segment.startswith(("left", "right")) or abs(place.at[1]) > 2.0 * place.spread

    return [name for name in alone if aside(name)]


def mirror_findings(where: str, labeller: RecordingLabeller, labelling: Labelling, clouds: Clouds) -> list[Finding]:
    """The finding that one-sided markers are found in the mirror image of a recording, and not in it.

    clouds: frames of it. The mirror image is labelled only where such markers have no labels.
    """
    if len(labeller.models) != 1:
        return []
    alone = one_sided(labeller.models[0].marker_set)
    absent = [name for name, share in _found(labelling, alone).items() if share < _HALF]
    if not alone or len(absent) < len(alone) or not len(clouds):
        return []
    some = fullest(clouds)
    mirrored = replace(some, xyz=np.ascontiguousarray(some.xyz * _other_hand(some)))
    try:
        here, there = (labeller.label_bodies(part).labelling for part in (some, mirrored))
    except SeveralBodies:
        return []
    shown = [name for name, share in _found(there, absent).items() if share >= _HALF]
    # not at the cost of others: a posture that is hard to label is so by chance
    if not shown or (there.indices >= 0).sum() <= (here.indices >= 0).sum():
        return []
    names = " and ".join(shown)
    sentence = (
        f"{where}: {names} fit{'s' if len(shown) == 1 else ''} on the other side only: the recording is a mirror image, whose labels of "
        "left and right are exchanged, or the marker is worn there."
    )
    mend = "Look which side a picture shows; a mirror image comes from an axis with the wrong sign, which the program before must correct."
    return [Finding("label-mirrored", Severity.WARNING, where, sentence, mend)]


def exchanged_sides(where: str, marker_set: MarkerSet, against: Sequence[Disagreement]) -> list[Finding]:
    """The finding that the names of a file are those of the other side throughout."""
    other = {name: twin for left, right in marker_set.pairs for name, twin in ((left, right), (right, left))}
    exchanged = {each.name for each in against if each.given is not None and other.get(each.name) == each.given}
    if not other or len(exchanged) < _EXCHANGED * len(other):
        return []
    sentence = (
        f"{where}: the file's names of left and right are exchanged against the labels given, which were written: the recording is a "
        "mirror image, and its names are right, or the names are wrong throughout."
    )
    mend = "Look which side a picture shows: correct the axis whose sign is wrong, or leave the file's names by --known-labels keep."
    return [Finding("label-mirrored", Severity.WARNING, where, sentence, mend)]


def _other_hand(clouds: Clouds) -> np.ndarray:
    """The factors of the coordinates that mirror along a horizontal axis."""
    factors = np.ones(3)
    factors[int(np.abs(clouds.vertical).argmin())] = -1.0
    return factors


def _found(labelling: Labelling, names: Sequence[str]) -> dict[str, float]:
    """Of each marker the share of the frames in which it has a label, each weighted by its confidence."""
    columns = [labelling.names.index(name) for name in names]
    weighted = np.where(labelling.indices[:, columns] >= 0, np.nan_to_num(labelling.confidence[:, columns], nan=1.0), 0.0)
    return dict(zip(names, weighted.mean(axis=0).tolist(), strict=True)) if len(weighted) else dict.fromkeys(names, 0.0)
