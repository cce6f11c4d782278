"""Kernels of synchrony: blobs of two cameras in; how many of one's lie on the other's epipolar lines, at each lag, out."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def crossing(flat, offsets, cameras, a, b, frames, essential, near, longest, crowd, fewest, scores):
    """The share of one camera's blobs that have one of another's on their epipolar line, at each lag of the other.

    IN  flat (P, 2): blobs on their cameras' normalized planes; offsets (T * C + 1,): frame t of camera c owns flat[offsets[t * C + c]:
        offsets[t * C + c + 1]]; cameras: C; a, b: the two; frames (F,): those of a that are looked at; essential (3, 3): from a to b;
        near: distance from a line at which a blob is on it; longest: lags from -longest to longest; crowd: frames of b with more blobs
        are passed over; fewest: frames that a lag must share
    OUT scores (2 longest + 1,), NaN where fewer frames are shared
    O(longest F blobs of a times those of b). Twin: tests/twins_detection.py
    """
    for lag in range(-longest, longest + 1):
        shared = asked = hits = 0
        for frame in frames:
            other = (frame + lag) * cameras + b
            # In a crowd every line has a blob nearby, which tells nothing.
            if not 0 <= frame + lag < (len(offsets) - 1) // cameras or not 0 < offsets[other + 1] - offsets[other] <= crowd:
                continue
            shared += 1
            for i in range(offsets[frame * cameras + a], offsets[frame * cameras + a + 1]):
                x, y = flat[i, 0], flat[i, 1]
                u = essential[0, 0] * x + essential[0, 1] * y + essential[0, 2]
                v = essential[1, 0] * x + essential[1, 1] * y + essential[1, 2]
                w = essential[2, 0] * x + essential[2, 1] * y + essential[2, 2]
                # The line's own length, so that distances are those on the normalised plane.
                within = near * math.sqrt(u * u + v * v)
                asked += 1
                for j in range(offsets[other], offsets[other + 1]):
                    if math.fabs(u * flat[j, 0] + v * flat[j, 1] + w) < within:
                        hits += 1
                        # One is enough: the share of blobs with a partner is asked, not how many partners.
                        break
        scores[lag + longest] = hits / asked if shared >= fewest and asked else np.nan
