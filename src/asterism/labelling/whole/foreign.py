"""A recording that does not fit its model, labelled again: labels in; the best of several whole labellings, and limits of confidence, out.

The frames of a foreign recording can agree on a wrong labelling, such as the body turned round. So the mean bodies are laid into one
frame at several headings and sizes, each is labelled from there, and the labellings are compared by three kinds of evidence: the body
model's evidence, the near-rigid distances against those of the training, and whether the body travels forward. Where the next labelling is
as good, or where another point or marker would fit the distances as well, a label is doubtful.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import expit, gammaln, logit

from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole.joint import SceneLabelling
from asterism.labelling.whole.plausibility import own_deviations
from asterism.labelling.whole.scene import RecordingScene, placed_points, with_fewer_samples
from asterism.labelling.whole.settings import ForeignRules, RecordingLabellingSettings
from asterism.labelling.whole.turned import joint_evidence
from asterism.labelling.whole.verdict import RigidDistances, log_distances, median_and_std
from asterism.recording import NULL, Floats, Ints

Relabel = Callable[[RecordingScene, Ints], SceneLabelling]
"""Labels a scene from given labels (J,) on."""


@dataclass(frozen=True)
class ForeignConfidence:
    """How certain the labels of n tracklets, or points, of a foreign recording may be.

    log_odds  (n,) that a label is right by its distances, see `ForeignRules`
    limit     (n,) what no label may be more certain than, as another labelling of the whole recording is nearly as good
    crowded   whether points are left over in a usual frame
    rules     weights
    """

    log_odds: Floats
    limit: Floats
    crowded: bool
    rules: ForeignRules

    def by_evidence(self, certainty: Floats, fit: Floats) -> Floats:
        """The probability that labels are right (n,), if no other labelling of the whole recording is.

        certainty: what it would be where recordings fit; fit in nats.
        """
        rules = self.rules
        by_fit = rules.by_fit * np.clip(fit, *rules.fits) / 2.0
        by_certainty = rules.by_certainty * logit(np.clip(certainty, 0.001, 0.999)) / 2.0
        return np.asarray(expit(self.log_odds + by_fit + by_certainty))

    @property
    def least_confidence(self) -> float:
        """Labels that the evidence makes less certain than this are taken back."""
        return self.rules.least_confidence_crowded if self.crowded else self.rules.least_confidence

    def of_points(self, points: int, long: Ints, track: Ints) -> ForeignConfidence:
        """That of P points from that of tracklets; long: the points of tracklets, track: theirs. Others have no margin and no rival."""
        log_odds, limit = np.full(points, float(np.median(self.log_odds))), np.ones(points)
        log_odds[long], limit[long] = self.log_odds[track], self.limit[track]
        return replace(self, log_odds=log_odds, limit=limit)

    def of_some(self, which: Ints | slice) -> ForeignConfidence:
        """That of some of the tracklets or points."""
        return replace(self, log_odds=self.log_odds[which], limit=self.limit[which])


@dataclass(frozen=True)
class ForeignLabels:
    """A foreign recording labelled again: the labels of its tracklets, and how certain they may be."""

    found: SceneLabelling
    confidence: ForeignConfidence


def label_foreign(
    labeller: BodyLabeller,
    found: SceneLabelling,
    reference: RigidDistances,
    names: Sequence[str],
    relabel: Relabel,
    settings: RecordingLabellingSettings,
) -> ForeignLabels:
    """The best whole labelling of a recording with one body, and how certain its labels may be.

    Labellings are compared on a sample of the frames. Only if another than the labels so far is the best, the recording is labelled again.
    found: the labels so far; names: of the body's markers. O(starts) on the sample.
    """
    rules = settings.foreign
    scene, markers = with_fewer_samples(found.scene, rules.frames, settings), labeller.body.mean.shape[1]
    crowded = _crowded(found, markers, rules)
    samples = Samples.of_scene(scene)
    starts = _best_starts(labeller.model.mean, samples, found.label, reference, rules)
    compared = [relabel(scene, start) for start in (found.label, *starts)] if starts else [found]
    scores = _scores(labeller, compared, samples, names, reference, crowded, rules) if starts else np.zeros(1)
    best = int(np.argmax(scores))
    chosen = relabel(found.scene, compared[best].label) if best else found
    limit = np.ones(len(chosen.label))
    for one, score in zip(compared, scores, strict=True):
        differs = one.label != compared[best].label
        if differs[scene.samples > 0].mean() > 1.0 - rules.same:
            differs |= (scene.samples == 0) & np.isin(chosen.label, compared[best].label[differs])
            limit[differs] = np.minimum(limit[differs], _odds(scores[best] - score, rules.scale))
    log_odds, surplus = label_evidence(chosen, Samples.of_scene(found.scene), markers, reference, settings)
    return ForeignLabels(chosen, ForeignConfidence(log_odds, limit, surplus >= 1.0, rules))


def _best_starts(mean: Floats, samples: Samples, found: Ints, reference: RigidDistances, rules: ForeignRules) -> list[Ints]:
    """The starts (J,) whose distances fit best, `max_starts` at most, each unlike the others and unlike the labels so far."""
    starts = [start for start in _starts(mean, samples, rules) if _differ(start, found, rules.same)]
    ranked = sorted(starts, key=lambda start: -_distance_score(samples.positions(start, mean.shape[1]), reference, rules)[0])
    chosen: list[Ints] = []
    for start in ranked:
        if len(chosen) < rules.max_starts and all(_differ(start, other, rules.same) for other in chosen):
            chosen.append(start)
    return chosen


def _scores(
    labeller: BodyLabeller,
    compared: Sequence[SceneLabelling],
    samples: Samples,
    names: Sequence[str],
    reference: RigidDistances,
    crowded: bool,
    rules: ForeignRules,
) -> Floats:
    """Nats of evidence for each whole labelling, the first of which are the labels so far."""
    positions = [samples.positions(one.label, len(names)) for one in compared]
    distances = np.array([_distance_score(some, reference, rules) for some in positions])
    seconds, sides = _seconds(compared[0].scene), _side_pairs(names)
    forward = np.array([forward_share(some, seconds, sides, rules.min_speed) for some in positions])
    # among many points some always fit the distances, unless one labelling fits them closely
    lost_in_crowd = crowded and not (distances[:, 1] <= rules.close).any()
    weight = rules.distance_weight_crowded if lost_in_crowd else rules.distance_weight
    # by the body of people at large: one that was adapted to wrong labels explains these well
    evidence = np.array([joint_evidence([labeller], one.scene, one.label) for one in compared])
    independent = float(compared[0].scene.independent.max(initial=0.0))
    scores = rules.body_weight * independent * evidence + weight * distances[:, 0] + rules.forward * forward
    scores[0] += rules.prior_crowded if crowded else rules.prior
    return scores


def _odds(nats: float | Floats, scale: float) -> Floats:
    """The probability that one of two explanations is right that is so many nats ahead; see `ForeignRules.scale`."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(nats / scale, -60.0, 60.0))))


@dataclass(frozen=True)
class Samples:
    """Where J tracklets are in E frames: frame, track (Q,) and xyz (Q, 3) m of each point, frame by frame, in each by track."""

    frame: Ints
    track: Ints
    xyz: Floats
    frames: int
    tracks: int

    @classmethod
    def of_scene(cls, scene: RecordingScene) -> Samples:
        """The sampled frames of a scene."""
        order = np.lexsort((scene.sampled_track, scene.sampled_frame))
        frame, track, xyz = scene.sampled_frame[order], scene.sampled_track[order], scene.sampled_xyz[order]
        return cls(frame, track, xyz, len(scene.sampled_frames), len(scene.first))

    def positions(self, label: Ints, markers: int) -> Floats:
        """Positions of the markers (E, M, 3) m under labels (J,), NaN where they have no point."""
        return placed_points(self.frame, label[self.track], self.xyz, self.frames, markers)

    def fullest(self) -> tuple[Ints, Floats]:
        """The tracklets (n,) in the first frame with most points, and their points (n, 3) m."""
        inside = self.frame == np.bincount(self.frame, minlength=1).argmax()
        return self.track[inside], self.xyz[inside]

    def by_track(self) -> list[Ints]:
        """The points of each tracklet."""
        order = np.argsort(self.track, kind="stable")
        return np.split(order, np.cumsum(np.bincount(self.track, minlength=self.tracks))[:-1])


def _differ(one: Ints, other: Ints, same: float) -> bool:
    """Whether two labellings (J,) share less than this part of the labels of the first."""
    given = one != NULL
    return bool((one == other)[given].mean() < same)


def _starts(mean: Floats, samples: Samples, rules: ForeignRules) -> list[Ints]:
    """Labels of the tracklets (J,) that a mean body (K, M, 3) m, laid into the frame with most points, gives; each once."""
    there, points = samples.fullest()
    found = {}
    for body in mean:
        centred = body - body.mean(axis=0)
        radius = float(np.sqrt((centred**2).sum(axis=1).mean()))
        for size in rules.sizes:
            for turn in 2.0 * np.pi * np.arange(rules.headings) / rules.headings:
                for top in (False, True):
                    placed = place_mean_body(centred @ _about_z(turn).T * size, points, top)
                    pairs = _matched(placed, centred, points, radius, rules)
                    if len(pairs[0]) >= max(4, 0.5 * min(len(centred), len(points))):
                        label = np.full(samples.tracks, NULL, dtype=np.int64)
                        label[there[pairs[1]]] = pairs[0]
                        found[label.tobytes()] = label
    return list(found.values())


def place_mean_body(body: Floats, points: Floats, top: bool) -> Floats:
    """A body (M, 3) moved onto points (n, 3): its lowest or highest marker on theirs, its middle on that of the points at its height."""
    side = np.max if top else np.min
    body = body + np.array([0.0, 0.0, side(points[:, 2]) - side(body[:, 2])])
    level = (points[:, 2] < body[:, 2].max() + 0.1) & (points[:, 2] > body[:, 2].min() - 0.1)
    middle = np.median(points[level if level.any() else slice(None), :2], axis=0)
    body[:, :2] += middle - body[:, :2].mean(axis=0)
    return body


def _matched(placed: Floats, body: Floats, points: Floats, radius: float, rules: ForeignRules) -> tuple[Ints, Ints]:
    """Markers and points that match when a placed body (M, 3) is matched and placed again in turn."""
    last: tuple[bytes, bytes] | None = None
    marker = point = np.empty(0, dtype=np.int64)
    for turn in range(rules.rounds):
        apart = np.linalg.norm(placed[:, None] - points[None], axis=2)
        reach = radius * rules.reach[turn >= 3]
        marker, point = linear_sum_assignment(np.minimum(apart, reach) ** 2)
        near = apart[marker, point] < reach
        marker, point = marker[near], point[near]
        if len(marker) < 4 or last == (marker.tobytes(), point.tobytes()):
            break
        last = marker.tobytes(), point.tobytes()
        placed = _placed_on(body, body[marker], points[point])
    return marker, point


def _placed_on(body: Floats, markers: Floats, points: Floats) -> Floats:
    """A body (M, 3) turned about the vertical, scaled and moved so that some of its markers (n, 3) come next to their points (n, 3)."""
    centre, target = markers.mean(axis=0), points.mean(axis=0)
    a, b = points - target, markers - centre
    turn = np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (a[:, :2] * b[:, :2]).sum())
    rotation = _about_z(float(turn))
    turned = b @ rotation.T
    scale = float(np.clip((a * turned).sum() / max(1e-12, (turned**2).sum()), 0.7, 1.4))
    return (body - centre) @ rotation.T * scale + target


def _about_z(turn: float) -> Floats:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def forward_travel(found: SceneLabelling, names: Sequence[str], rules: ForeignRules) -> float:
    """`forward_share` of a recording with one body; names: of its markers."""
    positions = Samples.of_scene(found.scene).positions(found.label, len(names))
    return forward_share(positions, _seconds(found.scene), _side_pairs(names), rules.min_speed)


def _seconds(scene: RecordingScene) -> Floats:
    """When each sampled frame is (E,)."""
    return scene.sampled_frames / scene.rate


def _distance_score(positions: Floats, reference: RigidDistances, rules: ForeignRules) -> tuple[float, float]:
    """Nats by which near-rigid distances of marker positions (E, M, 3) m fit the training's better than any do; and their scatter."""
    median, std = median_and_std(positions, reference.first, reference.second, 3)
    known = ~np.isnan(median)
    if not known.any():
        return 0.0, float("nan")
    rigid = known & (std < reference.max_rigid_std)
    scatter, size, logs = reference.nearest(np.where(rigid, median, np.nan))
    gain = _log_ratio(log_distances(median) - size - logs, np.exp(logs), rules.share_std, rules)
    gain = np.where(rigid & ~np.isnan(gain), gain, rules.loose if reference.moving else 0.0) * known
    count = sum(np.bincount(side[known], minlength=positions.shape[1]) for side in (reference.first, reference.second))
    part = np.minimum(1.0, rules.partners / np.maximum(count, 1))
    return float((gain * 0.5 * (part[reference.first] + part[reference.second])).sum()), scatter


def _log_ratio(deviation: Floats, distance: Floats, share_std: float, rules: ForeignRules) -> Floats:
    """Nats for deviations of the log of distances (m) that are the markers', against any others."""
    std, nu = np.sqrt(share_std**2 + (rules.noise / distance) ** 2), rules.freedom
    peak = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
    return np.asarray(peak - np.log(std * rules.background) - 0.5 * (nu + 1.0) * np.log1p((deviation / std) ** 2 / nu))


def _side_pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Places of the left and the right marker of each pair that the names show: LKNE and RKNE."""
    place = {name.upper(): i for i, name in enumerate(names)}
    return [(i, place["R" + name[1:]]) for name, i in place.items() if name.startswith("L") and "R" + name[1:] in place]


def forward_share(positions: Floats, seconds: Floats, sides: Sequence[tuple[int, int]], min_speed: float) -> float:
    """Mean cosine, from -1 to 1, of the direction of travel with the body's forward axis; 0 for a body that does not travel.

    positions (E, M, 3) m, z up, right-handed; seconds (E,); sides: markers of the left and the right side. Forward is left times up.
    """
    if not sides or len(positions) < 6:
        return 0.0
    left = np.array([positions[:, one, :2] - positions[:, other, :2] for one, other in sides])
    centre = np.array([positions[:, marker, :2] for pair in sides for marker in pair])
    shown = ~np.isnan(left[:, :, 0])
    left = np.where(shown[:, :, None], left, 0.0).sum(axis=0) / np.maximum(shown.sum(axis=0), 1)[:, None]
    forward = np.stack([left[:, 1], -left[:, 0]], axis=1)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    step = max(1, len(positions) // 10)
    moved = centre[:, step:] - centre[:, :-step]
    known = ~np.isnan(moved[:, :, 0])
    moved = np.where(known[:, :, None], moved, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)[:, None]
    velocity = moved / np.maximum(seconds[step:] - seconds[:-step], 1e-9)[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    if np.median(speed) < min_speed:
        return 0.0
    return float(((forward[:-step] * velocity).sum(axis=1) / np.maximum(speed, 1e-9)).mean())


def _surplus(found: SceneLabelling) -> float:
    """Points without a label in a usual frame."""
    scene = found.scene
    left_over = np.bincount(scene.sampled_frame, found.label[scene.sampled_track] == NULL, len(scene.sampled_frames))
    return float(np.median(left_over))


def _crowded(found: SceneLabelling, markers: int, rules: ForeignRules) -> bool:
    """Whether a usual frame has many points without a label."""
    return _surplus(found) >= rules.crowded * markers


def label_evidence(
    found: SceneLabelling, samples: Samples, markers: int, reference: RigidDistances, settings: RecordingLabellingSettings
) -> tuple[Floats, float]:
    """Log odds (J,) that labels are right: their distances against those of another marker, and what is left over; and how much that is."""
    rules = settings.foreign
    gain = distance_gains(found.label, samples, markers, reference, rules)
    margin = distance_margins(gain, found.label, found.scene.first, found.scene.last)
    by_margin = rules.by_margin * np.clip(margin, *rules.margin_range) / 4.0
    by_hidden: Floats | float = 0.0
    if len(reference.median) < rules.hidden_people:
        over_hidden = hidden_margins(gain, found.label, found.scene.first, found.scene.last)
        by_hidden = rules.by_hidden * np.clip(rules.hidden_margin - over_hidden, 0.0, 2.0 * rules.hidden_margin)
    deviation = own_deviations(found.scene, found.label, np.array([0, markers]), settings)
    by_deviation = rules.by_deviation * np.clip(deviation - rules.max_deviation, 0.0, 4.0)
    surplus = _surplus(found)
    return rules.log_odds + by_margin - by_hidden - by_deviation - rules.by_surplus * float(np.log1p(surplus)) / 2.0, surplus


def distance_gains(label: Ints, samples: Samples, markers: int, reference: RigidDistances, rules: ForeignRules) -> Floats:
    """Nats (J, M) for each tracklet as each marker, by its distances to the markers that the labels (J,) give."""
    positions = samples.positions(label, markers)
    median, std = median_and_std(positions, reference.first, reference.second, 3)
    rigid = ~np.isnan(median) & (std < reference.max_rigid_std)
    _, size, logs = reference.nearest(np.where(rigid, median, np.nan))
    deviation = np.abs(log_distances(median) - size - logs)[rigid]
    scatter = 1.4826 * float(np.nanmedian(deviation)) if np.isfinite(deviation).any() else rules.share_std
    of_pair = np.full((markers, markers), np.nan)
    of_pair[reference.first, reference.second] = of_pair[reference.second, reference.first] = logs
    gain = np.zeros((len(label), markers))
    for j, own_points in enumerate(samples.by_track()):
        own = np.concatenate([positions[samples.frame[own_points]], samples.xyz[own_points][:, None]], axis=1)
        apart, spread = median_and_std(own, np.full(markers, markers), np.arange(markers), 3)
        apart[apart < 1e-6] = np.nan  # the marker's own points
        score = _log_ratio(log_distances(apart)[None] - size - of_pair, np.exp(of_pair), max(rules.share_std, scatter), rules)
        score = np.where(spread[None] < reference.max_rigid_std, score, rules.loose if reference.moving else np.nan)
        used = ~np.isnan(score) & ~np.isnan(of_pair) & ~np.isnan(apart)[None]
        count = used.sum(axis=1)
        gain[j] = np.where(used, score, 0.0).sum(axis=1) * np.minimum(1.0, rules.partners / np.maximum(count, 1))
    return gain


def distance_margins(gain: Floats, label: Ints, first: Ints, last: Ints) -> Floats:
    """By how many nats (J,) the distances of each label beat the best exchange with a tracklet of the same time; 0 without a label."""
    margin = np.zeros(len(label))
    rows = np.arange(len(label))
    for j in np.nonzero(label != NULL)[0]:
        other = (first <= last[j]) & (last >= first[j]) & (rows != j) & (label != label[j])
        theirs = np.where(label != NULL, gain[rows, label] - gain[j, label], 0.0)
        over_others = gain[j, label[j]] - gain[:, label[j]] + theirs
        margin[j] = over_others[other].min(initial=60.0)
    return margin


def hidden_margins(gain: Floats, label: Ints, first: Ints, last: Ints) -> Floats:
    """By how many nats (J,) the distances of each label beat those of the best marker that is hidden for most of the tracklet's time.

    Infinite where no marker is hidden, and without a label. O(J^2).
    """
    margin = np.full(len(label), np.inf)
    given = label != NULL
    for j in np.nonzero(given)[0]:
        shared = np.maximum(0, np.minimum(last, last[j]) - np.maximum(first, first[j]) + 1)
        held = np.bincount(label[given], shared[given], gain.shape[1])
        hidden = held < 0.5 * (last[j] - first[j] + 1)
        margin[j] = (gain[j, label[j]] - gain[j, hidden]).min(initial=np.inf)
    return margin
