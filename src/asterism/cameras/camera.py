"""One calibrated camera: world points in, pixels out, and back to rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras import lens_kernels
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector
from asterism.recording import Floats

LARGEST_IMAGE = 100_000
"""px, the longest side that an image may have."""


@dataclass(frozen=True)
class Camera:
    """A pinhole with a lens (thesis eqs 3.1 to 3.5), in OpenCV's conventions.

    name         what the rig calls it
    size         (width, height) px, or None where the file that it came from does not say
    focal        (fx, fy) px
    centre       (cx, cy) px, the principal point; the centre of the top left pixel is (0, 0)
    rotation     (3, 3) camera from world; the camera looks along its z, x to the right, y down
    translation  (3,) m, camera from world: X' = rotation X + translation (the thesis' -R P0)
    radial       k1, k2, k3 and any further coefficients of r2, r4, r6, ... on the normalized plane
    tangential   p1, p2
    denominator  k4, k5, k6 of OpenCV's rational model; zeros in the thesis' model
    error        px, the reprojection error (RMS) that its calibration left, NaN where unknown
    posed        whether rotation and translation are known; lenses calibrated alone have none
    """

    name: str
    size: tuple[int, int] | None
    focal: tuple[float, float]
    centre: tuple[float, float]
    rotation: Floats = field(default_factory=lambda: np.eye(3))
    translation: Floats = field(default_factory=lambda: np.zeros(3))
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    denominator: tuple[float, float, float] = (0.0, 0.0, 0.0)
    error: float = float("nan")
    posed: bool = True

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64).ravel()
        lens = [*self.focal, *self.centre, *self.radial, *self.tangential, *self.denominator]
        if rotation.shape != (3, 3) or translation.shape != (3,) or not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise AsterismError(f"camera {self.name}: its pose is not a 3 x 3 rotation and three metres, all finite.")
        if np.abs(rotation).max() > 1.1 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-5 or np.linalg.det(rotation) < 0:
            raise AsterismError(
                f"camera {self.name}: its rotation is not orthonormal, or mirrored; export it again, unscaled and right-handed."
            )
        if not np.isfinite(lens).all() or min(self.focal) <= 0:
            raise AsterismError(f"camera {self.name}: its focal length must be positive and all its lens parameters finite.")
        if self.size is not None and not 0 < min(self.size) <= max(self.size) <= LARGEST_IMAGE:
            raise AsterismError(
                f"camera {self.name}: its image size {self.size[0]:g} x {self.size[1]:g} is not that of an image, in pixels."
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)
        for numbers in ("focal", "centre", "radial", "tangential", "denominator"):
            object.__setattr__(self, numbers, tuple(float(value) for value in getattr(self, numbers)))
        object.__setattr__(self, "error", float(self.error))

    @classmethod
    def from_opencv(
        cls,
        name: str,
        matrix: ArrayLike,
        distortion: ArrayLike = (),
        rotation: ArrayLike | None = None,
        translation: ArrayLike | None = None,
        size: Sequence[int] | None = None,
    ) -> Self:
        """From OpenCV's camera matrix (3, 3) px, distortion (k1, k2, p1, p2[, k3[, k4, k5, k6]]) and, where known, pose.

        rotation (3, 3) or a rotation vector (3,) rad; translation (3,) m. Raises AsterismError for skew, thin prism and tilt
        coefficients that are not zero, and for a number of coefficients that OpenCV does not have.

        >>> camera = Camera.from_opencv("c1", [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1]], [-0.1, 0.01, 0, 0], size=(640, 480))
        >>> camera.radial, camera.posed
        ((-0.1, 0.01, 0.0), False)
        """
        k = np.asarray(matrix, dtype=np.float64)
        d = np.asarray(distortion, dtype=np.float64).ravel()
        if k.shape != (3, 3) or np.abs([k[0, 1], k[1, 0], *(k[2] - [0.0, 0.0, 1.0])]).max() > 1e-9 * np.abs(k).max():
            raise AsterismError(
                f"camera {name}: its matrix is not (fx, 0, cx), (0, fy, cy), (0, 0, 1): transposed, scaled, or with skew; export it again."
            )
        if len(d) not in (0, 4, 5, 8, 12, 14) or np.any(d[8:]):
            raise AsterismError(f"camera {name}: {len(d)} distortion coefficients; OpenCV's 4, 5 or 8 are understood, thin prisms are not.")
        d = np.concatenate([d[:8], np.zeros(8 - min(len(d), 8))])
        r = np.eye(3) if rotation is None else np.asarray(rotation, dtype=np.float64)
        return cls(
            name,
            None if size is None else (int(size[0]), int(size[1])),
            (float(k[0, 0]), float(k[1, 1])),
            (float(k[0, 2]), float(k[1, 2])),
            r if r.size == 9 else rotation_from_vector(r),
            np.zeros(3) if translation is None else np.asarray(translation, dtype=np.float64).ravel(),
            (float(d[0]), float(d[1]), float(d[4])),
            (float(d[2]), float(d[3])),
            (float(d[5]), float(d[6]), float(d[7])),
            posed=translation is not None,
        )

    @property
    def matrix(self) -> Floats:
        """(3, 3) px, OpenCV's camera matrix."""
        return np.array([[self.focal[0], 0.0, self.centre[0]], [0.0, self.focal[1], self.centre[1]], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> Floats:
        """k1, k2, p1, p2, k3, and k4, k5, k6 where they are not zero, in OpenCV's order.

        Raises AsterismError where the camera has radial coefficients that OpenCV has no place for.
        """
        k = (*self.radial, 0.0, 0.0, 0.0)
        if any(k[3:]):
            raise AsterismError(
                f"camera {self.name}: OpenCV has no place for its {len(self.radial)} radial coefficients; fit it with three."
            )
        rational = self.denominator if any(self.denominator) else ()
        return np.array([k[0], k[1], *self.tangential, k[2], *rational])

    @property
    def lens(self) -> Floats:
        """The intrinsic parameters as the kernels take them, see `cameras.lens_kernels`."""
        return np.array([*self.focal, *self.centre, *self.tangential, *self.denominator, *self.radial])

    @property
    def position(self) -> Floats:
        """(3,) m, where the camera stands in the world (the thesis' P0)."""
        place: Floats = -self.rotation.T @ self.translation
        return place

    def project(self, points: ArrayLike) -> Floats:
        """World points (..., 3) m as pixels (..., 2); NaN where one is missing, behind the camera or beyond the lens model.

        >>> camera = Camera("c1", (640, 480), focal=(500.0, 500.0), centre=(319.5, 239.5))
        >>> camera.project([[0.0, 0.0, 2.0], [0.4, 0.0, 2.0], [0.0, 0.0, -1.0]])
        array([[319.5, 239.5],
               [419.5, 239.5],
               [  nan,   nan]])
        """
        points = np.asarray(points, dtype=np.float64)
        out = np.empty((*points.shape[:-1], 2))
        lens_kernels.project_points(
            self.lens, self.rotation, self.translation, np.ascontiguousarray(points.reshape(-1, 3)), out.reshape(-1, 2)
        )
        return out

    def undistort(self, pixels: ArrayLike) -> Floats:
        """Pixels (..., 2) as points of the normalized plane (..., 2), x/z and y/z in the camera's axes; NaN where no ray leads there.

        >>> camera = Camera("c1", (640, 480), focal=(500.0, 500.0), centre=(319.5, 239.5), radial=(-0.1,))
        >>> pixels = camera.project([[0.4, 0.2, 2.0]])
        >>> camera.undistort(pixels).round(6)
        array([[0.2, 0.1]])
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        out = np.empty(pixels.shape)
        lens_kernels.undistort_points(self.lens, np.ascontiguousarray(pixels.reshape(-1, 2)), out.reshape(-1, 2))
        return out

    def rays(self, pixels: ArrayLike) -> Floats:
        """The unit directions in the world (..., 3) along which the camera sees pixels (..., 2); they start at `position`."""
        flat = self.undistort(pixels)
        rays = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1) @ self.rotation
        unit: Floats = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit
