"""A printed sheet and a rig in; the sheet waved before the cameras, as a scene that can be photographed, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.garment.pattern import Pattern
from asterism.geometry import rotation_from_vector
from asterism.recording import Floats
from asterism.simulation.garment.suit import Mesh, grid_triangles

_FINER = 4
"""Vertices of the mesh per pitch: a lens' distortion is linear within a triangle of 17 mm to 0.002 px."""


@dataclass(frozen=True)
class WavedTarget:
    """A flat sheet in a few poses; its time is the number of the pose.

    pattern      what is printed on it, in one piece
    rotations    (T, 3, 3), translations (T, 3) m: world from sheet
    """

    pattern: Pattern
    rotations: Floats
    translations: Floats

    def __len__(self) -> int:
        return len(self.rotations)

    def circles(self, time: float) -> Floats:
        """Where the middle of each circle is: (rows, cols, 3) m, NaN outside the mask."""
        return np.asarray(self.pattern.positions() @ self.rotations[int(time)].T + self.translations[int(time)])

    def mesh(self, time: float) -> Mesh:
        """The sheet, half a pitch larger than its print."""
        rows, cols = self.pattern.shape
        row, column = (np.linspace(-0.5, n - 0.5, _FINER * n + 1) for n in (rows, cols))
        sheet = np.stack(np.meshgrid(row, column, indexing="ij"), axis=-1)
        flat = np.stack([sheet[..., 1] * self.pattern.pitch, sheet[..., 0] * self.pattern.pitch, np.zeros(sheet.shape[:2])], axis=-1)
        turn = self.rotations[int(time)]
        triangles = grid_triangles(*sheet.shape[:2])
        vertices = (flat @ turn.T + self.translations[int(time)]).reshape(-1, 3)
        normals = np.tile(-turn[:, 2], (len(vertices), 1))
        return Mesh(vertices, normals, sheet.reshape(-1, 2), triangles.astype(np.int32), np.zeros(len(triangles), dtype=np.int32))


def wave_target(pattern: Pattern, rig: Rig, views: int, *, reach: float = 0.5, rng: np.random.Generator) -> WavedTarget:
    """Poses in which somebody shows a sheet to the cameras in turn: each faces one camera, tilted by up to 50 degrees.

    reach  m, how far its middle is from where most cameras look, at most, in each axis

    Raises AsterismError for less than one view.
    """
    if views < 1:
        raise AsterismError("a target is waved in at least one pose.")
    rows, cols = pattern.shape
    middle = 0.5 * np.array([(cols - 1) * pattern.pitch, (rows - 1) * pattern.pitch, 0.0])
    places = np.array([camera.position for camera in rig])
    looks = np.array([camera.rotation[2] for camera in rig])
    across = np.eye(3) - looks[:, :, None] * looks[:, None, :]
    # The place nearest to all lines of sight, where most cameras look.
    around = np.linalg.lstsq(across.sum(axis=0), np.einsum("cij,cj->i", across, places), rcond=None)[0]
    turns, shifts = np.empty((views, 3, 3)), np.empty((views, 3))
    for t in range(views):
        # Each camera in turn: none is left without views.
        camera = rig.cameras[t % len(rig)]
        tilt = rng.uniform(0.0, np.radians(50.0))
        direction = rng.uniform(0.0, 2 * np.pi)
        turn = rotation_from_vector(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
        # Any turn in its own plane: a person does not hold a sheet level.
        spin = rotation_from_vector(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        turns[t] = camera.rotation.T @ turn @ spin
        shifts[t] = around + rng.uniform(-reach, reach, 3) - turns[t] @ middle
    return WavedTarget(pattern, turns, shifts)
