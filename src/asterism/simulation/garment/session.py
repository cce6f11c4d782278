"""A seed in; a simulated session with a garment out: a calibration target waved and a wearer filmed by the same cameras, with the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.garment.dense import DenseTrajectories
from asterism.garment.pattern import Pattern
from asterism.geometry import fit_rigid
from asterism.recording import Floats
from asterism.simulation.garment.photograph import Photo, PhotoSettings, photograph
from asterism.simulation.garment.rigs import garment_rig
from asterism.simulation.garment.suit import Wearer, WornGarment, wear
from asterism.simulation.garment.target import WavedTarget, wave_target

Image = NDArray[np.uint8]
Moment = tuple[int, list[Image | None]]

_STEEPEST = np.cos(np.radians(75.0))


@dataclass(frozen=True)
class GarmentSession:
    """Who is filmed by what.

    rig       the true cameras
    worn      the garment on its wearer
    target    the sheet that is waved before
    settings  of all pictures
    rate      moments per second of the film
    seed      of the noise
    """

    rig: Rig
    worn: WornGarment
    target: WavedTarget
    settings: PhotoSettings = field(default_factory=PhotoSettings)
    rate: float = 10.0
    seed: int = 0

    def calibration(self, workers: int = 1) -> Iterator[Moment]:
        """The pictures of the target, pose by pose; None of cameras that it shows its back or edge to, or that it is out of view of."""

        def picture(place: tuple[int, int]) -> Image | None:
            t, c = place
            if not self._shows_target(t, c):
                return None
            # A stream for each picture: workers may take them in any order.
            rng = np.random.default_rng([self.seed, 1, t, c])
            return photograph(self.target, self.rig.cameras[c], float(t), self.settings, rng=rng).image

        yield from _by_moment(picture, len(self.target), len(self.rig), workers)

    def film(self, frames: int, workers: int = 1, seen: Callable[[int, int, Photo], None] | None = None) -> Iterator[Moment]:
        """The pictures of the wearer; `seen` is told each with its frame and camera, and the truth of its circles."""

        def picture(place: tuple[int, int]) -> Image | None:
            t, c = place
            rng = np.random.default_rng([self.seed, 2, t, c])
            photo = photograph(self.worn, self.rig.cameras[c], t / self.rate, self.settings, rng=rng)
            if seen is not None:
                seen(t, c, photo)
            return photo.image

        yield from _by_moment(picture, frames, len(self.rig), workers)

    def truth(self, frames: int) -> dict[int, Floats]:
        """identity -> (frames, 3) m, where each circle was."""
        ids = self.worn.pattern.ids
        inner = ids >= 0
        paths = np.stack([self.worn.circles(t / self.rate)[inner] for t in range(frames)], axis=1)
        return dict(zip(ids[inner].tolist(), paths, strict=True))

    def _shows_target(self, t: int, c: int) -> bool:
        camera, turn = self.rig.cameras[c], self.rig.cameras[c].rotation @ self.target.rotations[t]
        places = self.target.circles(t).reshape(-1, 3)
        middle = camera.rotation @ places.mean(axis=0) + camera.translation
        # From the back, or nearly edge-on, there is nothing to read.
        if turn[:, 2] @ middle < _STEEPEST * np.linalg.norm(middle):
            return False
        xy = camera.project(places)
        with np.errstate(invalid="ignore"):
            inside = ((xy >= 0) & (xy < np.array(camera.size))).all(axis=1)
        return bool(inside.mean() > 0.3)


def _by_moment(picture: Callable[[tuple[int, int]], Image | None], moments: int, cameras: int, workers: int) -> Iterator[Moment]:
    """The pictures of one moment after the other, taken by several workers."""
    with ThreadPoolExecutor(max(1, workers)) as pool:
        for t in range(moments):
            yield t, list(pool.map(picture, [(t, c) for c in range(cameras)]))


def simulate_garment_session(
    pattern: Pattern,
    target: Pattern,
    wearer: Wearer | None = None,
    seed: int = 0,
    *,
    cameras: int = 8,
    size: tuple[int, int] = (1280, 960),
    poses: int = 32,
    settings: PhotoSettings | None = None,
) -> GarmentSession:
    """Eight colour cameras of 1280 x 960 px around a wearer, and a target shown to them in so many poses.

    pattern  of the suit, made from `suit_masks` of the same wearer
    target   a sheet in one piece

    Raises AsterismError where the pattern does not fit the wearer.
    """
    wearer = wearer or Wearer(seed=seed)
    rngs = [np.random.default_rng([seed, part]) for part in range(2)]
    rig = garment_rig(cameras, size, wearer=wearer, rng=rngs[0])
    return GarmentSession(
        rig, wear(pattern, wearer), wave_target(target, rig, poses, rng=rngs[1]), settings or PhotoSettings(), seed=seed
    )  # fmt: skip


@dataclass(frozen=True)
class DenseErrors:
    """Captured points against the truth.

    errors      (n, 3) m, of all points of all frames, in the true world
    normalised  root of the mean of their squares by their covariance, per axis: 1 where the covariance tells the truth
    """

    errors: Floats
    normalised: float

    @property
    def rms(self) -> float:
        """m, of the distances."""
        return float(np.sqrt(np.mean(np.square(self.errors).sum(axis=1)))) if len(self.errors) else float("nan")

    @property
    def worst(self) -> float:
        """m, the largest distance."""
        return float(np.linalg.norm(self.errors, axis=1).max()) if len(self.errors) else float("nan")


def compare_dense(captured: DenseTrajectories, truth: dict[int, Floats], *, aligned: bool = True) -> DenseErrors:
    """How far captured points are from the truth.

    aligned  whether the captured world is first moved onto the true one, by one turn and one shift for all frames, without a scale: a
             calibration leaves open where the world begins

    Raises AsterismError where fewer than three points are captured.
    """
    true = np.stack([truth[number] for number in captured.ids.tolist()], axis=1) if len(captured.ids) else np.empty((len(captured), 0, 3))
    there = np.isfinite(captured.positions[..., 0]) & np.isfinite(true[..., 0])
    if there.sum() < 3:
        raise AsterismError("fewer than three points were captured; there is nothing to compare.")
    given, expected = captured.positions[there], true[there]
    # One turn and shift for all frames: a calibration leaves open where the world begins.
    turn, shift = fit_rigid(given, expected) if aligned else (np.eye(3), np.zeros(3))
    errors = given @ turn.T + shift - expected
    covariance = np.concatenate([captured.covariances(t)[there[t]] for t in range(len(captured))])
    # Back into the captured world, in which the covariances are given.
    in_captured_world = errors @ turn
    normalised = float(
        np.sqrt(np.mean(np.einsum("ni,ni->n", in_captured_world, np.linalg.solve(covariance, in_captured_world[..., None])[..., 0])) / 3)
    )
    return DenseErrors(errors, normalised)
