"""A marker set that was asked for, and points of which many are no marker of it, in; a model that explains these, too, out.

Extra points on a body are markers of a larger set, as a rule. A model that does not know them takes them for its own markers, or gives
labels back of which it is not certain: a heel beside three other markers of the foot. So the shipped set that explains the points best
labels them all, and only the markers asked for are told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from asterism.labelling.marker_model import MarkerModel
from asterism.labelling.recording_labeller import RecordingLabeller, WiderModel
from asterism.labelling.virtual_model import virtual_model
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Labelling, MarkerSet
from asterism.session.worn.find import evidence_of
from asterism.skeleton import counterparts, with_markers_of


@dataclass(frozen=True)
class WiderRules:
    """When another set labels.

    left_over  points of a usual frame beyond the markers, as a share of these, from which one is looked for. At half, looking costs a
               second where labels are right anyhow; at double, medial markers may be taken for lateral ones
    frames     that the models label to be compared, in one piece: some seconds. Not tuned
    sure       confidence from which a label counts. Nothing below it tells models apart: in a crowd, labels of a model that does not know
               the extra points are 0.95 certain and wrong
    explained  share of the points that must have a sure name: most of them. At half of it, sets that are not worn label a person with two
               sets (pig39), a fifth of it wrong; at 1.5 times, standing people with raised arms and those who squat have none
    """

    left_over: float = 0.3
    frames: int = 60
    sure: float = 0.99
    explained: float = 0.5


def wider_model(model: MarkerModel, clouds: Clouds, rules: WiderRules | None = None, progress: Progress | None = None) -> WiderModel | None:
    """What labels these points in place of a model of virtual people; None where its own markers explain them as well.

    The best of the shipped sets is taken as it is, or with the markers that it lacks, whichever is sure of more points; but only where it
    is sure of most of them, and of more markers asked for. Models that are not kept yet take seconds each.
    """
    rules, asked = rules or WiderRules(), model.marker_set
    counts = np.asarray(clouds.counts)
    if not asked.places or not counts.any() or np.median(counts[counts > 0]) - len(asked) < rules.left_over * len(asked):
        return None
    evidence = evidence_of(clouds)
    if evidence is None:
        return None
    best = max(evidence.nats, key=lambda name: evidence.nats[name])
    other = MarkerSet.load(best)
    if other.names == asked.names:
        return None
    part = _fullest(clouds, rules.frames)
    own = RecordingLabeller(model)
    found, most, least = None, -1.0, _sure(own, part, rules)
    for wider in _candidates(best, other, asked, progress):
        labeller = RecordingLabeller(model, wider=wider)
        try:
            bodies = labeller.label_bodies(part)
        except SeveralBodies:
            continue
        sure = sum(_sure_of(labels, rules) for labels in bodies.bodies)
        # one more marker in a usual frame: the noise of one label is no reason to take another set
        better = sure >= rules.explained * part.counts.mean() and _sure_of(bodies.labelling, rules) >= least + 1.0
        if better and sure > most:
            found, most = wider, sure
    return found


def _candidates(name: str, other: MarkerSet, asked: MarkerSet, progress: Progress | None) -> Iterator[WiderModel]:
    """A shipped set, and the same with the markers that it lacks."""
    columns = counterparts(asked, other)
    by_name = np.array([other.name_of(name) is not None for name in asked.names])
    if (columns != NULL).any():
        yield WiderModel(name, virtual_model(other, progress=progress), columns, by_name)
    if (columns == NULL).any():
        own = columns == NULL
        both, columns = with_markers_of(other, asked, columns)
        yield WiderModel(name, virtual_model(both, progress=progress), columns, by_name | own)


def _fullest(clouds: Clouds, frames: int) -> Clouds:
    """So many frames in one piece in which most points are seen."""
    counts = np.asarray(clouds.counts)
    begin = int(np.convolve(counts, np.ones(min(frames, len(counts))), "valid").argmax())
    return clouds.frames(slice(begin, begin + frames))


def _sure(labeller: RecordingLabeller, clouds: Clouds, rules: WiderRules) -> float:
    try:
        return _sure_of(labeller.label_bodies(clouds).labelling, rules)
    except SeveralBodies:
        # two people are not one with many markers
        return float("inf")


def _sure_of(labelling: Labelling, rules: WiderRules) -> float:
    """Markers of a frame, on average, of whose points the labels are sure."""
    return float(((labelling.indices != NULL) & (labelling.confidence >= rules.sure)).sum() / max(1, len(labelling.indices)))
