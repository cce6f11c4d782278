"""The names that points of a file have already, and the labels given; the labels with the names that hold, and what contradicts, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import (
    Clouds,
    Disagreement,
    Labelling,
    MarkerSet,
    Recording,
    check_labels,
    is_partly_labelled,
    keep_labels,
    labelled_live,
)
from asterism.session.mirror import exchanged_sides
from asterism.session.options import CHECK, IGNORE, KEEP

_PAIRS_SHOWN = 4
"""Disagreements of names that a finding lists; the others are counted."""


def choose_name_policy(recording: Recording, marker_set: MarkerSet, wanted: str | None) -> str | None:
    """What becomes of the names of a file, where nobody has said: they are checked where it is partly labelled.

    Names that were given live are no person's: all that they were told by is there, and what came after them, too.
    """
    if wanted is None and labelled_live(recording.log) is not None:
        return IGNORE
    return CHECK if wanted is None and is_partly_labelled(recording, marker_set) else wanted


def merge_file_names(
    path: Path, recording: Recording, clouds: Clouds, labelling: Labelling, marker_set: MarkerSet, policy: str | None
) -> tuple[Labelling, tuple[Disagreement, ...]]:
    """The labelling with the names of the file that hold, and which names contradict the labels given.

    Raises AsterismError where names are to be kept and two columns claim one marker.
    """
    if policy == KEEP:
        try:
            return keep_labels(labelling, recording, clouds, marker_set), ()
        except AsterismError as problem:
            raise AsterismError(f"{path}: {problem}") from None
    # what contradicts is told in any case; only CHECK lets names stay
    checked, against = check_labels(labelling, recording, clouds, marker_set)
    return checked if policy == CHECK else labelling, against


def under_names_of_set(recording: Recording, marker_set: MarkerSet, policy: str | None) -> Recording:
    """The recording whose labels of markers are the marker set's names; as it is where names are kept."""
    if policy == KEEP:
        return recording
    return replace(recording, labels=tuple(marker_set.name_of(label) or label for label in recording.labels))


def join_disagreements(of_pieces: Sequence[tuple[int, Disagreement]]) -> list[Disagreement]:
    """The disagreements of a recording from those of its pieces, each with the piece's first frame.

    Each pair of names is one disagreement, those of most frames first.
    """
    joined = dict[tuple[str, str | None], Disagreement]()
    for begin, each in of_pieces:
        pair = each.name, each.given
        last, before = each.last_frame + begin, joined.get(pair)
        # the pieces come in their order, so that the first one has the first frame
        if before is None:
            joined[pair] = replace(each, first_frame=each.first_frame + begin, last_frame=last)
        else:
            joined[pair] = replace(before, last_frame=last, frames=before.frames + each.frames)
    return sorted(joined.values(), key=lambda each: -each.frames)


def findings_on_names(
    path: Path, recording: Recording, marker_set: MarkerSet, against: Sequence[Disagreement], policy: str | None
) -> list[Finding]:
    """What a person should know of names that contradict. recording: any frames of it."""
    findings = list[Finding]()
    if against and policy != IGNORE:
        findings += exchanged_sides(str(path), marker_set, against)
        findings.append(_disagreement(path, recording, against))
    if against:
        findings += _out_of_date(path, recording)
    return findings


def _disagreement(path: Path, recording: Recording, against: Sequence[Disagreement]) -> Finding:
    def in_words(each: Disagreement) -> str:
        first, last = each.first_frame + recording.first_frame, each.last_frame + recording.first_frame
        where = f"frame {first}" if each.frames == 1 else f"{each.frames} frames from {first} to {last}"
        return f"{each.name} is {each.given or 'at another point'} ({where})"

    listed = "; ".join(map(in_words, against[:_PAIRS_SHOWN]))
    listed += f"; and {len(against) - _PAIRS_SHOWN} more" if len(against) > _PAIRS_SHOWN else ""
    sentence = f"{path}: names of the file contradict the labels given, which were written: {listed}."
    mend = "Look at them with `asterism review`; --known-labels keep leaves the file's names."
    return Finding("label-names-differ", Severity.WARNING, str(path), sentence, mend)


def _out_of_date(path: Path, recording: Recording) -> list[Finding]:
    """The finding that a file holds what a model computed from labels that are no more."""
    from asterism.formats import computed_labels

    computed = computed_labels(recording)
    if not computed:
        return []
    few = ", ".join(computed[:3]) + (", ..." if len(computed) > 3 else "")
    what = f"{len(computed)} computed points and angles ({few}) come" if len(computed) > 1 else f"the computed point {few} comes"
    sentence = f"{path}: {what} from labels that have changed."
    mend = "Compute them again, or leave them out with --drop-computed."
    return [Finding("label-computed-outdated", Severity.WARNING, str(path), sentence, mend)]
