"""A recording and the vertical that its file says in; the verticals that its points may mean instead, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.findings import Finding, Severity
from asterism.formats import vertical_from_positions
from asterism.labelling.recording_labeller import RecordingLabeller
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.recording import Clouds, Floats, Recording, axis_name

_OTHER = 0.5
"""Cosine of the angle between verticals from which they are one: 60 degrees. Axes are 90 degrees apart, a tilted floor a few."""

_FRAMES = 60
"""Frames that are labelled under each vertical, in one piece: half a step of a walk, in which a body moves. Twice as many take twice as
long and say the same."""

_LABELS = 1.0
"""Labels of a frame, each weighted by its confidence, that another vertical must give beyond that of the file: one marker. At half of it
chance decides, at twice a head that is upside down passes."""


def other_verticals(recording: Recording, *, every: bool = False) -> list[Floats]:
    """What may point up instead of the vertical that a recording was read with: what its points show, where that is something else.

    every: all other axes behind it, since nothing was found with the vertical that was read.
    """
    shown = vertical_from_positions(recording.positions, recording.labels)
    found = [] if shown is None else [shown]
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    others = [*found, *(axis for axis in axes if every and not any(axis @ one > _OTHER for one in found))]
    return [axis for axis in others if axis @ recording.vertical < _OTHER]


def labelled_upright(labeller: RecordingLabeller, recording: Recording, *, every: bool = False) -> Floats | None:
    """That of `other_verticals` under which a recording gets clearly more labels than under its own; None where none does."""
    verticals = other_verticals(recording, every=every)
    if not verticals:
        return None
    part = fullest(recording.clouds())
    own, *found = (_labels(labeller, part, vertical) for vertical in (part.vertical, *verticals))
    best = int(np.argmax(found))
    return verticals[best] if found[best] >= own + _LABELS else None


def fullest(clouds: Clouds, frames: int = _FRAMES) -> Clouds:
    """So many frames in one piece, that in which most points are seen: there a body shows most of itself."""
    counts = np.asarray(clouds.counts)
    begin = int(np.convolve(counts, np.ones(min(frames, len(counts))), "valid").argmax())
    return clouds.frames(slice(begin, begin + frames))


def _labels(labeller: RecordingLabeller, clouds: Clouds, vertical: Floats) -> float:
    """Labels of a frame, weighted by their confidence."""
    try:
        labelling = labeller.label_bodies(replace(clouds, vertical=vertical)).labelling
    except SeveralBodies:
        # two whole bodies were found
        return 2.0 * max(len(model.marker_set) for model in labeller.models)
    return float(np.where(labelling.indices >= 0, labelling.confidence, 0.0).sum()) / max(1, len(clouds))


def vertical_finding(where: str, said: Floats, taken: Floats) -> Finding:
    """The finding that a file's vertical was not believed."""
    up, other = axis_name(taken), axis_name(said)
    sentence = f"{where}: it was read with {other} up, but its points are a body with {up} up, and were labelled so."
    mend = f"Say it with --vertical {up}, and correct it in the file; --vertical {other} where the file is right."
    return Finding("label-vertical", Severity.WARNING, where, sentence, mend)
