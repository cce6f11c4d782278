"""Blobs of a few calibrated cameras and a body model in; the marker of each blob and the places of all markers, over time, out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.findings import Finding
from asterism.progress import Progress
from asterism.recording import NULL, Blobs, Clouds, Floats, Ints, Labelling, Recording
from asterism.views import checks
from asterism.views.body import BodyModel
from asterism.views.body_file import load_body
from asterism.views.frame import FrameLabeller
from asterism.views.passes import Pass, Seen, Starts, joined
from asterism.views.personal import personal_body
from asterism.views.rules import RULES, ViewsRules
from asterism.views.scene import scene_of
from asterism.views.sights import BEFORE, SightRules, foreseen

_DOUBTFUL = 0.3
"""The highest confidence of labels that were not given because the whole does not fit."""


@dataclass(frozen=True, eq=False)
class ViewsLabelling:
    """Labels of blobs, and where the markers are.

    rig, blobs, body  what was labelled, and with which body
    person       the body of this person, with the places at which the markers were found to sit
    labels       (P,) the marker of each blob, its place in `body.labels`; -1 for "I do not know" or no marker
    confidence   (P,) the probability that the blob is that marker; of a blob without a label that of the label that was not accepted
    candidates   (P,) the most probable marker of each blob, also where it was not accepted; -1 for none
    positions    (T, M, 3) m: markers with a label in at least one camera; NaN for others
    covariances  (T, M, 3, 3) m2, of one standard deviation; NaN as positions
    views        (T, M) how many cameras show the marker
    poses        (T, 9 + J), rotations (T, 3, 3): the body; NaN where it was not found
    placed       (T, M, 3) m: all markers of the body as posed, also those that no camera shows
    expected     (T, C, M) the probability that a camera has a blob of a marker, by the body
    restarts     frames in which the body was sought anew
    findings     what a person should know
    """

    rig: Rig
    blobs: Blobs
    body: BodyModel
    person: BodyModel
    labels: Ints
    confidence: Floats
    candidates: Ints
    positions: Floats
    covariances: Floats
    views: Ints
    poses: Floats
    rotations: Floats
    placed: Floats
    expected: Floats
    restarts: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = field(default=())

    @property
    def deviations(self) -> Floats:
        """(T, M) m, standard deviation of each position along its worst direction."""
        out = np.full(self.views.shape, np.nan)
        there = self.views > 0
        out[there] = np.sqrt(np.linalg.eigvalsh(self.covariances[there])[:, -1])
        return out

    @property
    def marker_confidence(self) -> Floats:
        """(T, M) the probability that the marker's place is of its own blobs alone: the least of its labels'; 0 without a label."""
        out = np.ones(self.views.shape)
        given = self.labels >= 0
        np.minimum.at(out, (self.blobs.frame_of[given], self.labels[given]), self.confidence[given])
        return np.where(self.views > 0, out, 0.0)

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(T, C, M) whether a camera has a blob with the marker's label."""
        out = np.zeros(self.expected.shape, dtype=np.bool_)
        given = self.labels >= 0
        out[self.blobs.frame_of[given], self.blobs.camera_of[given], self.labels[given]] = True
        return out

    def foreseen(self, rules: SightRules = BEFORE) -> Floats:
        """(T, C, M) the probability that a marker is in view of a camera, by the body, and by the labels of the frames beside.

        By default that of the frame before alone; see `foreseen` in `sights`. O(T C M).
        """
        return foreseen(self.expected, self.shown, np.isfinite(self.poses[:, 0]), rules)

    @property
    def clouds(self) -> Clouds:
        """The markers' positions as points without names: those that two cameras or more show, then those of one camera, in each frame."""
        frame, marker, _ = self._points()
        offsets = np.concatenate([[0], np.cumsum(np.bincount(frame, minlength=len(self.views)))]).astype(np.int64)
        points = np.ascontiguousarray(self.positions[frame, marker])
        vertical = np.array([0.0, 0.0, 1.0]) if self.rig.vertical is None else self.rig.vertical
        return Clouds(points, offsets, self.blobs.rate, vertical, np.full(len(points), -1, dtype=np.int64))

    @property
    def labelling(self) -> Labelling:
        """The labels of `clouds`."""
        frame, marker, place = self._points()
        indices = np.full(self.views.shape, NULL, dtype=np.int64)
        indices[frame, marker] = place
        return Labelling(indices, self.marker_confidence, self.body.labels)

    def _points(self) -> tuple[Ints, Ints, Ints]:
        """Frame and marker of each point of the clouds, and its place in its frame."""
        order = np.argsort(np.where(self.views >= 2, 0, np.where(self.views == 1, 1, 2)), axis=1, kind="stable")
        frame = np.repeat(np.arange(len(self.views)), (self.views > 0).sum(axis=1))
        place = np.concatenate([np.arange(n) for n in (self.views > 0).sum(axis=1)] or [np.empty(0)]).astype(np.int64)
        return frame, order[frame, place], place

    def recording(self, *, least_views: int = 1, most_deviation: float = float("inf")) -> Recording:
        """The labelled trajectories: markers that at least so many cameras show, and that are exact to `most_deviation` (m)."""
        with np.errstate(invalid="ignore"):
            kept = (self.views >= least_views) & (self.deviations <= most_deviation)
        vertical = np.array([0.0, 0.0, 1.0]) if self.rig.vertical is None else self.rig.vertical
        positions = np.where(kept[:, :, None], self.positions, np.nan)
        first = self.blobs.first_frame if self.blobs.first_frame > 0 else 1
        made = Recording(positions, self.body.labels, self.blobs.rate, vertical, first_frame=first, metadata={"units": "m"})
        return made.logged("labelled in the images", self.body.title)


def label_views(
    blobs: Blobs,
    rig: Rig,
    body: BodyModel | str,
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
    if rules.personal and len(blobs):
        labeller = _for_person(labeller)
    track = _Track(labeller, body)
    track.run(progress)
    result = track.result(least_confidence)
    misfits = checks.misfits(result)
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
    blobs: Blobs, rig: Rig, cameras: Ints, body: BodyModel, height: float | None, rules: ViewsRules, least_confidence: float
) -> ViewsLabelling:
    """The labelling by the other cameras; without any label where fewer than two of them, or fewer than half of all, have blobs."""
    kept = ~np.isin(blobs.camera_of, cameras)
    seeing = blobs.counts.sum(axis=0) > 0
    left = int(seeing.sum()) - int(seeing[cameras].sum())
    scene = scene_of(blobs.select(kept), rig)
    labeller = FrameLabeller(scene, body, rules, None if height is None else height / body.height)
    enough = left >= 2 and 2 * left >= int(seeing.sum())
    if enough and rules.personal:
        labeller = _for_person(labeller)
    track = _Track(labeller, body)
    track.run()
    few = track.result(least_confidence)
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

    def __init__(self, labeller: FrameLabeller, body: BodyModel) -> None:
        self.body = body
        self.labeller = labeller
        self.seen: list[Seen | None] = []
        self.restarts: list[int] = []

    def run(self, progress: Progress | None = None) -> None:
        """Label all frames."""
        frames, both = len(self.labeller.scene.blobs), self.labeller.rules.both_ways
        starts, total = Starts(self.labeller), frames * (2 if both else 1)
        forward, backward = Pass(self.labeller, starts, 1), Pass(self.labeller, starts, -1)
        for n in range(total):
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
            sure = rules.confidence(found.labels.worth, sights[found.labels.labels] < 2, found.labels.leads)
            given = (found.labels.labels >= 0) & (sure >= least_confidence)
            confidence[first:last] = np.where(found.labels.labels >= 0, sure, 0.0)
            candidates[first:last] = found.labels.labels
            if found.quality < rules.lost:
                confidence[first:last] = np.minimum(confidence[first:last], _DOUBTFUL)
                continue
            labels[first:last] = np.where(given, found.labels.labels, NULL)
            found_views = np.bincount(found.labels.labels[given], minlength=markers)
            poses[t], rotations[t] = found.labels.pose, found.labels.rotation
            expected[t] = self.labeller.expected(found.labels)
            placed[t] = self.labeller.placed(found.labels)
            views[t] = found_views
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
