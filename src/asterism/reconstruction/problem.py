"""A rig and an observation model in; the arrays that the kernels take out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.reconstruction._input_kernels import RigArrays
from asterism.reconstruction._pack_kernels import MOST_WORK
from asterism.recording import Blobs, Floats, Ints

_VIEW_CELLS, _VIEW_ROUNDS = 16, 3
"""Cells along each side of the grid on which the common view is measured, and how often it is narrowed to the cells that are seen."""
_SAME_POSITION = 1e-9
"""m: cameras nearer to each other than this see no depth together."""


@dataclass(frozen=True)
class ObservationModel:
    """How points and strays become blobs.

    noise             (C,) px, standard deviation of a blob's position per axis
    detection_rate    (C,) share of the points in a camera's image that it shows
    stray_rate        (C,) blobs per frame that show no point
    points_per_frame  mean number of points in a frame
    space             m3, the volume in which they are
    """

    noise: Floats
    detection_rate: Floats
    stray_rate: Floats
    points_per_frame: float
    space: float


@dataclass(frozen=True)
class ReconstructionProblem:
    """What is given, whatever the observation model.

    rig          the cameras, in the order of the blobs' cameras
    bounds       (2, C, 2) px, the least and greatest pixel of each image
    volume       (2, 3) m, the corners of the box in which points may be
    space        m3, how much of it two cameras have in view
    min_cameras  how many cameras must show a point
    gate         standard deviations
    """

    rig: Rig
    bounds: Floats
    volume: Floats
    space: float
    min_cameras: int
    gate: float

    def arrays(self, model: ObservationModel, most_work: float = MOST_WORK) -> RigArrays:
        """Problem and observation model as the kernels take them; most_work: see `pack`. Raises AsterismError where all cameras stand in
        one place."""
        cameras = self.rig.cameras
        lenses = np.zeros((len(cameras), max(len(camera.lens) for camera in cameras)))
        for row, camera in zip(lenses, cameras, strict=True):
            row[: len(camera.lens)] = camera.lens
        positions = np.array([camera.position for camera in cameras])
        area = np.maximum(np.prod(self.bounds[1] - self.bounds[0], axis=1), 1.0)
        rows = np.column_stack(
            [
                np.array([camera.rotation.ravel() for camera in cameras]),
                np.array([camera.translation for camera in cameras]),
                positions,
                model.noise,
                np.log(model.detection_rate * area / (2 * math.pi * model.noise**2 * model.stray_rate)),
                np.log(1 - model.detection_rate),
                self.bounds[0],
                self.bounds[1],
                lenses,
            ]
        )
        pairs, axes = _pairs(self.rig)
        prior = math.log(model.points_per_frame / model.space) + 1.5 * math.log(2 * math.pi)
        limits = np.array([prior, self.gate, self.min_cameras, *self.volume[0], *self.volume[1], most_work])
        return RigArrays(np.ascontiguousarray(rows), limits, pairs, axes)


def image_bounds(blobs: Blobs, rig: Rig) -> Floats:
    """(2, C, 2) px, the least and greatest pixel of each image; where its size is not known, of its blobs."""
    camera_of = blobs.camera_of
    bounds = np.zeros((2, len(rig), 2))
    for number, camera in enumerate(rig):
        xy = blobs.xy[camera_of == number]
        if camera.size is not None:
            bounds[:, number] = [(-0.5, -0.5), (camera.size[0] - 0.5, camera.size[1] - 0.5)]
        elif len(xy):
            bounds[:, number] = [xy.min(axis=0), xy.max(axis=0)]
    return bounds


def common_view(rig: Rig, bounds: Floats, volume: Floats) -> float:
    """How much space (m3) two cameras or more have in their images, measured on a grid around the point nearest to all lines of sight.

    Where the volume (2, 3) m is finite, that volume is taken.
    """
    if np.isfinite(volume).all():
        return float(np.prod(volume[1] - volume[0]))
    positions = np.array([camera.position for camera in rig])
    # The point nearest to all lines of sight, by least squares: what the cameras were aimed at.
    across = np.array([np.eye(3) - np.outer(camera.rotation[2], camera.rotation[2]) for camera in rig])
    aim = np.linalg.lstsq(across.sum(axis=0), np.einsum("cij,cj->i", across, positions), rcond=None)[0]
    reach = float(np.median(np.linalg.norm(positions - aim, axis=1)))
    low, high = aim - reach, aim + reach
    # A coarse grid finds the common view, and the next one is laid closely around it.
    for _ in range(_VIEW_ROUNDS):
        step = (high - low) / _VIEW_CELLS
        grid = low + step * (np.stack(np.meshgrid(*[np.arange(_VIEW_CELLS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5)
        pixels = rig.project(grid)
        inside = ((pixels >= bounds[0][:, None]) & (pixels <= bounds[1][:, None])).all(axis=2)
        seen = grid[inside.sum(axis=0) >= 2]
        if not len(seen):
            break
        low, high = seen.min(axis=0) - step, seen.max(axis=0) + step
    return float(max(len(seen), 1) * np.prod(step))


def _pairs(rig: Rig) -> tuple[Ints, Floats]:
    """All camera pairs (K, 2), by falling angle between the lines of sight, and axes (K, 2, 3) across each baseline."""
    views = np.array([camera.rotation[2] for camera in rig])
    found = []
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            baseline = rig[b].position - rig[a].position
            length = float(np.linalg.norm(baseline))
            if length < _SAME_POSITION:
                continue
            along = baseline / length
            middle = views[a] + views[b]
            # Any two axes across the baseline sort points by epipolar plane; these have the scene in front of them.
            across = middle - along * (middle @ along)
            if np.linalg.norm(across) < 1e-6:
                across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
            across /= np.linalg.norm(across)
            found.append((-float(np.linalg.norm(np.cross(views[a], views[b]))), a, b, np.stack([across, np.cross(along, across)])))
    if not found:
        raise AsterismError("all cameras of the rig stand in one place and see no depth; check the rig's translations.")
    # Lines of sight at right angles tell depth best, so such pairs propose points first.
    found.sort(key=lambda pair: pair[:3])
    return np.array([pair[1:3] for pair in found], dtype=np.int64), np.array([pair[3] for pair in found])
