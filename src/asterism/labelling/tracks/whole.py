"""A whole recording's labelling: models and clouds in; each model's labels with calibrated confidence out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.hiding import hide_in_gaps
from asterism.labelling.body.model import BodyRules
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.calibration import Calibration
from asterism.labelling.look import Progress
from asterism.labelling.tracks.joint import Looker, Outcome, TimeRules, label_scene, lay_out, own_labels
from asterism.labelling.tracks.linking import find_tracklets
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording


@dataclass(frozen=True)
class Member:
    """A model as one of the bodies in a recording.

    looker            what finds the body
    names, markers    all names of its marker set, and which of them (M,) the body has learned
    calibration       from a tracklet's margin to the confidence of its label
    least_confidence  below which a label is taken back
    """

    looker: Looker
    names: tuple[str, ...]
    markers: Ints
    calibration: Calibration
    least_confidence: float


def label_whole(
    members: Sequence[Member],
    clouds: Clouds,
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    workers: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Labelling], Outcome | None]:
    """One labelling for each member, each point given to one of them at most; and how it came about, None where there are no points."""
    if not len(clouds.xyz):
        return [_nothing(member, clouds) for member in members], None
    scene = lay_out(clouds, find_tracklets(clouds), rules)
    outcome = label_scene([member.looker for member in members], scene, rules, subject_rules, body_rules, workers, progress)
    labellings = []
    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    starts = np.concatenate([[0], np.cumsum([len(member.markers) for member in members])])
    for number, member in enumerate(members):
        label, rival = own_labels(outcome.label, starts, number), own_labels(outcome.rival, starts, number)
        blank = _nothing(member, clouds)
        indices, confidence = blank.indices, blank.confidence
        sure = member.calibration.confidence(outcome.margin)
        kept = (label != NULL) & (sure >= member.least_confidence)
        # a marker without a point: how likely its best candidate was it, never above one half unless a label was taken back
        candidate = np.where(label != NULL, label, np.where(outcome.label == NULL, rival, NULL))
        chance = np.where(label != NULL, sure, 0.5 * np.exp(np.minimum(outcome.margin, 0.0)))
        points = np.nonzero(candidate[scene.track] != NULL)[0]
        track = scene.track[points]
        np.maximum.at(confidence, (frame_of[points], member.markers[candidate[track]]), chance[track])
        points = np.nonzero(kept[scene.track])[0]
        track = scene.track[points]
        indices[frame_of[points], member.markers[label[track]]] = scene.place[points]
        confidence[frame_of[points], member.markers[label[track]]] = sure[track]
        labellings.append(Labelling(indices, confidence, member.names))
    return labellings, outcome


def trial(
    looker: Looker,
    stretches: Sequence[Recording],
    trials: Sequence[tuple[float, int]],
    rules: TimeRules,
    subject_rules: SubjectRules,
    body_rules: BodyRules,
    seed: int,
) -> tuple[Floats, Floats]:
    """Label stretches of recordings whose truth is known, markers hidden in gaps and ghosts added: margin and rightness of labels given.

    trials: (share of the markers hidden at every moment, ghosts). One entry for each label in each frame that was looked at.
    """
    rng = np.random.default_rng(seed)
    margins, rights = [np.empty(0)], [np.empty(0)]
    for stretch in stretches:
        for share, ghosts in trials:
            clouds, truth = hide_in_gaps(stretch, round(share * len(stretch.labels)), ghosts, rng)
            if not len(clouds.xyz):
                continue
            scene = lay_out(clouds, find_tracklets(clouds), rules)
            outcome = label_scene([looker], scene, rules, subject_rules, body_rules)
            label = outcome.label[scene.track]
            frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
            looked = np.isin(frame_of, scene.looked) & (label != NULL)
            margins.append(outcome.margin[scene.track[looked]])
            rights.append((truth[frame_of[looked], label[looked]] == scene.place[looked]).astype(np.float64))
    return np.concatenate(margins), np.concatenate(rights)


def _nothing(member: Member, clouds: Clouds) -> Labelling:
    shape = (len(clouds), len(member.names))
    return Labelling(np.full(shape, NULL, dtype=np.int64), np.zeros(shape), member.names)
