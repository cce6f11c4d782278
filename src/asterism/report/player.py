"""Labelled recordings in; what the page's player shows of them, packed small, and the player's own script and style, out."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.geometry import rotate_z_up
from asterism.recording import Clouds, Floats, ForcePlate, Ints, Labelling, MarkerSet
from asterism.recording.sides import marker_sides
from asterism.report.figures import MOST_NINES, nines
from asterism.report.skeleton import marker_bones

WRONG, IN_QUESTION = 1, 2
"""Marks of a point: its label is known to be wrong; it is what the page asks about."""
HIDDEN, UNSURE, LOWEST, HIGHEST, WRONG_HERE = 0, 1, 2, 200, 255
"""A timeline's codes: no label and out of view, no label, labels of the lowest and the highest confidence, a wrong label."""
SCRIPTS = ("recording", "body", "camera", "scene", "timeline", "player")
_FARTHEST = 1e6
"""m: points that are farther from the origin are drawn there."""


@dataclass(frozen=True)
class PageRules:
    """How much of its recordings a page holds. Chosen so that a page of thirteen recordings is smaller than 2.5 MB.

    bytes       for all recordings of a page together, as they stand in it
    least_rate  frames per second: a recording that would be shown with fewer is not shown
    columns     columns of a timeline at most; each stands for a block of frames
    unit        m, to which positions are rounded
    fine        m, the same for bodies that span less than `small`
    small       m
    least_bytes of a point, of the smoothest recordings; where a search for the rate begins
    """

    bytes: int = 2_000_000
    least_rate: float = 2.0
    columns: int = 600
    unit: float = 1e-3
    fine: float = 1e-5
    small: float = 0.5
    least_bytes: float = 1.5


RULES = PageRules()


def player_script() -> str:
    """The player's script, which defines `Asterism`."""
    return "\n".join(template(f"player/{name}.js") for name in SCRIPTS)


def player_style() -> str:
    """The player's style sheet."""
    return template("player/player.css")


@dataclass(frozen=True)
class ShownRecording:
    """A labelled recording as the player shows it.

    labelling    of the clouds; its names are the markers
    first_frame  the number that the file gives its first frame
    unsure       (T, M) which markers have no label though they may be in view
    marks        (P,) int, sums of WRONG and IN_QUESTION for each point, or None
    marker_set   for sides and bones
    note         one line on the recording
    start        the frame that is shown at first
    chosen       the first frame that is shown, and the first that is not; by default all are
    sides        of the markers, "left", "right" or "middle"; by default by the marker set and their names
    names_shown  the names shown at first: "all", "doubtful" or "none"; by default all of up to 20 markers, else those in doubt
    plates       force plates, in the axes of the clouds, drawn with their forces
    cycles       of the feet, "left" or "right": from and to, and when the foot leaves the floor, s from the first frame
    """

    name: str
    labelling: Labelling
    clouds: Clouds
    first_frame: int = 1
    unsure: NDArray[np.bool_] | None = None
    marks: Ints | None = None
    marker_set: MarkerSet | None = None
    note: str = ""
    start: int = 0
    chosen: tuple[int, int] | None = None
    sides: Sequence[str] | None = None
    names_shown: str | None = None
    plates: Sequence[ForcePlate] = ()
    cycles: Sequence[tuple[str, float, float, float]] = ()


def pack_recordings(shown: Sequence[ShownRecording], rules: PageRules = RULES) -> list[dict[str, Any]]:
    """Each recording as the player takes it, within the bytes that the rules allow for all together.

    A recording that needs more than its share is shown with fewer frames per second, those with the fewest points first in line; one
    that fits with no rate is named, with its timeline, but not drawn.
    """
    out: list[dict[str, Any]] = [{} for _ in shown]
    left = rules.bytes
    # Small recordings take what they need; what they leave is shared by the large ones.
    order = sorted(range(len(shown)), key=lambda i: len(shown[i].clouds.xyz))
    for place, number in enumerate(order):
        packed = _within(shown[number], left / (len(order) - place), rules)
        left -= _size(packed)
        out[number] = packed
    return out


def _within(one: ShownRecording, room: float, rules: PageRules) -> dict[str, Any]:
    """One recording in so many bytes, with as many frames per second as fit."""
    about = _about(one, rules)
    # A first guess by the smallest size of a point; the loop enlarges it until it fits.
    step = max(1, int(rules.least_bytes * len(one.clouds.xyz) / max(room, 1.0)))
    while one.clouds.rate / step >= rules.least_rate or step == 1:
        packed = {**about, **_points(one, step, rules)}
        size = _size(packed)
        if size <= room:
            return packed
        # By the measured excess, so that few rounds are needed.
        step = max(step + 1, int(np.ceil(step * size / room))) if room > 0 else len(one.clouds) + step
    return {**about, "points": None}


def _size(packed: dict[str, Any]) -> int:
    return sum(len(packed[key]["data"]) for key in ("points", "timeline", "forces") if packed.get(key)) + 400


def _about(one: ShownRecording, rules: PageRules) -> dict[str, Any]:
    """What does not depend on the frames that are shown."""
    labelling, clouds = one.labelling, one.clouds
    positions = labelling.positions(clouds)
    sides = one.sides if one.sides is not None else marker_sides(labelling.names, one.marker_set)
    return {
        "name": one.name,
        "note": one.note,
        "markers": list(labelling.names),
        "side": list(sides),
        "bones": marker_bones(positions, labelling.names, one.marker_set),
        "rate": clouds.rate,
        "firstFrame": one.first_frame,
        "namesShown": one.names_shown,
        "timeline": None if one.unsure is None or not one.unsure.size else _timeline(one, rules),
        "cycles": [[side, *(round(time, 4) for time in times)] for side, *times in one.cycles],
    }


def _points(one: ShownRecording, step: int, rules: PageRules) -> dict[str, Any]:
    """The points of every `step`-th frame, packed: series of one marker or one track each, as differences."""
    from asterism.labelling.review import labels_of_points

    clouds = one.clouds
    frames = np.arange(*(one.chosen or (0, len(clouds))))[::step]
    number = np.full(len(clouds), -1)
    number[frames] = np.arange(len(frames))
    points = np.nonzero(number[clouds.frame_of] >= 0)[0]
    # Points, not markers: what bears no label is shown, too.
    marker, confidence = labels_of_points(one.labelling, clouds)
    series, marker_of_series, counts = _series(marker[points], clouds, points, len(one.labelling.names))
    # Series by series, in order of time: neighbours differ little, and small numbers pack well.
    points = points[np.lexsort((points, series))]
    frame = number[clouds.frame_of[points]]
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    # A coordinate of a million metres would cost all others their digits.
    xyz = np.clip(rotate_z_up(clouds.xyz[points], clouds.vertical), -_FARTHEST, _FARTHEST)
    unit = rules.fine if _span(xyz) < rules.small else rules.unit
    whole = np.rint(xyz / unit).astype(np.int64)
    marks = np.zeros(len(points), dtype=np.uint8) if one.marks is None else one.marks[points].astype(np.uint8)
    # First differences of frames, second ones of places: constant speed packs to zeros.
    parts = [varints(differences(frame, first, 1))]
    parts += [varints(zigzag(differences(whole[:, axis], first, 2))) for axis in range(3)]
    parts += [_codes(np.nan_to_num(confidence[points]), marker[points] >= 0), marks]
    start = int(np.searchsorted(frames, one.start)) if len(frames) else 0
    return {
        "points": {"lengths": [len(part) for part in parts], "data": deflated(np.concatenate(parts))},
        "unit": unit,
        "frames": len(frames),
        "step": step,
        "firstShown": int(frames[0]) if len(frames) else 0,
        "start": min(start, max(len(frames) - 1, 0)),
        "series": marker_of_series,
        "counts": counts,
        "forces": _forces(one, frames) if one.plates and len(frames) else None,
    }


def _forces(one: ShownRecording, frames: Ints) -> dict[str, Any]:
    """Corners of the plates, m, and packed for each frame: centre of pressure in mm, and force in N, both 0 without a load."""
    corners, parts = [], []
    for plate in one.plates:
        shown = plate.at(one.clouds.rate, len(one.clouds))
        loaded = shown.loaded & np.isfinite(shown.pressure).all(axis=1)
        corners.append(np.round(rotate_z_up(plate.corners, one.clouds.vertical), 3).tolist())
        for values, scale in ((shown.pressure, 1000.0), (shown.force, 1.0)):
            placed = np.where(loaded[:, None], np.nan_to_num(rotate_z_up(values, one.clouds.vertical)), 0.0)[frames]
            # The pointer of an unusual plate must not cost all others their digits.
            whole = np.rint(np.clip(scale * placed, -_FARTHEST, _FARTHEST)).astype(np.int64)
            first = np.zeros(1, dtype=np.int64)
            parts += [varints(zigzag(differences(whole[:, axis], first, 1))) for axis in range(3)]
    return {"corners": corners, "lengths": [len(part) for part in parts], "data": deflated(np.concatenate(parts))}


def _series(marker: Ints, clouds: Clouds, points: Ints, markers: int) -> tuple[Ints, list[int], list[int]]:
    """(N,) the series of each point, and for each series its marker, -1 for none, and its number of points.

    A series is a marker's points, or those of a track or column that bear no label.
    """
    track = clouds.columns if clouds.tracks is None else clouds.tracks
    # Labelled points by marker, others by track: each is a smooth path.
    key = np.where(marker >= 0, marker, markers + np.maximum(track[points], -1) + 1)
    keys, series, counts = np.unique(key, return_inverse=True, return_counts=True)
    series = series.reshape(-1).astype(np.int64)
    return series, [int(k) if k < markers else -1 for k in keys], [int(n) for n in counts]


def _span(xyz: Floats) -> float:
    """m, the size of the box that holds nearly all points."""
    if not len(xyz):
        return 1.0
    # Without the strays, which would make a hand as large as the room.
    low, high = np.percentile(xyz, [2, 98], axis=0)
    return float((high - low).max())


def _codes(confidence: Floats, given: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The confidence of labels as codes from LOWEST to HIGHEST, by nines; 0 without a label."""
    return np.where(given, LOWEST + np.rint((HIGHEST - LOWEST) * nines(confidence) / MOST_NINES), 0).astype(np.uint8)


def _timeline(one: ShownRecording, rules: PageRules) -> dict[str, Any]:
    """Codes of each marker in each block of frames, packed: what most of the block is, its lowest confidence, any wrong label."""
    from asterism.labelling.review import labels_of_points

    labelling, unsure = one.labelling, one.unsure
    assert unsure is not None
    given = labelling.indices >= 0
    block = max(1, -(-len(given) // rules.columns))
    starts = np.arange(0, len(given), block)
    codes = _codes(np.nan_to_num(labelling.confidence), given)
    # A block shows its worst label: an error must not vanish in a mean.
    lowest = np.minimum.reduceat(np.where(given, codes, 255), starts, axis=0)
    size = np.diff([*starts, len(given)])[:, None]
    doubtful, labelled = (2 * np.add.reduceat(part.astype(np.int64), starts, axis=0) for part in (unsure, given))
    # What most of the block is; on a tie doubt wins over hidden.
    out = np.where(labelled > size, lowest, np.where(doubtful >= size - labelled / 2, UNSURE, HIDDEN)).astype(np.uint8)
    if one.marks is not None:
        marker, _ = labels_of_points(labelling, one.clouds)
        wrong = np.nonzero((one.marks & WRONG) & (marker >= 0))[0]
        # One wrong label colours its block.
        out[one.clouds.frame_of[wrong] // block, marker[wrong]] = WRONG_HERE
    return {
        "block": block,
        "columns": len(starts),
        "data": deflated(np.ascontiguousarray(out.T).reshape(-1)),
        "frames": len(given),
        "labelled": np.round(given.mean(axis=0), 4),
    }


def differences(values: Ints, first: Ints, order: int) -> Ints:
    """Values less the one before in their series, so many times; first: where the series begin. Undone by sums."""
    # The first values of a series have none before them and stay as they are.
    place = np.arange(len(values)) - np.repeat(first, np.diff([*first, len(values)]))
    for done in range(order):
        values = np.where(place > done, values - np.roll(values, 1), values)
    return values


def zigzag(values: Ints) -> Ints:
    """Whole numbers as natural ones: 0, -1, 1, -2, ... become 0, 1, 2, 3, ..."""
    return np.where(values < 0, -2 * values - 1, 2 * values)


def varints(values: Ints) -> NDArray[np.uint8]:
    """Natural numbers in as many bytes as they need, seven bits in each, the lowest first; the highest bit says that more follow."""
    if not len(values):
        return np.zeros(0, dtype=np.uint8)
    # Seven bits in a byte, all numbers at once; as many bytes as the largest needs.
    groups = values[:, None] >> np.arange(0, max(int(values.max()).bit_length(), 1), 7)
    used = np.maximum((groups > 0).sum(axis=1), 1)
    column = np.arange(groups.shape[1])
    out = (groups & 0x7F) | np.where(column < used[:, None] - 1, 0x80, 0)
    return out[column < used[:, None]].astype(np.uint8)


def deflated(data: NDArray[np.uint8]) -> str:
    """Bytes as base64 of their zlib stream."""
    # Level 9 takes nine times as long as 6, and makes paths of markers smaller by 2 %.
    return base64.b64encode(zlib.compress(data.tobytes(), 6)).decode("ascii")


@cache
def template(name: str) -> str:
    """One of the pages' own files."""
    return resources.files("asterism.report").joinpath("templates", *name.split("/")).read_text(encoding="utf-8")
