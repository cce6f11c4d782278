"""What speaks against labels when all are chosen: distances that are not those of this body, or not those of any body known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.body.model import BodyModel, BodyRules, length_scale
from asterism.labelling.whole._distance_kernels import foreign_distances, misfits
from asterism.labelling.whole._kernels import score_frames
from asterism.labelling.whole.certainty import beside_spare
from asterism.labelling.whole.scene import Scene, TimeRules, own_labels
from asterism.recording import NULL, Floats, Ints

LEAST, PARTNERS, MOST = 5, 6, 8.0
"""Frames that a distance must be known from; the steadiest distances that count; standard deviations that one counts at most."""


def riding_along(scene: Scene, label: Ints, starts: Ints, rules: TimeRules) -> Floats:
    """Nats of margin (J,) that tracklets lose whose near-rigid distances are not those that their markers have elsewhere in the recording.

    A ghost that rides along where a marker is hidden can have the right pose, but hardly the right distances of this very body. Only
    recordings with points that nobody claims are suspected of ghosts.
    """
    off, one = np.zeros(len(label)), np.zeros(len(label))
    spare = beside_spare(label, scene.first, scene.last)
    if not spare.any():
        return off
    for number in range(len(starts) - 1):
        own = own_labels(label, starts, number)
        misfits(
            scene.seen_xyz,
            scene.seen_frame,
            scene.seen_track,
            own,
            frames=len(scene.looked),
            markers=int(starts[number + 1] - starts[number]),
            noise=rules.rigid_noise,
            rigid=rules.rigid,
            least=LEAST,
            partners=PARTNERS,
            most=MOST,
            out=one,
        )
        off = np.maximum(off, one)
    return rules.misfit_cost * np.maximum(off - rules.misfit, 0.0) ** 2 * (spare > 0)


def strange(labeller: BodyLabeller, body: BodyModel, scene: Scene, own: Ints, rules: TimeRules, body_rules: BodyRules) -> NDArray[np.bool_]:
    """Labelled tracklets (J,) whose distances to near-rigid neighbours are not those that their marker had in the training.

    Where most frames of a tracklet explain their labels worse than nearly every frame of people left out did, it is a movement that the
    model knows nothing of: there a label must prove itself by distances that fit better, and is doubted where there are none to compare.
    own (J,): labels as markers of this body, -1 for none; body: the model as adapted to the subject.
    """
    markers = labeller.model.mean.shape[1]
    apart = np.linalg.norm(labeller.model.mean[:, :, None] - labeller.model.mean[:, None], axis=3)
    unit = length_scale(labeller.model.mean[0], body_rules)
    off = np.empty(len(own))
    usual = foreign_distances(
        scene.seen_xyz,
        scene.seen_frame,
        scene.seen_track,
        own,
        frames=len(scene.looked),
        low=apart.min(axis=0),
        high=apart.max(axis=0),
        noise=rules.foreign_noise * unit,
        size=body_rules.size_std,
        rigid=rules.rigid * unit,
        least=LEAST,
        partners=PARTNERS,
        most=MOST,
        out=off,
    )
    scores, totals = np.empty((len(scene.seen_xyz), markers)), np.empty(len(scene.looked))
    arrays = labeller.body if body is labeller.model else body.arrays()
    poses = np.empty(len(scene.looked), dtype=np.int64)
    score_frames(scene.seen_xyz, scene.seen_offsets, scene.seen_track, own, arrays, labeller.settings, scores, totals, poses)
    points = np.nonzero(own[scene.seen_track] != NULL)[0]
    frame, track = scene.seen_frame[points], scene.seen_track[points]
    # the more points there are, the less one more that lies well tells; see `frame_settings`
    crowd = np.log1p(np.maximum(np.diff(scene.seen_offsets) - markers, 0))
    poor = _medians(scores[points, own[track]], frame, len(scene.looked)) < labeller.settings.usual_score - crowd
    looks, poorly = np.bincount(track, minlength=len(own)), np.bincount(track, weights=poor[frame], minlength=len(own))
    unfamiliar = poorly > 0.5 * looks
    # a body that differs all over, as another person does from the only one of the training, says little against single labels
    limit = np.where(unfamiliar, rules.unfamiliar, rules.familiar * max(1.0, usual))
    return (own != NULL) & np.where(np.isnan(off), unfamiliar, off > limit)


def _medians(values: Floats, group: Ints, groups: int) -> Floats:
    """The (lower) median of the values of each group, NaN for one that is empty: (groups,)."""
    order = np.lexsort((values, group))
    counts = np.bincount(group, minlength=groups)
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    out = np.full(groups, np.nan)
    some = counts > 0
    out[some] = values[order][begins[some] + (counts[some] - 1) // 2]
    return out
