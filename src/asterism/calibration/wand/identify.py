"""Blobs in; which of them single images take for the markers of a wand, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand import _kernels
from asterism.errors import AsterismError
from asterism.recording import Blobs, Floats, Ints

LONGEST_M, SHORTEST_M = 4.0, 0.02
"""m: no wand is longer or shorter. Lengths beyond are millimetres or centimetres, or a mistake."""
_MILLIMETRES_FROM = 80.0
"""A length beyond this can only be millimetres; between 4 and 80 it may be centimetres."""
LIKE_ITS_MIRROR = 0.12
"""Wands whose middle marker is nearer than this share of their length to the middle look alike from both ends, in perspective."""


@dataclass(frozen=True)
class WandSearchRules:
    """What three blobs of one image must fulfil to be a wand.

    depth_ratio  one end is at most this many times as far from the camera as the other; a wand of 0.6 m that points at the camera
                 reaches 1.7 at 0.86 m
    shortest     px between the ends; the direction of shorter wands is too uncertain
    slack, bend  px, and share of the length: how far the inner blob may lie off the line, by noise and by the lens

    Checked on the simulated and real wands of tests/test_wand.py and benchmarks/cameras/wand.py.
    """

    depth_ratio: float = 1.7
    shortest: float = 14.0
    slack: float = 1.2
    bend: float = 0.02


SEARCH = WandSearchRules()


@dataclass(frozen=True)
class Wand:
    """Markers in a line.

    lengths    (K,) m, ascending from 0: where each marker sits; one marker is a single moved dot
    symmetric  whether images leave open which end is which
    """

    lengths: Floats
    symmetric: bool

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def template(self) -> Floats:
        """(K, 3) m, along x."""
        return np.column_stack([self.lengths, np.zeros((len(self.lengths), 2))])


def wand_of(lengths: ArrayLike) -> Wand:
    """A wand from the positions of its markers along it, m, in any order.

    Raises AsterismError where they cannot be those of a wand: millimetres, four markers, two at one place.

    >>> wand_of([0.6, 0.0, 0.2]).lengths.tolist()
    [0.0, 0.2, 0.6]
    >>> wand_of([0.0, 0.3, 0.6]).symmetric
    True
    >>> wand_of([0, 200, 600])
    Traceback (most recent call last):
    asterism.errors.AsterismError: a wand of 600 m is no wand: the lengths look like millimetres; give metres: 0 0.2 0.6.
    """
    along = np.asarray(lengths, dtype=np.float64).ravel()
    given = " ".join(f"{length:g}" for length in along)
    if not 1 <= len(along) <= 3 or not np.isfinite(along).all():
        raise AsterismError(
            f"the wand {given} has {len(along)} markers; give the places of one, two or three in a line, such as 0 0.2 0.6."
        )
    along = np.sort(along - along.min())
    whole = along[-1]
    if len(along) > 1 and np.diff(along).min() <= 0.0:
        raise AsterismError(f"two markers of the wand {given} are at one place; give each its place along the wand in metres.")
    if whole > LONGEST_M:
        millimetres = whole > _MILLIMETRES_FROM
        metres = " ".join(f"{length / (1000.0 if millimetres else 100.0):g}" for length in along)
        raise AsterismError(
            f"a wand of {whole:g} m is no wand: the lengths look like {'millimetres' if millimetres else 'centimetres'}; "
            f"give metres: {metres}{'' if millimetres else ', if they are'}."
        )
    if len(along) > 1 and whole < SHORTEST_M:
        raise AsterismError(f"a wand of {whole * 1000:g} mm is too short to calibrate with; are its lengths {given} metres?")
    symmetric = len(along) < 3 or abs(float(along[1] / whole) - 0.5) < LIKE_ITS_MIRROR
    return Wand(along, symmetric)


def identify(blobs: Blobs, wand: Wand) -> Ints:
    """Which blobs each image by itself shows of the wand: (T, C, K) int, places in blobs.xy, -1 where it shows none for certain.

    Three markers are found among strays by line and ratio; two or one where there are no other blobs. The order of the markers may be
    the reverse one where the wand is symmetric.
    """
    frames, cameras, markers = len(blobs), len(blobs.cameras), len(wand.lengths)
    detections = np.full((frames * cameras, markers), -1, dtype=np.int64)
    if markers == 3:
        certain = np.zeros(len(detections), dtype=bool)
        share = float(wand.lengths[1] / wand.lengths[2])
        _kernels.find_lines(
            blobs.xy, blobs.offsets, share, SEARCH.depth_ratio, SEARCH.slack, SEARCH.bend, SEARCH.shortest, wand.symmetric,
            detections, certain,
        )  # fmt: skip
        detections[~certain] = -1
    else:
        # One or two dots have no shape that would tell them from strays, so only images without strays count.
        exact = np.nonzero(np.diff(blobs.offsets) == markers)[0]
        detections[exact] = blobs.offsets[exact, None] + np.arange(markers)
        if markers == 2:
            apart = np.linalg.norm(blobs.xy[detections[exact, 1]] - blobs.xy[detections[exact, 0]], axis=1)
            # Two markers this near each other are seen end on: which is which, and where the wand points, stay open.
            detections[exact[apart < SEARCH.shortest]] = -1
    return detections.reshape(frames, cameras, markers)
