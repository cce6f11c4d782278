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
from asterism.recording import NULL, Clouds, MarkerSet
from asterism.session.upright import fullest
from asterism.session.worn.find import evidence_of, placed_sets
from asterism.skeleton import counterparts, with_markers_of


@dataclass(frozen=True)
class WiderRules:
    """When another set labels.

    left_over  points of a usual frame beyond the markers, as a share of these, from which one is looked for. At half, looking costs a
               second where labels are right anyhow; at double, medial markers may be taken for lateral ones
    sets       shipped sets that are tried at most: each costs seconds where its model is not kept yet. Not tuned
    behind     nats of a frame by which a set may be behind the best to be tried: it is a twentieth as probable then
    frames     that the models label to be compared, in one piece: some seconds. Not tuned
    sure       confidence from which a label counts. Nothing below it tells models apart: in a crowd, labels of a model that does not know
               the extra points are 0.95 certain and wrong
    explained  share of the points that must have a sure name. The largest at which no larger set was refused that labels better, on 42
               recordings of virtual people and of `movement`: 75.8 % right, 1.12 % wrong. At half the same; at 0.5 73.9 and 1.53 %; at
               double 62.8 and 4.28 %. On a person with two sets (pig39), sets that are not worn are sure of 0.01
    """

    left_over: float = 0.3
    sets: int = 2
    behind: float = 9.0
    frames: int = 60
    sure: float = 0.99
    explained: float = 0.35


def wider_model(model: MarkerModel, clouds: Clouds, rules: WiderRules | None = None, progress: Progress | None = None) -> WiderModel | None:
    """What labels these points in place of a model of virtual people; None where its own markers explain them as well.

    The best of the shipped sets is taken as it is, or with the markers that it lacks, whichever is sure of more points; but only where it
    is sure of enough of them, and of more markers asked for. Models that are not kept yet take seconds each.
    """
    rules, asked = rules or WiderRules(), model.marker_set
    counts = np.asarray(clouds.counts)
    if not asked.places or not counts.any() or np.median(counts[counts > 0]) - len(asked) < rules.left_over * len(asked):
        return None
    evidence = evidence_of(clouds)
    if evidence is None:
        return None
    nats = evidence.nats
    best = np.argsort(-nats, kind="stable")[: rules.sets]
    likely = [list(placed_sets())[at] for at in best if nats[at] > nats[best[0]] - rules.behind]
    if MarkerSet.load(likely[0]).names == asked.names:
        return None
    part = fullest(clouds, rules.frames)
    found, most, (least, _) = None, -1.0, _sure(RecordingLabeller(model), part, rules)
    for name in likely:
        for wider in _candidates(name, asked, progress):
            own, sure = _sure(RecordingLabeller(model, wider=wider), part, rules)
            # one more marker in a usual frame: the noise of one label is no reason to take another set
            if sure >= rules.explained * part.counts.mean() and own >= least + 1.0 and sure > most:
                found, most = wider, sure
    return found


def _candidates(name: str, asked: MarkerSet, progress: Progress | None) -> Iterator[WiderModel]:
    """A shipped set, and the same with the markers that it lacks."""
    other = MarkerSet.load(name)
    columns = counterparts(asked, other)
    by_name, own = np.array([other.name_of(marker) is not None for marker in asked.names]), columns == NULL
    if not own.all():
        yield WiderModel(name, virtual_model(other, progress=progress), columns, by_name)
    if own.any():
        both, columns = with_markers_of(other, asked, columns)
        yield WiderModel(name, virtual_model(both, progress=progress), columns, by_name | own)


def _sure(labeller: RecordingLabeller, clouds: Clouds, rules: WiderRules) -> tuple[float, float]:
    """Markers asked for, and markers in all, of whose points in a frame the labels are sure, on average.

    Both are 0 where two bodies seem to be there.
    """
    try:
        bodies = labeller.label_bodies(clouds).bodies
    except SeveralBodies:
        return 0.0, 0.0
    sure = [float(((one.indices != NULL) & (one.confidence >= rules.sure)).sum() / max(1, len(one.indices))) for one in bodies]
    return sure[0], sum(sure)
