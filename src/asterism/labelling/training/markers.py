"""Labelled recordings in; the markers that a model learns from them out."""

from __future__ import annotations

from collections.abc import Sequence

from asterism.errors import AsterismError
from asterism.recording import MarkerSet, Recording, is_unnamed, subject_of

FEWEST_MARKERS = 4
"""Markers that recordings must share to be learned from together."""

LEAST_SHARE_OF_PEOPLE = 0.7
"""Share of the people who must show a marker for it to be learned without being asked for. Not tuned: below a half, the files of two
laboratories with few markers in common would make one set that no frame shows half of."""


def learned_marker_set(recordings: Sequence[Recording], subjects: Sequence[str] | None = None) -> tuple[MarkerSet, tuple[str, ...]]:
    """The markers to learn from recordings, and those left out because too few people show them.

    Recordings with equal labels share all of them; else see `learned_markers`. subjects: the person of each recording, by default as
    `subject_of` says. Raises AsterismError where there is no recording, or too few markers are left.
    """
    if not recordings:
        raise AsterismError("there is no recording to learn from; give at least one labelled file.")
    names = recordings[0].labels
    left_out: tuple[str, ...] = ()
    # Equal labels mean one laboratory's set, to be learned as it is, unnamed columns and all.
    if any(recording.labels != names for recording in recordings):
        names, left_out = learned_markers(recordings, subjects)
    return MarkerSet(names, title="the recordings' own labels"), left_out


def learned_markers(
    recordings: Sequence[Recording], subjects: Sequence[str] | None = None, least_share: float | None = None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The markers (`named_markers`) that at least a share of the people show, `LEAST_SHARE_OF_PEOPLE` by default; and the others, sorted.

    The markers are in the order of the recordings that name them first. Raises AsterismError where fewer than `FEWEST_MARKERS` are left.
    """
    people = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
    # By people, not recordings: one person with many trials must not decide for all.
    shown_by: dict[str, set[str]] = {}
    for person, recording in zip(people, recordings, strict=True):
        for name in named_markers(recording):
            shown_by.setdefault(name, set()).add(person)
    fewest = (LEAST_SHARE_OF_PEOPLE if least_share is None else least_share) * len(set(people))
    learned = tuple(name for name, by in shown_by.items() if len(by) >= fewest)
    if len(learned) < FEWEST_MARKERS:
        raise AsterismError(
            f"{recordings[0].metadata.get('file', 'the first recording')} and the other files share {len(learned)} labelled markers, "
            f"fewer than {FEWEST_MARKERS}; name the set with --markers (in Python: marker_set)."
        )
    return learned, tuple(sorted(set(shown_by) - set(learned)))


def named_markers(recording: Recording) -> tuple[str, ...]:
    """The labels of the columns that have a name, no other column's, and a sample."""
    return tuple(
        name
        for column, name in enumerate(recording.labels)
        if not is_unnamed(name) and recording.labels.count(name) == 1 and recording.visible[:, column].any()
    )
