"""The first images of a recording in; nothing out, or the reason why the rest need not be read."""

from __future__ import annotations

from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.garment.footage import ColourFootage
from asterism.garment.pattern import Pattern
from asterism.garment.read import read_image

_ANOTHER = ("garment-other-pattern", "garment-no-colours", "garment-mirrored", "garment-channels-swapped")


def check_first_images(footage: ColourFootage, pattern: Pattern, rig: Rig) -> None:
    """Raise AsterismError where the first images are not of the rig's sizes, or where they show no circle of this garment but others.

    Images without any circle say nothing about the garment: somebody may come into view later. One image that shows this garment is enough.
    """
    number, images = next(iter(footage), (0, []))
    against: list[tuple[str, Finding]] = []
    for camera, image in zip(rig, images, strict=False):
        if image is None:
            continue
        size = (int(image.shape[1]), int(image.shape[0]))
        if camera.size is not None and size != camera.size:
            raise AsterismError(
                f"the images of camera {camera.name} are {size[0]} x {size[1]}, the rig was calibrated for {camera.size[0]} x "
                f"{camera.size[1]}; film in that size, or calibrate again."
            )
        found = [finding for finding in read_image(image, pattern).findings if finding.code in _ANOTHER]
        if not found:
            return
        against.append((camera.name, found[0]))
    if against:
        name, finding = against[0]
        raise AsterismError(f"frame {number} of camera {name} does not show this garment: {finding}")
