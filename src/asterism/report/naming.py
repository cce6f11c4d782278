"""The groups of an unlabelled recording in; a page that shows their numbers on the body, for a person to name them, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from asterism.recording import NULL, Clouds, Labelling
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, write_page
from asterism.report.player import ShownRecording, pack_recordings

if TYPE_CHECKING:
    from asterism.labelling.naming import GroupPlace, MarkerGroups

_MIDDLE = 0.03
"""m from the middle of the body up to which a group is called middle."""


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

    The recording is shown in 3D, with the number of each frequent group beside it. Raises AsterismError where the file cannot be written.
    """
    names = names or {}
    # How much of the recording gets a name by naming these groups.
    share = float(groups.frames[: groups.frequent].sum() / max(1, groups.frames.sum()))
    sections = [
        Section(
            "The groups in 3D",
            "Left and right are those of the subject, if it walks forwards. Small grey points are groups that are rarely seen. "
            "Drag to turn; with the picture in focus, space plays and the arrow keys step.",
            player=pack_recordings([_shown(clouds, groups, places, names, first_frame)]),
        )
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


def _shown(
    clouds: Clouds, groups: MarkerGroups, places: Sequence[GroupPlace], names: Mapping[int, str], first_frame: int
) -> ShownRecording:
    """The recording with its frequent and its named groups as markers; it starts where most of them are seen."""
    # Groups with a name are shown though they are rare: a person wants to see what they named.
    shown = sorted({*range(groups.frequent), *(group for group in names if group < len(groups))})
    column = np.full(len(groups), NULL)
    column[shown] = np.arange(len(shown))
    points = np.nonzero(column[groups.of_point] >= 0)[0]
    # Groups become markers of a labelling, so that the same player shows them.
    frames = clouds.frame_of[points]
    indices = np.full((len(clouds), len(shown)), NULL)
    indices[frames, column[groups.of_point[points]]] = points - clouds.offsets[frames]
    seen = indices >= 0
    labelling = Labelling(indices, np.where(seen, 1.0, 0.0), tuple(_group_text(group, names) for group in shown))
    sides = [side(places[group]) for group in shown]
    return ShownRecording(
        "",
        labelling,
        clouds,
        first_frame,
        unsure=np.zeros(seen.shape, dtype=np.bool_),
        # Begin where most groups are seen: they are easiest to tell apart there.
        start=int(np.argmax(seen.sum(axis=1))) if seen.size else 0,
        sides=["middle" if where == NOTHING else where for where in sides],
        names_shown="all",
    )


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
