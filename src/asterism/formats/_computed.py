"""The points of a file that a model computed: their labels, and a recording that is written without them."""

from __future__ import annotations

from dataclasses import replace

from asterism.formats._columns import Points
from asterism.formats.c3d._file import C3DFile
from asterism.recording import Recording


def computed_labels(recording: Recording) -> tuple[str, ...]:
    """The labels of the points, angles and forces of a recording's file that are no columns of the recording; they are written with it.

    Of a recording that was read without a marker set, these are what a model computed.
    """
    return tuple(label for column, label in enumerate(_source_labels(recording)) if column not in set(recording.taken))


def without_computed(recording: Recording) -> Recording:
    """The same recording, which is written without the points of its file that are no columns of it."""
    # All columns of the source count as replaced, so that none of them is written.
    return replace(recording, taken=tuple(range(len(_source_labels(recording)))))


def _source_labels(recording: Recording) -> tuple[str, ...]:
    source = recording.source
    return tuple(source.labels) if isinstance(source, Points | C3DFile) else ()
