"""The body as a whole: labelled frames in; a Gaussian mixture of key poses, sizes and marker placements out.

A frame's labelled points, once the body is turned about the vertical and shifted onto a key pose's mean body, are modelled as

    y_m = mean_m + load_m u + noise_m,     u ~ N(0, I),  noise_m ~ N(0, S_m)

with latent directions u: the main directions in which the bodies of the training set differ there (pose and person together), a change of
size, and small moves of the whole body (shift, turn) that the first rough placing leaves over. Given any labelled subset, every other
marker's place follows in closed form with its covariance, and so does the density of a whole labelling. This is what single distances and
heights lack: the whole pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2

from asterism.geometry import align_about_z
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.recording import Floats, Ints

MOVES = 4
"""Latent directions, the last ones, that are small moves of the whole body: three shifts, and a turn about the vertical."""


@dataclass(frozen=True)
class BodyRules:
    """How a body model is learned. Chosen on the gait subjects, each left out in turn (docs/labelling.md).

    poses           key poses at most; fewer where there are not `frames_per_pose` frames for each
    frames_per_pose training frames that a key pose needs
    latents         directions in which pose and person vary within a key pose: one for each marker, but this many at most. Virtual people
                    on seven sets of 39 to 73 markers, `movement`: with 16, 24, 32 and 48, 86, 89, 93 and 93 % of the labels are right, and
                    61, 73, 83 and 85 % sure; with 24 and 48 some sure ones are wrong. A foot moves little, but all its markers together:
                    what the directions leave out counts as each marker's own, so that near ones seem
                    exchangeable
    least_latents   and not fewer than this, with which 15 markers do as well as with all 45
    size_std        how much bodies differ in size beyond the people of the training set, as a share of the size
    placement_std   how far a marker sits from where the model expects it, beyond what was seen (m)
    few_std         the same beyond that, where one person was seen (m); falls with the number of people
    person_extra    the covariance of people's mean bodies counts (1 + person_extra / people) times: few people vary too little
    other_std       how far one person's frames move beyond what one other person's did (m); falls with the root of the number of people
    human           m, root mean square from the body's middle: smaller bodies, such as a mouse's, get that much smaller lengths above
    shift_std       first placing of the body, error of the position (m)
    turn_std        first placing of the body, error of the heading (rad)
    """

    poses: int = 4
    frames_per_pose: int = 300
    latents: int = 32
    least_latents: int = 16
    size_std: float = 0.06
    placement_std: float = 0.012
    few_std: float = 0.06
    person_extra: float = 2.0
    other_std: float = 0.025
    human: float = 0.25
    shift_std: float = 0.1
    turn_std: float = 0.3


@dataclass(frozen=True)
class BodyModel:
    """K key poses of M markers with r latents.

    mean        (K, M, 3) m
    load        (K, M, 3, r) m per latent
    noise       (K, M, 3, 3) m2
    log_weight  (K,) log share of the training frames
    within      (K, 3M, 3M) m2, covariance of the placed body of one unknown person within a key pose; None in models of format 1
    between     (K, 3M, 3M) m2, how people's mean bodies differ, placement of the markers included; None in models of format 1
    """

    mean: Floats
    load: Floats
    noise: Floats
    log_weight: Floats
    within: Floats | None = None
    between: Floats | None = None

    def to_arrays(self) -> dict[str, Floats]:
        """The fields that are not None, by name: `BodyModel(**arrays)` is the model again."""
        return {name: array for name, array in vars(self).items() if array is not None}

    def arrays(self) -> BodyArrays:
        """The model as the kernels read it."""
        lower = np.linalg.cholesky(self.noise)
        whiten = np.linalg.inv(lower)
        load = whiten @ self.load
        gram = gram_of(load)
        log_scale = -np.log(np.diagonal(lower, axis1=2, axis2=3)).sum(axis=2)
        full = np.eye(load.shape[3]).ravel() + gram.sum(axis=1)
        by_latent = np.ascontiguousarray(load.transpose(0, 3, 2, 1)).reshape(len(load), load.shape[3], -1)
        return BodyArrays(self.mean, whiten, load, by_latent, gram, full, lower, log_scale, self.log_weight)

    def covariance(self, pose: int) -> Floats:
        """(3M, 3M) m2, of the placed body in one key pose."""
        flat = self.load[pose].reshape(-1, self.load.shape[3])
        full = flat @ flat.T
        for m, block in enumerate(self.noise[pose]):
            full[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] += block
        return full


def gram_of(load: Floats) -> Floats:
    """`BodyArrays.gram` of loads (K, M, 3, r): (K, M, r r). O(K M r^2), nine tenths of the memory of a body."""
    return np.asarray(load.swapaxes(2, 3) @ load).reshape(*load.shape[:2], -1)


def fit_body(frames: Floats, people: Ints, rules: BodyRules, seed: int, weights: Floats | None = None) -> BodyModel:
    """Learn a body model from labelled frames.

    frames (N, M, 3) m, z up, NaN where missing, every marker shown somewhere; people (N,) whose frame it is, from 0; weights (P,) how much
    each person counts, all alike by default. O(N M^2 + M^3) per key pose.
    """
    weights = np.ones(int(people.max()) + 1) if weights is None else weights
    mean = frames[np.argmax((~np.isnan(frames[:, :, 0])).sum(axis=1))]
    for _ in range(12):
        placed = align_about_z(frames, mean)
        mean = _mean_over_people(placed, people, weights)
    placed = _fill(placed, mean)
    pose_of = _key_poses(placed - placed.mean(axis=1, keepdims=True), people, rules, seed)
    poses = []
    for k in range(pose_of.max() + 1):
        in_pose = pose_of == k
        centre = _mean_over_people(placed[in_pose], people[in_pose], weights)
        filled = _fill(align_about_z(frames[in_pose], centre), centre)
        poses.append((*_pose(filled, people[in_pose], rules, weights), np.log(in_pose.mean())))
    means, loads, noises, within, between, shares = zip(*poses, strict=True)
    return BodyModel(np.stack(means), np.stack(loads), np.stack(noises), np.array(shares), np.stack(within), np.stack(between))


def _mean_over_people(frames: Floats, people: Ints, weights: Floats) -> Floats:
    """The weighted mean of the people's mean bodies: (M, 3), NaN for a marker that no frame shows."""
    sums, counts = np.zeros(frames.shape[1:]), np.zeros((frames.shape[1], 1))
    for person in np.unique(people):
        own = frames[people == person]
        shown = ~np.isnan(own[:, :, :1])
        count = shown.sum(axis=0)
        sums += weights[person] * np.where(count > 0, np.where(shown, own, 0.0).sum(axis=0) / np.maximum(count, 1), 0.0)
        counts += weights[person] * (count > 0)
    return np.where(counts > 0, sums / np.where(counts > 0, counts, 1.0), np.nan)


def _fill(placed: Floats, mean: Floats) -> Floats:
    """Missing samples replaced by their conditional means, given the visible ones of the same frame (three rounds)."""
    missing = np.isnan(placed[:, :, 0])
    if not missing.any():
        return placed
    deviation = np.where(np.isnan(placed), 0.0, placed - mean).reshape(len(placed), -1)
    patterns, which = np.unique(missing, axis=0, return_inverse=True)
    for _ in range(3):
        covariance = deviation.T @ deviation / len(deviation) + 1e-4 * np.eye(deviation.shape[1])
        for p, pattern in enumerate(patterns):
            hidden = np.repeat(pattern, 3)
            if hidden.any() and not hidden.all():
                rows = np.nonzero(which == p)[0]
                gain = np.linalg.solve(covariance[np.ix_(~hidden, ~hidden)], covariance[np.ix_(~hidden, hidden)])
                deviation[np.ix_(rows, np.nonzero(hidden)[0])] = deviation[np.ix_(rows, np.nonzero(~hidden)[0])] @ gain
    return deviation.reshape(placed.shape) + mean


def _key_poses(centred: Floats, people: Ints, rules: BodyRules, seed: int) -> Ints:
    """Which key pose each frame belongs to: k-means of the bodies brought to one size, (N,)."""
    count = int(np.clip(len(centred) // rules.frames_per_pose, 1, rules.poses))
    if count == 1:
        return np.zeros(len(centred), dtype=np.int64)
    scaled = centred.reshape(len(centred), -1).copy()
    for person in np.unique(people):
        scaled[people == person] /= np.sqrt((scaled[people == person] ** 2).sum(axis=1).mean())
    _, pose_of = kmeans2(scaled, count, minit="++", rng=np.random.default_rng(seed))
    sizes = np.bincount(pose_of, minlength=count)
    kept = np.nonzero(sizes >= rules.frames_per_pose // 4)[0]
    centres = np.stack([scaled[pose_of == k].mean(axis=0) for k in kept])
    return np.argmin(((scaled[:, None] - centres[None]) ** 2).sum(axis=2), axis=1)


def _pose(placed: Floats, people: Ints, rules: BodyRules, weights: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Mean (M, 3), load (M, 3, r), noise (M, 3, 3), within and between (3M, 3M) of one key pose."""
    markers = placed.shape[1]
    shown = np.unique(people)
    groups = [placed[people == person].reshape(-1, 3 * markers) for person in shown]
    means = np.stack([group.mean(axis=0) for group in groups])
    share = weights[shown] * len(groups) / weights[shown].sum()
    centre = (share[:, None] * means).mean(axis=0)
    within = np.zeros((3 * markers, 3 * markers))
    for group, of_all in zip(groups, share, strict=True):
        within += of_all * ((group - centre).T @ (group - centre) / len(group))
    apart_of = (means - centre).T @ (share[:, None] * (means - centre)) / len(groups)
    within = within / len(groups) - apart_of
    between = apart_of * (1.0 + rules.person_extra / len(groups))
    mean = centre.reshape(markers, 3)
    apart = mean - mean.mean(axis=0)
    scale = length_scale(mean, rules)
    placement, few, other = scale * rules.placement_std, scale * rules.few_std, scale * rules.other_std
    size = apart.ravel() * rules.size_std
    between += np.outer(size, size) + (few / len(groups)) ** 2 * np.eye(3 * markers)
    load, noise = factors(mean, within + between, rules)
    noise += placement**2 * np.eye(3)
    within = within + other**2 / len(groups) * np.eye(3 * markers)
    return mean, load, noise, within, between + placement**2 * np.eye(3 * markers)


def length_scale(mean: Floats, rules: BodyRules) -> float:
    """The factor for lengths that were chosen on people, for a body (M, 3) m: 1, or less for a smaller body."""
    apart = mean - mean.mean(axis=0)
    return min(1.0, float(np.sqrt((apart**2).sum(axis=1).mean())) / rules.human)


def factors(mean: Floats, covariance: Floats, rules: BodyRules, *, near: bool = False) -> tuple[Floats, Floats]:
    """Latent directions (M, 3, r) of a placed body's covariance (3M, 3M), small moves included, and what they leave over: (M, 3, 3).

    near: find the main directions by a few power steps in O(M^2 r), for live labelling; what these miss goes to the second part.
    """
    markers = len(mean)
    count = min(rules.latents, max(rules.least_latents, markers))
    if near:
        start = np.unique(np.linspace(0, len(covariance) - 1, count).astype(np.int64))
        basis = np.linalg.qr(covariance[:, start])[0]
        for _ in range(4):
            basis = np.linalg.qr(covariance @ basis)[0]
        values, vectors = np.linalg.eigh(basis.T @ covariance @ basis)
        vectors = basis @ vectors
    else:
        values, vectors = np.linalg.eigh(covariance)
    main = vectors[:, ::-1][:, :count] * np.sqrt(np.maximum(values[::-1][:count], 0.0))
    rest = covariance - main @ main.T
    noise = np.stack([rest[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] for m in range(markers)])
    moves = np.zeros((markers, 3, MOVES))
    moves[:, :, :3] = rules.shift_std * np.eye(3)
    moves[:, 0, 3], moves[:, 1, 3] = -rules.turn_std * mean[:, 1], rules.turn_std * mean[:, 0]
    return np.concatenate([main.reshape(markers, 3, -1), moves], axis=2), noise


def distance_variance(mean: Floats, covariance: Floats) -> Floats:
    """How much the distance of each two markers varies in each key pose: (K, M, M) m2.

    mean (K, M, 3) m; covariance (K, 3M, 3M) m2, of their places; as far as it is along the line between two.
    """
    poses, markers = mean.shape[:2]
    blocks = covariance.reshape(poses, markers, 3, markers, 3).transpose(0, 1, 3, 2, 4)
    own = blocks[:, np.arange(markers), np.arange(markers)]
    of_difference = own[:, :, None] + own[:, None] - blocks - blocks.transpose(0, 2, 1, 3, 4)
    away = mean[:, :, None] - mean[:, None]
    along = away / np.maximum(np.linalg.norm(away, axis=3, keepdims=True), 1e-9)
    return np.asarray(np.maximum(np.einsum("kija,kijab,kijb->kij", along, of_difference, along), 0.0))


def subsample(people: Ints, per_person: int) -> Ints:
    """Rows of at most `per_person` frames of each person, evenly spread."""
    rows = [np.nonzero(people == person)[0] for person in np.unique(people)]
    return np.sort(np.concatenate([row[np.unique(np.linspace(0, len(row) - 1, min(per_person, len(row))).astype(int))] for row in rows]))


def names_of(people: Sequence[str]) -> tuple[tuple[str, ...], Ints]:
    """The different names in order of appearance, and each one's number."""
    order = tuple(dict.fromkeys(people))
    return order, np.array([order.index(person) for person in people], dtype=np.int64)
