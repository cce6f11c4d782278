"""One frame's blobs and a body in; the pose and the label of each blob out: from a given start, from none, or from the last frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, permutations

import numpy as np

from asterism.recording import Floats, Ints
from asterism.skeleton.arrays import ArticulatedBodyArrays, PosePrior
from asterism.skeleton.body import ArticulatedBody
from asterism.skeleton.body_fit import known_of
from asterism.skeleton.pose_kernels import HINGES, add_priors
from asterism.skeleton.posing import posed_points
from asterism.views._carry_kernels import carry_labels
from asterism.views._fit_kernels import minimise, predict_visible, project_linear
from asterism.views._label_kernels import label_globally, place_priors, unseen_cost
from asterism.views.arrays import Observing, PinholeArrays
from asterism.views.exchanges import Exchange, exchanges_of
from asterism.views.limbs import RULES as LIMB_RULES
from asterism.views.limbs import Limb, LimbScreen, LimbSearchRules, limbs_of
from asterism.views.rules import RULES, ViewsRules
from asterism.views.scene import ViewsScene
from asterism.views.start import POSTURES, StartPosture, starts

_UNKNOWN = np.empty(0, dtype=np.int64)
_BETTER = 1.0
"""nats by which another way to hold an arm must be better."""
_ANY_TILT = 2.0
"""rad, standard deviation of the tilt of a body that may lie: lying costs an eighth of a nat, so blobs alone decide."""
_OF_POSTURE = 2
"""Starts of each posture that are fitted to the end: two headings that are half a turn apart look alike in an outline."""


@dataclass(frozen=True, eq=False)
class BlobLabels:
    """What was found in one frame.

    labels       (N,) the marker of each blob, -1 for none
    margin       (N,) nats, by how much the label is better than the best change of it
    pose         (9 + J,), rotation (3, 3): the body
    points       (M, 3) m, markers by all their blobs and the body
    covariances  (M, 3, 3) m2
    gain         nats, of the whole against no body at all: all blobs strays
    rival_margin (N,) nats, by how much the gain exceeds that of the best other explanation that was tried and labels the blob otherwise;
                 inf where none does
    counts       (C,) blobs of each camera in the frame
    """

    labels: Ints
    margin: Floats
    pose: Floats
    rotation: Floats
    points: Floats
    covariances: Floats
    gain: float
    rival_margin: Floats
    counts: Ints

    def against(self, other: BlobLabels, by: float = 0.0) -> BlobLabels:
        """This explanation of a frame, or another one that is better by more than `by` nats; its margins know both. O(N)."""
        # A single place that compares two explanations, so that a label's margin knows all that was tried.
        if other.gain > self.gain + by:
            return other.against(self)
        ahead = max(self.gain - other.gain, 0.0)
        differ = self.labels != other.labels
        # Where both agree on a blob, it is as far ahead of whatever the other explanation's rivals would have it be.
        return replace(self, rival_margin=np.minimum(self.rival_margin, np.where(differ, ahead, ahead + other.rival_margin)))


@dataclass(frozen=True, eq=False)
class FrameLabeller:
    """Labels frames of one scene with one body; holds what the kernels need."""

    scene: ViewsScene
    body: ArticulatedBody
    rules: ViewsRules = RULES
    size: float | None = None
    """The person's size as a multiple of the body's, where it is known."""
    limb_rules: LimbSearchRules = LIMB_RULES

    @property
    def known(self) -> PosePrior:
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

    def expected(self, found: BlobLabels) -> Floats:
        """(C, M) the probability that a camera has a blob of a marker, by the fitted body."""
        shares = np.empty((len(self.scene.rig), len(self.body.markers)))
        predict_visible(self.body.arrays, self.scene.cameras, self.observing, found.pose, found.rotation, shares)
        return shares

    def expected_blobs(self, found: BlobLabels, *, shown: bool = False) -> float:
        """How many blobs with a label the fitted body lets expect in the frame; shown: or how many there are, in images with more.

        Of each image no more than it has blobs: one without blobs says nothing of the body, its camera was off, or looks elsewhere.
        """
        return float(self._expected_of_cameras(found, shown).sum())

    def _expected_of_cameras(self, found: BlobLabels, shown: bool) -> Floats:
        """(C,) of each image, see `expected_blobs`."""
        expected: Floats = self.expected(found).sum(axis=1)
        if shown:
            camera = np.repeat(np.arange(len(found.counts)), found.counts)
            expected = np.maximum(expected, np.bincount(camera[found.labels >= 0], minlength=len(found.counts)))
        return np.minimum(expected, found.counts)

    def explained(self, found: BlobLabels, *, shown: bool = False) -> float:
        """The gain of an expected blob, as a share of that of one that is exactly where it is expected; shown: see `expected_blobs`."""
        # The gain of a blob at its expected place: its normal density against the density of strays.
        most = -np.log(2 * np.pi * self.rules.noise**2 * self.observing.strays)
        expected = self._expected_of_cameras(found, shown)
        # Where a camera loses blobs, a right body gains less of each that is there, and pays for those that are not.
        lost = _surprise(self.rules.shown * self.scene.cameras.detected) - _surprise(np.array(self.rules.shown))
        return float(found.gain / max(float((most - lost) @ expected), most))

    def placed(self, found: BlobLabels) -> Floats:
        """(M, 3) m, the markers of the fitted body, wherever their blobs are."""
        return posed_points(self.body, found.pose, found.rotation)[0]

    def from_start(self, t: int, pose: Floats, rotation: Floats) -> BlobLabels:
        """The labels of frame t, from a pose (9 + J,) and a rotation (3, 3) that may be far off; see `ViewsRules.blur`."""
        return self._fitted(t, pose, rotation, self.rules.blur, self.rules.steps)

    def from_near(self, t: int, pose: Floats, rotation: Floats) -> BlobLabels:
        """The labels of frame t from a start that may be wrong: as `from_start`; where that explains the blobs worse than is usual, also
        as `from_nothing`, and the better explanation counts. Raises as `from_nothing`."""
        found = self.from_start(t, pose, rotation)
        return found if self.explained(found) >= self.rules.sure_gain else found.against(self.from_nothing(t))

    def follow(self, t: int, pose: Floats, rotation: Floats, last: tuple[int, BlobLabels] | None = None) -> BlobLabels:
        """The labels of frame t, from the pose that the last frames let expect.

        last: a frame beside t and its labels. Then blobs that are where its blobs are expected keep their labels at first; where that
        explains the frame much worse than the last one, the pose is fitted without labels, and the better explanation counts.
        """
        rules = self.rules
        carried = None if last is None else self._carried(t, pose, rotation, *last)
        if carried is None or last is None:
            return self._fitted(t, pose, rotation, rules.follow, rules.follow_steps)
        found = self._fitted(t, pose, rotation, rules.follow[-1:], rules.follow_steps, carried)
        # The last frame's labels lead a fit astray once a limb has left its blobs; a fit without labels is not misled by them.
        if found.gain < last[1].gain - rules.drop:
            found = found.against(self._fitted(t, pose, rotation, rules.follow, rules.follow_steps))
        return found

    def again(self, t: int, found: BlobLabels) -> BlobLabels:
        """The labels of frame t from labels and a pose that are known, which another body may explain otherwise."""
        rules = self.rules
        return self._fitted(t, found.pose, found.rotation, rules.follow[-1:], rules.follow_steps, found.labels)

    def _carried(self, t: int, pose: Floats, rotation: Floats, before: int, found: BlobLabels) -> Ints | None:
        """The labels (N,) of the blobs that are where those of the frame before are expected; None where they are fewer than half."""
        (old_xy, old_offsets), (xy, offsets) = self.scene.frame(before), self.scene.frame(t)
        cameras, count = self.scene.cameras, len(self.body.markers)
        uv = np.empty((2, len(self.scene.rig), count, 2))
        slopes = np.empty((len(self.scene.rig), count, 2, 3))
        project_linear(cameras, posed_points(self.body, found.pose, found.rotation)[0], uv[0], slopes)
        project_linear(cameras, posed_points(self.body, pose, rotation)[0], uv[1], slopes)
        labels = np.empty(len(xy), dtype=np.int64)
        carry_labels(uv[0], uv[1], old_xy, old_offsets, found.labels, xy, offsets, self.rules.carry, labels)
        # Fewer labels than half would tie the pose to a part of the body.
        return labels if 2 * (labels >= 0).sum() >= (found.labels >= 0).sum() > 0 else None

    def from_nothing(self, t: int) -> BlobLabels:
        """The labels of frame t when nothing is known: any heading, size and place. Raises as `starts`.

        Where the best of the starts explains the blobs worse than is usual, more starts are tried.
        """
        found = self._best_start(t)
        rules = self.rules
        if self.explained(found) < rules.enough_gain:
            # A second, wider search: twice the headings, and none of the starts is left behind early.
            more = replace(rules, headings=2 * rules.headings, kept=2 * rules.kept, going_on=1.0, coarse_steps=2 * rules.coarse_steps)
            found = found.against(replace(self, rules=more)._best_start(t))
        # Whoever lies, kneels or stands on the hands is explained badly by everybody who is upright, but for a body that hides its markers.
        if self.explained(found, shown=True) < rules.enough_gain:
            # Their starts lean as they do, so that nothing is to set them upright before the blobs are found.
            leaning = replace(self, rules=replace(rules, tilt=_ANY_TILT))._best_start(t, POSTURES)
            found = found.against(self.again(t, leaning))
        return found

    def _best_start(self, t: int, postures: tuple[StartPosture, ...] = ()) -> BlobLabels:
        """The labels from the best of the starts of `ViewsRules.headings`; upright ones unless postures are given."""
        xy, offsets = self.scene.frame(t)
        rules = self.rules
        # Starts have been through the coarse blurs already.
        fine = tuple(blur for blur in rules.blur if blur < rules.coarse[-1]) or rules.blur[-1:]
        results = []
        poses, rotations = starts(self.scene, self.body, xy, offsets, rules.headings, self.size, postures)
        # Outlines of postures differ less than their fits do, so each posture sends its own best starts.
        for group in np.split(np.arange(len(poses)), max(len(postures), 1)):
            own = poses[group], rotations[group]
            costs = self._screened(t, *own)
            results += [
                self._fitted(t, self._arms_sought(t, own[0][n], own[1][n], self.limb_rules.blur), own[1][n], fine, rules.steps)
                for n in _different(costs, *own, _OF_POSTURE if postures else rules.kept)
            ]
        results.sort(key=lambda result: -result.gain)
        best = results[0]
        # Exchanged sides and limbs that hold each other's blobs are where fits get stuck; each is tried only while the whole is in doubt.
        if self.explained(best) < rules.sure_gain:
            best = self.exchanged(t, best)
        best = self.with_limbs_sought(t, best)
        if self.explained(best) < rules.sure_gain:
            best = self.with_limbs_parted(t, best)
        best = self.turned(t, best, hands=True)
        # The other heading is the one rival that no local fit reaches from here.
        about = self.from_start(t, *self._about(best))
        if about.gain > best.gain:
            best, about = self.turned(t, self.with_limbs_sought(t, about), hands=True), best
        for other in (*results[1:], about):
            best = best.against(other)
        return best

    def _about(self, found: BlobLabels) -> tuple[Floats, Floats]:
        """The pose and the rotation of a body in the same place that faces the other way, its joints as usual."""
        up, axis = self.scene.vertical, found.rotation[:, 2]
        # Half a turn about the vertical; whoever lies is taken for another by half a turn about the own length.
        up = axis if abs(axis @ up) < np.sqrt(0.5) else up
        half = 2.0 * np.outer(up, up) - np.eye(3)
        middle = self.placed(found).mean(axis=0)
        pose = found.pose.copy()
        pose[3:6] = middle + half @ (pose[3:6] - middle)
        pose[HINGES:] = self.body.arrays.usual
        return pose, half @ found.rotation

    def _screened(self, t: int, poses: Floats, rotations: Floats) -> Floats:
        """(N,) nats, the starts' costs after the coarse stages, in each of which the worse ones stay behind; moves poses and rotations."""
        xy, offsets = self.scene.frame(t)
        arrays, cameras, known, observing, free, rules = self._kit
        hessian = np.empty((poses.shape[1], poses.shape[1]))
        costs, left = np.full(len(poses), np.inf), np.arange(len(poses))
        for stage, blur in enumerate(rules.coarse):
            # Blurred blobs show the outline only, so that many starts lead to one place; the blur shrinks from stage to stage.
            fixed = (arrays, cameras, known, observing, xy, offsets, _UNKNOWN, np.array([blur]))
            found = np.array([minimise(*fixed, rules.coarse_steps, free, poses[n], rotations[n], hessian) for n in left])
            last = stage == len(rules.coarse) - 1
            # Some of the starts go on, and never fewer than are wanted in the end.
            going = max(int(np.ceil(rules.going_on * len(left))), 2 * rules.kept)
            best = np.argsort(found, kind="stable")[: len(left) if last else going]
            left, found = left[best], found[best]
            # In the right place with wrong arms a start costs as much as in a wrong place, so the arms are sought before the next stage.
            for n in () if last else left:
                poses[n] = self._arms_sought(t, poses[n], rotations[n], rules.coarse[stage + 1], self.limb_rules.early)
        costs[left] = found
        return costs

    def turned(self, t: int, found: BlobLabels, *, hands: bool = False) -> BlobLabels:
        """The labels of frame t with the two markers of a bone of a limb exchanged, where that explains the blobs better.

        A wrist with a marker on each side looks nearly the same when the forearm is turned by half a turn, and no fit leads from one to the
        other: shoulder and elbow turn with it. hands: a single marker of the next bone takes part, in every order; of use where nothing is
        known, but not beside frames that are. O(limbs) labellings.
        """
        rules = self.limb_rules
        for limb in self._limbs:
            for pair, beyond in limb.pairs:
                for labels in _reordered(found.labels, np.append(pair, beyond) if hands else pair):
                    pose = self._screen(t).labelled(
                        limb, labels, found.pose, found.rotation, self._kit[2], tried=rules.starts, steps=rules.steps
                    )
                    other = self._fitted(t, pose, found.rotation, self.rules.follow, self.rules.follow_steps, labels)
                    found = found.against(other, by=_BETTER)
        return found

    def with_limbs_sought(self, t: int, found: BlobLabels) -> BlobLabels:
        """The labels of frame t with each loose limb sought anew over all its angles, where that explains the blobs better.

        A fit of the whole body follows an arm as far as its blobs are near; raised or bent arms are not. O(limbs) labellings.
        """
        for limb in self._limbs:
            for pose in self._free(t, found, limb.markers).alone(limb, *self._from(found), self.limb_rules.kept):
                found = found.against(self._with_limbs(t, pose, found.rotation), by=_BETTER)
        return found

    def with_limbs_parted(self, t: int, found: BlobLabels) -> BlobLabels:
        """The labels of frame t with two limbs sought anew, one after the other, where that explains the blobs better.

        Two arms that have each other's blobs keep each other from being found by themselves. O(limbs) labellings.
        """
        for one, other in pairwise(self._limbs):
            before = found
            both = np.concatenate([one.markers, other.markers])
            # Each of the two limbs is sought among the blobs that neither has, so that neither keeps the other from its own.
            for pose in self._free(t, before, both).alone(one, *self._from(before), self.limb_rules.kept):
                first = self._fitted(t, pose, before.rotation, self.rules.follow[-1:], 0)
                pose = self._free(t, first, other.markers).alone(other, pose, before.rotation, self._kit[2], self.limb_rules, 1)[0]
                found = found.against(self._with_limbs(t, pose, before.rotation), by=_BETTER)
        return found

    def exchanged(self, t: int, found: BlobLabels) -> BlobLabels:
        """The labels of frame t with parts of the body left and right exchanged, where that explains the blobs better.

        No fit leads from crossed legs, or a trunk that is turned about, to the other way round. O(bones) labellings.
        """
        for part in self._exchanges:
            labels = part.names[found.labels + 1]
            if not np.array_equal(labels, found.labels):
                # The hinges of exchanged parts say nothing of the other side.
                pose = found.pose.copy()
                pose[HINGES + part.hinges] = self.body.arrays.usual[part.hinges]
                found = found.against(self._fitted(t, pose, found.rotation, self.rules.exchange, self.rules.steps, labels), by=_BETTER)
        return found

    def _with_limbs(self, t: int, pose: Floats, rotation: Floats) -> BlobLabels:
        return self._fitted(t, pose, rotation, self.limb_rules.fit, self.rules.steps)

    def _from(self, found: BlobLabels) -> tuple[Floats, Floats, PosePrior, LimbSearchRules]:
        return found.pose, found.rotation, self._kit[2], self.limb_rules

    def _free(self, t: int, found: BlobLabels, markers: Ints) -> LimbScreen:
        """The blobs of frame t without a label, or with that of one of these markers."""
        xy, offsets = self.scene.frame(t)
        # Blobs of other parts stay theirs.
        free = (found.labels < 0) | np.isin(found.labels, markers)
        before = np.concatenate([[0], np.cumsum(free)]).astype(np.int64)
        return LimbScreen(self.body, self.scene.cameras, self._kit[3], xy[free], before[offsets])

    def _arms_sought(self, t: int, pose: Floats, rotation: Floats, blur: float, tried: int | None = None) -> Floats:
        """The pose with the angles of each loose limb that explain the blobs best, without a fit."""
        for limb in self._limbs:
            pose = self._screen(t).poses(limb, pose, rotation, tried=self.limb_rules.tried if tried is None else tried, blur=blur)[0]
        return pose

    def _screen(self, t: int) -> LimbScreen:
        return LimbScreen(self.body, self.scene.cameras, self._kit[3], *self.scene.frame(t))

    @cached_property
    def _exchanges(self) -> tuple[Exchange, ...]:
        return exchanges_of(self.body) if self.rules.joints else ()

    @cached_property
    def _limbs(self) -> tuple[Limb, ...]:
        return limbs_of(self.body, self.limb_rules) if self.rules.joints else ()

    def _fitted(
        self, t: int, pose: Floats, rotation: Floats, blur: tuple[float, ...], steps: int, thought: Ints | None = None
    ) -> BlobLabels:
        """Fit the pose to blobs without labels, label them by it, fit it to the labels, and label again, until the labels stay.

        thought: labels (N,) to which the pose is fitted at first instead.
        """
        xy, offsets = self.scene.frame(t)
        arrays, cameras, known, observing, free, rules = self._kit
        pose, rotation = pose.copy(), rotation.copy()
        hessian, shares = np.empty((len(pose), len(pose))), np.empty((len(self.scene.rig), len(self.body.markers)))
        labels, margin = np.full(len(xy), -1, dtype=np.int64), np.zeros(len(xy))
        points, covariances = np.empty((len(arrays.bones), 3)), np.empty((len(arrays.bones), 3, 3))
        means, priors = np.empty_like(points), np.empty_like(covariances)
        noise, counts = np.array([rules.noise]), np.diff(offsets)
        # Numba compiles one kernel for both cases; only what the pose is fitted to differs.
        if thought is None:
            minimise(arrays, cameras, known, observing, xy, offsets, _UNKNOWN, np.array(blur), steps, free, pose, rotation, hessian)
        else:
            minimise(arrays, cameras, known, observing, xy, offsets, thought, np.array(blur), steps, free, pose, rotation, hessian)
        gain, before = 0.0, np.full(len(xy), -2, dtype=np.int64) if thought is None else thought.copy()
        # Labels and pose in turns until the labels stay: each is easy when the other is known.
        for turn in range(rules.turns + 1):
            predict_visible(arrays, cameras, observing, pose, rotation, shares)
            # A camera that has no blob at all in this frame misses none.
            shares[counts == 0] = 0.0
            place_priors(arrays, pose, rotation, hessian, free, points, priors)
            gain = label_globally(
                *(cameras, observing, shares, points, priors, xy, offsets, rules.rounds, rules.together),
                *(labels, margin, means, covariances),
            )
            if turn == rules.turns or np.array_equal(labels, before):
                break
            before[:] = labels
            minimise(arrays, cameras, known, observing, xy, offsets, labels, noise, rules.label_steps, free, pose, rotation, hessian)
        # What the cameras should have shown and did not, and how unusual the pose is, count against it.
        gain -= unseen_cost(shares) + self._pose_cost(pose, rotation)
        return BlobLabels(labels, margin, pose, rotation, points + means, covariances, float(gain), np.full(len(labels), np.inf), counts)

    def _pose_cost(self, pose: Floats, rotation: Floats) -> float:
        """nats, what a pose costs before any image."""
        size, known, arrays = len(pose), self._kit[2], self._kit[0]
        cost = add_priors(
            *(pose, rotation, known.vertical, arrays.usual, arrays.precision),
            *(known.scale_usual, known.scale_precision, known.tilt_precision, np.zeros((size, size)), np.zeros(size)),
        )
        return float(cost)

    @cached_property
    def _kit(self) -> tuple[ArticulatedBodyArrays, PinholeArrays, PosePrior, Observing, Ints, ViewsRules]:
        return self.body.arrays, self.scene.cameras, self.known, self.observing, self.free, self.rules


def _surprise(share: Floats) -> Floats:
    """nats per blob that it costs not to know which markers a camera has a blob of, for the share of those that it has."""
    entropy: Floats = -(share * np.log(share) + (1.0 - share) * np.log(1.0 - share)) / share
    return entropy


def _reordered(labels: Ints, group: Ints) -> list[Ints]:
    """Labels (N,) with the markers of a group in each other order that changes them."""
    number = np.arange(-1, max(labels.max(initial=-1), group.max()) + 1)
    ways = list[Ints]()
    # Every order once; orders that change nothing, as of markers without blobs, are left out.
    for order in permutations(group.tolist()):
        number[group + 1] = order
        changed: Ints = number[labels + 1]
        if not any(np.array_equal(changed, way) for way in (labels, *ways)):
            ways.append(changed)
    return ways


def _different(costs: Floats, poses: Floats, rotations: Floats, most: int) -> list[int]:
    """The best starts, no two at one place: 3 cm and 0.2 rad."""
    chosen = list[int]()
    # A second start at the same place would be fitted to the same end.
    for n in np.argsort(costs, kind="stable"):
        near = (
            np.linalg.norm(poses[n, 3:6] - poses[k, 3:6]) < 0.03
            and np.trace(rotations[n].T @ rotations[k]) > 1 + 2 * np.cos(0.2)
            and np.abs(poses[n, HINGES:] - poses[k, HINGES:]).max(initial=0.0) < 0.2
            for k in chosen
        )
        if len(chosen) == most or not np.isfinite(costs[n]):
            break
        if not any(near):
            chosen.append(int(n))
    return chosen
