"""The body of one person: a body model learned from many people and labelled frames of one person in; the model of this person out.

A person's mean body in a key pose is a draw from how people differ, a frame a draw from how one person moves:

    mean body ~ N(mean_k, between_k),     placed frame ~ N(mean body, within_k)

so labelled frames give the mean body's posterior in closed form (a Kalman update), and the person's frames follow N(posterior mean,
within_k + posterior covariance). Frames of other key poses count, too, with more uncertainty: a marker's offset turns with its segment.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import align_about_z
from asterism.labelling.body.model import BodyModel, BodyRules, factors
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class SubjectRules:
    """How a body is learned from one person's frames.

    independent_after s; frames of one person that are at least this far apart count as independent
    pose_variation    how much a person's difference from the mean body varies from key pose to key pose, as a share of `between`
    noise_std         m, standard deviation of a marker in one frame beyond what the adapted model explains
    """

    independent_after: float = 0.2
    pose_variation: float = 1.0
    noise_std: float = 0.004


def shows_enough(frames: Floats) -> NDArray[np.bool_]:
    """Whether each frame (N, M, 3) m, NaN where missing, shows enough markers to place the body: three, and two fifths of all."""
    shown = ~np.isnan(frames[:, :, 0])
    return shown.sum(axis=1) >= max(3, 0.4 * shown.shape[1])


def adapt_body(body: BodyModel, frames: Floats, poses: Ints, weight: Floats, rules: SubjectRules, body_rules: BodyRules) -> BodyModel:
    """The body model of one person, from labelled frames.

    frames (N, M, 3) m, z up, NaN where missing; poses (N,) key pose of each; weight (N,) how many independent frames each counts for.
    O(K^2 M^3 + N M^2).
    """
    steps = adapt_in_steps(body, frames, poses, weight, rules, body_rules, near=False)
    while True:
        try:
            next(steps)
        except StopIteration as done:
            return done.value


def adapt_in_steps(
    body: BodyModel, frames: Floats, poses: Ints, weight: Floats, rules: SubjectRules, body_rules: BodyRules, *, near: bool = True
) -> Generator[None, None, BodyModel]:
    """`adapt_body` in steps of O(M^3) each, for live labelling; the last step returns the body. near: see `factors`."""
    if body.within is None or body.between is None:
        raise ValueError("the body model has no covariance between people; it was trained by an earlier Asterism")
    count = body.mean.shape[1]
    seen = []
    for k in range(len(body.mean)):
        seen.append((yield from _seen(body, k, body.within[k], frames[poses == k], weight[poses == k])))
    means, loads, noises, betweens = [], [], [], []
    for k in range(len(body.mean)):
        centre, spread = np.zeros(3 * count), body.between[k].copy()
        for other, (deviation, shown, share) in enumerate(seen):
            if not shown.any():
                continue
            rows = np.nonzero(np.repeat(shown, 3))[0]
            error = body.within[other][np.ix_(rows, rows)] * np.kron(share[np.ix_(shown, shown)], np.ones((3, 3)))
            if other != k:
                error = error + rules.pose_variation * body.between[k][np.ix_(rows, rows)]
            gain = np.linalg.solve(spread[np.ix_(rows, rows)] + error, spread[rows]).T
            centre = centre + gain @ (deviation[rows] - centre[rows])
            spread = spread - gain @ spread[rows]
            spread = 0.5 * (spread + spread.T)
            yield
        mean = body.mean[k] + centre.reshape(count, 3)
        load, rest = factors(mean, body.within[k] + spread, body_rules, near=near)
        means.append(mean)
        loads.append(load)
        noises.append(rest + rules.noise_std**2 * np.eye(3))
        betweens.append(spread)
        yield
    return BodyModel(np.stack(means), np.stack(loads), np.stack(noises), body.log_weight, body.within, np.stack(betweens))


def _seen(
    body: BodyModel, k: int, within: Floats, frames: Floats, weight: Floats
) -> Generator[None, None, tuple[Floats, np.ndarray, Floats]]:
    """Mean deviation (3M,) of the placed frames from a key pose, which markers were seen (M,), and the variance factor (M, M) of that mean.

    Missing markers are first filled in with what the others let expect, so that every frame is placed by its whole body.
    """
    count = body.mean.shape[1]
    if not len(frames):
        return np.zeros(3 * count), np.zeros(count, dtype=np.bool_), np.zeros((count, count))
    shown = ~np.isnan(frames[:, :, 0])
    precision = np.linalg.inv(body.covariance(k))
    placed = align_about_z(frames, body.mean[k])
    patterns, which = np.unique(shown, axis=0, return_inverse=True)
    by_pattern = np.argsort(which, kind="stable")
    begins = np.searchsorted(which[by_pattern], np.arange(len(patterns) + 1))
    for p, pattern in enumerate(patterns):
        if pattern.all():
            continue
        here, hidden = (np.nonzero(np.repeat(some, 3))[0] for some in (pattern, ~pattern))
        frames_of = by_pattern[begins[p] : begins[p + 1]]
        deviation = (placed[frames_of] - body.mean[k]).reshape(len(frames_of), -1)[:, here]
        # the conditional mean by the precision: a system as large as what is hidden, not as what is seen
        of_hidden = precision[hidden]
        expected = -np.linalg.solve(of_hidden[:, hidden], of_hidden[:, here] @ deviation.T).T
        placed[np.ix_(frames_of, np.nonzero(~pattern)[0])] = expected.reshape(len(frames_of), -1, 3) + body.mean[k][~pattern]
        yield
    placed = align_about_z(placed, body.mean[k])
    weights = weight[:, None] * shown
    total = weights.sum(axis=0)
    seen = total > 0
    deviation = (weights[:, :, None] * (placed - body.mean[k])).sum(axis=0) / np.maximum(total, 1e-12)[:, None]
    share = (weights.T @ shown) / np.maximum(np.outer(total, total), 1e-12)
    # frames that differ less than a person's frames usually do repeat each other: ten seconds of standing say no more than one
    spread = (weights[:, :, None] * (placed - body.mean[k] - deviation) ** 2).sum()
    usual = (total[:, None] * np.diagonal(within).reshape(-1, 3)).sum()
    fewest = 1.0 / max(1.0, float(weight.sum()))
    repeated = max(0.0, 1.0 - spread / usual - fewest) / max(1.0 - fewest, 1e-12)
    # a weighted mean of two covariances is a covariance; their element-wise maximum need not be
    return deviation.ravel(), seen, (1.0 - repeated) * share + repeated
