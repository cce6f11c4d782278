"""A photo of a printed garment in; how many of its colours can be misread, without any truth, out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from asterism.findings import Finding, Severity
from asterism.garment.pattern import Pattern
from asterism.garment.read import ReadCircles, read_image
from asterism.garment.read.findings import chance_share

_BLOCK = 9
_LEVEL = 0.95
_MANY_MISREAD = 0.02
"""Of colours: from here on one block in six is lost."""
_SMALL = 5.0
"""px, diameter from which on circles are read surely (seen on simulated garments)."""
_FEW_BLOCKS = 90
"""Blocks read: ten that share no circle, fewer bound nothing."""


@dataclass(frozen=True)
class PhotoCheck:
    """What a photo says about itself.

    circles     found in the image
    identified  of them, with an identity
    diameter    px, median of the longer diameters of identified circles; NaN without any
    windows     blocks of 3 x 3 that were read whole
    existing    of them, in the pattern
    chance      share of blocks of nine random colours that are in the pattern
    misread     share of colours that are misread, estimated; NaN, as the next three, where it is unknown: where fewer than nine blocks were
                read, all of which may share one circle, and where the image shows another pattern
    misread_most    and at most, with 95 % probability
    wrong_blocks    share of blocks that are in the pattern by a misread, estimated: before the grid confirms them
    wrong_blocks_most   and at most, with 95 % probability
    findings    what speaks against the photo
    """

    circles: int
    identified: int
    diameter: float
    windows: int
    existing: int
    chance: float
    misread: float
    misread_most: float
    wrong_blocks: float
    wrong_blocks_most: float
    findings: tuple[Finding, ...]

    @property
    def share(self) -> float:
        """Of blocks read, those that are in the pattern; NaN without any."""
        return self.existing / self.windows if self.windows else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Plain values; findings by their own `to_dict`."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "findings"}
        return {**plain, "share": self.share, "findings": [finding.to_dict() for finding in self.findings]}


def check_photo(image: NDArray[np.uint8], pattern: Pattern) -> PhotoCheck:
    """Read an image (h, w, 3) uint8 blue, green, red, and bound the rate of misread colours by the blocks that do not exist.

    A block with a misread colour is in the pattern by chance only, with probability `chance`; all others are. So of the blocks read,
    (1 - m) + m chance exist, where m is the share of blocks with a misread colour, and m = 1 - (1 - e)^9 for a share e of misread colours.
    One misread colour spoils up to nine blocks, which are not independent: the bound is that of Clopper and Pearson for a ninth of the
    blocks. What the grid's consistency takes out after that is not counted. Raises AsterismError where the image cannot be read.
    """
    return judge_reading(read_image(image, pattern), pattern)


def judge_reading(read: ReadCircles, pattern: Pattern) -> PhotoCheck:
    """The check of what was read; see `check_photo`."""
    chance = chance_share(pattern)
    blocks, blocks_most = misread_blocks(read.windows, read.existing, chance)
    # Blocks of another garment are in this pattern by chance, however well their colours were read.
    if any(finding.severity is Severity.ERROR for finding in read.findings):
        blocks = blocks_most = float("nan")
    named = read.ids >= 0
    diameter = float(np.median(2 * read.axes[named, 0])) if named.any() else float("nan")
    checked = PhotoCheck(
        circles=len(read),
        identified=int(named.sum()),
        diameter=diameter,
        windows=read.windows,
        existing=read.existing,
        chance=chance,
        misread=_of_colours(blocks),
        misread_most=_of_colours(blocks_most),
        wrong_blocks=blocks * chance,
        wrong_blocks_most=blocks_most * chance,
        findings=(),
    )
    return PhotoCheck(**{**checked.__dict__, "findings": (*read.findings, *_findings(checked, read))})


def misread_blocks(windows: int, existing: int, chance: float) -> tuple[float, float]:
    """The share of blocks with a misread colour, estimated and at most (95 %), from how many of the blocks read exist; NaN of too few."""
    if windows < _BLOCK:
        return float("nan"), float("nan")
    # One misread colour spoils up to nine blocks, so a ninth of them counts as independent.
    missing = 1.0 - existing / windows
    apart = windows / _BLOCK
    most = float(beta.ppf(_LEVEL, apart * missing + 1.0, max(apart * (1.0 - missing), 1e-9)))
    return min(1.0, missing / (1.0 - chance)), min(1.0, most / (1.0 - chance))


def _of_colours(blocks: float) -> float:
    """The share of misread colours where so many blocks have one."""
    return 1.0 - (1.0 - blocks) ** (1.0 / _BLOCK)


def _findings(checked: PhotoCheck, read: ReadCircles) -> list[Finding]:
    """What speaks against the photo beside what the reader said itself."""
    # What made the image unreadable has been said; all else follows from it.
    if any(finding.severity is Severity.ERROR for finding in read.findings):
        return []
    found = []
    if checked.windows < _FEW_BLOCKS:
        mend = "Take a photo in which more of the cloth is seen from the front."
        bound = f"bound the misreads to {checked.misread_most:.1%} only"
        unknown = "say nothing about misreads"
        sentence = f"{checked.windows} blocks were read, which {unknown if np.isnan(checked.misread) else bound}."
        found.append(Finding("garment-few-blocks", Severity.WARNING, "", sentence, mend))
    if checked.misread > _MANY_MISREAD:
        mend = "Use lamps that have all colours, mend exposure and focus, and compare the printed card's colours with the planned ones."
        sentence = f"{checked.misread:.1%} of the colours are misread."
        found.append(Finding("garment-misread", Severity.WARNING, "", sentence, mend))
    if checked.diameter < _SMALL:
        mend = "Come nearer, take a longer lens, or print larger circles."
        sentence = f"Circles have {checked.diameter:.1f} px; {_SMALL:g} px or more are read surely."
        found.append(Finding("garment-small-circles", Severity.WARNING, "", sentence, mend))
    return found
