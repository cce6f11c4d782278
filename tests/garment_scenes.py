"""A dressed arm before three cameras, small enough for tests: who wears what, and the truth."""

from __future__ import annotations

from functools import cache

import numpy as np

from asterism.calibration.coded_target import centre_offsets
from asterism.cameras import Camera, Rig
from asterism.cameras.aim import looking
from asterism.errors import AsterismError
from asterism.garment import Pattern, Piece
from asterism.garment.identities import RING, identities
from asterism.simulation.garment import (
    Folds,
    Photo,
    PhotoSettings,
    SimulatedCircles,
    Wearer,
    WornGarment,
    photograph,
    sheet_of,
    suit_masks,
    wear,
)
from asterism.simulation.garment.target import WavedTarget

ARM = Wearer(motion="stand", parts=("left arm",), folds=Folds(height=0.0015))


def coded(mask: np.ndarray, pieces: tuple, seed: int = 0, pitch: float = 0.018, diameter: float = 0.010) -> Pattern:
    """A pattern on a mask, row by row: a colour that would repeat an identity is not taken; from the beginning where none is left."""
    for again in range(20):
        rng = np.random.default_rng([seed, again])
        colours, used = np.full(mask.shape, -1), {-1}
        for i, j in np.argwhere(mask):
            closes = i >= 2 and j >= 2 and bool(mask[i - 2 : i + 1, j - 2 : j + 1].all())
            for colour in rng.permutation(4):
                colours[i, j] = colour
                ring = [colours[i - 1 + a, j - 1 + b] for a, b in RING] if closes else []
                number = int(identities(colours[i - 1, j - 1], ring, 4)) if closes else None
                if number not in used:
                    break
            else:
                break
            used |= set() if number is None else {number}
        else:
            return Pattern(colours.astype(np.int8), pitch=pitch, diameter=diameter, pieces=pieces)
    raise AsterismError("no pattern was found in twenty trials.")


@cache
def sleeve() -> WornGarment:
    """A sleeve on a standing wearer's left arm."""
    return wear(coded(*sheet_of(suit_masks(ARM))), ARM)


def arm_rig(size: tuple[int, int] = (640, 480), cameras: int = 3, apart: float = 0.5) -> Rig:
    """Cameras 0.9 m beside the arm, `apart` rad from each other, that its sleeve fills; lenses with a little distortion."""
    joints = ARM.at(0.0)
    middle = 0.5 * (joints["left shoulder"] + joints["left wrist"])
    hung = []
    for i in range(cameras):
        angle = apart * (i - 0.5 * (cameras - 1))
        place = middle + 0.9 * np.array([np.sin(angle), np.cos(angle), 0.3])
        rotation, translation = looking(place, middle, 0.05 * i)
        focal = 1.25 * size[1]
        centre = (0.5 * size[0] - 0.5 + i, 0.5 * size[1] - 0.5 - i)
        hung.append(Camera(f"c{i + 1}", size, (focal, focal), centre, rotation, translation, radial=(-0.05, 0.02)))
    return Rig(tuple(hung), vertical=np.array([0.0, 0.0, 1.0]))


@cache
def photos(noise: float = 0.005, seed: int = 0) -> tuple[Photo, ...]:
    """What three cameras see of the sleeve."""
    settings = PhotoSettings(noise=noise, clutter=3)
    return tuple(photograph(sleeve(), camera, 0.0, settings, rng=np.random.default_rng([seed, i])) for i, camera in enumerate(arm_rig()))


def true_positions(worn: WornGarment, time: float = 0.0) -> dict[int, np.ndarray]:
    """identity -> (3,) m."""
    ids, points = worn.pattern.ids, worn.circles(time)
    return dict(zip(ids[ids >= 0].tolist(), points[ids >= 0], strict=True))


@cache
def sheet(rows: int = 7, cols: int = 9) -> Pattern:
    """A calibration target at the paper's pitch."""
    return coded(np.ones((rows, cols), dtype=bool), (Piece("sheet", 0, 0, rows, cols),), pitch=0.068, diameter=0.038)


def read_target(
    scene: WavedTarget, rig: Rig, noise: float, *, rng: np.random.Generator, steepest: float = 70.0
) -> list[list[SimulatedCircles]]:
    """What each camera reads of a waved target in each frame: the centres of the ellipses, which are not the images of the centres."""
    pattern, frames = scene.pattern, []
    ids = pattern.ids[pattern.ids >= 0]
    for t in range(len(scene)):
        places, frame = scene.circles(t)[pattern.ids >= 0], []
        for camera in rig:
            turns = np.tile(camera.rotation @ scene.rotations[t], (len(places), 1, 1))
            inside = places @ camera.rotation.T + camera.translation
            xy = camera.project(places) + centre_offsets(camera, turns, inside, 0.5 * pattern.diameter)
            facing = np.einsum("ni,ni->n", turns[:, :, 2], inside) / np.linalg.norm(inside, axis=1)
            with np.errstate(invalid="ignore"):
                there = ((xy > 3) & (xy < np.array(camera.size) - 4)).all(axis=1) & (facing > np.cos(np.radians(steepest)))
            rows = np.flatnonzero(there)
            covariance = np.tile(max(noise, 1e-3) ** 2 * np.eye(2), (len(rows), 1, 1))
            frame.append(SimulatedCircles(xy[rows] + noise * rng.standard_normal((len(rows), 2)), covariance, ids[rows]))
        frames.append(frame)
    return frames


def grid_links(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """Links of a whole grid, each circle's directions turned by any quarter, and centres 10 px apart."""
    turn = np.random.default_rng(8).integers(0, 4, (rows, cols))
    links = np.full((rows, cols, 4, 2), -1, np.int32)
    for row, col in np.ndindex(rows, cols):
        for d, (down, right) in enumerate(((0, 1), (1, 0), (0, -1), (-1, 0))):
            r, c = row + down, col + right
            if 0 <= r < rows and 0 <= c < cols:
                links[row, col, (d + turn[row, col]) % 4] = r * cols + c, (d + 2 + turn[r, c]) % 4
    y, x = np.mgrid[0:rows, 0:cols]
    return links.reshape(-1, 4, 2), np.stack([x, y], axis=-1).reshape(-1, 2) * 10.0
