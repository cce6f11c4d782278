"""Labellings of several bodies in one recording in; one labelling of all of them, each marker under a name of its own, out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Labelling, MarkerSet, canonical


def join_labellings(
    labellings: Sequence[Labelling], marker_sets: Sequence[MarkerSet], subjects: Sequence[str] | None = None
) -> tuple[Labelling, MarkerSet]:
    """One labelling of all bodies of a recording, and the marker set of its names.

    labellings (T, M) each, as `label_together` gives them; marker_sets: theirs; subjects: what each body is called, by default 1, 2, ...
    A body that shares a marker's name with another one has its subject before all its names, as in "1:LASI". The verdict is that of the
    first body that does not fit its model, where there is one. O(T M).
    Raises AsterismError where two names still are one, or the labellings are of different numbers of frames.

    >>> from asterism.recording import MarkerSet
    >>> knees = Labelling(np.array([[0, 1]]), np.ones((1, 2)), ("LKNE", "RKNE"))
    >>> others = Labelling(np.array([[2, 3]]), np.ones((1, 2)), ("LKNE", "RKNE"))
    >>> both, names = join_labellings([knees, others], [MarkerSet(knees.names)] * 2, subjects=["Ann", "Ben"])
    >>> both.names
    ('Ann:LKNE', 'Ann:RKNE', 'Ben:LKNE', 'Ben:RKNE')
    """
    subjects = [str(i + 1) for i in range(len(labellings))] if subjects is None else list(subjects)
    if not len(labellings) == len(marker_sets) == len(subjects) or len({len(labelling.indices) for labelling in labellings}) != 1:
        raise AsterismError(
            f"{len(labellings)} labellings, {len(marker_sets)} marker sets and {len(subjects)} subjects do not fit; "
            "give one of each for every body, all of one recording."
        )
    spelled = [_spellings(marker_set) for marker_set in marker_sets]
    uses = Counter(spelling for spellings in spelled for spelling in spellings)
    own = [
        _of_subject(marker_set, subject) if any(uses[spelling] > 1 for spelling in spellings) else marker_set
        for marker_set, spellings, subject in zip(marker_sets, spelled, subjects, strict=True)
    ]
    everyone = MarkerSet(
        names=tuple(name for marker_set in own for name in marker_set.names),
        title=" and ".join(marker_set.title for marker_set in own),
        aliases={name: others for marker_set in own for name, others in marker_set.aliases.items()},
        pairs=tuple(pair for marker_set in own for pair in marker_set.pairs),
        segments={name: members for marker_set in own for name, members in marker_set.segments.items()},
        places={name: place for marker_set in own for name, place in marker_set.places.items()},
        optional=tuple(name for marker_set in own for name in marker_set.optional),
    )
    indices = np.concatenate([labelling.indices for labelling in labellings], axis=1)
    confidence = np.concatenate([labelling.confidence for labelling in labellings], axis=1)
    known = [labelling.candidates for labelling in labellings if labelling.candidates is not None]
    candidates = np.concatenate(known, axis=1) if len(known) == len(labellings) else None
    verdicts = [
        replace(labelling.verdict, body=subject if len(labellings) > 1 else "")
        for labelling, subject in zip(labellings, subjects, strict=True)
        if labelling.verdict is not None
    ]
    verdict = next((verdict for verdict in verdicts if not verdict.fits), verdicts[0] if verdicts else None)
    return Labelling(indices, confidence, everyone.names, candidates, verdict), everyone


def _spellings(marker_set: MarkerSet) -> set[str]:
    """All that the set's markers are called, without case and punctuation."""
    return {canonical(s) for name in marker_set.names for s in (name, *marker_set.aliases.get(name, ()))}


def _of_subject(marker_set: MarkerSet, subject: str) -> MarkerSet:
    """The marker set with a subject before all its names."""

    def called(names: Sequence[str]) -> tuple[str, ...]:
        return tuple(f"{subject}:{name}" for name in names)

    return MarkerSet(
        names=called(marker_set.names),
        title=f"{subject}: {marker_set.title}",
        aliases={f"{subject}:{name}": called(others) for name, others in marker_set.aliases.items()},
        pairs=tuple((f"{subject}:{left}", f"{subject}:{right}") for left, right in marker_set.pairs),
        segments={f"{subject}:{name}": called(members) for name, members in marker_set.segments.items()},
        places={f"{subject}:{name}": place for name, place in marker_set.places.items()},
        optional=called(marker_set.optional),
    )
