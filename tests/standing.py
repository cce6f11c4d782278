"""People who stand with their feet apart, as no simulated walker does: whose whole body models of walkers used to label turned round."""

from __future__ import annotations

import numpy as np

from asterism.recording import Clouds, Floats, MarkerSet
from asterism.simulation.body import markers_of, random_body
from asterism.simulation.gait import pose, random_style

MARKER_SET = MarkerSet.load("helen-hayes")


def standing_body(seed: int) -> Floats:
    """One person (M, 3) m, z up, of a height from a child's to a tall adult's, with the feet up to half a metre apart and turned out."""
    rng = np.random.default_rng([seed, 33])
    body = random_body(rng, float(rng.uniform(1.2, 1.95)), markers_of(MARKER_SET))
    style = random_style(rng, body, 0.0)
    # still: each joint is where its curve has its mean; but the legs are straight and the feet flat, and apart
    for name, degrees in {"hip": rng.normal(3.0, 4.0), "knee": rng.uniform(0.0, 8.0), "foot": 0.0}.items():
        style.series[name][:] = 0.0
        style.series[name][0] = np.radians(degrees)
    style = type(style)(style.series, rng.uniform(0.2, 0.5) * body.size, np.radians(rng.uniform(0.0, 35.0)), 0.0, style.lean, 0.0)
    segments = pose(body, style, np.zeros(1), (np.zeros(1), np.zeros(1))).segments
    at = [segments[name][0][0] @ place + segments[name][1][0] for name, place in zip(body.segments, body.places, strict=True)]
    turn = rng.uniform(-np.pi, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    person = np.array(at) @ rotation.T
    return np.asarray(person - [0.0, 0.0, person[:, 2].min() - 0.03])


def standing_clouds(seed: int, frames: int = 40) -> tuple[Clouds, np.ndarray]:
    """The person as points without names, half a millimetre of noise; and the marker of each point of each frame (T, M)."""
    rng, body = np.random.default_rng([seed, 34]), standing_body(seed)
    order = np.array([rng.permutation(len(body)) for _ in range(frames)])
    points = [body[own] + rng.normal(0.0, 0.0005, body.shape) for own in order]
    return Clouds.from_points(points, rate=100.0, vertical="z"), order
