"""A body model and a random generator in; another person with such a body who moves everything, and the capsules that hide, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.recording import Floats, Recording
from asterism.simulation.cameras import Capsules
from asterism.skeleton.body import ArticulatedBody, as_point
from asterism.skeleton.posing import posed_points

_FREE_ARMS = ("upper arm raising", "upper arm abduction", "forearm flexion")
_FREE_DEGREES = {"upper arm raising": (0.0, 110.0), "upper arm abduction": (0.0, 60.0), "forearm flexion": (5.0, 80.0)}
"""Degrees that the arms sweep besides what the body's own hinges do."""


def simulate_motion(
    body: ArticulatedBody, frames: int = 180, rate: float = 60.0, *, rng: np.random.Generator, offsets: float = 1.0
) -> tuple[Recording, Capsules]:
    """A person of another size, with other marker places, who steps, bends, turns around and raises the arms within 0.4 m of the origin.

    offsets  standard deviation of each marker's place per axis, as a multiple of the spread that the body states for it;
             sizes differ by 7 %, and each direction by 3 %

    Angles are sums of three sines of 0.1 to 0.8 Hz around the hinges' usual angles. Returns the recording (z up, the lowest marker at its
    rest height) and the body's capsules in each frame. The same arguments and generator give the same motion.
    """
    size = float(np.clip(rng.normal(1.0, 0.07), 0.8, 1.25))
    # Another person: of another size, and a little longer or wider than the model.
    scales = size * np.clip(rng.normal(1.0, 0.03, 3), 0.9, 1.1)
    person = replace(
        body,
        markers=tuple(
            replace(marker, place=as_point(np.array(marker.place) + offsets * marker.spread * np.clip(rng.normal(0.0, 1.0, 3), -2.5, 2.5)))
            for marker in body.markers
        ),
    )
    time = np.arange(frames) / rate
    hinges = body.hinges
    # Around the usual pose, as far as the hinge allows.
    angles = np.stack([np.clip(h.usual + _swinging(time, rng) * h.spread, h.low, h.high) for h in hinges], axis=1)
    for j, hinge in enumerate(hinges):
        plain = hinge.name.partition(" ")[2]
        # Arms sweep farther than in walking: they are what hides markers.
        if plain in _FREE_ARMS:
            low, high = np.radians(_FREE_DEGREES[plain])
            angles[:, j] = np.clip(low + (high - low) * (0.5 + 0.5 * _swinging(time, rng)).clip(0.0, 1.0), hinge.low, hinge.high)
    heading = rng.uniform(-np.pi, np.pi) + 0.8 * _swinging(time, rng)
    walk = np.stack([0.3 * _swinging(time, rng), 0.3 * _swinging(time, rng)], axis=1)
    # The lowest marker keeps its height: whoever bends does not float.
    lowest = float(person.places[:, 2].min()) * scales[2]
    points, starts, ends = [], [], []
    for t in range(frames):
        cos, sin = np.cos(heading[t]), np.sin(heading[t])
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        pose = np.concatenate([scales, walk[t], [0.0], np.zeros(3), angles[t]])
        shown, begin, end = posed_points(person, pose, turn)
        up = np.array([0.0, 0.0, lowest - shown[:, 2].min()])
        points.append(shown + up)
        starts.append(begin + up)
        ends.append(end + up)
    radii = float(scales.mean()) * person.arrays.radii.mean(axis=1)
    capsules = Capsules(np.array(starts), np.array(ends), radii, tuple(part.name for part in person.capsules))
    facts = {"file": "simulated motion", "format": "simulated", "units": "m"}
    return Recording(np.array(points), body.labels, rate, metadata=facts), capsules


def _swinging(time: Floats, rng: np.random.Generator) -> Floats:
    """(T,) a smooth curve of standard deviation near 1."""
    frequency, phase, share = rng.uniform(0.1, 0.8, 3), rng.uniform(0, 2 * np.pi, 3), rng.dirichlet(np.ones(3))
    curve: Floats = np.sqrt(2.0) * (np.sqrt(share) * np.sin(2 * np.pi * frequency * time[:, None] + phase)).sum(axis=1)
    return curve
