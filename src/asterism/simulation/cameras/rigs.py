"""Numbers or a random generator in; rigs like those of laboratories out. The room's z points up, the volume is around its origin."""

from __future__ import annotations

import numpy as np

from asterism.cameras import Camera, Rig
from asterism.cameras.aim import looking
from asterism.errors import AsterismError
from asterism.recording import Floats

SIZES = ((640, 480), (1280, 720), (1280, 1024), (1920, 1080), (2048, 1088), (2352, 1728))
TARGET_HEIGHT = 0.9
"""Where cameras look, in metres above the floor."""


def ring_rig(
    cameras: int = 8,
    radius: float = 4.0,
    height: float = 2.5,
    size: tuple[int, int] = (1280, 1024),
    focal: float | None = None,
    distortion: bool = True,
    *,
    rng: np.random.Generator | None = None,
) -> Rig:
    """Cameras on a circle, at equal angles, all of one kind, looking at the volume around (0, 0, 0.9) m.

    radius, height  m, of the circle
    size            px, of each image
    focal           px; by default 0.86 of the width, a lens of 60 degrees
    distortion      whether the lenses have a barrel distortion of 6 % in the image's corners
    rng             hangs each camera a little elsewhere (0.15 m, 2 degrees, 1 % of the focal length, principal points off the centre),
                    as hands do; without it the circle is exact
    Raises AsterismError where a number is not positive.

    >>> rig = ring_rig(4, radius=3.0)
    >>> rig.names, rig.cameras[0].position.round(3).tolist()
    (('c1', 'c2', 'c3', 'c4'), [3.0, 0.0, 2.5])
    """
    focal = 0.86 * size[0] if focal is None else focal
    if cameras < 1 or not min(radius, *size, focal) > 0:
        raise AsterismError("a ring needs at least one camera, and a positive radius, image size and focal length.")
    hung = []
    for i in range(cameras):
        angle = 2 * np.pi * i / cameras
        # Drawn even where it is small: camera k has the same jitter whatever the others are.
        jitter = np.zeros(9) if rng is None else rng.normal(size=9)
        place = np.array([radius * np.cos(angle), radius * np.sin(angle), height]) + 0.15 * jitter[:3]
        target = np.array([0.0, 0.0, TARGET_HEIGHT]) + 0.15 * jitter[3:6]
        of_camera = focal * (1 + 0.01 * jitter[6])
        off = 0.01 * size[0] * jitter[7:]
        hung.append(_camera(f"c{i + 1}", place, target, 0.035 * jitter[5], size, of_camera, off, (-0.06 if distortion else 0.0, 0.0)))
    return Rig(tuple(hung), vertical=np.array([0.0, 0.0, 1.0]))


def random_rig(cameras: int | None = None, *, rng: np.random.Generator) -> Rig:
    """A rig as somebody may have hung it: every camera of a different kind, all looking at parts of one volume around (0, 0, 0.9) m.

    By default 3 to 12 cameras, all around or on one side (at least 120 degrees), 2.5 to 6 m away and 0.4 to 3.5 m high, rolled by up to
    8 degrees; images of 640 x 480 to 2352 x 1728; lenses that see 38 to 80 degrees, and at least 0.9 m around where they look;
    distortion in the corners from -15 % (barrel) to 3 %; principal points 1 % off the centre.
    """
    count = int(rng.integers(3, 13)) if cameras is None else cameras
    if count < 1:
        raise AsterismError("a rig needs at least one camera.")
    # From a third of a circle to all around: rooms have walls.
    arc = rng.uniform(2 * np.pi / 3, 2 * np.pi)
    step = arc / max(count, 2)
    start = rng.uniform(0, 2 * np.pi)
    same_size = SIZES[int(rng.integers(len(SIZES)))] if rng.random() < 0.5 else None
    hung = []
    for i in range(count):
        angle = start + step * (i + rng.uniform(-0.3, 0.3))
        distance = rng.uniform(2.5, 6.0)
        place = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(0.4, 3.5)])
        target = np.array([0.0, 0.0, TARGET_HEIGHT]) + rng.normal(0.0, 0.2, 3)
        size = same_size or SIZES[int(rng.integers(len(SIZES)))]
        # A lens that sees less than the person from there would make a camera without use.
        narrowest = 2 * np.arctan2(0.9, np.linalg.norm(target - place))
        view = max(np.radians(rng.uniform(38, 80)), narrowest * size[0] / size[1])
        focal = 0.5 * size[0] / np.tan(0.5 * view)
        off = 0.01 * size[0] * rng.normal(size=2)
        hung.append(
            _camera(
                f"c{i + 1}", place, target, rng.uniform(-0.14, 0.14), size, focal, off, (rng.uniform(-0.15, 0.03), rng.uniform(-0.02, 0.02))
            )
        )
    return Rig(tuple(hung), vertical=np.array([0.0, 0.0, 1.0]))


def _camera(
    name: str,
    place: Floats,
    target: Floats,
    roll: float,
    size: tuple[int, int],
    focal: float,
    off: Floats,
    distortion: tuple[float, float],
) -> Camera:
    """A camera at a place (3,) m that looks at a target (3,) m.

    roll        rad
    off         (2,) px, of the principal point
    distortion  by which share the r2 and r4 terms change the radius in the image's corners
    """
    rotation, translation = looking(place, target, roll)
    # Distortion is given for the corner, where it is seen; the coefficient is by the squared radius.
    corner = (size[0] ** 2 + size[1] ** 2) / (2 * focal) ** 2
    centre = (0.5 * (size[0] - 1) + float(off[0]), 0.5 * (size[1] - 1) + float(off[1]))
    return Camera(name, size, (focal, focal), centre, rotation, translation, radial=(distortion[0] / corner, distortion[1] / corner**2))
