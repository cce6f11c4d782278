"""Pieces of tracks to check in; a page with the list, and pictures of the frames to look at, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import Clouds, Floats, Labelling, MarkerSet
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, write_page
from asterism.report.projection import Dots, travel, two_views
from asterism.report.scene import known_set

if TYPE_CHECKING:
    from asterism.labelling import ReviewItem

_LEFT, _RIGHT, _MIDDLE, _UNLABELLED, _IN_QUESTION = "#2563c9", "#d1495b", "#23304d", "#9aa4b5", "#f08c00"
_NAMED = 20
"""Up to so many markers, a picture names all points; with more, only those near the point in question."""


@dataclass(frozen=True)
class ReviewEntry:
    """One line of a review: an item, and the recording that it is in.

    file         the recording's file
    item         one that `asterism.labelling.review` gave
    labelling    of the recording, with its clouds; without them the item has no picture
    clouds       the clouds that were labelled
    first_frame  the number that the file gives its first frame
    """

    file: str
    item: ReviewItem
    labelling: Labelling | None = None
    clouds: Clouds | None = None
    first_frame: int = 0

    @property
    def frame(self) -> int:
        """The frame to look at, as the file numbers it."""
        return self.item.frame + self.first_frame

    @property
    def frames(self) -> str:
        """The item's frames, as the file numbers them: 12 to 40."""
        return f"{self.item.first_frame + self.first_frame} to {self.item.last_frame + self.first_frame}"


def review_report(
    path: str | Path,
    entries: Sequence[ReviewEntry],
    *,
    title: str = "What to check first",
    totals: tuple[int, float] | None = None,
    model_info: Mapping[str, Any] | None = None,
    marker_set: MarkerSet | None = None,
    pictures: int = 6,
) -> None:
    """Write an HTML page on what `review` listed.

    entries     the first is the one to check first; the first `pictures` of them are drawn
    totals      the number of items in the whole list, and the samples that it gains, where `entries` is only its head
    marker_set  for the sides' colours; by default the shipped set that has the markers

    Raises AsterismError where the file cannot be written.
    """
    names = _short_names([entry.file for entry in entries])
    head = sum(entry.item.gain for entry in entries)
    number, gain = totals or (len(entries), head)
    merits = [
        (count(number), "pieces of tracks to check", ""),
        (f"{gain:,.1f}", "wrong or missing samples expected in them", "warn" if gain >= 1 else "good"),
        (count(len(entries)), "listed here", ""),
        (percent(head / gain if gain else float("nan"), 1), "of the expected gain is in this list", ""),
    ]
    sections = [
        Section(
            "The list",
            "Each line is a piece of a track between two gaps. One name for the piece corrects all its frames. "
            "The gain is the expected number of its samples whose label is wrong or missing.",
            table=_table(entries, names),
        )
    ]
    for place, entry in enumerate(entries[:pictures], 1):
        if entry.labelling is not None and entry.clouds is not None:
            sections.append(
                Section(
                    f"{place}. {names[entry.file]}, frame {entry.frame}: {label_text(entry.item)}",
                    f"The ringed point, frames {entry.frames}. The line is its path. {_advice(entry.item)}",
                    figure=_picture(entry.item, entry.labelling, entry.clouds, marker_set),
                )
            )
    lead = f"{len(entries)} of {number:,} pieces of tracks, by the number of samples that a check corrects."
    write_page(path, Page(title, lead if entries else "No label needs a check.", model_info or {}, merits, sections))


def label_text(item: ReviewItem) -> str:
    """An item's label and its mean confidence: LKNE 93.1 %, or no label."""
    return "no label" if item.marker is None else f"{item.marker} {percent(item.confidence, 1)}"


def alternatives_text(item: ReviewItem) -> str:
    """What else an item could be: RKNE 12.0 %, LTIB 3.1 %."""
    return ", ".join(f"{name} {percent(chance, 1)}" for name, chance in item.alternatives)


def _advice(item: ReviewItem) -> str:
    if item.alternatives:
        return f"It could be {alternatives_text(item)}."
    return "Only some of its frames have a low confidence." if item.marker else "It may be a ghost."


def _short_names(files: Sequence[str]) -> dict[str, str]:
    """What to call each file: its name, with its folder where another file has the same name."""
    names = [Path(file).name for file in dict.fromkeys(files)]
    return {file: Path(file).name if names.count(Path(file).name) == 1 else "/".join(Path(file).parts[-2:]) for file in files}


def _table(entries: Sequence[ReviewEntry], names: Mapping[str, str]) -> Table:
    most = max((entry.item.gain for entry in entries), default=1.0)
    rows: list[list[str | Cell]] = [
        [
            f"{place}. {names[entry.file]}",
            label_text(entry.item),
            alternatives_text(entry.item) or NOTHING,
            entry.frames,
            str(entry.frame),
            count(entry.item.samples),
            Cell(f"{entry.item.gain:.1f}", float(np.sqrt(entry.item.gain / most)), "warn"),
        ]
        for place, entry in enumerate(entries, 1)
    ]
    return Table(["file", "label", "alternatives", "frames", "look at", "samples", "gain"], rows, left=3)


def _picture(item: ReviewItem, labelling: Labelling, clouds: Clouds, marker_set: MarkerSet | None) -> figures.Figure:
    """The frame to look at, from the side and from the front."""
    marker_set = marker_set if marker_set and marker_set.pairs else known_set(labelling.names)
    t = item.frame
    points = clouds[t]
    ringed = item.points[np.searchsorted(item.points, clouds.offsets[t])] - clouds.offsets[t]
    name_of = {int(place): name for name, place in zip(labelling.names, labelling.indices[t], strict=True) if place >= 0}
    near = np.argsort(np.linalg.norm(points - points[ringed], axis=1), kind="stable")[: _NAMED // 2]
    named = set(range(len(points))) if len(labelling.names) <= _NAMED else {int(place) for place in near}
    left, right = (set(side) for side in zip(*marker_set.pairs, strict=True)) if marker_set and marker_set.pairs else (set(), set())
    sides: dict[str, list[int]] = {_LEFT: [], _RIGHT: [], _MIDDLE: [], _UNLABELLED: []}
    for place in range(len(points)):
        name = name_of.get(place)
        sides[_UNLABELLED if name is None else _LEFT if name in left else _RIGHT if name in right else _MIDDLE].append(place)
    legend = {_LEFT: "left", _RIGHT: "right", _MIDDLE: "middle", _UNLABELLED: "no label"}
    dots = [Dots("", _path(item, clouds, t), [], _IN_QUESTION, path=True)]
    dots += [
        Dots(legend[color], points[places], [name_of.get(p, "") if p in named else "" for p in places], color)
        for color, places in sides.items()
    ]
    dots.append(Dots("in question", points[[ringed]], [""], _IN_QUESTION, 18, ring=True))
    return two_views(dots, clouds.vertical, travel(clouds, t))


def _path(item: ReviewItem, clouds: Clouds, frame: int) -> Floats:
    """(N, 3) m, the piece's path within a quarter of a second of a frame, less the mean motion of the cloud."""
    reach = max(1, round(0.25 * clouds.rate))
    frames = np.searchsorted(clouds.offsets, item.points, side="right") - 1
    near = np.abs(frames - frame) <= reach
    times = frames[near] - frame
    middles = np.array([np.median(clouds[int(t)], axis=0) for t in frames[near]])
    drift = np.polyfit(times, middles, 1)[0] if len(times) > 1 else np.zeros(3)
    return np.asarray(clouds.xyz[item.points[near]] - times[:, None] * drift)
