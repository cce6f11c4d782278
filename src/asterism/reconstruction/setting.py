"""A rig, and what is believed about its images, in; the arrays that the kernels take out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.reconstruction import _kernels
from asterism.recording import Blobs, Floats, Ints

_VIEW_CELLS, _VIEW_ROUNDS = 16, 3


@dataclass(frozen=True)
class Belief:
    """How the images come about.

    noise   (C,) px, standard deviation of a blob's position per axis
    seen    (C,) share of the points in a camera's image that it shows
    strays  (C,) blobs per frame that show no point
    points  points per frame
    space   m3, where they are
    """

    noise: Floats
    seen: Floats
    strays: Floats
    points: float
    space: float


@dataclass(frozen=True)
class Setting:
    """What does not change while beliefs do: the rig, its image borders (2, C, 2) px, the corners (2, 3) m of where points may be, the
    space m3 that two cameras have in view, how many cameras a point needs, and the gate in standard deviations."""

    rig: Rig
    borders: Floats
    corners: Floats
    space: float
    min_cameras: int
    gate: float

    def arrays(self, belief: Belief) -> _kernels.RigArrays:
        """All of it as the kernels take it. Raises AsterismError where all cameras stand in one place."""
        cameras = self.rig.cameras
        lenses = np.zeros((len(cameras), max(len(camera.lens) for camera in cameras)))
        for row, camera in zip(lenses, cameras, strict=True):
            row[: len(camera.lens)] = camera.lens
        positions = np.array([camera.position for camera in cameras])
        area = np.maximum(np.prod(self.borders[1] - self.borders[0], axis=1), 1.0)
        rows = np.column_stack(
            [
                np.array([camera.rotation.ravel() for camera in cameras]),
                np.array([camera.translation for camera in cameras]),
                positions,
                belief.noise,
                np.log(belief.seen * area / (2 * math.pi * belief.noise**2 * belief.strays)),
                np.log(1 - belief.seen),
                self.borders[0],
                self.borders[1],
                lenses,
            ]
        )
        pairs, axes = _pairs(self.rig)
        prior = math.log(belief.points / belief.space) + 1.5 * math.log(2 * math.pi)
        setting = np.array([prior, self.gate, self.min_cameras, *self.corners[0], *self.corners[1]])
        return _kernels.RigArrays(np.ascontiguousarray(rows), setting, pairs, axes)


def image_borders(blobs: Blobs, rig: Rig) -> Floats:
    """(2, C, 2) px, the least and greatest pixel of each image; where its size is not known, of its blobs."""
    camera_of = blobs.camera_of
    borders = np.zeros((2, len(rig), 2))
    for number, camera in enumerate(rig):
        mine = blobs.xy[camera_of == number]
        if camera.size is not None:
            borders[:, number] = [(-0.5, -0.5), (camera.size[0] - 0.5, camera.size[1] - 0.5)]
        elif len(mine):
            borders[:, number] = [mine.min(axis=0), mine.max(axis=0)]
    return borders


def common_view(rig: Rig, borders: Floats, corners: Floats) -> float:
    """m3: how much space two cameras or more have within their borders, looked for on a grid around where all of them look."""
    if np.isfinite(corners).all():
        return float(np.prod(corners[1] - corners[0]))
    places = np.array([camera.position for camera in rig])
    across = np.array([np.eye(3) - np.outer(camera.rotation[2], camera.rotation[2]) for camera in rig])
    aim = np.linalg.lstsq(across.sum(axis=0), np.einsum("cij,cj->i", across, places), rcond=None)[0]
    reach = float(np.median(np.linalg.norm(places - aim, axis=1)))
    low, high = aim - reach, aim + reach
    for _ in range(_VIEW_ROUNDS):
        step = (high - low) / _VIEW_CELLS
        grid = low + step * (np.stack(np.meshgrid(*[np.arange(_VIEW_CELLS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5)
        pixels = rig.project(grid)
        inside = ((pixels >= borders[0][:, None]) & (pixels <= borders[1][:, None])).all(axis=2)
        seen = grid[inside.sum(axis=0) >= 2]
        if not len(seen):
            break
        low, high = seen.min(axis=0) - step, seen.max(axis=0) + step
    return float(max(len(seen), 1) * np.prod(step))


def _pairs(rig: Rig) -> tuple[Ints, Floats]:
    """All camera pairs (K, 2), those that look across each other's view first, and axes (K, 2, 3) across each baseline."""
    looks = np.array([camera.rotation[2] for camera in rig])
    found = []
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            baseline = rig[b].position - rig[a].position
            length = float(np.linalg.norm(baseline))
            if length < 1e-9:
                continue
            along = baseline / length
            middle = looks[a] + looks[b]
            across = middle - along * (middle @ along)
            if np.linalg.norm(across) < 1e-6:
                across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
            across /= np.linalg.norm(across)
            found.append((-float(np.linalg.norm(np.cross(looks[a], looks[b]))), a, b, np.stack([across, np.cross(along, across)])))
    if not found:
        raise AsterismError("all cameras of the rig stand in one place, where no depth can be seen; check the rig's translations.")
    found.sort(key=lambda pair: pair[:3])
    return np.array([pair[1:3] for pair in found], dtype=np.int64), np.array([pair[3] for pair in found])
