"""A place for eight ordinary colour cameras around a wearer."""

from __future__ import annotations

import numpy as np

from asterism.cameras import Camera, Rig
from asterism.cameras.aim import looking
from asterism.errors import AsterismError
from asterism.simulation.garment.suit import Wearer


def garment_rig(
    cameras: int = 8,
    size: tuple[int, int] = (1280, 960),
    radius: float = 2.7,
    wearer: Wearer | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> Rig:
    """Cameras in a ring, turned on their side, whose longer side the wearer fills.

    radius  m, of the ring; heights alternate between 0.7 and 1.5 m
    rng     hangs each camera a little elsewhere (30 mm), turns it (0.6 degrees), and gives it its own lens: focal length (1 %), principal
            point (8 px), distortion (-4 to 1 % of the radius in the corners); without it all are alike and without distortion

    Raises AsterismError where a number is not positive.
    """
    if cameras < 1 or not min(radius, *size) > 0:
        raise AsterismError("a rig needs at least one camera, and a positive radius and image size.")
    stature = (wearer or Wearer()).stature
    middle = np.array([0.0, 0.0, 0.505 * stature])
    # The wearer fills the longer side, with a little room.
    focal = 0.93 * max(size) * radius / stature
    hung = []
    for i in range(cameras):
        angle = 2 * np.pi * i / cameras + 0.2
        jitter = np.zeros(9) if rng is None else rng.normal(size=9)
        place = np.array([radius * np.cos(angle), radius * np.sin(angle), 1.1 + 0.4 * (-1) ** i]) + 0.03 * jitter[:3]
        # On their side: people are tall.
        rotation, translation = looking(place, middle + 0.015 * jitter[3:6], 0.5 * np.pi + 0.01 * jitter[6])
        own_focal = focal * (1 + 0.01 * jitter[7]) if rng is not None else focal
        centre = (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
        radial: tuple[float, ...] = ()
        if rng is not None:
            off = size[0] / 160 * rng.normal(size=2)
            centre = (centre[0] + float(off[0]), centre[1] + float(off[1]))
            corner = (size[0] ** 2 + size[1] ** 2) / (2 * own_focal) ** 2
            radial = (float(rng.uniform(-0.04, 0.01)) / corner,)
        hung.append(Camera(f"c{i + 1}", size, (own_focal, own_focal), centre, rotation, translation, radial=radial))
    return Rig(tuple(hung), vertical=np.array([0.0, 0.0, 1.0]))
