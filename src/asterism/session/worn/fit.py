"""The points of one frame and the shapes of a body in; how well each marker set explains these points, in nats, out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.special import gammaln

from asterism.recording import Floats, Ints
from asterism.session.worn.shapes import BodyShapes

_ORDERS = 0.5
"""Share that counts of the freedom of extra points. With 1, a foot alone explains 64 points best; with 0, the largest set does."""


@dataclass(frozen=True)
class FitRules:
    """How a frame is held against marker sets. All chosen on recordings of `movement`, by the share of files whose set is found.

    headings   directions in which each posture is tried. 24 find no more, 8 lose turned bodies
    starts     postures that are refined: the best of different headings and shapes
    reach      m beyond which a point is on no marker while a posture is sought
    rounds     of refinement
    extra      log density (nats per m3) of a point that is no marker of the set, beside what their number costs: the skin of a body has a
               room of 0.1 m3, which is 2.3. Half and twice that room move sets with more markers by 0.7 nats a point
    missing    log odds against a marker of the set that no point shows: 0.05 of the markers are out of view
    noise      m, standard deviation of a point's place besides, while few points hold the body
    """

    headings: int = 12
    starts: int = 6
    reach: float = 0.15
    rounds: int = 4
    extra: float = 2.3
    missing: float = -3.0
    noise: float = 0.01


@dataclass(frozen=True)
class FrameFit:
    """How the sets explain one frame: by the name of the set.

    evidence  nats: of sets, the difference of two is the log odds of the one against the other
    matched   markers that have a point
    mirrored  nats: the same of the mirrored points, under the best set; what exceeds the best evidence speaks for a mirrored recording
    """

    evidence: dict[str, float]
    matched: dict[str, int]
    mirrored: float = float("-inf")


def fit_frame(points: Floats, shapes: BodyShapes, rules: FitRules | None = None, sets: Sequence[str] | None = None) -> FrameFit:
    """Hold the points (N, 3) m, z up, against the sets. O(templates headings N + starts sets N^3)."""
    rules = rules or FitRules()
    names = list(shapes.columns) if sets is None else list(sets)
    evidence, matched = dict.fromkeys(names, float("-inf")), dict.fromkeys(names, 0)
    for placed, latents in _starts(points, shapes, rules, names):
        for name in names:
            found, count = _explained(placed, latents, shapes, shapes.columns[name], rules)
            if found > evidence[name]:
                evidence[name], matched[name] = found, count
    return FrameFit(evidence, matched)


def _starts(points: Floats, shapes: BodyShapes, rules: FitRules, names: Sequence[str]) -> list[tuple[Floats, Floats]]:
    """Points in the axes of a body, and its latents, for the postures that explain them best as points on any marker of any of the sets."""
    some = np.unique(np.concatenate([shapes.columns[name] for name in names]))
    bodies = shapes.bodies(shapes.templates)[:, some]
    # the floor may be elsewhere than the file says: the lowest point is a foot's, some centimetres up
    middle = np.array([*np.median(points[:, :2], axis=0), 0.0])
    low = float(np.quantile(points[:, 2], 0.02))
    lifts = [0.0] if 0.0 < low < 0.12 else [0.05 - low, 0.0]
    turned = []
    for lift in lifts:
        for angle in np.arange(rules.headings) * (2 * np.pi / rules.headings):
            turned.append((points - middle) @ _about_z(angle).T + (0.0, 0.0, lift))
    stack = np.stack(turned)
    cost = np.empty((len(bodies), len(stack)))
    for t, body in enumerate(bodies):
        shift = np.array([*np.median(body[:, :2], axis=0), 0.0])
        distance, _ = cKDTree(body - shift).query((stack).reshape(-1, 3), distance_upper_bound=rules.reach)
        cost[t] = np.minimum(distance.reshape(len(stack), -1), rules.reach).__pow__(2).mean(axis=1)
    order = np.argsort(cost, axis=None)[: 4 * rules.starts]
    refined = []
    for t, h in zip(*np.unravel_index(order, cost.shape), strict=True):
        shift = np.array([*np.median(bodies[t][:, :2], axis=0), 0.0])
        placed, latents = stack[h] + shift, shapes.templates[t]
        refined.append(_refined(placed, latents, shapes, some, rules))
    refined.sort(key=lambda each: -each[0])
    return [(placed, latents) for _, placed, latents in refined[: rules.starts]]


def _refined(placed: Floats, latents: Floats, shapes: BodyShapes, some: Ints, rules: FitRules) -> tuple[float, Floats, Floats]:
    """Points and latents after rounds in which each point pulls the nearest marker of any set; first the score."""
    score = float("-inf")
    for number in range(rules.rounds):
        body = shapes.mean[some] + shapes.basis[some] @ latents
        distance, nearest = cKDTree(body).query(placed)
        reach = rules.reach / (1.0 + number / 2)
        near = distance < reach
        if near.sum() < 4:
            return float("-inf"), placed, latents
        placed = _aligned(placed, body[nearest], near)
        noise = shapes.variance[some][nearest[near]] + (0.03 / (1 + number)) ** 2
        latents, _ = _posterior(placed[near], some[nearest[near]], noise, shapes)
    body = shapes.mean[some] + shapes.basis[some] @ latents
    distance, _ = cKDTree(body).query(placed)
    score = -float(np.minimum(distance / 0.03, 3.0).__pow__(2).sum()) - 0.5 * float(latents @ latents)
    return score, placed, latents


def _explained(placed: Floats, latents: Floats, shapes: BodyShapes, columns: Ints, rules: FitRules) -> tuple[float, int]:
    """The evidence of a set for the points, and how many of its markers have one."""
    basis, mean, variance = shapes.basis[columns], shapes.mean[columns], shapes.variance[columns] + rules.noise**2
    best, count, extras = float("-inf"), 0, max(1, len(placed) - len(columns))
    for _ in range(rules.rounds):
        body = mean + basis @ latents
        squared = ((body[:, None] - placed[None]) ** 2).sum(axis=2)
        # what a marker on this point gains over a marker that is missing and a point that is extra
        another = rules.extra + _ORDERS * np.log(max(1.0, extras))
        gain = -0.5 * squared / variance[:, None] - 1.5 * np.log(2 * np.pi * variance)[:, None] - another - rules.missing
        markers, points = linear_sum_assignment(-np.maximum(gain, 0.0))
        taken = gain[markers, points] > 0.0
        markers, points = markers[taken], points[taken]
        if len(points) < 4:
            break
        placed = _aligned(placed, body[markers], None, points)
        latents, fitted = _posterior(placed[points], columns[markers], variance[markers], shapes)
        extras = len(placed) - len(points)
        found = fitted + rules.extra * extras + _number_of_extras(extras) + rules.missing * (len(columns) - len(points))
        if found > best:
            best, count = found, len(points)
    return best, count


def _number_of_extras(extras: int) -> float:
    """Nats of a set of so many points in any order that are no markers: files without any are half, and many are as likely as few."""
    # n points of one kind have n! orders, of which the density of a set is the sum; extra points come in patterns, so that half counts
    return math.log(0.5) if not extras else _ORDERS * float(gammaln(extras + 1)) - 2.0 * math.log(extras + 1) + math.log(0.5 / 0.645)


def _posterior(points: Floats, columns: Ints, variance: Floats, shapes: BodyShapes) -> tuple[Floats, float]:
    """The mean latents of a body whose markers are at these points, and the log density of the points, the latents integrated out."""
    weight = np.repeat(1.0 / variance, 3)
    basis = shapes.basis[columns].reshape(-1, shapes.basis.shape[2])
    rest = (points - shapes.mean[columns]).reshape(-1)
    scaled = basis * weight[:, None]
    precision = np.eye(basis.shape[1]) + basis.T @ scaled
    pull = scaled.T @ rest
    latents = np.linalg.solve(precision, pull)
    fitted = 0.5 * (pull @ latents - weight @ rest**2) - 0.5 * np.linalg.slogdet(precision)[1]
    return latents, float(fitted + 0.5 * np.log(weight / (2 * np.pi)).sum())


def _aligned(placed: Floats, wanted: Floats, near: Floats | None, points: Ints | None = None) -> Floats:
    """All points turned about the vertical and moved so that these lie best on what is wanted."""
    chosen = placed[near] if points is None else placed[points]
    target = wanted[near] if points is None else wanted
    a, b = chosen.mean(axis=0), target.mean(axis=0)
    u, v = chosen - a, target - b
    angle = np.arctan2((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum(), (u[:, :2] * v[:, :2]).sum())
    return (placed - a) @ _about_z(angle).T + b


def _about_z(angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
