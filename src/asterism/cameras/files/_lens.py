"""One lens model said in another: radial coefficients fitted to what a lens does, and how far the fit misses it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Floats
from asterism.recording.display import significant

CLOSE_PX = 1e-3
TOLERABLE_PX = 0.1
POLYNOMIALS = tuple((count, 0) for count in range(2, 9))
RATIONALS = tuple((count, 3) for count in range(2, 9))
OPENCV = ((3, 0), (3, 3))
_LEAST_DENOMINATOR = 1e-3
_FISHEYE_TERMS = 4
_WIDEST = np.radians(75.0)
"""From the axis, of a fisheye lens that a radial one can follow."""
_BEYOND = 4.0
_RADII = 400

Radial = tuple[tuple[float, ...], tuple[float, float, float]]


def fitted_radial(
    source: Floats, target: Floats, focal: float, shapes: Sequence[tuple[int, int]], *, beyond: bool = True
) -> tuple[Radial, float]:
    """Coefficients k of target = source (1 + k1 s + k2 s2 + ...) / (1 + k4 s + k5 s2 + k6 s3), s = source2, by least squares in pixels.

    source, target  (n,) radii of the normalized plane, rising, beyond zero
    shapes          (coefficients above, below) to try in this order; the first that leaves less than 0.001 px is taken, else the best

    beyond          whether points from further outside must not come back into the image

    Returns the coefficients and the largest error in px; with no fit left, the lens is taken for none.
    """
    from scipy.optimize import least_squares

    none: Radial = ((), (0.0, 0.0, 0.0))
    best = (none, float(np.abs(target - source).max() * focal))
    if best[1] < 1e-9:
        return best
    # Powers of a radius up to one keep sixteen of them comparable in size.
    scale = float(source.max()) ** 2
    powers = np.stack([(source**2 / scale) ** (i + 1) for i in range(max(max(shape) for shape in shapes))], axis=1)
    for above, below in shapes:
        top, under = powers[:, :above], powers[:, :below]

        def missed(k: Floats, top: Floats = top, under: Floats = under, above: int = above) -> Floats:
            wrong: Floats = (source * (1.0 + top @ k[:above]) / (1.0 + under @ k[above:]) - target) * focal
            return wrong

        def slopes(k: Floats, top: Floats = top, under: Floats = under, above: int = above) -> Floats:
            bottom = 1.0 + under @ k[above:]
            by_under = -source / bottom**2 * (1.0 + top @ k[:above])
            return focal * np.concatenate([top * (source / bottom)[:, None], under * by_under[:, None]], axis=1)

        # Multiplied out by the denominator the fit is linear: exact for a polynomial, a start for a quotient.
        columns = np.concatenate([top * source[:, None], -under * target[:, None]], axis=1)
        k = np.linalg.lstsq(columns, target - source, rcond=None)[0]
        if below:
            start = k if (1.0 + under @ k[above:]).min() > _LEAST_DENOMINATOR else np.zeros(above + below)
            k = least_squares(missed, start, slopes, method="lm", max_nfev=200).x
            # A denominator near zero throws points of the image to infinity.
            if (1.0 + under @ k[above:]).min() <= _LEAST_DENOMINATOR:
                continue
        left = float(np.abs(missed(k)).max())
        real = [float(v) / scale ** (i + 1) for i, v in enumerate(k[:above])]
        denominator = [float(v) / scale ** (i + 1) for i, v in enumerate(k[above:])] or [0.0, 0.0, 0.0]
        radial: Radial = (tuple(real), (denominator[0], denominator[1], denominator[2]))
        # A polynomial that turns back outside puts things beside the camera into its image.
        if left < best[1] and not (beyond and _comes_back(radial, float(source.max()), float(target.max()))):
            best = (radial, left)
        # The fewest coefficients that are exact enough: more of them only fold over sooner.
        if best[1] < CLOSE_PX:
            break
    return best


def _comes_back(radial: Radial, inside: float, edge: float) -> bool:
    """Whether points of the normalized plane beyond `inside` are projected to less than `edge`."""
    lens = Camera("fit", None, (1.0, 1.0), (0.0, 0.0), radial=radial[0], denominator=radial[1])
    beyond = np.linspace(1.02 * inside, _BEYOND * inside, _RADII)
    seen = lens.project(np.stack([beyond, np.zeros(_RADII), np.ones(_RADII)], axis=1))[:, 0]
    return bool((np.abs(seen[np.isfinite(seen)]) < 0.98 * edge).any())


def corner_radius(size: Sequence[float], centre: Sequence[float]) -> float:
    """How far the furthest corner of the image is from the principal point, px."""
    corners = np.array([[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], [size[0], size[1]]])
    return float(np.linalg.norm(corners - np.asarray(centre), axis=1).max())


def with_shapes(place: str, camera: Camera, shapes: Sequence[tuple[int, int]]) -> tuple[Camera, float]:
    """The camera with no more radial coefficients than a format has, and the largest error that this leaves, px.

    Raises AsterismError where more than 0.1 px of the image would be lost.
    """
    most = max(above for above, _ in shapes)
    rational = any(below for _, below in shapes)
    if not any(camera.radial[most:]) and (rational or not any(camera.denominator)):
        return camera, 0.0
    size = camera.size or (2.0 * camera.centre[0], 2.0 * camera.centre[1])
    focal = float(np.mean(camera.focal))
    round_lens = Camera("fit", None, (1.0, 1.0), (0.0, 0.0), radial=camera.radial, denominator=camera.denominator)
    seen = np.linspace(0.0, corner_radius(size, camera.centre) / focal, _RADII + 1)[1:]
    ideal = round_lens.undistort(np.stack([seen, np.zeros(_RADII)], axis=1))[:, 0]
    there = np.isfinite(ideal)
    (radial, denominator), left = fitted_radial(ideal[there], seen[there], focal, shapes, beyond=False)
    if left > TOLERABLE_PX:
        raise AsterismError(
            f"{place}: camera {camera.name} has a lens that the radial coefficients of this format miss by {significant(left, 2)} px; "
            "write Asterism's own .toml instead."
        )
    return replace(camera, radial=radial, denominator=denominator), left


def with_fisheye(where: str, camera: Camera, distortion: Floats) -> Camera:
    """A camera with the radial lens nearest to OpenCV's fisheye: angle (1 + k1 angle2 + k2 angle4 + ...) instead of its tangent.

    distortion  up to four coefficients. Raises AsterismError for more than 150 degrees, and where the fit leaves more than 0.1 px.
    """
    if len(distortion) > _FISHEYE_TERMS:
        raise AsterismError(
            f"{where}: {len(distortion)} distortion coefficients, a fisheye lens of OpenCV's has {_FISHEYE_TERMS}; mend it."
        )
    size = camera.size or (2.0 * camera.centre[0], 2.0 * camera.centre[1])
    reach = corner_radius(size, camera.centre) / min(camera.focal)
    angle = np.linspace(0.0, _WIDEST, 4001)[1:]
    seen = angle * (1.0 + sum(k * angle ** (2 * i + 2) for i, k in enumerate(distortion)))
    # Up to where the map stops rising; from there on it is no lens.
    inside = np.cumprod(np.diff(seen, prepend=0.0) > 0).astype(bool) & (seen < 1.02 * reach)
    if seen[inside].max(initial=0.0) < reach:
        raise AsterismError(
            f"{where}: a fisheye lens of more than {2 * np.degrees(_WIDEST):.0f} degrees, which this camera model cannot have."
        )
    some = np.nonzero(inside)[0][:: max(1, int(inside.sum()) // 400)]
    (radial, denominator), left = fitted_radial(np.tan(angle[some]), seen[some], camera.focal[0], POLYNOMIALS + RATIONALS)
    if left > TOLERABLE_PX:
        raise AsterismError(
            f"{where}: a fisheye lens that this camera model misses by {significant(left, 2)} px; calibrate it with a pinhole model."
        )
    return replace(camera, radial=radial, denominator=denominator)


def lens_lost(lefts: Mapping[str, float]) -> list[str]:
    """One phrase for what the fits of lenses miss, by camera in px, where that is more than 0.001 px anywhere."""
    worst = max(lefts, key=lambda name: lefts[name])
    return [f"up to {significant(lefts[worst], 2)} px of the lenses (camera {worst})"] if lefts[worst] > CLOSE_PX else []
