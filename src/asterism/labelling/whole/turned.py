"""A labelled scene held against its twins: labels of tracklets in; better ones, and how far ahead of the twins they are, out.

Single frames that were labelled turned round agree with one another, and so do all their tracklets. So in a few frames the labels found are
exchanged for those of each twin of the body (`body/twins.py`), completed with the points that are left over, refined, and compared by the
joint evidence of the whole frame, by the body of people at large. A person stands in one posture, and wears the markers in one way: what
one frame says for the labels against a twin, the next one repeats. So a twin that is behind by few nats a frame limits the confidence,
however many frames there are.

The same holds for two markers that may have each other's points, and for one that may have the point of a hidden one: a marker that was
placed elsewhere is one event for the whole recording. So every exchange of near labels is scored by the joint evidence, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from asterism.labelling.body._search_kernels import LAID
from asterism.labelling.body.exchanges import HeldFrames
from asterism.labelling.body.labeller import BodyLabeller
from asterism.labelling.whole._twin_kernels import TwinScores, score_exchanges, score_twins
from asterism.labelling.whole.scene import RecordingScene, labels_of_body, marker_offsets, placed_points, score_scene, with_fewer_samples
from asterism.labelling.whole.settings import RecordingLabellingSettings, TwinRules
from asterism.recording import NULL, Floats, Ints
from asterism.recording.verdict import CERTAIN

NO_COLUMNS = np.empty(0, dtype=np.int64)


def twin_limits(lead: Floats, label: Ints, rules: TwinRules) -> Floats:
    """What labels (P,), columns of all bodies, may be as certain as, by the lead (L,) of each column: (P,)."""
    return np.append(expit(rules.prior + lead / rules.scale), 1.0)[label]


def joint_evidence(labellers: Sequence[BodyLabeller], scene: RecordingScene, label: Ints) -> float:
    """What the labels (J,) explain of a frame, the mean over the sampled ones in nats, by the bodies of people at large."""
    offsets, total = marker_offsets(labellers), 0.0
    for number, labeller in enumerate(labellers):
        totals = score_scene(scene, labels_of_body(label, offsets, number), labeller.body, labeller.settings).totals
        # a frame with fewer than three labels explains nothing
        total += float(np.where(np.isnan(totals), -labeller.settings.first_ghost_cost, totals).mean()) if len(totals) else 0.0
    return total


@dataclass(frozen=True)
class HeldLabels:
    """Labels of a scene that were held against their twins and exchanges.

    label   (J,) columns of all bodies, -1 for none: those given where nothing is better
    lead    (L,) nats a frame by which each column is ahead of the best twin that labels most of its points otherwise, 0 or more, infinite
            where there is none
    over_exchanges  (L,) the same over exchanges of few markers
    over_others     (L,) the same over points without a label that may be the marker in place of its own
    excess  (L, L) nats a frame by which the leave-one-out score of a column's points as another column is too high for an exchange
    poor    (L,) whether the body of a column is explained poorly, see `is_poor`
    """

    label: Ints
    lead: Floats
    over_exchanges: Floats
    over_others: Floats
    excess: Floats
    poor: NDArray[np.bool_]

    def limits(self, label: Ints, rules: TwinRules, *, with_exchanges: bool) -> Floats:
        """What labels (P,), columns of all bodies, may be as certain as: (P,), 1 for none."""
        limits = np.minimum(twin_limits(self.lead, label, rules), np.where(np.append(self.poor, False)[label], CERTAIN, 1.0))
        if not with_exchanges:
            return limits
        # margins have weighed points left over, once for each independent frame: what they may be takes no label back
        of_others = np.maximum(expit(self.over_others / rules.exchange_scale), CERTAIN)
        of_exchange = np.minimum(expit(self.over_exchanges / rules.exchange_scale), of_others)
        return np.minimum(limits, np.append(of_exchange, 1.0)[label])


def hold_against_twins(
    labellers: Sequence[BodyLabeller],
    scene: RecordingScene,
    label: Ints,
    relabel: Callable[[Ints, Ints], Ints],
    rules: TwinRules,
    settings: RecordingLabellingSettings,
) -> HeldLabels:
    """Hold the labels (J,) of a scene, columns of all bodies, against the twins of each body and against exchanges of two labels.

    relabel: labels the scene from given labels (J,) on until they no longer change, without some columns. O(frames) calls of `score_twins`
    and of `score_exchanges`, and one `relabel` where a twin is better.
    """
    few, offsets = with_fewer_samples(scene, rules.frames, settings), marker_offsets(labellers)
    lead, over_exchanges, over_others = np.full((3, offsets[-1]), np.inf)
    excess = np.zeros((offsets[-1], offsets[-1]))
    for number, labeller in enumerate(labellers):
        columns = slice(offsets[number], offsets[number + 1])
        for turn in range(rules.rounds + 1):
            lead[columns], better = _lead_over_twins(labeller, few, label, offsets, number, rules)
            if better is None or turn == rules.rounds:
                break
            other = relabel(better, NO_COLUMNS)
            if joint_evidence(labellers, few, other) <= joint_evidence(labellers, few, label):
                break
            label = other
        if rules.rounds:
            label = _without_optional(labellers, few, label, relabel, number)
        for turn in range(rules.rounds + 1):
            exchanges, held = _exchanges(labeller, few, label, offsets, number)
            best = None if turn == rules.rounds else exchanges.best()
            if best is None:
                break
            label = _permuted(label, best, offsets[number])
        excess[columns, columns], over_exchanges[columns] = exchanges.excess, exchanges.lead()
        over_others[columns] = _lead_over_others(held, few, label, offsets, number)
    poor = np.repeat([is_poor(labellers, few, label, number, rules) for number in range(len(labellers))], np.diff(offsets))
    return HeldLabels(label, np.maximum(lead, 0.0), np.maximum(over_exchanges, 0.0), np.maximum(over_others, 0.0), excess, poor)


def is_poor(labellers: Sequence[BodyLabeller], few: RecordingScene, label: Ints, number: int, rules: TwinRules) -> bool:
    """Whether the labels (J,) explain little of a body: points are left over beside missing markers, and labels hardly earn what is usual.

    A body that is labelled one segment along, thighs as shanks and shanks as feet, has no better exchange beside it.
    """
    labeller, own = labellers[number], labels_of_body(label, marker_offsets(labellers), number)
    _, begins, track = _own_points(few, label, own)
    labelled, points = float((own[track] != NULL).sum()), float(len(track))
    frames = max(len(begins) - 1, 1)
    if min(points / frames, len(labeller.worn_odds)) - labelled / frames < rules.poor_left or not labelled:
        return False
    earned = frames * (joint_evidence([labeller], few, own) + labeller.settings.first_ghost_cost)
    return earned < (labeller.settings.usual_score + rules.poor_gain) * labelled


def _without_optional(
    labellers: Sequence[BodyLabeller], few: RecordingScene, label: Ints, relabel: Callable[[Ints, Ints], Ints], number: int
) -> Ints:
    """The labels (J,), or better ones in which a body wears none of the markers that laboratories often leave out, or one of them less.

    Looked for only where other markers have no point: an elbow that is called a marker of the upper arm leaves wrist and hand without one.
    """
    labeller, first = labellers[number], marker_offsets(labellers)[number]

    def evidence(given: Ints) -> float:
        worn = np.isin(first + np.arange(len(labeller.worn_odds)), given)
        return joint_evidence(labellers, few, given) + float(labeller.worn_odds[worn].sum())

    worn = np.isin(first + np.arange(len(labeller.optional)), label)
    optional = first + np.nonzero(labeller.optional & worn)[0]
    if not len(optional) or worn[~labeller.optional].all():
        return label
    best = evidence(label)
    for columns in (optional, *optional[:, None]):
        other = relabel(np.where(np.isin(label, columns), NULL, label), columns)
        found = evidence(other)
        if found > best:
            best, label = found, other
    return label


def _own_points(few: RecordingScene, label: Ints, own: Ints) -> tuple[Floats, Ints, Ints]:
    """The points that may be one body's, in all sampled frames: xyz (P, 3) m, where each frame's begin (E + 1,), and their tracklets (P,).

    label (J,) of all bodies, own (J,) of this one: the points of other bodies are theirs.
    """
    points = np.nonzero((label == NULL)[few.sampled_track] | (own != NULL)[few.sampled_track])[0]
    counts = np.bincount(few.sampled_frame[points], minlength=len(few.sampled_frames))
    begins = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return np.ascontiguousarray(few.sampled_xyz[points]), begins, few.sampled_track[points]


@dataclass(frozen=True)
class Exchanges:
    """Permutations of few markers of a body that its labels were held against.

    table   (W, M) for each marker the one whose point it takes
    behind  (W,) nats a frame by which each is behind the labels, infinite where it changes none
    excess  (M, M) see `HeldLabels`
    """

    table: Ints
    behind: Floats
    excess: Floats

    def lead(self) -> Floats:
        """By how many nats a frame each marker (M,) is ahead of the best that gives its point to another one; infinite without any."""
        moved = self.table != np.arange(self.table.shape[1])
        return np.where(moved, self.behind[:, None], np.inf).min(axis=0, initial=np.inf)

    def best(self) -> Ints | None:
        """All that are better than the labels as one permutation (M,), the best first, each marker in one; None where there is none."""
        found = np.arange(self.table.shape[1])
        for w in np.argsort(self.behind, kind="stable"):
            moved = self.table[w] != np.arange(len(found))
            if self.behind[w] < 0.0 and (found[moved] == np.nonzero(moved)[0]).all():
                found[moved] = self.table[w, moved]
        return None if (found == np.arange(len(found))).all() else found


def _exchanges(labeller: BodyLabeller, few: RecordingScene, label: Ints, offsets: Ints, number: int) -> tuple[Exchanges, HeldFrames]:
    """Hold the labels of the body with this number against exchanges of two markers, and permutations of three or four side by side.

    With the frames that were held, for what else they are held against.
    """
    own, model = labels_of_body(label, offsets, number), labeller.exchanges
    xyz, begins, track = _own_points(few, label, own)
    markers, frames = model.mean.shape[1], len(begins) - 1
    apart, both, shown = np.empty((markers, markers)), *(np.empty((markers, markers), dtype=np.int64) for _ in range(2))
    score_exchanges(xyz, begins, track, own, labeller.body, labeller.settings, apart, both, shown)
    placed = placed_points(np.repeat(np.arange(frames), np.diff(begins)), own[track], xyz, frames, markers)
    held = model.held(placed, labeller.settings.tail_freedom)
    behind = held.behind()
    seen = ~np.isnan(behind)
    mean = np.where(seen, behind, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    mean[~seen.any(axis=1)] = np.inf
    table, worn = model.table, np.isin(np.arange(markers), own)
    # what laboratories leave out is known before any point is seen
    mean += (worn - worn[table].astype(np.float64)) @ labeller.worn_odds
    excess, (one, other) = np.zeros((markers, markers)), model.pairs.T
    for a, b in ((one, other), (other, one)):
        ahead = mean[: len(one)]
        known = (shown[a, b] > 0) & np.isfinite(ahead) & np.isfinite(apart[a, b])
        a, b = a[known], b[known]
        # where both have points, half of it for each of the two; far from near, a tail says less than the scores
        too_high = np.maximum(ahead[known] - apart[a, b] / shown[a, b], 0.0)
        excess[a, b] = too_high * (1.0 - 0.5 * both[a, b] / shown[a, b])
    return Exchanges(table, mean, excess), held


def _lead_over_others(held: HeldFrames, few: RecordingScene, label: Ints, offsets: Ints, number: int) -> Floats:
    """The lead (M,) of the labels of the body with this number, held, over points without a label, in nats a frame; infinite without any.

    A marker beside others of a larger set is one event for the whole recording, as an exchange is. The median over the sampled frames that
    show a marker: a point that is beside it in few of them is a ghost, and one in a gap goes on as another tracklet.
    """
    own = labels_of_body(label, offsets, number)
    xyz, begins, track = _own_points(few, label, own)
    frames, markers = held.frames.shape[:2]
    frame_of, free = np.repeat(np.arange(frames), np.diff(begins)), np.nonzero(own[track] == NULL)[0]
    lead = np.full(markers, np.inf)
    others = np.full((frames, int(np.bincount(frame_of[free], minlength=1).max()), 3), np.nan)
    others[frame_of[free], np.arange(len(free)) - np.searchsorted(frame_of[free], frame_of[free])] = xyz[free]
    behind = held.behind_others(others)
    least = np.where(np.isnan(behind), np.inf, behind).min(axis=0, initial=np.inf)
    for marker in range(markers):
        seen = ~np.isnan(held.frames[:, marker, 0])
        if seen.any():
            lead[marker] = np.median(least[marker, seen])
    return lead


def _permuted(label: Ints, permutation: Ints, first: int) -> Ints:
    """The labels (J,) of all bodies, those of the body whose columns begin with `first` permuted: (M,), whose point each marker takes."""
    own = (label >= first) & (label < first + len(permutation))
    better = label.copy()
    better[own] = np.argsort(permutation)[label[own] - first] + first
    return better


def _lead_over_twins(
    labeller: BodyLabeller, few: RecordingScene, label: Ints, offsets: Ints, number: int, rules: TwinRules
) -> tuple[Floats, Ints | None]:
    """The lead (M,) of the labels of the body with this number over its twins, in nats a frame.

    And the labels (J,) of the best twin that is ahead, None where there is none.
    """
    own = labels_of_body(label, offsets, number)
    markers, (xyz, begins, track) = int(offsets[number + 1] - offsets[number]), _own_points(few, label, own)
    lead, point_of = compare_with_twins(labeller, xyz, begins, track, own, rules)
    if point_of is None:
        return lead, None
    # each tracklet becomes what the twin says of it in most of the frames
    votes = np.zeros((len(label), markers + 1), dtype=np.int64)
    votes[:, markers] = np.bincount(track, minlength=len(label))
    frame, marker = np.nonzero(point_of != NULL)
    np.add.at(votes, (track[begins[frame] + point_of[frame, marker]], marker), 2)
    given, mine, better = votes.argmax(axis=1), (own != NULL) | (label == NULL), label.copy()
    better[mine] = np.where(given == markers, NULL, given + offsets[number])[mine]
    return lead, better


def compare_with_twins(
    labeller: BodyLabeller,
    xyz: Floats,
    offsets: Ints,
    track: Ints,
    label: Ints,
    rules: TwinRules,
    most: int | None = None,
    done: NDArray[np.bool_] | None = None,
) -> tuple[Floats, Ints | None]:
    """Hold labels of one body in some frames against its twins; in one frame against a part of them, where only so many may be refined.

    xyz (P, 3) m, z up; offsets (E + 1,) where each frame's points begin; track (P,) tracklet of each point; label (J,) marker of each
    tracklet, -1 for none; most, how many twins are refined in a frame, None for all; done (`twins_held_against`,), those that are left
    out, to which those that were looked at are added. Gives by how many nats a frame each marker (M,) is ahead of the best twin that has
    another point for it in most frames, infinite where there is none; and the points (E, M) of the best twin that is ahead of the labels,
    None where there is none.
    """
    frames, markers, count = len(offsets) - 1, labeller.body.mean.shape[1], twins_held_against(labeller)
    shape = (count + 1, frames)
    out = TwinScores(np.empty(shape), np.empty((*shape, markers), dtype=np.int64))
    most, done = count if most is None else most, np.zeros(count, dtype=np.bool_) if done is None else done
    body, settings = labeller.body, labeller.settings
    score_twins(xyz, offsets, track, label, labeller.twins, body, settings, rules.gap, rules.marker_gain, most, done, out)
    ahead = out.scores[-1] - out.scores[:-1]
    seen = ~np.isnan(ahead)
    behind = np.where(seen, ahead, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    behind[~seen.any(axis=1)] = np.inf
    # a marker is labelled otherwise where its point is another one in most of the frames that show it
    shown = (out.point_of[-1] != NULL)[None] & seen[:, :, None]
    differs = 2 * (shown & (out.point_of[:-1] != out.point_of[-1])).sum(axis=1) > shown.sum(axis=1)
    lead = np.where(differs, behind[:, None], np.inf).min(axis=0)
    best = int(np.argmin(behind))
    if behind[best] >= 0.0:
        return lead, None
    return lead, np.where(seen[best][:, None], out.point_of[best], NULL)


def twins_held_against(labeller: BodyLabeller) -> int:
    """How many labellings `compare_with_twins` looks at: the body's twins, and the ways in which it is laid anew."""
    return len(labeller.twins) + LAID
