"""Images of printed cloth are read: every identity given is right, and what makes an image unreadable is said."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from garment_scenes import coded, photos, sleeve

from asterism.errors import AsterismError
from asterism.garment import Piece
from asterism.garment.read import ReadCircles, read_image
from asterism.simulation.garment import Photo


def judged(read: ReadCircles, photo: Photo, diameter: float = 6.0) -> tuple[int, int, float]:
    """Identities given, wrong ones, and the share of the readable circles that was given rightly."""
    truth = photo.truth
    place = {int(number): k for k, number in enumerate(truth.ids) if number >= 0}
    given = np.flatnonzero(read.ids >= 0)
    rows = np.array([place[int(number)] for number in read.ids[given]], dtype=int)
    right = np.linalg.norm(truth.centres[rows] - read.centres[given], axis=1) < 0.5 * truth.diameters[rows, 0]
    wanted = truth.ids[truth.readable(diameter) & (truth.ids >= 0)]
    return len(given), int((~right).sum()), float(np.isin(wanted, read.ids[given][right]).mean())


@pytest.mark.parametrize("noise", [0.005, 0.1], ids=["clean", "20 dB"])
def test_a_sleeve_is_read(noise: float) -> None:
    for photo in photos(noise=noise):
        read = read_image(photo.image, sleeve().pattern)
        given, wrong, recall = judged(read, photo)
        assert given > 50 and wrong == 0
        assert recall > 0.75, recall
        assert read.existing >= 0.95 * read.windows and not read.findings


def test_identities_of_another_pattern_are_not_given() -> None:
    other = coded(np.ones((24, 24), dtype=bool), (Piece("sheet", 0, 0, 24, 24),), seed=5)
    for photo in photos():
        assert (read_image(photo.image, other).ids < 0).all()


@pytest.mark.parametrize("value", [0, 90, 255])
def test_an_empty_image_has_no_circles(value: int) -> None:
    read = read_image(np.full((120, 160, 3), value, np.uint8), sleeve().pattern)
    assert len(read) == 0 and [f.code for f in read.findings][-1] == "garment-no-circles"


def test_a_black_and_white_image_has_no_identities() -> None:
    image = cv2.cvtColor(cv2.cvtColor(photos()[0].image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    read = read_image(image, sleeve().pattern)
    assert (read.ids < 0).all() and read.findings[0].code == "garment-no-colours"


def test_what_is_no_colour_image_is_refused() -> None:
    with pytest.raises(AsterismError, match="cannot be read"):
        read_image(np.zeros((20, 20), np.uint8), sleeve().pattern)
