"""Blobs of a few calibrated cameras and a body model in; the marker of each blob and the places of all markers, over time, out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.files.journal import Journal
from asterism.progress import Progress
from asterism.recording import NULL, Blobs, Floats, Ints
from asterism.skeleton.body import ArticulatedBody
from asterism.skeleton.body_file import load_body
from asterism.views import checks
from asterism.views.chains import continued
from asterism.views.frame import FrameLabeller
from asterism.views.lateness import in_step, late_by
from asterism.views.passes import DirectionalTracker, ScoredFrame, Starts, joined
from asterism.views.personal import PERSONAL, personal_body, spread_frames
from asterism.views.result import ViewsLabelling
from asterism.views.rig_fit import CameraAgreement, fit_rig, turned_rig
from asterism.views.rules import RULES, ViewsRules
from asterism.views.scene import scene_of

_DOUBTFUL = 0.3
"""The highest confidence of labels that were not given because the whole does not fit."""
_TRIES = 3
"""Times that everything is labelled anew after a delay was found: labels of a camera that is far out of step show less than all of it."""
_EVERY = 3
"""Every third of the frames by which the person is learned says how the cameras fit: eight of them, some 400 blobs of four cameras."""


def label_views(
    blobs: Blobs,
    rig: Rig,
    body: ArticulatedBody | str,
    *,
    height: float | None = None,
    rules: ViewsRules = RULES,
    least_confidence: float = 0.9,
    journal: Journal | None = None,
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
    journal what was found in each frame is kept there; frames that it holds are not labelled again, and the result is the same

    A camera that is late by a frame or more is labelled in the frames that it shows, see `ViewsLabelling.late`. A frame whose labelling
    fails has no labels, which is a finding.

    Raises AsterismError where the rig lacks a camera, a pose or a vertical, and where the body's left markers are on its right.
    O(T (P M + M D^2)) for P blobs of a frame and D numbers of a pose.
    """
    body = load_body(body)
    checks.refuse_mirrored(body)
    size = None if height is None else height / body.height
    labeller = FrameLabeller(scene_of(blobs, rig, usual=rules.shown), body, rules, size)
    keeping = _Keeping(journal, progress)
    done, behind, rows = (
        _settled(labeller, body, least_confidence, keeping),
        np.zeros(len(blobs.cameras), dtype=np.int64),
        np.arange(len(blobs.xy)),
    )
    late = _late(done)
    for _ in range(_TRIES):
        step = np.rint(late).astype(np.int64)
        if not step.any():
            break
        # A late camera is labelled in the frames that it shows; were the delay an error, the cameras would agree less.
        moved, there = in_step(blobs, behind + step)
        other = _settled(replace(labeller, scene=scene_of(moved, rig, usual=rules.shown)), body, least_confidence, keeping)
        if other.gain <= done.gain:
            late = np.where(step == 0, late, 0.0)
            break
        done, behind, rows, late = other, behind + step, there, _late(other)
    result, late = replace(done.result, late=behind), late + behind
    findings = (*checks.failed_frames(keeping.failed, blobs.first_frame), *checks.findings(result, done.fit, late))
    return replace(_of_all_blobs(result, blobs, rows), findings=findings)


@dataclass(frozen=True, eq=False)
class _Settled:
    """A labelling by the cameras that fit, how they agree, and the gain of all frames (nats)."""

    result: ViewsLabelling
    fit: CameraAgreement
    gain: float


def _settled(labeller: FrameLabeller, body: ArticulatedBody, least_confidence: float, keeping: _Keeping) -> _Settled:
    """The labelling by the cameras that fit each other; without any label where nobody knows which do."""
    fit = fit_rig(labeller, spread_frames(labeller, PERSONAL.frames)[::_EVERY])
    if len(fit.turned):
        labeller = replace(labeller, scene=labeller.scene.before(turned_rig(labeller.scene.rig, fit.turned)))
    result, gain = _labelled(labeller, body, fit, least_confidence, keeping)
    more = checks.misfits(result, fit)
    # A camera that was moved half-way fits in some frames: it is left out and everything is done again.
    if len(more):
        fit = replace(fit, left_out=np.concatenate([fit.left_out, more]), found={})
        result, gain = _labelled(labeller, body, fit, least_confidence, keeping)
        # Where the remaining cameras still contradict each other nobody knows which of them is right.
        if len(checks.misfits(result, fit)):
            result = _withdrawn(result)
    # Labels of mirrored images are those of the other side.
    mirrored = len(np.setdiff1d(fit.mirrored, fit.left_out)) > 0
    if mirrored or checks.is_contradicted(result, fit.left_out) or checks.is_other_body(result):
        result = _withdrawn(result)
    return _Settled(result, fit, gain)


def _late(done: _Settled) -> Floats:
    """(C,) frames by which cameras are still late; 0 where nothing is certain."""
    late: Floats = np.nan_to_num(late_by(done.result, done.fit.noise, done.fit.left_out))
    return late


def _of_all_blobs(result: ViewsLabelling, blobs: Blobs, rows: Ints) -> ViewsLabelling:
    """A labelling of some of the blobs, those of `rows`, as one of all: the others have no label."""
    labels, candidates = np.full((2, len(blobs.xy)), NULL, dtype=np.int64)
    confidence = np.zeros(len(blobs.xy))
    labels[rows], candidates[rows], confidence[rows] = result.labels, result.candidates, result.confidence
    return replace(result, blobs=blobs, labels=labels, candidates=candidates, confidence=confidence)


@dataclass
class _Keeping:
    """Where the frames of a labelling go as they are done, and why some of them failed."""

    journal: Journal | None
    progress: Progress | None
    failed: dict[int, str] = field(default_factory=dict)


def _labelled(
    labeller: FrameLabeller, body: ArticulatedBody, fit: CameraAgreement, least_confidence: float, keeping: _Keeping
) -> tuple[ViewsLabelling, float]:
    """The labelling by the cameras that fit, with their noise, and its gain; the blobs of the others stay without a label."""
    blobs, rules = labeller.scene.blobs, labeller.rules.at_noise(fit.noise)
    used = replace(labeller, scene=labeller.scene.without(fit.left_out), rules=rules)
    # The general body's places can be off by centimetres on this person, so it is learned before labels are given.
    if rules.personal and len(blobs):
        own = personal_body(used, PERSONAL, known=fit.found)
        used = used if own is body else replace(used, body=own, size=None)
    track = _Track(used, body)
    track.run(keeping.progress, keeping.journal)
    keeping.failed.update(track.failed)
    kept = np.nonzero(~np.isin(blobs.camera_of, fit.left_out))[0]
    # Frames that show no body gain nothing.
    gain = sum(max(found.labels.gain, 0.0) for found in track.seen if found is not None)
    return _of_all_blobs(track.result(least_confidence), blobs, kept), gain


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
        self.failed: dict[int, str] = {}
        """Why, by frame."""

    def run(self, progress: Progress | None = None, journal: Journal | None = None) -> None:
        """Label all frames. Raises AsterismError where the labelling of every one fails."""
        frames, both = len(self.labeller.scene.blobs), self.labeller.rules.both_ways
        starts, total = Starts(self.labeller), frames * (2 if both else 1)
        forward, backward = DirectionalTracker(self.labeller, starts, 1), DirectionalTracker(self.labeller, starts, -1)
        for n in range(total):
            # The second direction ends where the first began, so that both have seen the whole recording.
            if n < frames:
                forward.take(n, journal)
            else:
                backward.take(2 * frames - 1 - n, journal)
            if progress is not None:
                progress((n + 1) / total, "labelling")
        self.seen = joined(forward, backward) if both else [forward.seen[t] for t in range(frames)]
        self.restarts = sorted({*forward.restarts, *backward.restarts})
        self.failed = {**backward.failed, **forward.failed}
        # A fault that every frame has is none of a frame.
        if frames and len(forward.failed) == frames:
            raise AsterismError(f"no frame can be labelled ({forward.failed[0]}); please report this with the file of blobs.")

    def _explained(self) -> Floats:
        """(T,) the share of the gain that the blobs let expect: of each frame or of those around it, whichever is less."""
        own = np.array([np.nan if each is None else self.labeller.explained(each.labels, shown=True) for each in self.seen])
        there, around = np.isfinite(own), np.ones(2 * self.labeller.rules.window + 1)
        inside = slice(self.labeller.rules.window, self.labeller.rules.window + len(own))
        # A wrong body stays for many frames, and may explain a single one well.
        total, of = (np.convolve(each, around)[inside] for each in (np.nan_to_num(own), there.astype(np.float64)))
        return np.fmin(own, total / np.maximum(of, 1.0))

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
        explained = self._explained()
        for t, found in enumerate(self.seen):
            if found is None:
                continue
            first, last = scene.blobs.offsets[t * cameras], scene.blobs.offsets[(t + 1) * cameras]
            sights = np.bincount(found.labels.labels[found.labels.labels >= 0], minlength=markers)
            # A label seen by one camera alone has no second ray to contradict it, so its confidence is judged apart.
            sure = rules.confidence(found.labels.margin, sights[found.labels.labels] < 2, found.labels.rival_margin, explained[t])
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
        # A frame alone may be explained better by another body than by the one that the frames around it show.
        frame_of, there = scene.blobs.frame_of, candidates >= 0
        sure = np.zeros((frames, markers))
        np.maximum.at(sure, (frame_of[there], candidates[there]), confidence[there])
        confidence[there] = np.minimum(
            confidence[there], continued(positions, sure, scene.blobs.rate, rules.window)[frame_of[there], candidates[there]]
        )
        labels[confidence < least_confidence] = NULL
        views[:] = 0
        np.add.at(views, (frame_of[labels >= 0], labels[labels >= 0]), 1)
        positions[views == 0], covariances[views == 0] = np.nan, np.nan
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
            scene.cameras.detected,
            np.zeros(cameras, dtype=np.int64),
            tuple(self.restarts),
        )
        return made
