"""What makes angles uncertain, each source with a model that draws it and the publication that its size comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras import Camera, Rig
from asterism.cameras.accuracy import covariance, sees
from asterism.errors import AsterismError
from asterism.geometry import intersect_rays, rotation_from_vector
from asterism.recording import Floats

NODES = 6
"""Places along each axis of the points' volume at which calibration errors are composed; between them the shift is a cubic."""


@dataclass(frozen=True)
class MeasurementNoise:
    """Errors of single points, independent between points and frames: what is left of the blobs' noise after triangulation.

    sigma  m, standard deviation per coordinate; or
    root   (T, N, 3, 3) m, a matrix square root of each point's covariance, such as that of `noise_from_rig`
    """

    sigma: float = 0.0
    root: Floats | None = None

    @property
    def typical(self) -> float:
        """m: standard deviation per coordinate, root mean square over the points that are present."""
        if self.root is None:
            return self.sigma
        variance = (self.root**2).sum(axis=(2, 3)) / 3
        return float(np.sqrt(variance.sum() / max(int((variance > 0).sum()), 1)))

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """(T, N, 3) m, one draw."""
        white = rng.standard_normal(shape)
        return self.sigma * white if self.root is None else np.asarray(np.einsum("tnij,tnj->tni", self.root, white))


@dataclass(frozen=True)
class CalibrationErrors:
    """Errors of intrinsic and extrinsic parameters, the same in all frames, correlated as the calibration's covariance says.

    rig         as calibrated
    free        (C, 15) bool, which parameters were adjusted, in the order of `asterism.cameras.bundle.PARAMETERS`
    covariance  (free, free) px, m, rad; both as `Adjustment` has them
    """

    rig: Rig
    free: np.ndarray
    covariance: Floats

    def __post_init__(self) -> None:
        count = int(np.asarray(self.free).sum())
        if np.asarray(self.free).shape != (len(self.rig), 15) or np.asarray(self.covariance).shape != (count, count):
            raise AsterismError(f"a covariance of {np.asarray(self.covariance).shape} does not fit the {count} free parameters of the rig.")
        if not np.isfinite(self.covariance).all():
            raise AsterismError("the calibration's covariance is not finite; calibrate with more frames, or leave this source out.")

    def field(self, positions: Floats) -> CalibrationField:
        """What these errors do to points anywhere in the volume of (T, N, 3) m."""
        seen = positions[np.isfinite(positions).all(axis=-1)]
        if not len(seen):
            raise AsterismError("no point is ever seen, so the calibration's errors have no place to count; give a recording with points.")
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle, half = (low + high) / 2, np.maximum((high - low) / 2, 0.05)
        # A grid of nodes instead of every point: the shift is smooth, and each node costs a triangulation.
        axis = np.linspace(-1, 1, NODES)
        unit = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        nodes = middle + unit * half
        # A square root of the covariance by its eigenvectors: it may be singular, which Cholesky refuses.
        values, vectors = np.linalg.eigh(np.asarray(self.covariance))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        pixels = self.rig.project(nodes)
        in_view = np.asarray(sees(self.rig, nodes) if all(camera.size for camera in self.rig) else np.isfinite(pixels).all(axis=2))
        # What the true rig would see; the drawn rig composes the same pixels elsewhere.
        pixels = np.where(in_view[:, :, None], pixels, np.nan)
        terms = _cubic((positions - middle) / half)
        return CalibrationField(self, root, pixels, nodes, _cubic(unit), terms)


@dataclass(frozen=True)
class CalibrationField:
    """A calibration's errors made ready to draw, see `CalibrationErrors.field`."""

    errors: CalibrationErrors
    root: Floats
    pixels: Floats
    nodes: Floats
    node_terms: Floats
    terms: Floats

    def draw(self, rng: np.random.Generator) -> Floats:
        """(T, N, 3) m: a rig is drawn, the nodes' pixels are composed by it, and the shift is carried to the points."""
        steps = np.zeros(np.asarray(self.errors.free).shape)
        steps[np.asarray(self.errors.free)] = self.root @ rng.standard_normal(self.root.shape[1])
        cameras = [_stepped(camera, step) for camera, step in zip(self.errors.rig, steps, strict=True)]
        count = len(self.nodes)
        origins = np.repeat(np.stack([camera.position for camera in cameras])[None], count, axis=0)
        rays = np.stack([camera.rays(pixels) for camera, pixels in zip(cameras, self.pixels, strict=True)], axis=1)
        starts = np.arange(count + 1) * len(cameras)
        # How far composing by the drawn rig moves each node.
        shift = intersect_rays(origins.reshape(-1, 3), rays.reshape(-1, 3), starts) - self.nodes
        known = np.asarray(np.isfinite(shift).all(axis=1))
        if known.sum() < 20:
            raise AsterismError("the rig sees too little of the points' volume with two cameras; is it the rig of this recording?")
        return np.asarray(self.terms @ np.linalg.lstsq(self.node_terms[known], shift[known], rcond=None)[0])


def _cubic(unit: Floats) -> Floats:
    """(..., 20): the monomials up to the third degree."""
    x, y, z = unit[..., 0], unit[..., 1], unit[..., 2]
    powers = [(i, j, k) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
    return np.stack([x**i * y**j * z**k for i, j, k in powers], axis=-1)


def _stepped(camera: Camera, step: Floats) -> Camera:
    """A camera whose 15 parameters differ by a step, as a bundle adjustment applies it."""
    turn = rotation_from_vector(step[:3])
    fx = camera.focal[0] + step[6]
    aspect = camera.focal[1] / camera.focal[0] + step[7]
    radial = np.zeros(max(3, len(camera.radial)))
    radial[: len(camera.radial)] = camera.radial
    radial[:3] += step[10:13]
    return replace(
        camera,
        rotation=turn @ camera.rotation,
        translation=camera.translation + step[3:6],
        focal=(fx, aspect * fx),
        centre=(camera.centre[0] + step[8], camera.centre[1] + step[9]),
        radial=tuple(radial),
        tangential=(camera.tangential[0] + step[13], camera.tangential[1] + step[14]),
    )


def noise_from_rig(rig: Rig, positions: ArrayLike, noise: float | None = None) -> MeasurementNoise:
    """The noise of triangulated points (T, N, 3) m from that of the blobs (px, standard deviation per coordinate).

    noise  by default the median reprojection error that the rig's calibration left, over the root of 2; 0.3 px where it does not say.
    Every camera that has a point in its image counts as seeing it. Where only one does, the largest of the other points' covariances is
    taken. Raises AsterismError where no point is seen by two cameras.
    """
    given = np.asarray(positions, dtype=np.float64)
    known = [camera.error for camera in rig if np.isfinite(camera.error) and camera.error > 0]
    pixel = noise if noise is not None else float(np.median(known) / np.sqrt(2)) if known else 0.3
    present = np.isfinite(given).all(axis=2)
    spread = covariance(rig, given[present], pixel)
    composed = np.isfinite(spread).all(axis=(1, 2))
    if not composed.any():
        raise AsterismError("no point of the recording is seen by two cameras of the rig; is it the rig of this recording?")
    sizes = np.trace(spread[composed], axis1=1, axis2=2)
    # Of one camera nothing is composed; such a point is at least as uncertain as the worst.
    spread[~composed] = spread[composed][int(np.argmax(sizes))]
    root = np.zeros((*given.shape, 3))
    root[present] = np.linalg.cholesky(spread)
    return MeasurementNoise(root=root)


@dataclass(frozen=True)
class SoftTissueErrors:
    """Skin that moves over bone in step with the joints: smooth over the limb, and the same in each repetition.

    scales     by which what the points themselves show (their residuals) is multiplied, for a limb of 8 points and for one of 1,000;
               between them it follows the logarithm of the number. A rigid part of the skin's motion leaves no residual; robust weights
               find bone among many points. Chosen so that 65 % intervals hold 65 % of the truth on the simulated subjects 100 to 109
    (seed 1)
    freedoms   of the t distribution of the displacements: their size is itself known from a few places of the skin only
    least_m    m at the largest angle, also where points show less
    reach_m    distance over which the displacement is alike
    bumps      that make one smooth field
    """

    scales: tuple[float, float] = (0.80, 0.26)
    freedoms: float = 8.0
    least_m: float = 0.0005
    reach_m: float = 0.08
    bumps: int = 10

    def scale_of(self, points: int) -> float:
        """The scale for a limb of so many points."""
        return float(np.exp(np.interp(np.log(points), np.log([8.0, 1000.0]), np.log(self.scales))))

    def draw(self, template: Floats, amplitude: Floats, courses: Sequence[Floats], rng: np.random.Generator) -> Floats:
        """(T, N, 3) m in the limb's axes: a field for each joint of the limb, times that joint's course (T,) from 0 to 1."""
        known = np.asarray(np.isfinite(template).all(axis=1))
        places = np.where(known[:, None], template, 0.0)
        out = np.zeros((len(courses[0]), *template.shape)) if courses else np.zeros((1, *template.shape))
        # A t distribution: the size of the displacement is itself an estimate.
        size = np.sqrt(self.freedoms / rng.chisquare(self.freedoms)) if np.isfinite(self.freedoms) else 1.0
        for course in courses:
            # Bumps at points of the limb: the field is smooth over the skin and differs from trial to trial.
            middles = places[rng.choice(np.nonzero(known)[0], self.bumps)]
            square = ((places[:, None] - middles[None]) ** 2).sum(axis=2)
            bumps = np.exp(-square / self.reach_m**2) * rng.choice([-1.0, 1.0], self.bumps)
            field = bumps @ rng.standard_normal((self.bumps, 3))
            # Alike in strength where few bumps reach, but not blown up where none does.
            field /= np.maximum(np.sqrt((bumps**2).sum(axis=1, keepdims=True)), 0.3)
            out += course[:, None, None] * (size * amplitude[:, None] * field)
        return out / np.sqrt(max(len(courses), 1))


@dataclass(frozen=True)
class ErrorSources:
    """The sources that count; None for one that does not.

    noise None: taken from the points that follow their limbs best. calibration None: left out, which is said
    """

    noise: MeasurementNoise | None = None
    calibration: CalibrationErrors | None = None
    soft_tissue: SoftTissueErrors | None = SoftTissueErrors()
