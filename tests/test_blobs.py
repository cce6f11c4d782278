"""Blobs: rows in any order become cells of frame and camera."""

from __future__ import annotations

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.recording import Blobs


def test_rows_find_their_frame_and_camera() -> None:
    blobs = Blobs.from_rows([2, 0, 0, 2], [1, 0, 1, 1], [[5, 6], [1, 2], [3, 4], [7, 8]], ("left", "right"), sizes=[1, 2, 3, 4], frames=4)
    assert len(blobs) == 4
    assert blobs.counts.tolist() == [[1, 1], [0, 0], [0, 2], [0, 0]]
    assert blobs.of(2, 1).tolist() == [[5, 6], [7, 8]]
    assert blobs.sizes.tolist() == [2, 3, 1, 4]
    assert blobs.frame_of.tolist() == [0, 0, 2, 2]
    assert blobs.camera_of.tolist() == [0, 1, 1, 1]


def test_no_blobs_at_all_are_fine() -> None:
    blobs = Blobs.from_rows([], [], [], ("left",), frames=3)
    assert blobs.counts.tolist() == [[0], [0], [0]]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (([0], [2], [[1, 1]]), "camera number 2"),
        (([-1], [0], [[1, 1]]), "frame numbers"),
        (([0], [0], [[np.nan, 1]]), "NaN"),
        (([0, 1], [0], [[1, 1]]), "one of each"),
    ],
)
def test_impossible_rows_are_refused(rows: tuple, message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        Blobs.from_rows(*rows, ("left", "right"))
