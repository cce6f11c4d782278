"""The kernels that a first labelling needs late, compiled ahead: `python -m asterism.labelling.compile_ahead STEP ...`.

Numba compiles in one thread. Where no earlier run has compiled the kernels, the command line starts this module as a second process: it
compiles those of later steps into the compile cache while the command itself compiles those of its first. The kernels are called with
next to nothing: only the types of the arguments count.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, get_type_hints

import numpy as np

from asterism.recording import Clouds, Floats, Ints

__all__ = ["STEPS", "main"]


def compile_tracking() -> None:
    """Compile what links points to tracklets, with track numbers and without: three frames of one point."""
    from asterism.tracking.linking import find_tracklets

    frames = [_floats(1, 3)] * 3
    find_tracklets(Clouds.from_points(frames, 100.0))
    find_tracklets(Clouds.from_points(frames, 100.0, tracks=[_ints(1)] * 3))


def compile_whole() -> None:
    """Compile what decides on the labels of each recording as a whole, after its frames were labelled.

    Kernels that only some recordings need are left to the run that needs them.
    """
    from asterism.labelling.body._workspace_kernels import BodyArrays, FrameSettings
    from asterism.labelling.whole._distance_kernels import DistanceLimits, TrackedPoints, training_deviations
    from asterism.labelling.whole._kernels import (
        FrameScores,
        best_split,
        margins_of,
        overlaps,
        rivals_weight,
        score_frames,
        settle_dominant,
        sum_scores,
    )
    from asterism.labelling.whole._short_kernels import Expected, ShortLabels, ShortLimits, label_short
    from asterism.labelling.whole._twin_kernels import TwinScores, score_exchanges, score_twins

    body = BodyArrays(
        mean=_floats(0, 0, 3),
        whiten=_floats(0, 0, 3, 3),
        load=_floats(0, 0, 3, 0),
        load_by_latent=_floats(0, 0, 0),
        gram=_floats(0, 0, 0),
        full=_floats(0, 0),
        spread=_floats(0, 0, 3, 3),
        log_scale=_floats(0, 0),
        log_weight=_floats(0),
    )
    xyz, offsets, track, label, gain = _floats(0, 3), np.zeros(1, dtype=np.int64), _ints(0), _ints(0), _floats(0, 1)
    settings, none = _zeros(FrameSettings), np.zeros(0, dtype=np.bool_)
    score_frames(xyz, offsets, track, label, body, settings, FrameScores(_floats(0, 0), _floats(0), _ints(0)))
    points, limits = TrackedPoints(xyz, track, track, 0), _zeros(DistanceLimits)
    training_deviations(points, label, _floats(0, 0), _floats(0, 0), limits, _floats(0))
    sum_scores(track, _floats(0, 0), 0.0, 0.0, _floats(0, 0), _floats(0))
    pairs = overlaps(gain, track, track, track)
    rivals_weight(gain, pairs, track, track, track, _floats(0))
    settle_dominant(gain, pairs, 1)
    best_split(gain)
    margins_of(gain, label, track, track, track)
    score_exchanges(xyz, offsets, track, label, body, settings, _floats(0, 0), _ints(0, 0), _ints(0, 0))
    twins = TwinScores(_floats(0, 0), _ints(0, 0, 0))
    score_twins(xyz, offsets, track, label, _ints(0, 0), body, settings, 0.0, 0.0, 0, none, twins)
    short = ShortLabels(label, _floats(0), none, none, _ints(0, 4), _ints(0, 4))
    label_short(xyz, offsets, none, body, settings, _zeros(ShortLimits), Expected(_floats(0, 0, 3), _floats(0, 0)), short)


STEPS: dict[str, Callable[[], None]] = {"tracking": compile_tracking, "whole": compile_whole}
"""What can be compiled ahead, by name."""


def main(steps: Sequence[str]) -> None:
    """Compile steps of `STEPS`, one after the other."""
    for step in steps:
        STEPS[step]()


def _floats(*shape: int) -> Floats:
    return np.zeros(shape)


def _ints(*shape: int) -> Ints:
    return np.zeros(shape, dtype=np.int64)


def _zeros(settings: type[Any]) -> Any:
    """Settings, a named tuple, whose fields are 0, each of the type that it is annotated with."""
    return settings(*(kind(0) for kind in get_type_hints(settings).values()))


if __name__ == "__main__":
    main(sys.argv[1:])
