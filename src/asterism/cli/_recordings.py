"""Shared by commands on recordings: files in, labelled recordings out; a labelling in, its shares out; findings on files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism import formats
from asterism.cli import _console
from asterism.cli._options import marker_names, vertical_axis
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import MarkerSet, Recording

if TYPE_CHECKING:
    from asterism.cameras import Rig

_KEEP_THE_SOURCE = "Keep the source file, or choose a format that carries it."


def is_rig(path: Path) -> bool:
    """Whether a name is that of a rig file or of a folder of them; for a recording's name, the formats of rigs are not loaded."""
    # the usual case first: formats of rigs take a third of a second to import
    if formats.is_recording_file(path) and not path.is_dir():
        return False
    from asterism.cameras.files import is_rig_file

    return is_rig_file(path)


def is_model(path: Path) -> bool:
    """Whether a file's name is that of a model."""
    return path.suffix.lower() == ".model"


def read_labelled(files: Sequence[Path], markers: str | MarkerSet | None, vertical: str | None, batch: _console.Batch) -> list[Recording]:
    """The files of a batch that can be read, under one set of markers; without a set, the markers that all of them have.

    Raises AsterismError where none is left.
    """
    marker_set = markers if isinstance(markers, MarkerSet) else marker_set_of(markers)
    axis = vertical_axis(vertical)
    recordings = _each(files, batch, lambda path: formats.read(path, markers=marker_set, vertical=axis))
    return recordings if marker_set is not None else _with_common_markers(recordings, batch)


def _each(files: Sequence[Path], batch: _console.Batch, read: Callable[[Path], Recording]) -> list[Recording]:
    """The files of a batch that can be read, whose warnings are told. Raises AsterismError where none is left."""
    recordings = []
    for path in files:
        with batch.file(path):
            recording = read(path)
            report_warnings(recording, batch)
            recordings.append(recording)
    if not recordings:
        raise AsterismError("none of the files can be used; the reasons are above.")
    return recordings


def read_people(files: Sequence[Path], marker_set: MarkerSet, vertical: str | None, batch: _console.Batch) -> list[Recording]:
    """The files of a batch that can be read, under a set of markers; those of several people with the markers of each, under their names.

    Raises AsterismError where none is left.
    """
    from asterism.session.people import people_in

    axis = vertical_axis(vertical)

    def read(path: Path) -> Recording:
        try:
            return formats.read(path, markers=marker_set, vertical=axis)
        except AsterismError:
            # two people have two points of one name
            recording = formats.read(path, vertical=axis)
            if not people_in(recording.labels, marker_set):
                raise
            return recording.select([label for label in recording.labels if marker_set.name_of(label) is not None])

    return _each(files, batch, read)


def one_person(recording: Recording, batch: _console.Batch) -> Recording:
    """The markers of the person who is named first, where a file names those of several; that the others are left out is told."""
    from asterism.labelling.training.people import of_person, prefixes_of_people

    people = prefixes_of_people(recording.labels)
    if not people:
        return recording
    where, called = str(recording.metadata.get("file", "the recording")), [prefix or "the one without a name" for prefix in people]
    sentence = f"{where}: it names the markers of {len(people)} people ({', '.join(called)}); {called[0]} is analysed, and nobody else."
    mend = "Give each person's markers in a file of their own to analyse them all."
    batch.found(Finding("recording-several-people", Severity.WARNING, where, sentence, mend))
    return of_person(recording, people[0])


def read_some(files: Sequence[Path], marker_set: MarkerSet | None, vertical: str | None, batch: _console.Batch) -> list[Recording]:
    """The files of a batch that can be read, each with the markers of a set; without a set, with all its named physical points.

    A file without a labelled sample counts as one that cannot be used. Raises AsterismError where none is left.
    """
    from asterism.labelling.training.markers import named_markers

    axis = vertical_axis(vertical)

    def read(path: Path) -> Recording:
        recording = formats.read(path, markers=marker_set, vertical=axis)
        if marker_set is None:
            # computed points and numbers for tracks are no markers
            recording = recording.select(named_markers(recording))
        with_names(path, recording.labels if recording.visible.any() else ())
        return recording

    return _each(files, batch, read)


def marker_set_of(markers: str | None) -> MarkerSet | None:
    """The set that --markers names, or None where it was not given."""
    return None if markers is None else MarkerSet.load(marker_names(markers) or ())


def _with_common_markers(recordings: Sequence[Recording], batch: _console.Batch) -> list[Recording]:
    from asterism.labelling.training.markers import learned_markers

    # each file counts as a person of its own, so that a marker must be in all of them
    common, left_out = learned_markers(recordings, [str(i) for i in range(len(recordings))], 1.0)
    for finding in left_out_markers(len(common), left_out):
        batch.found(finding)
    return [recording.select(common) for recording in recordings]


def left_out_markers(used: int, left_out: Sequence[str]) -> list[Finding]:
    """The finding that some markers are not used because only some files have them; empty where there are none."""
    if not left_out:
        return []
    # a line of the terminal; the JSON has all
    few = ", ".join(left_out[:8]) + (", ..." if len(left_out) > 8 else "")
    sentence = f"{used} markers are used; {len(left_out)} others are in too few of the files ({few})."
    return [Finding("recordings-differ", Severity.NOTE, "the files", sentence, "Name the markers with --markers to use others.")]


def uncovered_markers(model: Path, partial_solvers: Mapping[str, Mapping[str, Any]]) -> list[Finding]:
    """The findings that no partial solver of a model reaches the target hit rate of some markers; by the rules that use the solvers."""
    found = []
    for rules, about in partial_solvers.items():
        if about["uncovered"]:
            names = ", ".join(f"{name} ({_console.percent(about['targets'][name], 3)})" for name in about["uncovered"])
            sentence = f"{model}, rules {rules}: no partial solver reaches the target hit rate of {names}; the best ones found vote there."
            mend = "Give lower targets (--target-hit-rate, --marker-target), more recordings, or move the marker: asterism capturability."
            found.append(Finding("model-uncovered-markers", Severity.NOTE, str(model), sentence, mend))
    return found


def with_names(path: Path, names: tuple[str, ...]) -> tuple[str, ...]:
    """The names of a file's markers. Raises AsterismError where there are none."""
    if not names:
        raise AsterismError(f"{path} has no labelled point; label it first, or name its markers with --markers.")
    return names


def report_warnings(recording: Recording, batch: _console.Batch) -> None:
    """Name what the reader of a file found, without its notes, which `asterism info` shows."""
    for finding in recording.warnings:
        batch.found(finding)


def report_coincident(recordings: Sequence[Recording], batch: _console.Batch) -> None:
    """Name the recordings to be learned in which two markers lie in one place, so that one of them has the other's name."""
    from asterism.session.coincident import coincident_findings

    for recording in recordings:
        for finding in coincident_findings(str(recording.metadata.get("file", "a recording")), recording.clouds()):
            batch.found(finding)


def not_carried(target: Path, lost: Sequence[str], mend: str = _KEEP_THE_SOURCE) -> list[Finding]:
    """What a written file leaves out because its format cannot carry it, as findings."""
    return [Finding("format-not-carried", Severity.NOTE, str(target), f"{target} leaves out {what}.", mend) for what in lost]


def assumptions(path: Path, rig: Rig) -> list[Finding]:
    """What a rig's file does not say and had to be assumed, as findings."""
    from asterism.cameras.files import guesses

    mend = "Check it with `asterism info`."
    return [Finding("format-rig-assumed", Severity.NOTE, str(path), f"{path} does not say {what}.", mend) for what in guesses(rig)]
