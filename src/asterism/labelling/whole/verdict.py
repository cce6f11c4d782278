"""Whether a recording shows what its model was trained on: labelled positions and the training's distances in; a verdict out.

The distances between markers of one segment do not depend on the pose. People of one laboratory have nearly the same ones, up to the size
of the body; those of other placements, and of wrongly labelled markers, differ by many times as much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from asterism.labelling.whole._distance_kernels import LEAST_DISTANCE, frame_deviations, frame_scatters
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, placed_points
from asterism.recording import NULL, Floats, Ints
from asterism.recording.arrays import nan_mean, nan_median, nan_var
from asterism.recording.verdict import CERTAIN, FITS, OTHER_BODY, OTHER_MARKERS, OTHER_PERSON, UNKNOWN, Verdict

MAX_JUDGED = 1200
"""Frames that are looked through for those that show most of the body: of these, `VerdictRules.shown_share` are 60. At half of it the
distances of a person who is there for a twentieth of a recording are known from 30 frames, at twice it takes twice the time."""

MIN_FRAMES = 5
"""Frames in which a distance must be known. In a recording of fewer frames the training's near-rigid distances are taken as such."""


@dataclass(frozen=True)
class VerdictRules:
    """When a recording counts as foreign. Chosen on simulation and on the sets for choosing (docs/recordings.md).

    frames           frames that are compared at most, where these show all markers; more where they show fewer
    max_rigid_std    m; two markers are near-rigid where their distance varies by less (robust standard deviation)
    noise            m, standard deviation of a distance beyond the share of it that `min_limit` allows
    min_pairs        near-rigid distances that a comparison needs
    min_limit        largest scatter that fits, whatever the training showed
    max_limit        least scatter that never fits
    min_people       people of the training from which their differences widen the limit
    left_out_factor  the limit as a multiple of the largest scatter of a person of the training against all others, between these two
    crowded_limit    largest scatter that fits where fewer people taught the model and many points are left over: among many points some
                     always fit
    shown_share      share of the frames in which a person must be there to be judged in these: a 20th; five frames at least. At half of it
                     labels that points got by chance in a few frames decide; at twice a person who is there for a tenth of the time
                     is judged among frames without one
    own_scatter      largest scatter of a person of the training in another movement: 0.01 in those measured, and 0.02 of the nearest other
                     person. Not tuned
    many_people      people of the training from which each distance is held against how much it differs among them: its standard deviation
                     is then known to a sixth. At half of it, to a quarter; at twice, only large trainings are judged so
    many_limit       root mean square of these deviations that fits, in standard deviations. Right labels of sets for choosing by virtual
                     people reach 1.64, labels given at random begin at 1.6 and are at 2.3 or more in 95 of 100. At half of it half of all
                     people are foreign, at twice nobody is
    most_deviation   standard deviations that one distance counts at most, so that one displaced marker makes nobody foreign. At half of it
                     right and random labels overlap, at twice nothing changes but for that
    known_share      share of the training's near-rigid distances that must be seen where fewer people taught the model: strangers have
                     some as long as these people. Of 258 steps in which markers or frames of `movement` were added, the verdict fell in
                     15 without it, in 5 at a half, and in 2 at 0.7, where
                     those who do fit are unknown as soon as three of 15 markers are hidden
    body_scatter     scatter from which it is another body; with many people, this is twice the limit
    body_size        factor between the sizes from which it is another body
    body_labelled    share of the markers, or of the points if fewer, below which what does not fit is another body
    moving_lost      the same from which a movement is foreign to a training of standing trials
    body_lost        share of the training's near-rigid distances that are not rigid from which it is another body
    min_labelled     share of the markers, or of the points if fewer, below which it is another marker set
    min_found        the same below which it is another body, where a usual frame shows `min_shown` of the markers' number of points
    min_shown        see above
    fall_within      log odds by which the largest confidence in a frame rises for each e-fold by which its scatter is below the limit
    standing_share   share of the limit that counts as the limit in frames labelled by a model of standing trials
    fall_standing    log odds by which the largest confidence there falls for each e-fold beyond it
    standing_confidence  to this at most
    either_way       confidence below which a label counts as one that could be exchanged
    min_surplus      points beyond the number of markers, as a share of these, from which what does not fit is another marker set
    crowd_doubt      log odds that labels lose for each e-fold of lasting points for a marker, where these are more than markers: of another
                     set that is worn beside, each is wrong once for a person. Where n points may be a marker, it would be 1; fitted
                     to 221 labels of `movement`, of which 87 % were right where 95 were said, and virtual people with larger sets
                     say 1.7. At half of it 8 of 10 labels at 0.9 are right; at double those of 15 markers among 60 points are
                     nearly all taken back
    """

    frames: int = 60
    max_rigid_std: float = 0.02
    noise: float = 0.01
    min_pairs: int = 6
    min_limit: float = 0.06
    max_limit: float = 0.09
    min_people: int = 5
    left_out_factor: float = 1.5
    crowded_limit: float = 0.035
    shown_share: float = 0.05
    own_scatter: float = 0.018
    many_people: int = 20
    many_limit: float = 1.75
    most_deviation: float = 4.0
    known_share: float = 0.5
    body_scatter: float = 0.3
    body_size: float = 1.7
    body_labelled: float = 0.5
    moving_lost: float = 0.25
    body_lost: float = 0.7
    min_labelled: float = 0.6
    min_found: float = 0.2
    min_shown: float = 0.4
    fall_within: float = 20.0
    standing_share: float = 0.5
    fall_standing: float = 3.3
    standing_confidence: float = 0.88
    either_way: float = 0.75
    min_surplus: float = 0.25
    crowd_doubt: float = 1.14


@dataclass(frozen=True)
class RigidDistances:
    """The near-rigid distances of the training: N pairs of markers, P people.

    first, second  (N,) markers of each pair
    median         (P, N) m, the median distance of each person, NaN where it was not seen
    moving         whether the training shows that other distances are not rigid; a standing trial alone does not
    limit          the largest scatter that fits
    unit           `length_scale` of the body
    rules          by which they were chosen
    spread         (N,) standard deviation of the log of each distance among many people, sizes set aside; None where few taught the model.
                   With many people, a scatter is the root mean square deviation in these, times their median
    """

    first: Ints
    second: Ints
    median: Floats
    moving: bool
    limit: float
    unit: float
    rules: VerdictRules
    spread: Floats | None = None

    @classmethod
    def of_training(cls, frames: Floats, people: Ints, unit: float, rules: VerdictRules) -> RigidDistances:
        """frames (N, M, 3) m, NaN where missing; people (N,) whose each is; unit: `length_scale` of the body. O(P frames M^2 + P^2 N)."""
        first, second = np.triu_indices(frames.shape[1], 1)
        medians, stds = [], []
        for person in np.unique(people):
            median, std = median_and_std(_some(frames[people == person], rules.frames), first, second)
            medians.append(median)
            stds.append(std)
        std = np.fmax.reduce(np.stack(stds), axis=0)
        rigid = std < rules.max_rigid_std * unit
        moving = bool((std > 1.5 * rules.max_rigid_std * unit).mean() > 0.2)
        return cls(first[rigid], second[rigid], np.stack(medians)[:, rigid], moving, rules.min_limit, unit, rules).with_limit()

    def with_limit(self) -> RigidDistances:
        """These distances, with the largest scatter that fits, and the spread where many people taught the model, as the people's say."""
        rules, people = self.rules, len(self.median)
        if people >= rules.many_people and len(self.first):
            spread = self._spread_of_people()
            return replace(self, spread=spread, limit=rules.many_limit * float(np.median(spread)))
        if self.few_people:
            return replace(self, spread=None, limit=rules.min_limit)
        rest = [replace(self, median=np.delete(self.median, p, axis=0)).nearest(self.median[p])[0] for p in range(people)]
        most = max((scatter for scatter in rest if not np.isnan(scatter)), default=0.0)
        return replace(self, spread=None, limit=float(np.clip(rules.left_out_factor * most, rules.min_limit, rules.max_limit)))

    @property
    def few_people(self) -> bool:
        """Whether so few people taught the model that it says little of how people differ."""
        return len(self.median) < self.rules.min_people

    def _spread_of_people(self) -> Floats:
        """How much the log of each distance differs among the training's people, sizes set aside: (N,) standard deviations.

        People who do not differ at all allow what few people do, `VerdictRules.min_limit`. A distance that few of them show differs as
        others do.
        """
        logs = log_distances(self.median)
        typical = nan_mean(logs, axis=0)
        apart = logs - typical
        apart -= nan_median(apart, axis=1)[:, None]
        variance = nan_var(apart, axis=0)
        known = (~np.isnan(apart)).sum(axis=0) >= self.rules.min_people
        variance[~known] = np.median(variance[known]) if known.any() else 0.0
        least = self.rules.min_limit / self.rules.many_limit
        return np.asarray(np.sqrt(variance + least**2 * (1.0 + (self.softness / np.exp(typical)) ** 2)))

    @property
    def max_rigid_std(self) -> float:
        """Standard deviation (m) up to which a distance is near-rigid."""
        return self.rules.max_rigid_std * self.unit

    @cached_property
    def log_references(self) -> Floats:
        """The logs of the distances (R, N) that a body may be near to: the people's mean, then each of several, unless they are many."""
        logs = log_distances(self.median)
        mean = nan_mean(logs, axis=0)
        return np.stack([mean, *(logs if len(logs) > 1 and self.spread is None else ())])

    @property
    def body_scatter(self) -> float:
        """Scatter from which it is another body."""
        return self.rules.body_scatter if self.spread is None else 2.0 * self.limit

    @property
    def softness(self) -> float:
        """Distances (m) well below this count for less: see `VerdictRules.noise`."""
        return self.rules.noise * self.unit / self.rules.min_limit

    def scatters(self, positions: Floats) -> Floats:
        """The scatter of each frame alone (T,): positions (T, M, 3) m, NaN where missing. All pairs count as rigid; see `nearest`."""
        return self.scatters_of(np.linalg.norm(positions[:, self.first] - positions[:, self.second], axis=2))

    def scatters_of(self, distance: Floats) -> Floats:
        """The scatter of each row of distances: (T, N) m in, (T,) out."""
        out = np.empty(len(distance))
        if self.spread is not None:
            frame_deviations(distance, self.log_references[0], self.spread, self.rules.most_deviation, self.rules.min_pairs, out)
            return np.asarray(out * np.median(self.spread))
        frame_scatters(distance, self.log_references, self.softness, self.rules.min_pairs, out)
        return out

    def confidence_limits(self, scatter: Floats) -> Floats:
        """Upper limit of the confidence of each frame's labels, by the frame's scatter: (T,) each.

        Just below 0.99 from the largest scatter that fits on; well below it, no limit; 1 where nothing can be compared. A model of
        standing trials knows no other pose, and a single frame does not show whether the person moves: there the confidence is limited
        from half that scatter on, and falls.
        """
        rules = self.rules
        beyond = np.log(np.maximum(scatter, 1e-9) / (self.limit if self.moving else rules.standing_share * self.limit))
        fallen = logit(CERTAIN) - (0.0 if self.moving else rules.fall_standing) * beyond
        log_odds = np.where(beyond < 0.0, logit(CERTAIN) - rules.fall_within * beyond, np.maximum(fallen, logit(rules.standing_confidence)))
        return np.where(np.isnan(beyond), 1.0, expit(log_odds))

    def nearest(self, distance: Floats) -> tuple[float, float, Floats]:
        """The people's mean, or the one of them, whose distances are the nearest to those of a body.

        distance (N,) m, NaN where not known or not rigid. Gives the scatter about the nearest, the log of the size, and the logs of the
        distances (N,); scatter and size are NaN and 0 where too few are known.
        """
        rules, mean = self.rules, self.log_references[0]
        best, size, nearest = float("nan"), 0.0, mean
        for reference in self.log_references:
            ratio = log_distances(distance) - reference
            known = ~np.isnan(ratio)
            if known.sum() < rules.min_pairs:
                continue
            middle = float(np.median(ratio[known]))
            if self.spread is not None:
                apart = np.minimum(np.abs(ratio[known] - middle) / self.spread[known], rules.most_deviation)
                return float(np.sqrt((apart**2).mean()) * np.median(self.spread)), middle, mean
            # a distance of 10 cm may be off by a centimetre as a long one may be by some per cent
            weight = 1.0 / np.sqrt(1.0 + (self.softness / np.maximum(distance[known], LEAST_DISTANCE)) ** 2)
            scatter = 1.4826 * float(np.median(np.abs(ratio[known] - middle) * weight))
            if not scatter >= best:
                best, size, nearest = scatter, middle, reference
        return best, size, np.where(np.isnan(nearest), mean, nearest)


def judge(positions: Floats, counts: Ints, reference: RigidDistances) -> Verdict:
    """The verdict on labelled frames: positions (E, M, 3) m of the markers, NaN where none; counts (E,) points of each frame. O(E N).

    The frames that show most of the body decide: one that enters late, or leaves, is the same body.
    """
    rules, markers = reference.rules, positions.shape[1]
    shows = shows_most((~np.isnan(positions[:, :, 0])).sum(axis=1), rules)
    positions, counts = positions[shows], counts[shows]
    labelled = (~np.isnan(positions[:, :, 0])).sum(axis=1)
    share = float(labelled.sum() / max(1, np.minimum(counts, markers).sum()))
    surplus = float(np.median(counts - labelled)) if len(counts) else 0.0
    # a pair of markers that are seen now and then needs more frames
    some = _some(positions, round(rules.frames * markers / max(1.0, labelled.mean()))) if len(labelled) else positions
    distance, std = median_and_std(some, reference.first, reference.second, min(MIN_FRAMES, len(some)))
    known = ~np.isnan(distance)
    rigid = known & (std < reference.max_rigid_std if len(some) >= MIN_FRAMES else reference.moving)
    lost = 1.0 - float(rigid.sum()) / max(1, int(known.sum()))
    scatter, log_size, _ = reference.nearest(np.where(rigid, distance, np.nan))
    size = float("nan") if np.isnan(scatter) else float(np.exp(log_size))
    comparable = len(reference.first) >= 2 * rules.min_pairs and len(some) >= MIN_FRAMES
    crowded = len(reference.median) < rules.min_people and surplus >= rules.min_surplus * markers
    verdict = Verdict(FITS, scatter, min(reference.limit, rules.crowded_limit) if crowded else reference.limit, size, share, surplus)
    if np.isnan(scatter):
        # a body whose markers move against each other, where enough of their distances are seen
        kind = OTHER_BODY if comparable and known.sum() >= 2 * rules.min_pairs else _kind_by_points(verdict, counts, markers, rules)
        # nothing contradicts, because nothing could be compared; a body of few near-rigid distances is never compared
        if kind == FITS and (not labelled.any() or len(reference.first) >= rules.min_pairs):
            kind = UNKNOWN
    elif _is_other_body(verdict, lost if reference.moving else 0.0, reference.body_scatter, rules):
        kind = OTHER_BODY
    elif scatter > verdict.limit:
        # points without a label may be markers of the model that fit badly; those beyond its markers are others, whatever is labelled
        others = float(np.median(counts)) - markers
        kind = OTHER_MARKERS if others >= rules.min_surplus * markers or share < rules.min_labelled else OTHER_PERSON
    elif not reference.moving and lost > rules.moving_lost:
        kind = OTHER_PERSON
    else:
        kind = _kind_by_points(verdict, counts, markers, rules)
        # a part of a stranger may be as long as a person's of the training; what is seen later must not take back that they fit
        if kind == FITS and reference.spread is None and rigid.sum() < rules.known_share * len(reference.first):
            kind = UNKNOWN
    return replace(verdict, kind=kind)


def shows_most(labelled: Ints, rules: VerdictRules) -> NDArray[np.bool_]:
    """The frames (E,) that show most of a body, by how many labels each of them has: labelled (E,).

    All frames where nothing is labelled, or no frames stand out.
    """
    if not len(labelled):
        return np.zeros(0, dtype=np.bool_)
    number = min(len(labelled), max(MIN_FRAMES, round(rules.shown_share * len(labelled))))
    return np.asarray(2 * labelled >= np.sort(labelled)[-number])


def _is_other_body(verdict: Verdict, lost: float, most: float, rules: VerdictRules) -> bool:
    """Whether the distances are no person's.

    lost: share of the training's near-rigid distances that are not rigid here; most: the largest scatter of a person.
    """
    return (
        verdict.scatter > most
        or abs(np.log(verdict.size)) > np.log(rules.body_size)
        or lost > rules.body_lost
        or (verdict.scatter > verdict.limit and verdict.labelled < rules.body_labelled)
    )


def judge_scene(scene: RecordingScene, label: Ints, offsets: Ints, number: int, reference: RigidDistances | None) -> Verdict | None:
    """The verdict on the labels of long tracklets, for the body with this number; None for a model that keeps no sample of its training.

    label (J,): labels of all bodies, -1 for none; offsets: where each body's markers begin among them.
    """
    if reference is None:
        return None
    frame_of = np.repeat(np.arange(len(scene.offsets) - 1), np.diff(scene.offsets))
    points = JudgedPoints(frame_of, scene.xyz, label[scene.track], np.ones(len(frame_of), dtype=np.bool_), len(scene.offsets) - 1)
    return judge_points(points, offsets, number, reference)


@dataclass(frozen=True)
class JudgedPoints:
    """P points of a recording, by which it is judged.

    frame_of  (P,) the frame of each
    xyz       (P, 3) m
    label     (P,) column among the markers of all bodies, -1 for none
    lasting   (P,) whether it is part of a long tracklet; a point that is seen for a moment and has no label is a reflection
    frames    number of frames
    """

    frame_of: Ints
    xyz: Floats
    label: Ints
    lasting: NDArray[np.bool_]
    frames: int


def judge_points(points: JudgedPoints, offsets: Ints, number: int, reference: RigidDistances) -> Verdict:
    """The verdict on the labels of the body with this number, by `MAX_JUDGED` frames at most; offsets: see `judge_scene`."""
    used = np.zeros(points.frames, dtype=np.bool_)
    used[np.linspace(0, points.frames - 1, min(points.frames, MAX_JUDGED)).round().astype(np.int64)] = True
    there = used[points.frame_of]
    frame, label = (np.cumsum(used) - 1)[points.frame_of[there]], points.label[there]
    own = labels_of_body(label, offsets, number)
    positions = placed_points(frame, own, points.xyz[there], int(used.sum()), int(offsets[number + 1] - offsets[number]))
    # the points of other bodies are theirs
    counted = (own != NULL) | ((label == NULL) & points.lasting[there])
    return judge(positions, np.bincount(frame, weights=counted, minlength=len(positions)).astype(np.int64), reference)


def _kind_by_points(verdict: Verdict, counts: Ints, markers: int, rules: VerdictRules) -> str:
    """The verdict where the distances say nothing, or that all is well. counts (E,) points of each frame."""
    if verdict.labelled >= rules.min_labelled or not counts.any():
        return FITS
    if verdict.labelled >= rules.min_found:
        return OTHER_MARKERS
    return OTHER_BODY if np.minimum(counts, markers).mean() >= rules.min_shown * markers else FITS


class RivalCounts:
    """How often each of M markers is labelled, and how often it may as well be another one; `add` takes in points of more frames."""

    def __init__(self, markers: int) -> None:
        self.labelled = np.zeros(markers, dtype=np.int64)
        self.doubtful = np.zeros((markers, markers), dtype=np.int64)

    def add(self, label: Ints, rival: Ints, certainty: Floats, rules: VerdictRules) -> None:
        """label, rival, certainty (P,): marker of each point, -1 for none; the best other marker; how certain the label is. O(P + M^2)."""
        shape = self.doubtful.shape
        self.labelled += np.bincount(label[label != NULL], minlength=shape[0])
        doubtful = np.nonzero((certainty < rules.either_way) & (label != NULL) & (rival != NULL))[0]
        pairs = label[doubtful] * shape[1] + rival[doubtful]
        self.doubtful += np.bincount(pairs, minlength=self.doubtful.size).reshape(shape)

    def exchangeable(self, frames: int) -> tuple[tuple[int, ...], ...]:
        """Groups of markers that may carry each other's labels in most frames of a recording of so many.

        Two markers belong together where each is labelled in half of the frames or more, doubtful in most of them, and the other one's
        usual rival.
        """
        often = (2 * self.labelled >= frames) & (2 * self.doubtful.sum(axis=1) > self.labelled)
        usual = {int(marker): int(self.doubtful[marker].argmax()) for marker in np.nonzero(often)[0]}
        return tuple((marker, other) for marker, other in usual.items() if marker < other and usual.get(other) == marker)


def confidence_limit(verdict: Verdict | None) -> float:
    """What no label of a recording may be more certain than: 1 where it fits or was not judged, below 0.99 where it does not fit."""
    return 1.0 if verdict is None else verdict.max_confidence


def median_and_std(frames: Floats, first: Ints, second: Ints, least: int = MIN_FRAMES) -> tuple[Floats, Floats]:
    """Median and robust standard deviation (N,) m of distances in frames (E, M, 3); NaN where known in fewer than `least` frames."""
    distance = np.linalg.norm(frames[:, first] - frames[:, second], axis=2)
    missing = np.isnan(distance)
    # The first takes several times as long.
    middle = nan_median if missing.any() or not len(frames) else np.median
    median = middle(distance, axis=0)
    std = 1.4826 * middle(np.abs(distance - median), axis=0)
    unknown = (~missing).sum(axis=0) < max(1, least)
    return np.where(unknown, np.nan, median), np.where(unknown, np.nan, std)


def log_distances(distance: Floats) -> Floats:
    """The logs of distances (m), NaN where not known; of points in one place as of `LEAST_DISTANCE`, whose log is finite."""
    return np.log(np.maximum(distance, LEAST_DISTANCE))


def _some(frames: Floats, most: int) -> Floats:
    """At most so many frames, evenly spread."""
    return frames if len(frames) <= most else frames[np.linspace(0, len(frames) - 1, most).round().astype(np.int64)]
