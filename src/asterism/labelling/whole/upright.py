"""Frames in which the body leans or lies as it never did in the training: labels in; the rotations that set it upright out.

The body model knows the body's heading only up to a turn about the vertical; how it leans, it has learned. A somersault therefore scores
poorly under its right labels, too. Once most of a frame's labels are known, the body can be laid onto a key pose by any rotation.
"""

from __future__ import annotations

import numpy as np

from asterism.geometry import fit_rigid
from asterism.labelling.body._score_kernels import best_pose
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole.scene import SceneScores
from asterism.labelling.whole.settings import RecordingLabellingSettings
from asterism.recording import NULL, Floats, Ints


def upright_turns(labeller: BodyLabeller, scores: SceneScores, label: Ints, rules: RecordingLabellingSettings) -> Floats | None:
    """The rotation (E, 3, 3) that sets each sampled frame's body upright, the identity for most; None where no frame is turned.

    scores: by the labeller's body; label (J,): markers of the tracklets, -1 for none. Only frames that score worse than rightly labelled
    ones usually do are tried, and only those that score better by `rules.turn_cost` are turned. O(tried frames * K^2) calls of `evidence`.
    """
    scene, totals = scores.scene, scores.of(label).totals
    frames, markers = len(scene.sampled_frames), labeller.body.mean.shape[1]
    labelled = np.bincount(scene.sampled_frame, weights=label[scene.sampled_track] != NULL, minlength=frames)
    surplus = np.log1p(np.maximum(np.diff(scene.sampled_offsets) - markers, 0))
    poor = (totals < labelled * (labeller.settings.usual_score - surplus)) & (labelled >= max(3.0, rules.min_turned_share * markers))
    turns = np.tile(np.eye(3), (frames, 1, 1))
    for e in np.nonzero(poor)[0]:
        own = slice(scene.sampled_offsets[e], scene.sampled_offsets[e + 1])
        marker = label[scene.sampled_track[own]]
        there = marker != NULL
        turns[e] = _upright_turn(labeller, scene.sampled_xyz[own][there], marker[there], rules)
    return turns if (turns != np.eye(3)).any() else None


def _upright_turn(labeller: BodyLabeller, points: Floats, marker: Ints, rules: RecordingLabellingSettings) -> Floats:
    """The rotation (3, 3) for one frame's labelled points (n, 3) m, marker (n,)."""
    body, settings = labeller.body, labeller.settings
    point_of = np.full(body.mean.shape[1], NULL, dtype=np.int64)
    point_of[marker] = np.arange(len(marker))
    workspace = make_body_workspace(len(points), len(point_of), body.load.shape[3])
    best, turn = best_pose(body, points, point_of, settings, workspace)[1] + rules.turn_cost, np.eye(3)
    for mean in body.mean:
        rotation = fit_rigid(points, mean[marker])[0]
        score = best_pose(body, np.ascontiguousarray(points @ rotation.T), point_of, settings, workspace)[1]
        if score > best:
            best, turn = score, rotation
    return turn


def turned(xyz: Floats, frame: Ints, turns: Floats) -> Floats:
    """Points (P, 3) m, turned about the origin by the rotation of the frame (P,) that each is in."""
    out = xyz.copy()
    points = np.nonzero((turns != np.eye(3)).any(axis=(1, 2))[frame])[0]
    out[points] = np.einsum("pij,pj->pi", turns[frame[points]], xyz[points])
    return out
