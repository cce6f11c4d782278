"""The first images of a recording in; nothing out, or the reason why the rest need not be read."""

from __future__ import annotations

from itertools import islice

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.garment.footage import ColourFootage
from asterism.garment.pattern import Pattern
from asterism.garment.read import read_image

_ANOTHER = ("garment-other-pattern", "garment-no-colours", "garment-mirrored", "garment-channels-swapped")
_BY_ACCIDENT = 1
"""Images of another size at the beginning that say nothing about the rest: one is a slip, a second one the camera's setting."""


def check_first_images(footage: ColourFootage, pattern: Pattern, rig: Rig) -> None:
    """Raise AsterismError where the first images are not of the rig's sizes, or where they show no circle of this garment but others.

    Images without any circle say nothing about the garment: somebody may come into view later. One image that shows this garment is enough.
    """
    for c, camera in enumerate(rig):
        _refuse_other_size(footage, c, camera.size)
    number, images = next(iter(footage), (0, []))
    against: list[tuple[str, Finding]] = []
    for camera, image in zip(rig, images, strict=False):
        if image is None:
            continue
        found = [finding for finding in read_image(image, pattern).findings if finding.code in _ANOTHER]
        if not found:
            return
        against.append((camera.name, found[0]))
    if against:
        name, finding = against[0]
        raise AsterismError(f"frame {number} of camera {name} does not show this garment: {finding}")


def _refuse_other_size(footage: ColourFootage, c: int, size: tuple[int, int] | None) -> None:
    """Raise AsterismError where a camera films in another size than its rig has: its first images have it, and not one by accident."""
    camera = footage.cameras[c]
    if size is None or not len(camera):
        return
    looked = list(islice(ColourFootage((camera,), camera.frames, (size,)), _BY_ACCIDENT + 1))
    if sum(finding.code == "garment-image-size" for finding in camera.findings) == len(looked):
        width, height = ColourFootage((camera,), camera.frames[: len(looked)]).sizes()[0]
        raise AsterismError(
            f"the images of camera {camera.name} are {width} x {height}, the rig was calibrated for {size[0]} x {size[1]}; film in that "
            "size, or calibrate again."
        )
