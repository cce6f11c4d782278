"""Labels checked when all are chosen: distances between markers that are not those of this body, or not those of any body known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules, length_scale
from asterism.labelling.whole._distance_kernels import DistanceLimits, TrackedPoints, rigid_deviations, training_deviations
from asterism.labelling.whole._residual_kernels import ResidualLimits, prediction_residuals, residual_deviations
from asterism.labelling.whole.certainty import overlaps_unlabelled
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, marker_offsets
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.recording import NULL, Floats, Ints

MIN_FRAMES, MAX_PARTNERS, MAX_DEVIATION = 5, 6, 8.0
"""Frames that a distance must be known from; how many of the steadiest distances count; standard deviations that one counts at most."""


def ghost_penalty(
    labellers: Sequence[BodyLabeller], bodies: Sequence[BodyModel], scene: RecordingScene, label: Ints, rules: RecordingLabellingSettings
) -> Floats:
    """Nats of margin (J,) that tracklets lose that do not lie, in this body, where their markers lie elsewhere in the recording.

    A ghost that moves with the body where a marker is hidden can fit the pose, but hardly the places and distances of this very body. Only
    tracklets during which some point has no label are checked: elsewhere there is no sign of ghosts.
    bodies: the models as adapted to the subjects.
    """
    near_unlabelled = overlaps_unlabelled(label, scene.first, scene.last)
    if not near_unlabelled.any():
        return np.zeros(len(label))
    offsets = marker_offsets(labellers)
    by_distance = own_deviations(scene, label, offsets, rules, labellers)
    by_place = place_deviations(labellers, bodies, scene, label, rules)
    deviation = np.where(np.isnan(by_place), by_distance, np.sqrt(0.5 * (np.nan_to_num(by_place) ** 2 + by_distance**2)))
    return rules.deviation_cost * np.maximum(deviation - rules.max_rigid_deviation, 0.0) ** 2 * (near_unlabelled > 0)


def place_deviations(
    labellers: Sequence[BodyLabeller], bodies: Sequence[BodyModel], scene: RecordingScene, label: Ints, rules: RecordingLabellingSettings
) -> Floats:
    """Standard deviations (J,) by which tracklets lie elsewhere, in the body, than their markers do in the rest of the recording.

    A marker's place in a frame is taken from where all other labelled points predict it. NaN where it cannot be told.
    bodies: the models as adapted to the subjects.
    """
    offsets, out = marker_offsets(labellers), np.full(len(label), np.nan)
    residuals, of_body = np.empty_like(scene.sampled_xyz), np.empty(len(label))
    limits = ResidualLimits(rules.min_rigid_std, MIN_FRAMES)
    for number, (labeller, body) in enumerate(zip(labellers, bodies, strict=True)):
        own = labels_of_body(label, offsets, number)
        arrays = labeller.body if body is labeller.model else body.arrays()
        prediction_residuals(scene.sampled_xyz, scene.sampled_offsets, scene.sampled_track, own, arrays, labeller.settings, residuals)
        residual_deviations(residuals, scene.sampled_track, own, limits, of_body)
        out = np.where(own != NULL, of_body, out)
    return out


def own_deviations(
    scene: RecordingScene, label: Ints, offsets: Ints, rules: RecordingLabellingSettings, labellers: Sequence[BodyLabeller] = ()
) -> Floats:
    """Standard deviations (J,) by which tracklets' near-rigid distances differ from those of their markers elsewhere in the recording.

    labellers: by their key poses, distances are taken to vary as much as they do from pose to pose, however few the recording shows.
    """
    worst, of_body = np.zeros(len(label)), np.zeros(len(label))
    points = TrackedPoints(scene.sampled_xyz, scene.sampled_frame, scene.sampled_track, len(scene.sampled_frames))
    limits = DistanceLimits(rules.min_rigid_std, 0.0, rules.max_rigid_std, MIN_FRAMES, MAX_PARTNERS, MAX_DEVIATION)
    for number, markers in enumerate(np.diff(offsets)):
        least_std = np.zeros((markers, markers))
        if labellers:
            mean = labellers[number].model.mean
            least_std = rules.pose_spread * np.ptp(np.linalg.norm(mean[:, :, None] - mean[:, None], axis=3), axis=0)
        rigid_deviations(points, labels_of_body(label, offsets, number), least_std, limits, of_body)
        worst = np.maximum(worst, of_body)
    return worst


@dataclass(frozen=True)
class TrainingDeviations:
    """How far the near-rigid distances of labelled tracklets (J,) are off those that their markers had in the training.

    deviation   (J,) standard deviations, NaN where a tracklet has no label or no distances to compare
    usual       their median over all near-rigid distances: how much this body differs from those of the training as a whole
    unfamiliar  (J,) whether most frames of the tracklet fit their labels worse than nearly every frame of people left out did
    """

    deviation: Floats
    usual: float
    unfamiliar: NDArray[np.bool_]

    def are_off(self, rules: RecordingLabellingSettings) -> NDArray[np.bool_]:
        """Tracklets (J,) whose labels are doubtful for it.

        In a movement that the model does not know the distances must fit more closely, and a label that has none to compare is doubtful,
        too. A body that differs all over, as another person does from the only one of the training, says little against single labels.
        """
        limit = np.where(self.unfamiliar, rules.max_deviation_unfamiliar, rules.max_deviation_familiar * max(1.0, self.usual))
        return np.where(np.isnan(self.deviation), self.unfamiliar, self.deviation > limit)


def compare_with_training(
    labeller: BodyLabeller, scores: Floats, scene: RecordingScene, label: Ints, rules: RecordingLabellingSettings, body_rules: BodyRules
) -> TrainingDeviations:
    """Compare the distances of labelled tracklets with those of the training.

    label (J,): labels as markers of this body, -1 for none; scores (Q, M) nats of the scene by the model as adapted to the subject, see
    `score_scene`.
    """
    unit = length_scale(labeller.model.mean[0], body_rules)
    deviation = np.empty(len(label))
    points = TrackedPoints(scene.sampled_xyz, scene.sampled_frame, scene.sampled_track, len(scene.sampled_frames))
    limits = DistanceLimits(
        rules.training_noise * unit, body_rules.size_std, rules.max_rigid_std * unit, MIN_FRAMES, MAX_PARTNERS, MAX_DEVIATION
    )
    usual = training_deviations(points, label, *labeller.distance_range, limits, deviation)
    return TrainingDeviations(deviation, float(usual), _in_unfamiliar_movement(labeller, scores, scene, label))


def _in_unfamiliar_movement(labeller: BodyLabeller, scores: Floats, scene: RecordingScene, label: Ints) -> NDArray[np.bool_]:
    """Tracklets (J,) most of whose sampled frames fit the body worse than nearly every frame of people left out did."""
    markers, frames = labeller.body.mean.shape[1], len(scene.sampled_frames)
    points = np.nonzero(label[scene.sampled_track] != NULL)[0]
    frame, track = scene.sampled_frame[points], scene.sampled_track[points]
    # the more points there are, the less one more that lies well means; see `frame_settings`
    log_surplus = np.log1p(np.maximum(np.diff(scene.sampled_offsets) - markers, 0))
    poor = _medians(scores[points, label[track]], frame, frames) < labeller.settings.usual_score - log_surplus
    count, poor_count = np.bincount(track, minlength=len(label)), np.bincount(track, weights=poor[frame], minlength=len(label))
    return poor_count > 0.5 * count


def _medians(values: Floats, group: Ints, groups: int) -> Floats:
    """The (lower) median of the values of each group, NaN for an empty one: (groups,)."""
    order = np.lexsort((values, group))
    counts = np.bincount(group, minlength=groups)
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    out = np.full(groups, np.nan)
    some = counts > 0
    out[some] = values[order][begins[some] + (counts[some] - 1) // 2]
    return out
