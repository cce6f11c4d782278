"""The groups of an unlabelled recording in; a page that shows their numbers on the body, for a person to name them, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import Clouds, Floats
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, write_page
from asterism.report.projection import Dots, travel, two_views

if TYPE_CHECKING:
    from asterism.labelling.naming import GroupPlace, MarkerGroups

_MIDDLE = 0.03
"""m from the middle of the body up to which a group is called middle."""
_PICTURES = 4
_LEFT, _RIGHT, _BETWEEN, _SMALL = "#2563c9", "#d1495b", "#23304d", "#9aa4b5"


def naming_report(
    path: str | Path,
    clouds: Clouds,
    groups: MarkerGroups,
    places: Sequence[GroupPlace],
    *,
    names: Mapping[int, str] | None = None,
    first_frame: int = 1,
    title: str = "Which marker is which?",
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Write an HTML page that shows the groups of `group_tracklets` on the body, with their numbers (from 1) and names.

    places       what `locate_groups` gave for them
    names        {group from 0: marker}, as far as they are known
    first_frame  the number that the file gives its first frame

    Up to four frames are drawn, so that every frequent group is seen in one of them. Raises AsterismError where the file cannot be written.
    """
    names = names or {}
    share = float(groups.frames[: groups.frequent].sum() / max(1, groups.frames.sum()))
    sections = [
        Section(
            f"Frame {frame + first_frame}",
            "Left and right are those of the subject, if it walks forwards. Small grey points are groups that are rarely seen.",
            figure=_picture(clouds, groups, places, names, frame),
        )
        for frame in _frames_to_draw(clouds, groups)
    ]
    sections.append(
        Section(
            "Groups",
            "The points of a group are one marker, as the motion shows. Write a CSV file with a line for each group that you know: "
            "group,marker. A marker whose track has gaps can have several groups: give them the same name.",
            table=_table(clouds, groups, places, names),
        )
    )
    merits = [
        (count(groups.frequent), "groups seen in a tenth of the frames or more", ""),
        (percent(share, 1), "of all samples are in them", "good" if share >= 0.98 else ""),
        (count(len(groups) - groups.frequent), "more, rarely seen", ""),
        (count(len(clouds)), "frames", ""),
    ]
    write_page(
        path, Page(title, f"Name {groups.frequent} groups once, and the whole recording is labelled.", facts or {}, merits, sections)
    )


def side(place: GroupPlace) -> str:
    """On which side of the body a group is: left, right or middle; a dash where the body does not travel."""
    if np.isnan(place.left):
        return NOTHING
    return "middle" if abs(place.left) < _MIDDLE else "left" if place.left > 0 else "right"


def neighbours_text(place: GroupPlace) -> str:
    """The nearest groups: 4 (6 cm), 7 (11 cm)."""
    return ", ".join(f"{group + 1} ({100 * distance:.0f} cm)" for group, distance in place.nearest)


def _frames_to_draw(clouds: Clouds, groups: MarkerGroups) -> list[int]:
    """Frames that together show all frequent groups: each shows as many as possible that no frame before it shows."""
    frame_of = clouds.frame_of
    shown = np.zeros((len(clouds), len(groups)), dtype=np.bool_)
    shown[frame_of, groups.of_point] = True
    missing, frames = set(range(groups.frequent)), list[int]()
    while missing and len(frames) < _PICTURES:
        new = shown[:, sorted(missing)].sum(axis=1)
        best = np.nonzero(new == new.max())[0]
        frame = int(best[np.argmin(np.abs(best - len(clouds) // 2))])
        frames.append(frame)
        missing -= set(np.nonzero(shown[frame])[0].tolist())
    return frames


def _picture(clouds: Clouds, groups: MarkerGroups, places: Sequence[GroupPlace], names: Mapping[int, str], frame: int) -> figures.Figure:
    points = clouds[frame]
    group_of = groups.of_point[clouds.offsets[frame] : clouds.offsets[frame + 1]]
    styles = {"left": (_LEFT, 9), "right": (_RIGHT, 9), "middle": (_BETWEEN, 9), "rarely seen": (_SMALL, 6)}
    kinds: dict[str, list[int]] = {kind: [] for kind in styles}
    for at, group in enumerate(group_of):
        rare = group >= groups.frequent
        where = side(places[int(group)])
        kinds["rarely seen" if rare else "middle" if where == NOTHING else where].append(at)
    dots = [
        Dots(kind, _rows(points, ats), [_group_text(int(group_of[at]), names) for at in ats], *styles[kind]) for kind, ats in kinds.items()
    ]
    return two_views(dots, clouds.vertical, travel(clouds, frame), height=500)


def _rows(points: Floats, rows: Sequence[int]) -> Floats:
    return points[list(rows)] if rows else np.zeros((0, 3))


def _group_text(group: int, names: Mapping[int, str]) -> str:
    return f"{group + 1} {names[group]}" if group in names else str(group + 1)


def _table(clouds: Clouds, groups: MarkerGroups, places: Sequence[GroupPlace], names: Mapping[int, str]) -> Table:
    rows: list[list[str | Cell]] = [
        [
            str(group + 1),
            *([names.get(group, NOTHING)] if names else []),
            side(place),
            neighbours_text(place),
            f"{place.height:.2f} m",
            count(int(groups.frames[group])),
            percent(groups.frames[group] / max(1, len(clouds)), 1),
        ]
        for group, place in enumerate(places)
    ]
    named = ["name"] if names else []
    return Table(["group", *named, "side", "nearest groups", "height", "frames", "of all frames"], rows, left=3 + len(named))
