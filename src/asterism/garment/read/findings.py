"""What speaks against an image of a printed garment."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Finding, Severity
from asterism.garment.pattern import Pattern
from asterism.garment.read.identify import Identified

_FEW = 9
"""Circles on a lattice: fewer hold no block of nine."""
_COLOURLESS = 12
"""Of 255: pixels of a colour image have channels that differ more."""
_CONTRAST = 60
"""Of 255: an image with less shows nothing at all."""
_WINDOWS = 12
"""So many blocks tell another garment from misread colours."""
_WHITE = 0.25
"""Share of white pixels from which on lamps or exposure hide colours."""
_SHARED = 0.05
"""Share of circles whose place on the sheet another circle has, too."""

_MIRRORED = Finding(
    "garment-mirrored",
    Severity.ERROR,
    "",
    "The image is mirrored.",
    "Turn off what mirrors it in the camera's program, or mirror it again.",
)
_SWAPPED = Finding(
    "garment-channels-swapped",
    Severity.ERROR,
    "",
    "Red and blue are exchanged in the image.",
    "Write images in the order that their format asks for; in Python, give blue, green, red, as OpenCV loads them.",
)
CHANGES: tuple[tuple[Callable[[NDArray[np.uint8]], NDArray[np.uint8]], tuple[Finding, ...]], ...] = (
    (lambda image: image[:, ::-1], (_MIRRORED,)),
    (lambda image: image[..., ::-1], (_SWAPPED,)),
    (lambda image: image[:, ::-1, ::-1], (_MIRRORED, _SWAPPED)),
)
"""What other programs do to images (h, w, 3) of a garment, and what to say where undoing it shows the pattern."""


def reading_findings(
    image: NDArray[np.uint8], linked: NDArray[np.bool_], grey: bool, found: Identified, pattern: Pattern, most: int
) -> tuple[Finding, ...]:
    """Findings of one image; docs/findings.md has the cause and the mend of each.

    linked (n,) are the circles on a lattice; grey says that their colours do not differ; most circles are looked for.
    """
    return (*_light(image), *_crowd(len(linked), most), *_circles(image, linked, grey), *_identities(linked, found, pattern))


def _light(image: NDArray[np.uint8]) -> Iterator[Finding]:
    # Each eighth pixel is enough for a share.
    sample = image[::8, ::8]
    white = float(np.mean((sample[..., 0] >= 250) & (sample[..., 1] >= 250) & (sample[..., 2] >= 250)))
    if white > _WHITE:
        mend = "Shorten the exposure or dim the lamps."
        yield Finding("garment-overexposed", Severity.WARNING, "", f"{white:.0%} of the image is white.", mend)


def _crowd(circles: int, most: int) -> Iterator[Finding]:
    if circles >= most:
        sentence = f"{circles} coloured spots were found, which is as many as are read; those below them in the image were left out."
        mend = "Light the cloth alone or come nearer; in Python, raise `ReadRules.most_circles`."
        yield Finding("garment-many-circles", Severity.WARNING, "", sentence, mend)


def _circles(image: NDArray[np.uint8], linked: NDArray[np.bool_], grey: bool) -> Iterator[Finding]:
    few = int(linked.sum()) < _FEW
    sample = image[::2, ::2] if few else image[:1, :1]
    if few and float(np.percentile(np.ptp(sample, axis=2), 99.9)) < _COLOURLESS and int(np.ptp(sample)) > _CONTRAST:
        # A picture with contrast and no colours was taken in black and white, which hides the circles.
        grey = True
    elif few:
        mend = "Come nearer, so that circles have 5 px or more, light the cloth, and see that it is in focus and faces the camera."
        sentence = f"{int(linked.sum())} circles on a lattice were found."
        yield Finding("garment-no-circles", Severity.ERROR, "", sentence, mend)
        return
    if grey:
        mend = "Record in colour, under lamps that have all colours."
        yield Finding("garment-no-colours", Severity.ERROR, "", "The image has no colours that differ.", mend)


def _identities(linked: NDArray[np.bool_], found: Identified, pattern: Pattern) -> Iterator[Finding]:
    # Too few blocks tell chance from another garment.
    if found.windows < _WINDOWS:
        return
    chance, share = chance_share(pattern), found.existing / found.windows
    # Both must hold: misread colours lower the share of blocks, but a few places are still found.
    if share < 0.5 * (1 + chance) and (found.grid[:, 0] >= 0).sum() < 0.2 * linked.sum():
        sentence = f"Of {found.windows} blocks read, {share:.0%} are in this pattern; by chance it would be {chance:.0%}."
        mend = "Give the garment file of this cloth. If it is the right one, mend light, focus or print."
        yield Finding("garment-other-pattern", Severity.ERROR, "", sentence, mend)
    if found.shared > _SHARED * max(found.shared + int((found.grid[:, 0] >= 0).sum()), 1):
        sentence = f"{found.shared} circles are at places of the sheet that other circles have, too; they were left out."
        mend = "Film one garment of a pattern at a time, or print the second one with another seed."
        yield Finding("garment-twice", Severity.WARNING, "", sentence, mend)


def chance_share(pattern: Pattern) -> float:
    """The share of blocks of nine colours by chance that the pattern has.

    An identity's ring has eight shifts (GaMoCap 2.1), of which a square grid makes four: the reader knows which circles are at the corners.
    """
    return float(4 * len(pattern.known) / pattern.q**9)
