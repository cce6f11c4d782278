"""Labels of the blobs of a few cameras, and what follows from them: trajectories, a cloud without names, what each camera shows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.findings import Finding
from asterism.recording import NULL, Blobs, Clouds, Floats, Ints, Labelling, Recording
from asterism.skeleton.body import ArticulatedBody
from asterism.views.sights import FROM_PREVIOUS, SightRules, predict_visibility


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
    detected     (C,) how often a camera has a blob of what it sees, as a share of what is usual: see `detection_shares`
    late         (C,) frames by which a camera is late: what its blobs of frame t + late show is in frame t
    restarts     frames in which the body was sought anew
    findings     what a person should know
    """

    rig: Rig
    blobs: Blobs
    body: ArticulatedBody
    person: ArticulatedBody
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
    detected: Floats
    late: Ints
    restarts: tuple[int, ...] = ()
    findings: tuple[Finding, ...] = field(default=())

    @property
    def frame_of(self) -> Ints:
        """(P,) the frame that each blob shows: its own, but for cameras that are late. Blobs with a label are in one of the frames."""
        of: Ints = self.blobs.frame_of - self.late[self.blobs.camera_of]
        return of

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
        np.minimum.at(out, (self.frame_of[given], self.labels[given]), self.confidence[given])
        return np.where(self.views > 0, out, 0.0)

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(T, C, M) whether a camera has a blob with the marker's label."""
        out = np.zeros(self.expected.shape, dtype=np.bool_)
        given = self.labels >= 0
        out[self.frame_of[given], self.blobs.camera_of[given], self.labels[given]] = True
        return out

    @property
    def in_view(self) -> Floats:
        """(T, C, M) the probability that nothing hides a marker from a camera, by the body: its blob may still be lost."""
        return self.expected / self.detected[:, None]

    def predict_visibility(self, rules: SightRules = FROM_PREVIOUS) -> Floats:
        """(T, C, M) the probability that a marker is in view of a camera, by the body, and by the labels of the frames beside.

        By default that of the frame before alone; see `predict_visibility` in `sights`. O(T C M).
        """
        return predict_visibility(self.in_view, self.shown, np.isfinite(self.poses[:, 0]), rules)

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
        # Points of several cameras first: programs that take so many points of a frame get the exact ones.
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
        # Blob files of most systems count from 1, and those without numbers are counted so.
        first = self.blobs.first_frame if self.blobs.first_frame > 0 else 1
        made = Recording(positions, self.body.labels, self.blobs.rate, vertical, first_frame=first, metadata={"units": "m"})
        return made.logged("labelled in the images", self.body.title)
