"""Views of a board by one camera in; its lens (OpenCV's calibration), and where the board was in each view, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.cameras.bundle import Sightings
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector
from asterism.recording import Floats, Ints

Single = NDArray[np.float32]

MOST_VIEWS, LEAST_VIEWS = 60, 3
"""Views that OpenCV's calibration uses, and different ones that it needs."""
_STILL = 0.01
"""Of the image's longer side: a view whose corners are all nearer than this to those of another shows nothing new."""
_OUTLYING, _OUTLYING_PX = 4.0, 1.0
"""A view is rejected whose error is so many times the median, and above so many px."""


@dataclass(frozen=True)
class Intrinsics:
    """One camera calibrated by itself.

    camera      without a pose; `error` is the RMS of its calibration
    frames      (V,) the frames of the views that were used, of all that can be used
    rotations   (V, 3, 3), translations (V, 3) m: camera from board
    errors      (V,) px, RMS of each view
    rejected    (n,) frames of views that do not fit the others
    focal_std   px, standard deviation of fx by that calibration
    different   how many of these views show the board elsewhere than another: a board that rests adds nothing new
    """

    camera: Camera
    frames: Ints
    rotations: Floats
    translations: Floats
    errors: Floats
    rejected: Ints
    focal_std: float
    different: int

    @property
    def repeated(self) -> float:
        """By how much standard deviations are larger than they would be if each view showed something new."""
        return float(np.sqrt(len(self.frames) / self.different))

    @property
    def rms(self) -> float:
        """px, over all views that were used, each weighed alike."""
        return float(np.sqrt(np.mean(self.errors**2)))


def calibrate_intrinsics(
    name: str, size: tuple[int, int], points: Floats, seen: Sightings, lens: Camera | None = None
) -> Intrinsics | None:
    """The lens of one camera from its views of a board, and the board's pose in each; None with less than three different views that agree.

    With a known lens one view is enough.

    points  (K, 3) m of the board; seen: this camera's sightings

    OpenCV's calibration (Zhang 2000) with k1, k2, p1, p2, k3, of at most 60 views that differ most; then every view's pose by itself
    (infinitesimal plane-based pose, refined). A view whose error is four times the median and above 1 px is left out, and the rest
    calibrated again.
    """
    frames = np.unique(seen.frame)
    starts = np.searchsorted(seen.frame, np.append(frames, frames[-1] + 1 if len(frames) else 0))
    objects = [points[seen.point[a:b]].astype(np.float32) for a, b in pairwise(starts.tolist())]
    images = [seen.xy[a:b].astype(np.float32) for a, b in pairwise(starts.tolist())]
    # A board at rest gives many views that teach one thing; they must not count as evidence many times.
    good, new = np.ones(len(frames), dtype=bool), _shows_new(points, objects, images, size)
    # Leaving a view out changes the lens by which all others are judged, so begin again until none is left to go.
    while (good & new).sum() >= (LEAST_VIEWS if lens is None else 1):
        calibrated = _lens(name, size, objects, images, good) if lens is None else (_without_pose(lens), 0.0)
        if calibrated is None:
            return None
        camera, focal_std = calibrated
        # All views get a pose, those too that the lens was not made from.
        poses = [_pose(camera, objects[i], images[i]) for i in range(len(frames))]
        errors = np.array([np.inf if pose is None else pose[2] for pose in poses])
        usual = float(np.median(errors[good & np.isfinite(errors)])) if np.isfinite(errors[good]).any() else 0.0
        outlying = good & ~(errors <= max(_OUTLYING * usual, _OUTLYING_PX))
        if not outlying.any():
            break
        good &= ~outlying
    else:
        return None
    kept = np.nonzero(good)[0]
    turned = np.stack([poses[i][0] for i in kept])  # type: ignore[index]
    placed = np.stack([poses[i][1] for i in kept])  # type: ignore[index]
    if lens is not None:
        camera = replace(camera, error=float(np.sqrt(np.mean(errors[kept] ** 2))))
    different = max(1, int((good & new).sum()))
    return Intrinsics(camera, frames[kept], turned, placed, errors[kept], frames[~good], focal_std, different)


def _lens(
    name: str, size: tuple[int, int], objects: list[Single], images: list[Single], good: NDArray[np.bool_]
) -> tuple[Camera, float] | None:
    """OpenCV's calibration of the good views, and the standard deviation of fx, px; None where they do not determine it."""
    import cv2

    used = np.nonzero(good)[0]
    used = used[_most_different([images[i] for i in used], size)]
    # Few views let a third radial coefficient bend the lens where no view is.
    flags = 0 if len(used) >= 2 * LEAST_VIEWS else cv2.CALIB_FIX_K3
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # with more, OpenCV 5 adds up in another order each time, and so do the last digits
    try:
        error, matrix, lens, _, _, spread, *_ = cv2.calibrateCameraExtended(
            [objects[i] for i in used], [images[i] for i in used], size, None, None, flags=flags
        )
        camera = Camera.from_opencv(name, np.asarray(matrix), np.asarray(lens).ravel()[:5], size=size)
    except (cv2.error, AsterismError):  # views that determine nothing, such as many times the same
        return None
    finally:
        cv2.setNumThreads(threads)
    return replace(camera, error=float(error)), float(np.ravel(spread)[0])


def _without_pose(camera: Camera) -> Camera:
    """The lens of a camera, without its pose."""
    return replace(camera, rotation=np.eye(3), translation=np.zeros(3), posed=False)


def _shows_new(points: Floats, objects: Sequence[Single], images: Sequence[Single], size: tuple[int, int]) -> NDArray[np.bool_]:
    """(V,) whether a view shows the board elsewhere than all views before: one of its corners farther by a hundredth of the image.

    points  (K, 3) m of the board, of which views show some; corners follow by a homography
    """
    import cv2

    (left, top), (right, bottom) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    corners = np.array([[[left, top], [right, top], [left, bottom], [right, bottom]]])
    ends = np.empty((len(images), 8))
    for i, (places, image) in enumerate(zip(objects, images, strict=True)):
        plane, _ = cv2.findHomography(places[:, :2], image)
        # Corners of the whole board stand for the view, whichever points it shows.
        ends[i] = np.nan if plane is None else cv2.perspectiveTransform(corners, plane).ravel()
    new: NDArray[np.bool_] = np.isfinite(ends[:, 0])
    for i in range(1, len(ends)):
        before = ends[:i][new[:i]]
        # Compared with the views that were new, not with the last one: a slow pan shows new things now and then.
        new[i] &= bool(np.abs(before - ends[i]).max(axis=1).min(initial=np.inf) > _STILL * max(size))
    return new


def _most_different(images: Sequence[Single], size: tuple[int, int]) -> Ints:
    """At most 60 views: the first in the middle of all, then always the one that differs most from those taken.

    A view is where its board is, how large and how skewed: middle and the second moments of its points.
    """
    if len(images) <= MOST_VIEWS:
        return np.arange(len(images))
    features = np.array([[*image.mean(axis=0), *image.std(axis=0), np.cov(image.T)[0, 1] / max(size)] for image in images])
    # Place, size and skew count alike, whatever their units.
    features = (features - features.mean(axis=0)) / np.maximum(features.std(axis=0), 1e-9)
    taken = [int(np.argmin((features**2).sum(axis=1)))]
    apart = ((features - features[taken[0]]) ** 2).sum(axis=1)
    while len(taken) < MOST_VIEWS:
        taken.append(int(np.argmax(apart)))
        apart = np.minimum(apart, ((features - features[taken[-1]]) ** 2).sum(axis=1))
    return np.array(sorted(taken))


def _pose(camera: Camera, points: Single, image: Single) -> tuple[Floats, Floats, float] | None:
    """Camera from board, and the RMS of the view in px; None where no pose is found or the board would be behind the camera."""
    import cv2

    flat = camera.undistort(image)
    if not np.isfinite(flat).all():
        return None
    # A plane seen from afar has two poses that nearly agree; both are refined, and the better one is taken.
    found, turns, shifts, _ = cv2.solvePnPGeneric(
        points.astype(np.float64), np.ascontiguousarray(flat), np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    best: tuple[Floats, Floats, float] | None = None
    for turn, shift in zip(turns, shifts, strict=True) if found else ():
        if not np.isfinite([turn, shift]).all():
            continue
        turn, shift = cv2.solvePnPRefineLM(points.astype(np.float64), flat, np.eye(3), np.zeros(4), turn.copy(), shift.copy())
        rotation, place = rotation_from_vector(turn), np.asarray(shift, dtype=np.float64).ravel()
        seen = replace(camera, rotation=rotation, translation=place).project(points)
        error = float(np.sqrt(((seen - image) ** 2).sum(axis=1).mean()))
        if np.isfinite(error) and (best is None or error < best[2]):
            best = (rotation, place, error)
    return best
