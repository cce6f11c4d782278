"""What a person should look at first in; out comes a page with the list, and pictures of the frames in question."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import Clouds, Floats, Labelling, MarkerSet
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, write_page
from asterism.report.projection import Dots, travel, two_views
from asterism.report.scene import known_set

if TYPE_CHECKING:
    from asterism.labelling import Item

_LEFT, _RIGHT, _MIDDLE, _FREE, _DOUBT = "#2563c9", "#d1495b", "#23304d", "#9aa4b5", "#f08c00"
_NAMED = 20


def review_report(
    path: str | Path,
    items: Sequence[tuple[str, Item]],
    shown: Mapping[str, tuple[Labelling, Clouds]],
    *,
    title: str = "What to look at first",
    first_frames: Mapping[str, int] | None = None,
    totals: tuple[int, float] | None = None,
    model_info: Mapping[str, Any] | None = None,
    marker_set: MarkerSet | None = None,
    pictures: int = 6,
) -> None:
    """Write an HTML page on what `review` listed.

    items         (file, item), the first to look at first
    shown         file -> its labelling and clouds, of at least the files of the first `pictures` items, which are drawn
    first_frames  file -> the number that the file gives its first frame; 0 where nothing is said
    totals        how many items the whole list has, and the samples that it gains, where `items` is only its head
    marker_set    for the sides' colours; by default the shipped set that has the markers
    Raises AsterismError where the file cannot be written.
    """
    told = _short_names([file for file, _ in items])
    numbers, gains = totals or (len(items), sum(item.gain for _, item in items))
    first_frames = first_frames or {}
    head = sum(item.gain for _, item in items)
    merits = [
        (count(numbers), "pieces of tracks in doubt", ""),
        (f"{gains:,.1f}", "wrong or missing samples expected in them", "warn" if gains >= 1 else "good"),
        (count(len(items)), "listed here", ""),
        (percent(head / gains if gains else float("nan"), 1), "of the expected gain is in this list", ""),
    ]
    sections = [
        Section(
            "First things first",
            "Each line is a piece of a track between two gaps: saying once which marker it is settles all its frames. "
            "The gain is the number of its samples that are probably wrong or missing now.",
            table=_table(items, told, first_frames),
        )
    ]
    for number, (file, item) in enumerate(items[:pictures], 1):
        if file in shown:
            labelling, clouds = shown[file]
            first = first_frames.get(file, 0)
            stretch = f"frames {item.first_frame + first} to {item.last_frame + first}"
            sections.append(
                Section(
                    f"{number}. {told[file]}, frame {item.frame + first}: {said(item)}",
                    f"The ringed point, {stretch}; the line is its way. {_advice(item)}",
                    figure=_picture(item, labelling, clouds, marker_set if marker_set and marker_set.pairs else known_set(labelling.names)),
                )
            )
    lead = "Nothing is in doubt." if not items else f"{len(items)} of {numbers:,} pieces of tracks, those first that a look mends most."
    write_page(path, Page(title, lead, model_info or {}, merits, sections))


def said(item: Item) -> str:
    """What the labeller says of an item: LKNE 93.1 %, or no label."""
    return "no label" if item.marker is None else f"{item.marker} {percent(item.confidence, 1)}"


def perhaps(item: Item) -> str:
    """What else an item could be: RKNE 12.0 %, LTIB 3.1 %."""
    return ", ".join(f"{name} {percent(chance, 1)}" for name, chance in item.perhaps)


def _advice(item: Item) -> str:
    if item.perhaps:
        return f"It could be {perhaps(item)}."
    return "It is doubtful in some of its frames only." if item.marker else "It may be a ghost."


def _short_names(files: Sequence[str]) -> dict[str, str]:
    """What to call each file: its name, with its folder where another one has the same."""
    own = [Path(file).name for file in dict.fromkeys(files)]
    return {file: Path(file).name if own.count(Path(file).name) == 1 else "/".join(Path(file).parts[-2:]) for file in files}


def _table(items: Sequence[tuple[str, Item]], told: Mapping[str, str], first_frames: Mapping[str, int]) -> Table:
    most = max((item.gain for _, item in items), default=1.0)
    rows: list[list[str | Cell]] = []
    for number, (file, item) in enumerate(items, 1):
        first = first_frames.get(file, 0)
        rows.append(
            [
                f"{number}. {told[file]}",
                said(item),
                perhaps(item) or NOTHING,
                f"{item.first_frame + first} to {item.last_frame + first}",
                str(item.frame + first),
                count(item.samples),
                Cell(f"{item.gain:.1f}", float(np.sqrt(item.gain / most)), "warn"),
            ]
        )
    return Table(["file", "said", "perhaps", "frames", "look at", "samples", "gain"], rows, left=3)


def _picture(item: Item, labelling: Labelling, clouds: Clouds, marker_set: MarkerSet | None) -> figures.Figure:
    t = item.frame
    points = clouds[t]
    doubted = item.points[np.searchsorted(item.points, clouds.offsets[t])] - clouds.offsets[t]
    name_of = {int(place): name for name, place in zip(labelling.names, labelling.indices[t], strict=True) if place >= 0}
    near = np.argsort(np.linalg.norm(points - points[doubted], axis=1), kind="stable")[: _NAMED // 2]
    told = set(range(len(points))) if len(labelling.names) <= _NAMED else {int(place) for place in near}
    left, right = (set(side) for side in zip(*marker_set.pairs, strict=True)) if marker_set and marker_set.pairs else (set(), set())
    sides: dict[str, list[int]] = {_LEFT: [], _RIGHT: [], _MIDDLE: [], _FREE: []}
    for place in range(len(points)):
        name = name_of.get(place)
        sides[_FREE if name is None else _LEFT if name in left else _RIGHT if name in right else _MIDDLE].append(place)
    legend = {_LEFT: "left", _RIGHT: "right", _MIDDLE: "middle", _FREE: "no label"}
    dots = [Dots("", _way(item, clouds, t), [], _DOUBT, path=True)]
    dots += [
        Dots(legend[color], points[places], [name_of.get(p, "") if p in told else "" for p in places], color)
        for color, places in sides.items()
    ]
    dots.append(Dots("in question", points[[doubted]], [""], _DOUBT, 18, ring=True))
    return two_views(dots, clouds.vertical, travel(clouds, t))


def _way(item: Item, clouds: Clouds, frame: int) -> Floats:
    """The piece's way within a quarter of a second of a frame, moved along with the cloud so that it stays beside the body."""
    reach = max(1, round(0.25 * clouds.rate))
    frames = np.searchsorted(clouds.offsets, item.points, side="right") - 1
    near = np.abs(frames - frame) <= reach
    times = frames[near] - frame
    middles = np.array([np.median(clouds[int(t)], axis=0) for t in frames[near]])
    drift = np.polyfit(times, middles, 1)[0] if len(times) > 1 else np.zeros(3)
    return np.asarray(clouds.xyz[item.points[near]] - times[:, None] * drift)
