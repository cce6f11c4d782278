"""Blobs of a few calibrated cameras and a body model in; the marker of each blob and the places of all markers, over time, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.cameras import Rig
from asterism.progress import Progress
from asterism.recording import NULL, Blobs, Ints
from asterism.views import checks
from asterism.views.body import ArticulatedBody
from asterism.views.body_file import load_body
from asterism.views.frame import FrameLabeller
from asterism.views.passes import DirectionalTracker, ScoredFrame, Starts, joined
from asterism.views.personal import personal_body
from asterism.views.result import ViewsLabelling
from asterism.views.rules import RULES, ViewsRules
from asterism.views.scene import scene_of

_DOUBTFUL = 0.3
"""The highest confidence of labels that were not given because the whole does not fit."""


def label_views(
    blobs: Blobs,
    rig: Rig,
    body: ArticulatedBody | str,
    *,
    height: float | None = None,
    rules: ViewsRules = RULES,
    least_confidence: float = 0.9,
    progress: Progress | None = None,
) -> ViewsLabelling:
    """Label the blobs of a recording with a body model, frame after frame, and place every marker that a camera shows.

    The body is sought with any heading, size and place, followed from frame to frame in both directions of time, and compared every
    `ViewsRules.turn_frames` frames with the body that is found without a start; the better explanation of the frames wins, and the other
    one lowers the confidence of the labels in which they differ. Where the body is lost it is sought anew. Before that some frames show
    where on this person the markers sit (`ViewsRules.personal`). Labels that are less probable than `least_confidence` are not given. A
    frame whose blobs the body does not explain gets no label at all.

    rig     calibrated cameras with the blobs' names and a vertical
    body    a body model, the name of a shipped one, or a file
    height  m, of the person, where it is known

    Raises AsterismError where the rig lacks a camera, a pose or a vertical, and where the body's left markers are on its right.
    O(T (P M + M D^2)) for P blobs of a frame and D numbers of a pose.
    """
    body = load_body(body)
    checks.refuse_mirrored(body)
    scene = scene_of(blobs, rig)
    labeller = FrameLabeller(scene, body, rules, None if height is None else height / body.height)
    # The general body's places can be off by centimetres on this person, so it is learned before labels are given.
    if rules.personal and len(blobs):
        labeller = _for_person(labeller)
    track = _Track(labeller, body)
    track.run(progress)
    result = track.result(least_confidence)
    misfits = checks.misfits(result)
    # A camera that does not fit the others would pull their points off: it is left out and everything is done again.
    if len(misfits):
        result = _without(blobs, rig, misfits, body, height, rules, least_confidence)
    if checks.is_other_body(result):
        result = _withdrawn(result)
    return replace(result, findings=tuple(checks.findings(result, misfits)))


def _for_person(labeller: FrameLabeller) -> FrameLabeller:
    """The labeller with the person's own body, which has its size; as it is where nothing is learned."""
    own = personal_body(labeller)
    return labeller if own is labeller.body else replace(labeller, body=own, size=None)


def _without(
    blobs: Blobs, rig: Rig, cameras: Ints, body: ArticulatedBody, height: float | None, rules: ViewsRules, least_confidence: float
) -> ViewsLabelling:
    """The labelling by the other cameras; without any label where fewer than two of them, or fewer than half of all, have blobs."""
    kept = ~np.isin(blobs.camera_of, cameras)
    seeing = blobs.counts.sum(axis=0) > 0
    left = int(seeing.sum()) - int(seeing[cameras].sum())
    scene = scene_of(blobs.select(kept), rig)
    labeller = FrameLabeller(scene, body, rules, None if height is None else height / body.height)
    # Two cameras that are left out of five say that the rig is wrong rather than two cameras.
    enough = left >= 2 and 2 * left >= int(seeing.sum())
    if enough and rules.personal:
        labeller = _for_person(labeller)
    track = _Track(labeller, body)
    track.run()
    few = track.result(least_confidence)
    # Where the remaining cameras still contradict each other nobody knows which of them is right.
    if not enough or len(checks.misfits(few)):
        few = _withdrawn(few)
    labels, candidates = np.full((2, len(blobs.xy)), NULL, dtype=np.int64)
    confidence = np.zeros(len(blobs.xy))
    labels[kept], candidates[kept], confidence[kept] = few.labels, few.candidates, few.confidence
    return replace(few, blobs=blobs, labels=labels, candidates=candidates, confidence=confidence)


def _withdrawn(result: ViewsLabelling) -> ViewsLabelling:
    """The labelling without any label: the whole does not fit."""
    return replace(
        result,
        labels=np.full_like(result.labels, NULL),
        confidence=np.minimum(result.confidence, _DOUBTFUL),
        views=np.zeros_like(result.views),
        positions=np.full_like(result.positions, np.nan),
        covariances=np.full_like(result.covariances, np.nan),
        poses=np.full_like(result.poses, np.nan),
    )


class _Track:
    """All frames in both directions of time, and the result."""

    def __init__(self, labeller: FrameLabeller, body: ArticulatedBody) -> None:
        self.body = body
        self.labeller = labeller
        self.seen: list[ScoredFrame | None] = []
        self.restarts: list[int] = []

    def run(self, progress: Progress | None = None) -> None:
        """Label all frames."""
        frames, both = len(self.labeller.scene.blobs), self.labeller.rules.both_ways
        starts, total = Starts(self.labeller), frames * (2 if both else 1)
        forward, backward = DirectionalTracker(self.labeller, starts, 1), DirectionalTracker(self.labeller, starts, -1)
        for n in range(total):
            # The second direction ends where the first began, so that both have seen the whole recording.
            if n < frames:
                forward.take(n)
            else:
                backward.take(2 * frames - 1 - n)
            if progress is not None:
                progress((n + 1) / total, "labelling")
        self.seen = joined(forward, backward) if both else [forward.seen[t] for t in range(frames)]
        self.restarts = sorted({*forward.restarts, *backward.restarts})

    def result(self, least_confidence: float) -> ViewsLabelling:
        """All frames together."""
        scene, body, rules = self.labeller.scene, self.labeller.body, self.labeller.rules
        frames, markers, cameras = len(self.seen), len(body.markers), len(scene.rig)
        labels, candidates = np.full((2, len(scene.blobs.xy)), NULL, dtype=np.int64)
        confidence = np.zeros(len(scene.blobs.xy))
        positions, covariances = np.full((frames, markers, 3), np.nan), np.full((frames, markers, 3, 3), np.nan)
        poses, rotations = np.full((frames, 9 + len(body.hinges)), np.nan), np.full((frames, 3, 3), np.nan)
        placed, expected = np.full((frames, markers, 3), np.nan), np.zeros((frames, cameras, markers))
        views = np.zeros((frames, markers), dtype=np.int64)
        for t, found in enumerate(self.seen):
            if found is None:
                continue
            first, last = scene.blobs.offsets[t * cameras], scene.blobs.offsets[(t + 1) * cameras]
            sights = np.bincount(found.labels.labels[found.labels.labels >= 0], minlength=markers)
            # A label seen by one camera alone has no second ray to contradict it, so its confidence is judged apart.
            sure = rules.confidence(found.labels.margin, sights[found.labels.labels] < 2, found.labels.rival_margin)
            given = (found.labels.labels >= 0) & (sure >= least_confidence)
            confidence[first:last] = np.where(found.labels.labels >= 0, sure, 0.0)
            candidates[first:last] = found.labels.labels
            # A frame in which the body was lost keeps its labels as candidates only.
            if found.quality < rules.lost:
                confidence[first:last] = np.minimum(confidence[first:last], _DOUBTFUL)
                continue
            labels[first:last] = np.where(given, found.labels.labels, NULL)
            found_views = np.bincount(found.labels.labels[given], minlength=markers)
            poses[t], rotations[t] = found.labels.pose, found.labels.rotation
            expected[t] = self.labeller.expected(found.labels)
            placed[t] = self.labeller.placed(found.labels)
            views[t] = found_views
            # Only markers with a label that was given get a place.
            there = found_views > 0
            positions[t, there], covariances[t, there] = found.labels.points[there], found.labels.covariances[there]
        made = ViewsLabelling(
            scene.rig,
            scene.blobs,
            self.body,
            body,
            labels,
            confidence,
            candidates,
            positions,
            covariances,
            views,
            poses,
            rotations,
            placed,
            expected,
            tuple(self.restarts),
        )
        return made
