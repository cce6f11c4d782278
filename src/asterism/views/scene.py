"""A rig and blobs in; undistorted blobs and cameras as the kernels take them out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera, Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints
from asterism.views.arrays import PinholeArrays
from asterism.views.detection import detection_shares
from asterism.views.rules import RULES


@dataclass(frozen=True, eq=False)
class ViewsScene:
    """Blobs of all frames before a rig.

    rig       the cameras that have blobs, in their order
    blobs     the blobs as they came
    xy        (P, 2) px of the undistorted image, from the principal point; far outside where the lens model has no ray
    cameras   the rig for the kernels
    area      px2, of the mean image
    vertical  (3,) unit vector, up
    """

    rig: Rig
    blobs: Blobs
    xy: Floats
    cameras: PinholeArrays
    area: float
    vertical: Floats

    def frame(self, t: int) -> tuple[Floats, Ints]:
        """Blobs of a frame (N, 2) px and where each camera's begin (C + 1,)."""
        count = len(self.rig)
        offsets = self.blobs.offsets[t * count : (t + 1) * count + 1]
        return self.xy[offsets[0] : offsets[-1]], offsets - offsets[0]

    def without(self, cameras: Ints) -> ViewsScene:
        """The same scene without the blobs of some cameras, which stay in the rig."""
        kept = ~np.isin(self.blobs.camera_of, cameras)
        return replace(self, blobs=self.blobs.select(kept), xy=self.xy[kept])

    def before(self, rig: Rig) -> ViewsScene:
        """The same blobs before a rig whose cameras stand and look otherwise."""
        poses = {"rotations": [c.rotation for c in rig], "translations": [c.translation for c in rig], "eyes": [c.position for c in rig]}
        cameras = self.cameras._replace(**{name: np.ascontiguousarray(values) for name, values in poses.items()})
        return replace(self, rig=rig, cameras=cameras)

    def mirrored(self, cameras: list[int]) -> ViewsScene:
        """The same scene with the images of some cameras mirrored left to right."""
        xy = self.blobs.xy.copy()
        for c in cameras:
            own = self.blobs.camera_of == c
            xy[own, 0] = _size(self.rig.cameras[c], xy[own])[0] - 1.0 - xy[own, 0]
        blobs = replace(self.blobs, xy=xy)
        return replace(self, blobs=blobs, xy=_undistorted(blobs, self.rig))


def scene_of(blobs: Blobs, rig: Rig, *, usual: float = RULES.shown) -> ViewsScene:
    """Blobs and a rig whose cameras have the same names, in the order of the blobs.

    usual: the share of the markers in its view of which a camera has a blob, where it is as good as any.

    Raises AsterismError where a camera is not in the rig, has no pose or no image size, or the rig does not say what is up.
    """
    absent = [name for name in blobs.cameras if name not in rig.names]
    if absent:
        raise AsterismError(
            f"the rig has no camera {absent[0]}; it has {', '.join(rig.names)}. Give the rig with which the blobs were recorded."
        )
    rig = rig.select(blobs.cameras)
    if rig.vertical is None:
        raise AsterismError("the rig does not say which way is up; calibrate it with an L-frame, or write `vertical` into its file.")
    for camera in rig:
        if not camera.posed:
            raise AsterismError(f"camera {camera.name} has no pose; calibrate the rig.")
    # Without a size in the rig, the blobs tell how far the image reaches at least.
    sizes = [_size(camera, blobs.xy[blobs.camera_of == c]) for c, camera in enumerate(rig)]
    xy = _undistorted(blobs, rig)
    detected = np.minimum(detection_shares(blobs, sizes, usual) / usual, 1.0)
    cameras = camera_arrays(rig, sizes)._replace(detected=detected)
    return ViewsScene(rig, blobs, xy, cameras, float(np.mean([width * height for width, height in sizes])), np.asarray(rig.vertical))


def _undistorted(blobs: Blobs, rig: Rig) -> Floats:
    """(P, 2) px, see `ViewsScene.xy`."""
    xy = np.empty(blobs.xy.shape)
    for c, camera in enumerate(rig):
        own = blobs.camera_of == c
        # A pixel without a ray is put far outside, where no marker is expected.
        xy[own] = np.nan_to_num(camera.undistort(blobs.xy[own]), nan=1e3) * np.array(camera.focal)
    return xy


def _size(camera: Camera, xy: Floats) -> tuple[float, float]:
    """px, width and height; where the rig does not say, as far as blobs reach."""
    if camera.size is not None:
        return float(camera.size[0]), float(camera.size[1])
    reach = xy.max(axis=0, initial=0.0) if len(xy) else np.zeros(2)
    return float(max(2 * camera.centre[0], reach[0], 1.0)), float(max(2 * camera.centre[1], reach[1], 1.0))


def camera_arrays(rig: Rig, sizes: list[tuple[float, float]]) -> PinholeArrays:
    """The rig for the kernels; sizes (C,) px, width and height of the images."""
    limits = []
    for camera, (width, height) in zip(rig, sizes, strict=True):
        # A lens bends the borders, so the limits are those of the whole outline and not of the corners.
        along, across = np.linspace(-0.5, width - 0.5, 17), np.linspace(-0.5, height - 0.5, 17)
        border = [(x, y) for x in along for y in (-0.5, height - 0.5)] + [(x, y) for y in across for x in (-0.5, width - 0.5)]
        flat = camera.undistort(np.array(border))
        flat = flat[np.isfinite(flat[:, 0])] * np.array(camera.focal)
        low, high = (flat.min(axis=0), flat.max(axis=0)) if len(flat) else (np.full(2, -1e4), np.full(2, 1e4))
        limits.append([low[0], high[0], low[1], high[1]])
    return PinholeArrays(
        np.ascontiguousarray([camera.rotation for camera in rig]),
        np.ascontiguousarray([camera.translation for camera in rig]),
        np.array([camera.focal for camera in rig], dtype=np.float64),
        np.ascontiguousarray([camera.position for camera in rig]),
        np.array(limits, dtype=np.float64),
        np.ones(len(rig)),
    )


def cameras_with_blobs(offsets: Ints) -> NDArray[np.bool_]:
    """(C,) which cameras have a blob in a frame."""
    some: NDArray[np.bool_] = np.diff(offsets) > 0
    return some
