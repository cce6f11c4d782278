"""The groups of a recording without names in; out comes a page that numbers them on the body, for a person to name."""

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
    from asterism.labelling.naming import Groups, Place

_MIDDLE = 0.03
_PICTURES = 4
_LEFT, _RIGHT, _BETWEEN, _SMALL = "#2563c9", "#d1495b", "#23304d", "#9aa4b5"


def naming_report(
    path: str | Path,
    clouds: Clouds,
    groups: Groups,
    places: Sequence[Place],
    *,
    names: Mapping[int, str] | None = None,
    first_frame: int = 1,
    title: str = "Which marker is which?",
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Write an HTML page on which the groups of `own_tracks` stand with their numbers (from 1), or with the names that they have.

    places       what `asterism.labelling.naming.places` says of them
    first_frame  the number that the file gives its first frame
    The pictures show as few frames as show every group that is seen in a tenth of the recording, at most four. Raises AsterismError where
    the file cannot be written.
    """
    names = names or {}
    share = float(groups.frames[: groups.often].sum() / max(1, groups.frames.sum()))
    sections = [
        Section(
            f"Frame {frame + first_frame}",
            "Left and right are the subject's own, as long as it walks forwards. Small grey points are groups that are seldom seen.",
            figure=_picture(clouds, groups, places, names, frame),
        )
        for frame in _telling_frames(clouds, groups)
    ]
    sections.append(
        Section(
            "Groups",
            "A group is what the recording's own motion shows to be one marker. Write a CSV file with a line for each that you know: "
            "group,marker. A marker that was left in pieces has several groups: give them the same name.",
            table=_table(clouds, groups, places, names),
        )
    )
    merits = [
        (count(groups.often), "groups seen in a tenth of the frames or more", ""),
        (percent(share, 1), "of all samples are in them", "good" if share >= 0.98 else ""),
        (count(len(groups) - groups.often), "more, seldom seen", ""),
        (count(len(clouds)), "frames", ""),
    ]
    write_page(path, Page(title, f"Name {groups.often} groups once, and the whole recording is labelled.", facts or {}, merits, sections))


def side(place: Place) -> str:
    """On which side of the body a group sits: left, right or middle; a dash where nobody goes anywhere."""
    if np.isnan(place.left):
        return NOTHING
    return "middle" if abs(place.left) < _MIDDLE else "left" if place.left > 0 else "right"


def beside(place: Place) -> str:
    """The nearest groups: 4 (6 cm), 7 (11 cm)."""
    return ", ".join(f"{group + 1} ({100 * distance:.0f} cm)" for group, distance in place.nearest)


def _telling_frames(clouds: Clouds, groups: Groups) -> list[int]:
    """Frames that together show all groups that are seen often: each shows most of those that the others before it do not."""
    frame_of = clouds.frame_of
    shown = np.zeros((len(clouds), len(groups)), dtype=np.bool_)
    shown[frame_of, groups.of_point] = True
    left, frames = set(range(groups.often)), list[int]()
    while left and len(frames) < _PICTURES:
        new = shown[:, sorted(left)].sum(axis=1)
        best = np.nonzero(new == new.max())[0]
        frame = int(best[np.argmin(np.abs(best - len(clouds) // 2))])
        frames.append(frame)
        left -= set(np.nonzero(shown[frame])[0].tolist())
    return frames


def _picture(clouds: Clouds, groups: Groups, places: Sequence[Place], names: Mapping[int, str], frame: int) -> figures.Figure:
    points = clouds[frame]
    own = groups.of_point[clouds.offsets[frame] : clouds.offsets[frame + 1]]
    looks = {"left": (_LEFT, 9), "right": (_RIGHT, 9), "middle": (_BETWEEN, 9), "seldom seen": (_SMALL, 6)}
    kinds: dict[str, list[int]] = {kind: [] for kind in looks}
    for at, group in enumerate(own):
        seldom = group >= groups.often
        where = side(places[int(group)])
        kinds["seldom seen" if seldom else "middle" if where == NOTHING else where].append(at)
    dots = [
        Dots(kind, _rows(points, ats), [_told(int(own[at]), names) for at in ats], looks[kind][0], looks[kind][1])
        for kind, ats in kinds.items()
    ]
    return two_views(dots, clouds.vertical, travel(clouds, frame), height=500)


def _rows(points: Floats, rows: Sequence[int]) -> Floats:
    return points[list(rows)] if rows else np.zeros((0, 3))


def _told(group: int, names: Mapping[int, str]) -> str:
    return f"{group + 1} {names[group]}" if group in names else str(group + 1)


def _table(clouds: Clouds, groups: Groups, places: Sequence[Place], names: Mapping[int, str]) -> Table:
    rows: list[list[str | Cell]] = [
        [
            str(group + 1),
            *([names.get(group, NOTHING)] if names else []),
            side(place),
            beside(place),
            f"{place.height:.2f} m",
            count(int(groups.frames[group])),
            percent(groups.frames[group] / max(1, len(clouds)), 1),
        ]
        for group, place in enumerate(places)
    ]
    named = ["name"] if names else []
    return Table(["group", *named, "side", "nearest groups", "height", "frames", "of all frames"], rows, left=3 + len(named))
