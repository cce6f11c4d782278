"""A recording without labels in, and no model; its tracklets joined to groups, one per marker, out; and the recording with their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import gammaln

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.recording import NULL, Clouds, Floats, Ints, Labelling, Recording, is_unnamed
from asterism.tracking.linking import find_tracklets

Bools = NDArray[np.bool_]

_SMOOTH_SECONDS = 0.15
"""Standard deviation (s) of the Gaussian that smooths the body's turn about the vertical."""
_MIN_SPEED = 0.2
"""m/s from which the body has a direction of travel."""
_FREQUENT = 0.1
"""Share of the frames from which a group is listed for a person."""


@dataclass(frozen=True)
class JoinRules:
    """When two tracklets count as one marker. Chosen on the gait subjects HC003, HC031, HC042, HC044, HC050, checked on the others.

    min_evidence    nats by which "one marker" must beat "two markers"
    min_margin      nats by which a join must beat every join that it would exclude
    max_neighbours  tracklets at most that the places of the two are compared with
    min_shared      share of a tracklet's frames in which a neighbour must be seen
    noise           m, standard deviation of a marker about the place that its neighbours predict
    offset          m, standard deviation of the distance between neighbours
    slope           standard deviation of the coefficients with which a marker follows a neighbour
    step            s between the frames that are used
    min_duration    s that a tracklet lasts at least; a shorter one is not joined
    """

    min_evidence: float = 8.0
    min_margin: float = 5.0
    max_neighbours: int = 4
    min_shared: float = 0.6
    noise: float = 0.016
    offset: float = 0.5
    slope: float = 0.5
    step: float = 0.08
    min_duration: float = 0.08


@dataclass(frozen=True)
class MarkerGroups:
    """Which points of a recording are one marker, as far as its motion shows.

    of_point  (P,) int: the group of each point of the clouds; every point has one
    frames    (G,) int: in how many frames each group is seen
    frequent  how many groups are seen in a tenth of the frames or more: a person names these

    The frequent groups come first, numbered from the head down; then the others, by falling number of frames.
    """

    of_point: Ints
    frames: Ints
    frequent: int

    def __len__(self) -> int:
        return len(self.frames)


@dataclass(frozen=True)
class GroupPlace:
    """Where a group is on the body, medians over its frames.

    height   m above the lowest point of the recording
    left     m to the left of the body's middle, as it walks; NaN where the body does not travel
    ahead    m ahead of the body's middle, as it walks; NaN where the body does not travel
    nearest  (group, distance in m) of the frequent groups that are nearest when both are seen, the nearest first
    """

    height: float
    left: float
    ahead: float
    nearest: tuple[tuple[int, float], ...]


def group_tracklets(clouds: Clouds, rules: JoinRules | None = None) -> MarkerGroups:
    """Join a recording's tracklets (`find_tracklets`) to one group per marker. No model, no label and no first frame is needed.

    Two tracklets that never share a frame can be one marker. Each tracklet's place is modelled as a linear function of the places of its
    near-rigid neighbours, in axes that turn with the body. The Bayesian evidence (normal-inverse-gamma) of one function for both tracklets
    is compared with that of two functions; it accounts for how much a short or a distant tracklet can show.

    The join with the most evidence is made first. The evidence of all pairs that it concerns is then computed again, until no join has
    enough evidence and a clear margin over those that it would exclude. A tracklet without such a join stays a group: a wrong join costs
    a person more than one more name. O(J^2) comparisons for J tracklets.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=60, markers="helen-hayes", seed=0)[0]
    >>> groups = group_tracklets(walk.clouds())
    >>> len(groups)
    15
    """
    rules = rules or JoinRules()
    of_tracklet = find_tracklets(clouds).of_point
    joined = _Joining(_body_frame(clouds, of_tracklet), clouds.rate, rules).run()
    return _numbered(clouds, joined[of_tracklet])


def suggested_names(clouds: Clouds, groups: MarkerGroups, labelling: Labelling) -> dict[int, str]:
    """{group from 0: marker}: what the labels of the same clouds call most of a group's points, each label by its confidence.

    A group of which no marker has half of the points gets no name.
    """
    frame, marker = np.nonzero(labelling.indices != NULL)
    of_group = groups.of_point[clouds.offsets[frame] + labelling.indices[frame, marker]]
    votes = np.zeros((len(groups), len(labelling.names)))
    # labels that somebody knows have no confidence of their own
    np.add.at(votes, (of_group, marker), np.nan_to_num(labelling.confidence[frame, marker], nan=1.0))
    best = votes.argmax(axis=1)
    likely = votes[np.arange(len(groups)), best] > 0.5 * groups.frames
    return {int(group): labelling.names[best[group]] for group in np.nonzero(likely)[0]}


def locate_groups(clouds: Clouds, groups: MarkerGroups, nearest: int = 3) -> list[GroupPlace]:
    """Where each group is on the body, with its `nearest` neighbours. Raises AsterismError where the groups are not of these clouds."""
    _check(groups, clouds)
    body = _body_frame(clouds, groups.of_point)
    seen = ~np.isnan(body[:, :, 0])
    centred = body - _middle(body, seen)[:, None]
    ahead = _direction(body, seen, clouds.rate)
    floor = np.nanmin(body[:, :, 2]) if seen.any() else 0.0
    places = []
    for group in range(len(groups)):
        path = centred[seen[:, group], group]
        distance = np.linalg.norm(body[seen[:, group]] - body[seen[:, group], group][:, None], axis=2)
        both = ~np.isnan(distance)
        median = np.array([np.median(distance[both[:, k], k]) if both[:, k].any() else np.inf for k in range(len(groups))])
        median[group] = np.inf
        median[groups.frequent :] = np.inf
        order = [int(k) for k in np.argsort(median, kind="stable")[:nearest] if np.isfinite(median[k])]
        places.append(
            GroupPlace(
                height=float(np.median(body[seen[:, group], group, 2]) - floor),
                left=float(np.median(path[:, 1] * ahead[0] - path[:, 0] * ahead[1])),
                ahead=float(np.median(path[:, :2] @ ahead)),
                nearest=tuple((k, float(median[k])) for k in order),
            )
        )
    return places


def body_positions(clouds: Clouds, groups: MarkerGroups) -> tuple[Floats, Floats]:
    """Where the groups are on the body: (G, 3) m medians about its middle, z up, in axes that turn with it; and (2,) where it travels.

    The direction is in the same axes, NaN where the body does not travel. Raises AsterismError where the groups are not of these clouds.
    """
    _check(groups, clouds)
    body = _body_frame(clouds, groups.of_point)
    seen = ~np.isnan(body[:, :, 0])
    centred = body - _middle(body, seen)[:, None]
    medians = [np.median(centred[seen[:, group], group], axis=0) for group in range(len(groups))]
    return np.reshape(medians, (-1, 3)), _direction(body, seen, clouds.rate)


def mirrored_groups(positions: Floats, ahead: Floats, pairs: Sequence[tuple[int, int]] = ()) -> dict[int, int]:
    """{group: the one at the same place on the other side of the body}, as far as two groups are each other's nearest there.

    positions  (G, 3) m and ahead (2,) as of `body_positions`
    pairs      (left, right) groups that are known: they say where left is, before the direction of travel does
    """
    if len(positions) < 2:
        return {}
    if pairs:
        left, right = (positions[[pair[side] for pair in pairs]] for side in (0, 1))
        across = (left - right)[:, :2].mean(axis=0)
        middle = 0.5 * (left + right)[:, :2].mean(axis=0)
    else:
        across, middle = np.array([-ahead[1], ahead[0]]), positions[:, :2].mean(axis=0)
    length = float(np.linalg.norm(across))
    # A body that stands says nothing of its sides until a pair is known.
    if not np.isfinite(length) or length == 0.0:
        return {}
    across = across / length
    aside = (positions[:, :2] - middle) @ across
    mirrored = positions.copy()
    mirrored[:, :2] -= 2.0 * aside[:, None] * across
    nearest = np.linalg.norm(mirrored[:, None] - positions, axis=2).argmin(axis=1)
    # A marker on the midline is its own mirror image.
    both = (nearest[nearest] == np.arange(len(positions))) & (aside * aside[nearest] < 0.0)
    return {int(group): int(nearest[group]) for group in np.nonzero(both)[0]}


def name_groups(recording: Recording, groups: MarkerGroups, names: Mapping[int, str], clouds: Clouds | None = None) -> Recording:
    """The recording with names for its groups: {group: marker}. Points of groups without a name become *1, *2, ...

    clouds: the clouds that were grouped, by default `recording.clouds()`. Several groups may have one name where they never share a frame:
    a marker that `group_tracklets` left in pieces. Raises AsterismError where a group does not exist, a name only numbers a point, or two
    groups of one name share a frame.
    """
    clouds = recording.clouds() if clouds is None else clouds
    _check(groups, clouds)
    markers = tuple(dict.fromkeys(names.values()))
    if not markers:
        raise AsterismError("no group has a name; give at least one.")
    indices = np.full((len(clouds), len(markers)), NULL, dtype=np.int64)
    frame_of = clouds.frame_of
    owner = np.full(indices.shape, -1, dtype=np.int64)
    for group, name in names.items():
        if not 0 <= group < len(groups):
            raise AsterismError(f"there is no group {group + 1}; the recording has groups 1 to {len(groups)}.")
        if is_unnamed(name):
            raise AsterismError(f"{name!r} is not a marker's name for group {group + 1}; give one such as LKNE, or leave the group out.")
        marker = markers.index(name)
        points = np.nonzero(groups.of_point == group)[0]
        frames = frame_of[points]
        taken = indices[frames, marker] >= 0
        if taken.any():
            frame = int(frames[np.argmax(taken)])
            raise AsterismError(
                f"groups {owner[frame, marker] + 1} and {group + 1} are both named {name} and both seen in frame {frame}; rename one."
            )
        indices[frames, marker], owner[frames, marker] = points - clouds.offsets[frames], group
    labelling = Labelling(indices, np.where(indices >= 0, 1.0, 0.0), markers)
    return recording.with_labelling(labelling, clouds)


class _Joining:
    """The joins so far: the groups' paths (T, J, 3) m, NaN where not seen, in axes that turn with the body."""

    def __init__(self, body: Floats, rate: float, rules: JoinRules) -> None:
        self.rules = rules
        self.path = body.copy()
        self.seen = ~np.isnan(body[:, :, 0])
        self.group = np.arange(body.shape[1])
        self.alive = self.seen.sum(axis=0) >= max(2, round(rules.min_duration * rate))
        self.step = max(1, round(rules.step * rate))
        count = body.shape[1]
        self.slack = np.full((count, count), np.inf)
        self.evidence = np.full((count, count), -np.inf)

    def run(self) -> Ints:
        """(J,) the group of each tracklet."""
        stale: set[int] = set(np.nonzero(self.alive)[0].tolist())
        for one in sorted(stale):
            self._update_slack(one)
        while True:
            self._update_evidence(stale)
            a, b = self._best()
            if a >= 0:
                self._join(a, b)
                stale = {a}
            elif len(stale) == int(self.alive.sum()):
                return self.group
            else:
                stale = set(np.nonzero(self.alive)[0].tolist())

    def _update_slack(self, a: int) -> None:
        """How far from rigid each other group is with group a (m): the spread of their distance, plus 3 % of the distance itself."""
        distance = np.linalg.norm(self.path - self.path[:, a : a + 1], axis=2)
        both = ~np.isnan(distance)
        number = np.maximum(both.sum(axis=0), 1)
        mean = np.where(both, distance, 0.0).sum(axis=0) / number
        spread = np.sqrt(np.where(both, (distance - mean) ** 2, 0.0).sum(axis=0) / number)
        slack = np.where(self.alive & (both.sum(axis=0) >= 3), spread + 0.03 * mean, np.inf)
        slack[a] = np.inf
        self.slack[a], self.slack[:, a] = slack, slack

    def _update_evidence(self, stale: set[int]) -> None:
        """Compute the evidence again for all pairs with a stale group."""
        alive = np.nonzero(self.alive)[0]
        overlap = self._overlaps()
        for a in alive:
            for b in alive:
                if a < b and (int(a) in stale or int(b) in stale):
                    value = -np.inf if overlap[a, b] else self._evidence(int(a), int(b))
                    self.evidence[a, b] = self.evidence[b, a] = value

    def _overlaps(self) -> Bools:
        """(J, J) whether two groups share a frame; true on the diagonal."""
        seen = self.seen.astype(np.float64)
        return np.asarray(seen.T @ seen > 0)

    def _best(self) -> tuple[int, int]:
        """The join with the most evidence, by a margin over all joins that it would exclude; (-1, -1) where no join has it."""
        overlap = self._overlaps()
        found, best = (-1, -1), self.rules.min_evidence
        for a, b in np.argwhere(np.triu(self.evidence) >= self.rules.min_evidence):
            value = float(self.evidence[a, b])
            rivals = [self.evidence[a, x] for x in np.nonzero(overlap[b])[0] if x != b] + [
                self.evidence[x, b] for x in np.nonzero(overlap[a])[0] if x != a
            ]
            if value >= best and value - max(rivals, default=-np.inf) >= self.rules.min_margin:
                found, best = (int(a), int(b)), value
        return found

    def _join(self, a: int, b: int) -> None:
        self.path[self.seen[:, b], a] = self.path[self.seen[:, b], b]
        self.seen[:, a] |= self.seen[:, b]
        self.path[:, b], self.seen[:, b] = np.nan, False
        self.alive[b] = False
        self.group[self.group == b] = a
        self.slack[b], self.slack[:, b] = np.inf, np.inf
        self.evidence[b], self.evidence[:, b] = -np.inf, -np.inf
        self._update_slack(a)

    def _evidence(self, a: int, b: int) -> float:
        """Evidence (nats) for one marker against two; minus infinity where the groups share fewer than two neighbours."""
        in_a, in_b = self.seen[:, a], self.seen[:, b]
        if in_a.sum() < in_b.sum():
            a, b, in_a, in_b = b, a, in_b, in_a
        rules, chosen = self.rules, list[int]()
        for other in np.argsort(self.slack[a], kind="stable"):
            if other == b or not np.isfinite(self.slack[a, other]) or len(chosen) == rules.max_neighbours:
                continue
            with_a, with_b = in_a & self.seen[:, other], in_b & self.seen[:, other]
            if with_a.sum() >= max(5, rules.min_shared * in_a.sum()) and with_b.sum() >= max(3, rules.min_shared * in_b.sum()):
                in_a, in_b = with_a, with_b
                chosen.append(int(other))
        if len(chosen) < 2:
            return -np.inf
        base, place = self._relative_to(a, chosen, in_a)
        other_base, other_place = self._relative_to(b, chosen, in_b)
        both, both_places = np.concatenate([base, other_base]), np.concatenate([place, other_place])
        middle = both.mean(axis=0)
        separate = self._log_evidence(base - middle, place) + self._log_evidence(other_base - middle, other_place)
        return self._log_evidence(both - middle, both_places) - separate

    def _relative_to(self, group: int, neighbours: list[int], frames: Bools) -> tuple[Floats, Floats]:
        """The other neighbours' and the group's places relative to the first neighbour: (N, 3 (K - 1)) and (N, 3) m, in N of the frames."""
        every = np.nonzero(frames)[0]
        some = every[:: self.step if len(every) > 8 * self.step else max(1, len(every) // 8)]
        origin = self.path[some, neighbours[0]]
        others = self.path[some][:, neighbours[1:]] - origin[:, None]
        return others.reshape(len(some), -1), self.path[some, group] - origin

    def _log_evidence(self, design: Floats, places: Floats) -> float:
        """Log of the marginal likelihood of a Bayesian linear regression of places (N, 3) on an offset and the design (N, D)."""
        rules, shape = self.rules, 3.0
        scale = (shape - 1.0) * rules.noise**2
        design = np.concatenate([np.ones((len(design), 1)), design], axis=1)
        prior = np.full(design.shape[1], (rules.slope / rules.noise) ** 2)
        prior[0] = (rules.offset / rules.noise) ** 2
        root = np.linalg.cholesky(np.diag(1.0 / prior) + design.T @ design)
        explained = np.linalg.solve(root, design.T @ places)
        shape_after = shape + 1.5 * len(places)
        scale_after = scale + 0.5 * ((places**2).sum() - (explained**2).sum())
        return float(
            -3.0 * (np.log(np.diag(root)).sum() + 0.5 * np.log(prior).sum())
            + shape * np.log(scale)
            - shape_after * np.log(scale_after)
            + gammaln(shape_after)
            - gammaln(shape)
            - 1.5 * len(places) * np.log(2 * np.pi)
        )


def _body_frame(clouds: Clouds, of_point: Ints) -> Floats:
    """(T, J, 3) m the paths of J tracklets or groups, NaN where not seen, z up, in axes that turn with the body about the vertical."""
    frame_of = clouds.frame_of
    path = np.full((len(clouds), int(of_point.max(initial=-1)) + 1, 3), np.nan)
    path[frame_of, of_point] = rotate_z_up(clouds.xyz, clouds.vertical)
    turn = _turn(path, clouds.rate)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y = path[:, :, 0].copy(), path[:, :, 1].copy()
    path[:, :, 0], path[:, :, 1] = cos * x + sin * y, cos * y - sin * x
    return path


def _turn(path: Floats, rate: float) -> Floats:
    """(T,) rad, how far the body has turned about the vertical since the first frame: best rotations from frame to frame, smoothed."""
    steps = np.zeros(len(path))
    for t in range(1, len(path)):
        both = ~np.isnan(path[t, :, 0]) & ~np.isnan(path[t - 1, :, 0])
        if both.sum() >= 3:
            before, after = (path[at, both, :2] - path[at, both, :2].mean(axis=0) for at in (t - 1, t))
            steps[t] = np.arctan2((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum(), (before * after).sum())
    if len(path) == 0:
        return steps
    return np.asarray(gaussian_filter1d(np.cumsum(steps), _SMOOTH_SECONDS * rate, mode="nearest"))


def _middle(body: Floats, seen: Bools) -> Floats:
    """(T, 3) m, the median of the points seen, smoothed over a tenth of the recording."""
    some = np.nonzero(seen.any(axis=1))[0]
    if len(some) == 0:
        return np.zeros((len(body), 3))
    middle = np.array([np.median(body[t, seen[t]], axis=0) for t in some])
    every = np.arange(len(body))
    filled = np.stack([np.interp(every, some, middle[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(gaussian_filter1d(filled, max(1.0, 0.1 * len(body)), axis=0, mode="nearest"))


def _direction(body: Floats, seen: Bools, rate: float) -> Floats:
    """(2,) the horizontal unit vector in which the body travels, in its own axes; NaN where it does not."""
    middle = _middle(body, seen)[:, :2]
    if len(middle) < 2:
        return np.full(2, np.nan)
    velocity = np.diff(middle, axis=0).mean(axis=0) * rate
    speed = float(np.linalg.norm(velocity))
    return velocity / speed if speed >= _MIN_SPEED else np.full(2, np.nan)


def _numbered(clouds: Clouds, raw: Ints) -> MarkerGroups:
    """Groups in the order of `MarkerGroups`, from any numbers of them."""
    _, of_point, frames = np.unique(raw, return_inverse=True, return_counts=True)
    of_point = of_point.ravel()
    height = rotate_z_up(clouds.xyz, clouds.vertical)[:, 2]
    order = np.argsort(of_point, kind="stable")
    ends = np.searchsorted(of_point[order], np.arange(len(frames) + 1))
    median = np.array([np.median(height[order[a:b]]) for a, b in pairwise(ends)])
    frequent = frames >= _FREQUENT * len(clouds)
    ranked = np.lexsort((np.where(frequent, -median, -frames), ~frequent)) if len(frames) else np.zeros(0, dtype=np.int64)
    place = np.empty(len(frames), dtype=np.int64)
    place[ranked] = np.arange(len(frames))
    return MarkerGroups(place[of_point].astype(np.int64), frames[ranked].astype(np.int64), int(frequent.sum()))


def _check(groups: MarkerGroups, clouds: Clouds) -> None:
    if len(groups.of_point) != len(clouds.xyz):
        raise AsterismError(f"the groups are of {len(groups.of_point)} points, the clouds have {len(clouds.xyz)}; group these clouds.")
