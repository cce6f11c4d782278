"""A file with points that have no name in; what can be said of them before anything is labelled, out: for `asterism info`."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from asterism import formats
from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.recording import Recording
from asterism.recording.marker_set import is_unnamed
from asterism.session.worn import FRAMES_TO_FIND, SetFinder
from asterism.tracking.linking import find_tracklets

_MOST_POINTS = 2_000_000
"""Points that are linked to pieces: an hour of a small set, or a minute of a large one with its ghosts, takes some seconds."""


def described_unnamed(path: Path) -> dict[str, Any]:
    """What a recording with unnamed points shows; empty where all its points have names. Plain values, for JSON.

    points_per_frame  the fewest, the median and the most points of a frame, of frames without points too
    empty_frames      frames without a point
    pieces            unbroken paths: how many, their median length in frames and in s, and how many last a single frame; of how many frames
                      they are, where the recording is too long to link all of it
    heights           m above 0, along the vertical: the usual lowest and highest point of a frame, which show a wrong unit of length
    people            one entry for each body that is like a shipped marker set: see `WornMarkers.to_dict`; and `words`
    no_people         why none is, or None
    people_vertical   another vertical with which these are bodies; None where they are with that of the file

    Where it is not known what points up, heights and people are left out.
    """
    recording, upright = _read(path)
    if recording is None or not any(is_unnamed(label) for label in recording.labels):
        return {}
    clouds = recording.clouds()
    counts = np.asarray(clouds.counts)
    if not counts.any():
        return {}
    frames = int(np.searchsorted(np.cumsum(counts), _MOST_POINTS, side="right")) if counts.sum() > _MOST_POINTS else len(counts)
    tracklets = find_tracklets(clouds.frames(slice(0, max(1, frames))))
    lengths = tracklets.last - tracklets.first + 1
    typical = float(np.median(lengths))
    found: dict[str, Any] = {
        "points_per_frame": {"fewest": int(counts.min()), "median": float(np.median(counts)), "most": int(counts.max())},
        "empty_frames": int((counts == 0).sum()),
        "pieces": {
            "number": len(lengths),
            "median_frames": typical,
            "median_seconds": typical / recording.rate,
            "single_frames": int((lengths == 1).sum()),
            "of_frames": frames,
        },
    }
    if not upright:
        return found
    height, shown = rotate_z_up(clouds.xyz, clouds.vertical)[:, 2], counts > 0
    starts = clouds.offsets[:-1][shown]
    ends = (np.minimum.reduceat(height, starts), np.maximum.reduceat(height, starts))
    return {**found, "heights": [float(np.median(end)) for end in ends], **_people(path, recording)}


def _read(path: Path) -> tuple[Recording | None, bool]:
    """The recording, None where it can be described but not read; and whether it is known what points up."""
    # with an axis given, only what needs none is said
    for vertical in (None, "z"):
        with suppress(AsterismError):
            return formats.read(path, vertical=vertical), vertical is None
    return None, False


def _people(path: Path, recording: Recording) -> dict[str, Any]:
    """The bodies in view by the sets that they wear, as `asterism label` finds them without a model."""
    try:
        worn = SetFinder(files=[path]).of(path, recording.frames(slice(0, FRAMES_TO_FIND)))
    except AsterismError as problem:
        said = str(problem).removeprefix(f"{path}: ").replace(f"{path} ", "it ")
        return {"people": [], "no_people": said, "people_vertical": None}
    bodies, shown = [body for one in worn for body in one.bodies], worn[0].vertical
    found = {"people": [{**body.to_dict(), "second": None, "words": body.words} for body in bodies], "no_people": None}
    # `asterism label` takes this axis then
    turned = shown is not None and not np.allclose(shown, recording.vertical)
    return {**found, "people_vertical": [float(v) + 0.0 for v in shown] if turned and shown is not None else None}
