"""A tube, its joints and a folding of its cloth in; points of its surface out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from asterism.recording import Floats
from asterism.simulation.garment.wearer import Tube

_ELLIPSE_STEPS = 720
_ROUNDING = np.linspace(-1.0, 1.0, 21)


@dataclass(frozen=True)
class Folds:
    """How cloth is wrinkled: waves of its height over the body.

    height       m, of each wave
    shortest, longest  m, wave lengths
    waves        how many, in directions drawn at random
    seed         which ones
    """

    height: float = 0.002
    shortest: float = 0.06
    longest: float = 0.20
    waves: int = 6
    seed: int = 0

    def heights(self, name: str, along: Floats, around: Floats, girth: Floats) -> Floats:
        """The height of the cloth over the body, m, at places along (n, 1) m and around (n, m) m of a tube of this girth (n, 1) m.

        The same piece has the same folds in each frame. Waves close around the tube.
        """
        if self.height <= 0 or self.waves < 1:
            return np.zeros(around.shape)
        rng = np.random.default_rng([self.seed, *name.encode()])
        height = np.zeros(around.shape)
        for _ in range(self.waves):
            length, slant = rng.uniform(self.shortest, self.longest), rng.uniform(-0.5 * np.pi, 0.5 * np.pi)
            # A whole number of waves around the tube closes them.
            turns = np.round(np.sin(slant) * float(girth.mean()) / length)
            phase = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * np.cos(slant) / length * along + 2 * np.pi * turns * around / girth
            height += self.height / np.sqrt(self.waves) * np.sqrt(2.0) * np.sin(phase)
        return height


def girths(tube: Tube, along: Floats) -> tuple[Floats, Floats, Floats]:
    """Half width, half depth and girth (n,) m of a tube at places along its centre line (n,) m."""
    table = np.asarray(tube.sections)
    shape = PchipInterpolator(table[:, 0], table[:, 1:], axis=0)(np.clip(along, table[0, 0], table[-1, 0]))
    wide, deep = shape[:, 0], shape[:, 1]
    return wide, deep, _ellipse_table(wide, deep)[1][:, -1]


def _ellipse_table(wide: Floats, deep: Floats) -> tuple[Floats, Floats]:
    """Angles (steps,) from the front to the front around an ellipse, and the arc length (n, steps) m up to each."""
    angles = np.linspace(0.0, 2 * np.pi, _ELLIPSE_STEPS + 1)
    x, y = deep[:, None] * np.cos(angles), wide[:, None] * np.sin(angles)
    steps = np.hypot(np.diff(x, axis=1), np.diff(y, axis=1))
    return angles, np.concatenate([np.zeros((len(wide), 1)), np.cumsum(steps, axis=1)], axis=1)


def tube_surface(tube: Tube, joints: Mapping[str, Floats], along: Floats, around: Floats, folds: Folds | None = None) -> Floats:
    """Points of a tube's surface: (n, m, 3) m.

    along   (n,) m, along the centre line from its first joint
    around  (n, m) m, around the tube: 0 at the front, growing to the right for whoever looks at it from outside with `along` pointing down,
            as on a printed sheet; at half the girth to both sides is the seam at the back

    The centre line is the polygon of the joints, averaged over `tube.bend` to both sides, so it rounds them; cross sections stand
    at right angles to it and turn with it as little as they can. O(n m).
    """
    wide, deep, girth = girths(tube, along)
    angles, arcs = _ellipse_table(wide, deep)
    at = np.empty(around.shape)
    for i in range(len(along)):
        # Arc length to angle by table: an ellipse has no closed form for it.
        at[i] = np.interp(np.mod(around[i], girth[i]), arcs[i], angles)
    centre, tangent = _centre_line(np.array([joints[name] for name in tube.joints]), along, tube.bend)
    front = _transported(np.asarray(tube.forward, dtype=np.float64), tangent)
    side = np.cross(front, tangent)
    cos, sin = np.cos(at)[..., None], np.sin(at)[..., None]
    points = centre[:, None] + deep[:, None, None] * cos * front[:, None] + wide[:, None, None] * sin * side[:, None]
    if folds is not None and tube.dressed is not None:
        # The normal of an ellipse is not its radius.
        outward = cos * front[:, None] / deep[:, None, None] + sin * side[:, None] / wide[:, None, None]
        outward /= np.linalg.norm(outward, axis=2, keepdims=True)
        points = points + folds.heights(tube.name, along[:, None], around, girth[:, None])[..., None] * outward
    return np.asarray(points)


def _centre_line(joints: Floats, along: Floats, bend: float) -> tuple[Floats, Floats]:
    """Points (n, 3) m and unit tangents (n, 3) of the rounded polygon at places along it."""
    lengths = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    directions = np.diff(joints, axis=0) / lengths[:, None]
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    # a triangular window: the tangent has no jumps
    weights = 1.0 - np.abs(_ROUNDING)
    weights /= weights.sum()
    # The polygon seen through the window: corners become curves.
    places = along[:, None] + bend * _ROUNDING
    segment = np.clip(np.searchsorted(starts, places, side="right") - 1, 0, len(lengths) - 1)
    points = joints[segment] + (places - starts[segment])[..., None] * directions[segment]
    centre = np.einsum("k,nkx->nx", weights, points)
    tangent = np.einsum("k,nkx->nx", weights, directions[segment])
    return centre, tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def _transported(forward: Floats, tangent: Floats) -> Floats:
    """(n, 3) unit vectors at right angles to tangents (n, 3), beginning near `forward`, each turned as little as can be from the last."""
    out = np.empty_like(tangent)
    last = forward
    for i, along in enumerate(tangent):
        # As little turn as can be from ring to ring: a tube must not twist.
        across = last - along * (along @ last)
        length = float(np.linalg.norm(across))
        # A line along the old direction leaves the front open; any direction across will do.
        if length < 1e-6:
            across = np.cross(along, [0.0, 1.0, 0.0])
            length = float(np.linalg.norm(across))
        last = across / length
        out[i] = last
    return out
