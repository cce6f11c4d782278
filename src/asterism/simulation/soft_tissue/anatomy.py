"""Limbs as tapered tubes around a joint: the points on their skin, in metres, the joint at the origin, z up, y along the flexion axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats

REFERENCE_HEIGHT = 1.75


@dataclass(frozen=True)
class LimbSkin:
    """A limb's skin: a tube with an elliptic section.

    begin, end   (x, y, z) m, the ends of its axis in the standing pose; `begin` is the end at the joint to its parent (or to its child,
                 for the limb that has no parent)
    depth, width m, half axes along x and across, at the beginning and at the end
    """

    begin: tuple[float, float, float]
    end: tuple[float, float, float]
    depth: tuple[float, float]
    width: tuple[float, float]


@dataclass(frozen=True)
class SimulatedJoint:
    """A joint of the simulated body.

    parent, child    numbers of limbs
    centre           (x, y, z) m in the standing pose, for REFERENCE_HEIGHT
    flexion_deg      the largest flexion
    other_deg        the largest rotation about the two other axes
    """

    parent: int
    child: int
    centre: tuple[float, float, float]
    flexion_deg: float
    other_deg: tuple[float, float]


@dataclass(frozen=True)
class Anatomy:
    """Limbs, the first of which has no parent, and the joints between them in order from there."""

    limbs: tuple[LimbSkin, ...]
    joints: tuple[SimulatedJoint, ...]


_TORSO_AT_SHOULDER = LimbSkin((0.0, -0.19, 0.06), (0.0, -0.19, -0.42), (0.10, 0.11), (0.17, 0.15))
_ARM = LimbSkin((0.0, 0.0, -0.02), (0.0, 0.0, -0.30), (0.055, 0.042), (0.050, 0.040))
_TORSO_AT_HIP = LimbSkin((0.0, -0.09, 0.04), (0.0, -0.09, 0.52), (0.11, 0.10), (0.17, 0.16))
_THIGH_AT_HIP = LimbSkin((0.0, 0.0, -0.03), (0.0, 0.0, -0.41), (0.088, 0.060), (0.085, 0.056))
_THIGH_AT_KNEE = LimbSkin((0.0, 0.0, 0.01), (0.0, 0.0, 0.40), (0.060, 0.088), (0.056, 0.085))
_SHANK = LimbSkin((0.0, 0.0, -0.01), (0.0, 0.0, -0.39), (0.055, 0.036), (0.050, 0.034))
_SHANK_BELOW = LimbSkin((0.0, 0.0, -0.43), (0.0, 0.0, -0.81), (0.055, 0.036), (0.050, 0.034))

ANATOMIES: dict[str, Anatomy] = {
    "shoulder": Anatomy((_TORSO_AT_SHOULDER, _ARM), (SimulatedJoint(0, 1, (0.0, 0.0, 0.0), 120.0, (25.0, 20.0)),)),
    "knee": Anatomy((_THIGH_AT_KNEE, _SHANK), (SimulatedJoint(0, 1, (0.0, 0.0, 0.0), 110.0, (5.0, 8.0)),)),
    "hip": Anatomy((_TORSO_AT_HIP, _THIGH_AT_HIP), (SimulatedJoint(0, 1, (0.0, 0.0, 0.0), 80.0, (20.0, 12.0)),)),
    "leg": Anatomy(
        (_TORSO_AT_HIP, _THIGH_AT_HIP, _SHANK_BELOW),
        (SimulatedJoint(0, 1, (0.0, 0.0, 0.0), 70.0, (15.0, 10.0)), SimulatedJoint(1, 2, (0.0, 0.0, -0.42), 90.0, (4.0, 6.0))),
    ),
    "rigid": Anatomy((_THIGH_AT_KNEE,), ()),
}
"""Lengths and girths are rounded values of a person of REFERENCE_HEIGHT; the ranges are those of the exercises in GaMoCap, section 4.3."""


@dataclass(frozen=True)
class Skin:
    """Points on limbs in the standing pose.

    places   (N, 3) m; limb_of (N,) int; along (N,) 0 at the limb's beginning, 1 at its end; around (N,) rad; outward (N, 3) unit vectors
    """

    places: Floats
    limb_of: np.ndarray
    along: Floats
    around: Floats
    outward: Floats


def dense_skin(anatomy: Anatomy, points: int, scale: float, rng: np.random.Generator) -> Skin:
    """So many points, spread evenly over the tubes' surfaces with some jitter; `scale` is the stature by REFERENCE_HEIGHT."""
    areas = np.array([_area(tube) for tube in anatomy.limbs])
    # Points by area, so that each limb is as dense; what rounding leaves goes to the first.
    counts = np.floor(points * areas / areas.sum()).astype(int)
    counts[0] += points - counts.sum()
    # The golden angle spreads points without rows.
    golden = np.pi * (3 - np.sqrt(5))
    along = np.concatenate([(np.arange(n) + rng.random(n)) / n for n in counts])
    around = np.concatenate([np.arange(n) * golden + 0.3 * rng.standard_normal(n) for n in counts])
    return _on_tubes(anatomy, np.repeat(np.arange(len(counts)), counts), along, around, scale)


def sparse_skin(anatomy: Anatomy, markers: int, scale: float, rng: np.random.Generator) -> Skin:
    """So many markers on each limb, one in each part of its length, from 8 to 92 %."""
    limbs = len(anatomy.limbs)
    # One marker in each part of the limb: laboratories spread their few markers.
    along = np.concatenate([0.08 + 0.84 * (np.arange(markers) + rng.random(markers)) / markers for _ in range(limbs)])
    around = np.concatenate([2 * np.pi * (rng.permutation(markers) + rng.random(markers)) / markers for _ in range(limbs)])
    return _on_tubes(anatomy, np.repeat(np.arange(limbs), markers), along, around, scale)


def _area(tube: LimbSkin) -> float:
    length = float(np.linalg.norm(np.subtract(tube.end, tube.begin)))
    return length * (sum(tube.depth) + sum(tube.width)) / 2


def _on_tubes(anatomy: Anatomy, limb_of: np.ndarray, along: Floats, around: Floats, scale: float) -> Skin:
    places, outward = np.empty((len(limb_of), 3)), np.zeros((len(limb_of), 3))
    for number, tube in enumerate(anatomy.limbs):
        rows = limb_of == number
        share, angle = along[rows], around[rows]
        depth = tube.depth[0] + share * (tube.depth[1] - tube.depth[0])
        width = tube.width[0] + share * (tube.width[1] - tube.width[0])
        axis = np.asarray(tube.begin) + share[:, None] * np.subtract(tube.end, tube.begin)
        section = np.stack([depth * np.cos(angle), width * np.sin(angle), np.zeros(len(share))], axis=1)
        normal = np.stack([np.cos(angle) / depth, np.sin(angle) / width, np.zeros(len(share))], axis=1)
        places[rows] = scale * (axis + section)
        outward[rows] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return Skin(places, limb_of, along, around, outward)
