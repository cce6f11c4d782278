"""Blobs of a recording in; how often each camera has a blob of what it sees, out: without labels, and so without any belief in a body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from asterism.recording import Blobs, Floats, Ints

_MOST_FRAMES = 240
"""Frames that are looked at: with ten blobs an image they give a share to within 1 %; half of them to within 1.4 %."""
_FASTEST = 0.01
"""Share of an image's diagonal that a blob may move in two frames: 14 px of a megapixel, a trunk that walks at 60 Hz. Half of it leaves
out walking people, twice as much pairs passing lights."""
_NEAR = 3.5
"""px beside the way from the frame before to the frame after within which the blob between is looked for: four times the usual noise."""
_BEFORE = 10.0
"""Sightings that what is usual counts for, so that a recording of a few frames changes little. Hundreds are usual, beside which it and its
half or double are nothing."""
_STEADY = 0.9
"""Share of the frames in which a light at one place is no marker. A marker that lies as still and is lost as rarely tells nothing new."""


def detection_shares(blobs: Blobs, sizes: list[tuple[float, float]], usual: float) -> Floats:
    """(C,) the share of the markers in its view of which each camera has a blob, in (0, 1].

    sizes (C,) px, width and height of the images; usual: the share that is expected before any blob.

    A marker that a camera shows in the frame before and in the frame after, nearly at the same place, is in its view between them: no
    body moves before it and away again so fast. So the share of such pairs with a blob between them is that of the camera, whoever is
    before it and wherever the body is thought to be. Left out are blobs with another one near, since either could be the other's, and
    lights that stay where they are. What is lost for longer than a frame at a time counts as hidden. O(frames C N^2) for N blobs of an
    image.
    """
    count, total = len(blobs.cameras), len(blobs)
    frames = np.unique(np.linspace(1, total - 2, min(_MOST_FRAMES, total - 2)).round().astype(np.int64)) if total > 2 else np.empty(0, int)
    shares = np.empty(count)
    for c, size in enumerate(sizes):
        fastest = _FASTEST * float(np.hypot(*size))
        moving = _moving(blobs, c, frames)
        seen, of = usual * _BEFORE, _BEFORE
        for t in frames.tolist():
            rows = [slice(*blobs.offsets[(t + d) * count + c :][:2]) for d in (-1, 0, 1)]
            before, here, after = (blobs.xy[each] for each in rows)
            # A frame without any blob was not taken at all.
            if not len(before) or not len(here) or not len(after):
                continue
            there = _between(before, here, after, fastest)[moving[rows[0]]]
            there = there[np.isfinite(there)]
            seen, of = seen + float(there.sum()), of + len(there)
        shares[c] = seen / of
    return shares


def _moving(blobs: Blobs, camera: int, frames: Ints) -> NDArray[np.bool_]:
    """(P,) which blobs of a camera are not at a place that has one in nearly all of these frames."""
    own = blobs.camera_of == camera
    looked_at = blobs.xy[own & np.isin(blobs.frame_of, frames)]
    moving = own.copy()
    if len(looked_at):
        moving[own] = cKDTree(looked_at).query_ball_point(blobs.xy[own], _NEAR, return_length=True) < _STEADY * len(frames)
    return moving


def _between(before: Floats, here: Floats, after: Floats, fastest: float) -> Floats:
    """(N,) for each blob of the frame before: 1 where a blob lies between it and the same marker's in the frame after, 0 where none does,
    NaN where nobody knows which one that is."""
    apart = np.linalg.norm(before[:, None] - after[None], axis=2)
    i, j = np.arange(len(before)), apart.argmin(axis=1)
    nearest = apart[i, j]
    reach = 0.5 * nearest + _NEAR
    apart[i, j] = np.inf
    # The nearest other blob on either side: a neighbour's could be taken for this one's.
    others = np.minimum(apart.min(axis=1), apart[:, j].min(axis=0))
    alone = (nearest <= fastest) & (others >= 3.0 * reach)
    off = np.linalg.norm(0.5 * (before + after[j])[:, None] - here[None], axis=2).min(axis=1)
    return np.where(alone, (off <= reach).astype(np.float64), np.nan)
