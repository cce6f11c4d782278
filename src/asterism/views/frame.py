"""One frame's blobs and a body in; the pose and the label of each blob out: from a given start, from none, or from the last frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from asterism.recording import Floats, Ints
from asterism.views._fit_kernels import minimise, minimise_all, predict_visible
from asterism.views._label_kernels import settle
from asterism.views._pose_kernels import HINGES
from asterism.views.arrays import Known, Observing
from asterism.views.body import BodyModel
from asterism.views.body_fit import known_of
from asterism.views.posing import posed_points
from asterism.views.rules import RULES, ViewsRules
from asterism.views.scene import Scene
from asterism.views.start import starts

_UNKNOWN = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class FrameLabels:
    """What was found in one frame.

    labels       (N,) the marker of each blob, -1 for none
    worth        (N,) nats, by how much the label is better than the best change of it
    pose         (9 + J,), rotation (3, 3): the body
    points       (M, 3) m, markers by all their blobs and the body
    covariances  (M, 3, 3) m2
    gain         nats, of the whole against no body at all: all blobs strays
    rival        nats, the gain of the best other start whose labels differ; -inf where there is none
    """

    labels: Ints
    worth: Floats
    pose: Floats
    rotation: Floats
    points: Floats
    covariances: Floats
    gain: float
    rival: float = float("-inf")


@dataclass(frozen=True, eq=False)
class FrameLabeller:
    """Labels frames of one scene with one body; holds what the kernels need."""

    scene: Scene
    body: BodyModel
    rules: ViewsRules = RULES
    size: float | None = None
    """The person's size as a multiple of the body's, where it is known."""

    @property
    def known(self) -> Known:
        """What is known of the body before any image."""
        usual = 1.0 if self.size is None else self.size
        narrow = (0.03, self.body.scale_spread[1]) if self.size is not None else None
        known = known_of(self.body, self.scene.vertical, tilt=self.rules.tilt, scale=narrow)
        return known._replace(scale_usual=np.full(3, usual))

    @property
    def observing(self) -> Observing:
        """The model of observation."""
        return self.rules.observing(self.scene.area)

    @property
    def free(self) -> Ints:
        """Which numbers of the pose are fitted."""
        return np.arange(HINGES + (len(self.body.hinges) if self.rules.joints else 0), dtype=np.int64)

    def expected(self, found: FrameLabels) -> Floats:
        """(C, M) the probability that a camera has a blob of a marker, by the fitted body."""
        shares = np.empty((len(self.scene.rig), len(self.body.markers)))
        predict_visible(self.body.arrays, self.scene.cameras, self.observing, found.pose, found.rotation, shares)
        return shares

    def placed(self, found: FrameLabels) -> Floats:
        """(M, 3) m, the markers of the fitted body, wherever their blobs are."""
        return posed_points(self.body, found.pose, found.rotation)[0]

    def from_start(self, t: int, pose: Floats, rotation: Floats) -> FrameLabels:
        """The labels of frame t, from a pose (9 + J,) and a rotation (3, 3) that may be far off; see `ViewsRules.blur`."""
        return self._fitted(t, pose, rotation, self.rules.blur, self.rules.steps)

    def follow(self, t: int, pose: Floats, rotation: Floats) -> FrameLabels:
        """The labels of frame t, from the pose that the last frame lets expect."""
        return self._fitted(t, pose, rotation, self.rules.follow, self.rules.follow_steps)

    def from_nothing(self, t: int) -> FrameLabels:
        """The labels of frame t when nothing is known: any heading, size and place. Raises as `starts`."""
        xy, offsets = self.scene.frame(t)
        rules = self.rules
        poses, rotations = starts(self.scene, self.body, xy, offsets, rules.headings, self.size)
        costs = np.empty(len(poses))
        coarse = np.array(rules.coarse)
        args = (self.body.arrays, self.scene.cameras, self.known, self.observing, xy, offsets, _UNKNOWN)
        minimise_all(*args, coarse, rules.coarse_steps, self.free, poses, rotations, costs)
        results: list[FrameLabels] = []
        fine = tuple(blur for blur in rules.blur if blur < rules.coarse[-1])
        for n in _different(costs, poses, rotations, rules.kept):
            results.append(self._fitted(t, poses[n], rotations[n], fine, rules.steps))
        results.sort(key=lambda result: -result.gain)
        best = results[0]
        others = [result.gain for result in results[1:] if not np.array_equal(result.labels, best.labels)]
        return replace(best, rival=max(others, default=float("-inf")))

    def _fitted(self, t: int, pose: Floats, rotation: Floats, blur: tuple[float, ...], steps: int) -> FrameLabels:
        xy, offsets = self.scene.frame(t)
        arrays, cameras, known, observing, free = self.body.arrays, self.scene.cameras, self.known, self.observing, self.free
        pose, rotation = pose.copy(), rotation.copy()
        size, markers = len(pose), len(self.body.markers)
        if len(blur):
            hessian = np.empty((size, size))
            minimise(arrays, cameras, known, observing, xy, offsets, _UNKNOWN, np.array(blur), steps, free, pose, rotation, hessian)
        labels, worth = np.full(len(xy), -1, dtype=np.int64), np.zeros(len(xy))
        points, covariances = np.empty((markers, 3)), np.empty((markers, 3, 3))
        noise = np.array([self.rules.noise])
        rules = self.rules
        gain = settle(
            *(arrays, cameras, known, observing, xy, offsets, noise, 5, free, rules.rounds, rules.together),
            *(pose, rotation, labels, worth, points, covariances),
        )
        return FrameLabels(labels, worth, pose, rotation, points, covariances, float(gain))


def _different(costs: Floats, poses: Floats, rotations: Floats, most: int) -> list[int]:
    """The best starts, no two at one place: 3 cm and 0.2 rad."""
    chosen = list[int]()
    for n in np.argsort(costs, kind="stable"):
        near = (
            np.linalg.norm(poses[n, 3:6] - poses[k, 3:6]) < 0.03
            and np.trace(rotations[n].T @ rotations[k]) > 1 + 2 * np.cos(0.2)
            and np.abs(poses[n, HINGES:] - poses[k, HINGES:]).max(initial=0.0) < 0.2
            for k in chosen
        )
        if not any(near):
            chosen.append(int(n))
        if len(chosen) == most:
            break
    return chosen
