"""Image sizes and a rig with known lenses in; the lens and the size of each camera out, checked against its blobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats


@dataclass(frozen=True)
class PlausibleInput:
    """What a user cannot have meant: bounds that no camera system reaches. Not tuned.

    shortest_side  px: no image has a shorter one
    beyond         share of an image's sides, and `beyond_px`, by which a blob's centre may lie outside: splitting and rounding move it
                   a little
    between_m      m: two cameras are not nearer to each other, or farther apart
    """

    shortest_side: int = 16
    beyond: float = 0.02
    beyond_px: float = 1.0
    between_m: tuple[float, float] = (0.01, 1000.0)


RULES = PlausibleInput()


def lenses_and_sizes(
    blobs: Blobs, sizes: Mapping[str, tuple[int, int]] | tuple[int, int] | None, known: Rig | None
) -> tuple[tuple[Camera | None, ...], tuple[tuple[int, int], ...]]:
    """The known lens (None where it is not known) and the image size of each camera.

    Raises AsterismError where a size is missing, cannot be, contradicts the known lens, or has blobs outside.
    """
    lenses: list[Camera | None] = []
    extents: list[tuple[int, int]] = []
    for c, name in enumerate(blobs.cameras):
        given = (sizes.get(name) if isinstance(sizes, Mapping) else sizes) or None
        lens = None
        if known is not None and name in known.names:
            lens = replace(known[name], rotation=np.eye(3), translation=np.zeros(3), posed=False)
        size = _size(name, given, lens)
        _check_inside(name, blobs.xy[blobs.camera_of == c], size)
        lenses.append(replace(lens, size=size) if lens is not None and lens.size is None else lens)
        extents.append(size)
    return tuple(lenses), tuple(extents)


def _size(name: str, given: tuple[int, int] | None, lens: Camera | None) -> tuple[int, int]:
    """The image size of a camera, by what was given and what its lens was calibrated for."""
    if lens is not None and lens.size is not None and given is not None and tuple(given) != lens.size:
        raise AsterismError(
            f"camera {name}: the image size given is {given[0]} x {given[1]}, but the rig says {lens.size[0]} x {lens.size[1]}; "
            "a lens is known for one image size only, so give the right rig or none."
        )
    size = given or (lens.size if lens is not None else None)
    if size is None:
        raise AsterismError(f"camera {name}: the size of its images is not known; give it, such as --image-size 1280x1024.")
    if min(size) < RULES.shortest_side:
        raise AsterismError(f"camera {name}: {size[0]} x {size[1]} px is too small for an image; give width x height.")
    return int(size[0]), int(size[1])


def _check_inside(name: str, xy: Floats, size: tuple[int, int]) -> None:
    """Raise AsterismError where blobs (n, 2) px lie outside their image."""
    if not len(xy):
        return
    low, high = xy.min(axis=0), xy.max(axis=0)
    beyond, px = RULES.beyond, RULES.beyond_px
    if low.min() < -beyond * size[0] - px or high[0] > (1 + beyond) * size[0] + px or high[1] > (1 + beyond) * size[1] + px:
        raise AsterismError(
            f"camera {name}: blobs lie between ({low[0]:.0f}, {low[1]:.0f}) and ({high[0]:.0f}, {high[1]:.0f}), outside "
            f"its image of {size[0]} x {size[1]} px; give the size of the images that they were found in."
        )


def check_distance(names: Sequence[str], distance: tuple[str, str, float]) -> None:
    """Raise AsterismError where a distance between two cameras (their names, and m) names an unknown one or is impossible."""
    for name in distance[:2]:
        if name not in names:
            raise AsterismError(f"a distance to camera {name} is given, but the cameras are {', '.join(names)}.")
    if distance[0] == distance[1] or not RULES.between_m[0] < distance[2] < RULES.between_m[1]:
        raise AsterismError(
            f"a distance of {distance[2]:g} m from camera {distance[0]} to camera {distance[1]} is not possible; give metres between two."
        )
