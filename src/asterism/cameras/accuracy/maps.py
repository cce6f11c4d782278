"""A rig and a volume in; out comes a map: how many cameras see each place, and how exactly they measure there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from asterism.cameras.accuracy.sensitivity import covariance, sees, sensitivity
from asterism.cameras.accuracy.volume import Volume, volume_of
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Floats, Ints, as_vertical
from asterism.recording.display import significant

NOISE = 0.3
"""px, of a blob's centre, where the rig does not say how well it was calibrated."""
_ONE_PLACE = 1e-6
"""m apart."""
FACINGS = 8
STEEPEST = np.cos(np.radians(80.0))
"""A marker on the skin is seen from within 80 degrees of where it faces."""


@dataclass(frozen=True)
class RigMap:
    """What a rig measures, place by place.

    volume       the box; axes: the coordinates along x, y and z of the places, m; places (N, 3) m, x slowest, z fastest
    noise        px, standard deviation of a blob's x and y
    seen_by      (N,) int, how many cameras have the place in their image
    facing       (N,) share of the horizontal directions that a marker on a body could face in which two cameras or more see it
    error        (N,) m, RMS length of the error of a point composed from all cameras that see it; NaN where fewer than two do
    worst_axis   (N,) m, standard deviation of that point along its worst direction
    sensitivity  (N,) m, the thesis' effective sensitivity of the best pair of cameras that see the place, for a shift of `noise` px
    """

    volume: Volume
    axes: tuple[Floats, Floats, Floats]
    places: Floats
    noise: float
    seen_by: Ints
    facing: Floats
    error: Floats
    worst_axis: Floats
    sensitivity: Floats

    def coverage(self, least: int = 3) -> float:
        """The share of the volume that at least so many cameras see."""
        return float((self.seen_by >= least).mean())

    @property
    def median_error(self) -> float:
        """m, over the places that two cameras see; NaN where there is no such place."""
        return float(np.nanmedian(self.error)) if np.isfinite(self.error).any() else float("nan")

    def grid(self, values: Floats | Ints) -> Floats:
        """Values (N,) as an array (x, y, z)."""
        return np.asarray(values, dtype=np.float64).reshape([len(axis) for axis in self.axes])

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON: the shares of the volume by number of cameras, and errors as median, 95th percentile and worst."""
        known = self.error[np.isfinite(self.error)]
        some = len(known) > 0
        return {
            "volume_m": [self.volume.low.tolist(), self.volume.high.tolist()],
            "places": len(self.places),
            "noise_px": self.noise,
            "coverage": {str(least): self.coverage(least) for least in range(1, int(self.seen_by.max(initial=0)) + 1)},
            "facing_coverage": float(self.facing.mean()),
            "error_median_m": float(np.median(known)) if some else None,
            "error_95_m": float(np.percentile(known, 95)) if some else None,
            "error_worst_m": float(known.max()) if some else None,
            "sensitivity_median_m": float(np.nanmedian(self.sensitivity)) if some else None,
        }


def map_rig(
    rig: Rig,
    volume: Volume | None = None,
    *,
    step: float | None = None,
    noise: float | None = None,
    progress: Progress | None = None,
) -> RigMap:
    """Coverage, error and sensitivity all over a volume (thesis 3.3).

    volume  by default the box that three cameras see (`volume_of`)
    step    m, between places; by default so that there are about 4,000
    noise   px; by default the median reprojection error that the rig's calibration left, over the root of 2 because that is a distance in
            the image, not a coordinate; 0.3 where the rig does not say
    Raises AsterismError where an image size or a pose is not known, cameras stand in one place or are fewer than two, or see no volume.
    """
    for camera in rig:
        if not camera.posed:
            raise AsterismError(f"camera {camera.name}: its pose is not known, so its rig has no map; calibrate the rig first.")
    if len(rig) < 2:
        raise AsterismError("one camera composes nothing: the rig needs at least two.")
    if np.ptp([camera.position for camera in rig], axis=0).max() < _ONE_PLACE:
        raise AsterismError("all cameras stand in one place, where nothing can be composed; are their poses known?")
    volume = volume_of(rig) if volume is None else volume
    step = float(np.cbrt(volume.size.prod() / 4000)) if step is None else step
    known = [camera.error for camera in rig if np.isfinite(camera.error) and camera.error > 0]
    noise = (float(np.median(known) / np.sqrt(2)) if known else NOISE) if noise is None else noise
    if not (step > 0 and 0 < noise < np.inf):
        raise AsterismError(f"a step of {significant(step, 3)} m and a noise of {noise:g} px make no map; both must be positive.")
    axes = volume.axes(step)
    places = volume.places(step)
    seen = sees(rig, places)
    spread = covariance(rig, places, noise, seen)
    error = np.sqrt(np.trace(spread, axis1=1, axis2=2))
    composed = np.isfinite(error)
    worst = np.full(len(places), np.nan)
    worst[composed] = np.sqrt(np.linalg.eigvalsh(spread[composed])[:, -1])
    best = np.full(len(places), np.inf)
    blocks = np.array_split(np.arange(len(places)), max(1, len(places) // 500))
    for b, block in enumerate(blocks):
        result = sensitivity(rig, places[block], noise)
        both = seen[result.pairs[:, 0]][:, block] & seen[result.pairs[:, 1]][:, block]
        effective = np.where(both & np.isfinite(result.effective), result.effective, np.inf)
        best[block] = effective.min(axis=0)
        if progress is not None:
            progress((b + 1) / len(blocks), "mapping the volume")
    best[~np.isfinite(best)] = np.nan
    return RigMap(volume, axes, places, noise, seen.sum(axis=0), facing_coverage(rig, places, seen), error, worst, best)


def facing_coverage(rig: Rig, places: Floats, seen: np.ndarray, least: int = 2) -> Floats:
    """(N,) share of the horizontal directions in which a marker may face so that `least` cameras see it: a body hides its other side."""
    up = as_vertical("z") if rig.vertical is None else rig.vertical
    across = np.eye(3)[int(np.argmin(np.abs(up)))]
    east = np.cross(up, across)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    angle = 2 * np.pi * np.arange(FACINGS) / FACINGS
    facings = np.cos(angle)[:, None] * east + np.sin(angle)[:, None] * north
    eyes = np.stack([camera.position for camera in rig])
    toward = eyes[:, None] - places[None]
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    from_there = seen[:, :, None] & (toward @ facings.T > STEEPEST)
    share: Floats = (from_there.sum(axis=0) >= least).mean(axis=1)
    return share
