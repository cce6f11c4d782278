"""Pieces of tracks to check in; a page with the list, and the seconds around the frames to look at in 3D, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import Clouds, Labelling, MarkerSet
from asterism.recording.display import short_names
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, write_page
from asterism.report.player import IN_QUESTION, ShownRecording, pack_recordings

if TYPE_CHECKING:
    from asterism.labelling import ReviewItem

_SECONDS_AROUND = 1.5
"""s before and after the frame to look at that the page shows."""


@dataclass(frozen=True)
class ReviewEntry:
    """One line of a review: an item, and the recording that it is in.

    file         the recording's file
    item         one that `asterism.labelling.review` gave
    labelling    of the recording, with its clouds; without them the item is not shown in 3D
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
    totals: tuple[int, float] | None = None,
    model_info: Mapping[str, Any] | None = None,
    marker_set: MarkerSet | None = None,
    pictures: int = 20,
) -> None:
    """Write an HTML page on what `review` listed.

    entries     the first is the one to check first; the first `pictures` of them are shown in 3D
    totals      the number of items in the whole list, and the samples that it gains, where `entries` is only its head
    marker_set  for sides and bones; by default the shipped set that has the markers

    Raises AsterismError where the file cannot be written.
    """
    files = [entry.file for entry in entries]
    names = dict(zip(files, short_names(files), strict=True))
    head = sum(entry.item.gain for entry in entries)
    # The list may be the head of a longer one; the totals are of the whole.
    number, gain = totals or (len(entries), head)
    merits = [
        (count(number), "pieces of tracks to look at", ""),
        (f"{gain:,.1f}", "wrong or missing samples expected in them", "warn" if gain >= 1 else "good"),
        (count(len(entries)), "listed here", ""),
        (percent(head / gain if gain else float("nan"), 1), "of the expected gain is in this list", ""),
    ]
    # Pictures cost space: only the head of the list gets them.
    drawn = [entry for entry in entries[:pictures] if entry.labelling is not None and entry.clouds is not None]
    shown = [_shown(place, entry, names[entry.file], marker_set) for place, entry in enumerate(drawn, 1)]
    sections = [
        Section(
            "The list",
            "Each line is a piece of a track between two gaps. One name for the piece corrects all its frames. "
            "The gain is the expected number of its samples whose label is wrong or missing.",
            table=_table(entries, names, drawn == list(entries[: len(drawn)])),
        )
    ]
    if shown:
        text = "The ringed point is in question; the list opens each of them. Drag to turn; with the picture in focus, space plays and "
        sections.append(Section("In 3D", text + "the arrow keys step.", player=pack_recordings(shown)))
    lead = f"{len(entries)} of {number:,} pieces of tracks, by the number of samples that a check corrects."
    lead = lead if entries else "No piece of a track stands out."
    write_page(path, Page("What to look at first", lead, model_info or {}, merits, sections))


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


def _table(entries: Sequence[ReviewEntry], names: Mapping[str, str], opens: bool) -> Table:
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
    return Table(["file", "label", "alternatives", "frames", "look at", "samples", "gain"], rows, left=3, opens=opens)


def _shown(place: int, entry: ReviewEntry, file: str, marker_set: MarkerSet | None) -> ShownRecording:
    """The seconds around the frame to look at, with the item's points in question."""
    item, labelling, clouds = entry.item, entry.labelling, entry.clouds
    assert labelling is not None and clouds is not None
    reach = max(1, round(_SECONDS_AROUND * clouds.rate))
    # Only the piece in question is ringed; its neighbours are context.
    marks = np.zeros(len(clouds.xyz), dtype=np.int64)
    marks[item.points] = IN_QUESTION
    return ShownRecording(
        f"{place}. {file}, frame {entry.frame}: {label_text(item)}",
        labelling,
        clouds,
        entry.first_frame,
        marks=marks,
        marker_set=marker_set,
        note=f"The ringed point, frames {entry.frames}. {_advice(item)}",
        start=item.frame,
        chosen=(max(0, item.frame - reach), min(len(clouds), item.frame + reach + 1)),
    )
