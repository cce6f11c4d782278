"""The points of one frame and the shapes of a body in; how well each marker set explains these points, in nats, out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from asterism.recording import Floats, Ints
from asterism.session.worn.shapes import BodyShapes, farthest

_ANKLE_AT_MOST, _FOOT = 0.12, 0.05
"""m: the lowest marker of a body on the floor is at most so high; where it is higher, or below the floor, the body is put with it at this
height. Of a body in the air, or upper bodies alone, the refinement finds the height."""

_THINNEST = 0.05
"""m, thickness of a thing whose markers lie in a plane: twice a marker's height and where it is held."""

_FEWEST = 4
"""Points that hold a body in place."""


@dataclass(frozen=True)
class FitRules:
    """How a frame is held against marker sets. Chosen on recordings of `movement`, by the share of files whose set is found.

    headings  directions in which each posture is tried: every 30 degrees. Not tuned; twice as many take twice as long
    coarse    places of markers by which postures are compared, and points of the frame: enough for each segment to have some. Not tuned
    starts    postures that are refined; `kept` of them are held against each set
    reach     m beyond which a point is on no marker while a posture is sought
    rounds    of refinement
    extra     log density (nats per m3) of a point that is no marker of the set: it may be anywhere about the body, in 6 m3
    missing   log odds of a marker that no point shows: one of 18. These two were fitted with `SetCertainty`, which says how. Half or twice
              `extra` raise the log loss from 0.12 to 0.13 and 0.14, of `missing` to 0.16 and 0.18, with 0 to 2 of 180 sure sets wrong
    astray    share of the markers that lie `far` (m) off: in a posture that virtual people do not know, or placed elsewhere. Without them a
              raised hand costs a marker that is missing and a point that is extra
    behind    nats behind the best set from which a set is not held against further postures
    """

    headings: int = 12
    coarse: tuple[int, int] = (300, 24)
    starts: int = 14
    kept: int = 4
    reach: float = 0.15
    rounds: int = 4
    extra: float = -1.8
    missing: float = -2.9
    astray: float = 0.05
    far: float = 0.08
    behind: float = 60.0


@dataclass(frozen=True)
class FrameFit:
    """How S sets explain the N points of one frame, in the sets' order.

    nats   (S,) log density of the points and of the markers without one, the posture integrated out: differences are log Bayes factors
    given  (S, N) the marker of the set that has each point, -1 for none
    sizes  (S,) markers of the sets
    thing  nats: log density of points anywhere in a box of their size, which are of no body but of a prop, an animal or nothing
    """

    nats: Floats
    given: Ints
    sizes: Ints
    thing: float

    @property
    def better(self) -> float:
        """Nats a point by which the best set explains them better than a box does."""
        return float(self.nats.max() - self.thing) / self.given.shape[1]


def fit_frame(points: Floats, shapes: BodyShapes, rules: FitRules | None = None) -> FrameFit:
    """Hold the points (N, 3) m, z up, against the sets. O(templates headings N + starts sets N^3)."""
    rules = rules or FitRules()
    nats = np.full(len(shapes.columns), -np.inf)
    given = np.full((len(shapes.columns), len(points)), -1, dtype=np.int64)
    for placed, latents in _starts(points, shapes, rules):
        # another posture saves no set that is so far behind
        rejected = nats.max() - rules.behind
        for number, columns in enumerate(shapes.columns.values()):
            if not -np.inf < nats[number] < rejected:
                found, markers = _explained(placed, latents, shapes, columns, rules)
                if found > nats[number]:
                    nats[number], given[number] = found, markers
    sizes = np.array([len(columns) for columns in shapes.columns.values()], dtype=np.int64)
    # all markers missing is the least that can be said of a set
    return FrameFit(np.maximum(nats, rules.extra * len(points) + rules.missing * sizes), given, sizes, as_a_thing(points))


def _starts(points: Floats, shapes: BodyShapes, rules: FitRules) -> list[tuple[Floats, Floats]]:
    """Points in the axes of a body, and its latents, for the postures that explain them best as points on any marker of any of the sets."""
    trees, shifts = _postures(shapes, rules.coarse[0])
    some = points[farthest(points, rules.coarse[1])]
    # the floor may be elsewhere than the file says: the lowest point is a foot's, some centimetres up
    middle = np.array([*np.median(points[:, :2], axis=0), 0.0])
    low = float(np.quantile(points[:, 2], 0.02))
    # an upper body alone is as high as the file says
    lifts = [0.0] if 0.0 < low < _ANKLE_AT_MOST else [_FOOT - low, 0.0]
    angles = np.arange(rules.headings) * (2 * np.pi / rules.headings)
    turns = [(_about_z(angle), np.array([0.0, 0.0, lift])) for lift in lifts for angle in angles]
    stack = np.concatenate([(some - middle) @ turn.T + lift for turn, lift in turns])
    cost = np.empty((len(trees), len(turns)))
    for t, tree in enumerate(trees):
        distance, _ = tree.query(stack, distance_upper_bound=rules.reach)
        cost[t] = np.square(np.minimum(distance, rules.reach)).reshape(len(turns), -1).mean(axis=1)
    refined = []
    for place in np.argsort(cost, axis=None, kind="stable")[: rules.starts]:
        t, h = divmod(int(place), len(turns))
        turn, lift = turns[h]
        refined.append(_refined((points - middle) @ turn.T + lift + shifts[t], shapes.templates[t], shapes, rules))
    refined.sort(key=lambda each: -each[0])
    return [(placed, latents) for _, placed, latents in refined[: rules.kept]]


@lru_cache(maxsize=1)
def _postures(shapes: BodyShapes, places: int) -> tuple[list[cKDTree], Floats]:
    """So many places of each posture from which a fit starts, above the origin; and where it was."""
    chosen = shapes.coarse[:places]
    bodies = shapes.mean[chosen] + np.einsum("uxk,tk->tux", shapes.basis[chosen], shapes.templates, optimize=True)
    shifts = np.median(bodies, axis=1) * (1.0, 1.0, 0.0)
    return [cKDTree(body, balanced_tree=False, compact_nodes=False) for body in bodies - shifts[:, None]], shifts


def _refined(placed: Floats, latents: Floats, shapes: BodyShapes, rules: FitRules) -> tuple[float, Floats, Floats]:
    """Points and latents after rounds in which each point pulls the nearest marker of any set; first the score."""
    places = shapes.coarse
    mean, basis, variance = shapes.mean[places], shapes.basis[places], shapes.variance[places]
    for number in range(rules.rounds):
        distance, nearest = cKDTree(mean + basis @ latents).query(placed)
        near = distance < rules.reach
        if near.sum() < _FEWEST:
            return float("-inf"), placed, latents
        placed = _aligned(placed, placed[near], (mean + basis @ latents)[nearest[near]])
        # at first a point may be some other marker's: its place says little
        noise = variance[nearest[near]] + (rules.far / (2 + 2 * number)) ** 2
        latents, _ = _posterior(placed[near], places[nearest[near]], noise, shapes)
    distance, _ = cKDTree(mean + basis @ latents).query(placed)
    score = -0.5 * float(np.minimum(distance / 0.02, 4.0).__pow__(2).sum()) - 0.5 * float(latents @ latents)
    return score, placed, latents


def _explained(placed: Floats, latents: Floats, shapes: BodyShapes, columns: Ints, rules: FitRules) -> tuple[float, Ints]:
    """The evidence of a set for the points, and the marker (N,) that has each of them, -1 for none."""
    basis, mean, near = shapes.basis[columns], shapes.mean[columns], shapes.variance[columns]
    far = near + rules.far**2
    usual, seldom = math.log1p(-rules.astray) - 1.5 * np.log(2 * np.pi * near), math.log(rules.astray) - 1.5 * np.log(2 * np.pi * far)
    best, given = float("-inf"), np.full(len(placed), -1, dtype=np.int64)
    for _ in range(rules.rounds):
        body = mean + basis @ latents
        squared = ((body[:, None] - placed[None]) ** 2).sum(axis=2)
        as_usual, astray = usual[:, None] - 0.5 * squared / near[:, None], seldom[:, None] - 0.5 * squared / far[:, None]
        # what a marker on this point gains over a marker that is missing and a point that is extra
        gain = np.maximum(as_usual, astray) - rules.extra - rules.missing
        markers, points = linear_sum_assignment(-np.maximum(gain, 0.0))
        taken = gain[markers, points] > 0.0
        markers, points = markers[taken], points[taken]
        if len(points) < _FEWEST:
            break
        placed = _aligned(placed, placed[points], body[markers])
        strays = astray[markers, points] > as_usual[markers, points]
        latents, fitted = _posterior(placed[points], columns[markers], np.where(strays, far[markers], near[markers]), shapes)
        fitted += float(np.where(strays, math.log(rules.astray), math.log1p(-rules.astray)).sum())
        found = fitted + rules.extra * (len(placed) - len(points)) + rules.missing * (len(columns) - len(points))
        if found > best:
            best, given = found, np.full(len(placed), -1, dtype=np.int64)
            given[points] = markers
    return best, given


def as_a_thing(points: Floats) -> float:
    """Log density (nats) of points (N, 3) m that are anywhere in a box of their size."""
    # a box with even density is the square root of 12 standard deviations long
    sides = np.maximum(np.sqrt(12.0 * np.linalg.eigvalsh(np.cov(points.T))), _THINNEST)
    return -len(points) * float(np.log(sides).sum())


def _posterior(points: Floats, columns: Ints, variance: Floats, shapes: BodyShapes) -> tuple[Floats, float]:
    """The mean latents of a body whose markers are at these points, and the log density of the points, the latents integrated out."""
    weight = np.repeat(1.0 / variance, 3)
    basis = shapes.basis[columns].reshape(-1, shapes.basis.shape[2])
    rest = (points - shapes.mean[columns]).reshape(-1)
    scaled = basis * weight[:, None]
    precision = np.eye(basis.shape[1]) + basis.T @ scaled
    pull = scaled.T @ rest
    latents: Floats = np.linalg.solve(precision, pull).astype(np.float64)
    fitted = 0.5 * (pull @ latents - weight @ rest**2) - 0.5 * np.linalg.slogdet(precision)[1]
    return latents, float(fitted + 0.5 * np.log(weight / (2 * np.pi)).sum())


def _aligned(placed: Floats, chosen: Floats, wanted: Floats) -> Floats:
    """All points turned about the vertical and moved so that the chosen ones lie best on what is wanted."""
    a, b = chosen.mean(axis=0), wanted.mean(axis=0)
    u, v = chosen - a, wanted - b
    angle = math.atan2(float((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()), float((u[:, :2] * v[:, :2]).sum()))
    return (placed - a) @ _about_z(angle).T + b


def _about_z(angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
