"""A recording without labels and without a model in; its groups of points while a person names them, and the named recording, out."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from asterism.errors import AsterismError, NoMarkers
from asterism.labelling.correction.correct import CorrectionChange, PieceChange
from asterism.labelling.correction.event_log import CorrectionLog, hash_of_points
from asterism.labelling.correction.history import History
from asterism.labelling.naming import MarkerGroups, body_positions, group_tracklets, locate_groups, mirrored_groups, name_groups
from asterism.recording import Ints, MarkerSet, Recording, is_unnamed
from asterism.recording.sides import marker_sides, mirrored_name

NAMED = "group"
"""The kind of a log's entry that names a group."""
_LONGEST_NAME = 100
"""Characters of a name: more than any marker's, less than a file's header holds."""


@dataclass(frozen=True)
class _Named:
    """What a person said at once: a group (from 0) and its marker, None for no name."""

    group: int
    marker: str | None

    def to_plain(self) -> dict[str, Any]:
        return {"kind": NAMED, "group": self.group + 1, "marker": self.marker}


class GroupNaming(History[_Named]):
    """The groups of a recording (`group_tracklets`) while a person names them, as `Correction` is for labels.

    What was said, not the names, is the state: `undo` and `redo` have no end.
    """

    def __init__(self, recording: Recording) -> None:
        """Group the recording's points. Raises NoMarkers where it has none."""
        super().__init__()
        self.recording, self.clouds = recording, recording.clouds()
        if not len(self.clouds.xyz):
            raise NoMarkers("the recording has no points to name.")
        self.groups: MarkerGroups = group_tracklets(self.clouds)
        self.places = locate_groups(self.clouds, self.groups)
        self.revision = 0

    @property
    def names(self) -> dict[int, str]:
        """{group from 0: marker}, as far as they are named."""
        named: dict[int, str | None] = {}
        for said in self._done:
            named[said.group] = said.marker
        return {group: marker for group, marker in sorted(named.items()) if marker is not None}

    @property
    def left(self) -> list[int]:
        """The groups that a person names and has not named yet."""
        return [group for group in range(self.groups.frequent) if group not in self.names]

    @cached_property
    def identity(self) -> tuple[str, str]:
        """Hashes of the recording's points and of its groups: to whom a log of names belongs."""
        of_point = np.ascontiguousarray(self.groups.of_point, dtype="<i8")
        return hash_of_points(self.clouds), hashlib.sha256(b"groups" + of_point.tobytes()).hexdigest()

    @cached_property
    def frames_of(self) -> tuple[Ints, Ints, Ints]:
        """(G,) each: the first and the last frame of each group, and the one to look at, in which most groups are seen."""
        frame_of, of_point, count = self.clouds.frame_of, self.groups.of_point, len(self.groups)
        first, last = np.full(count, len(self.clouds)), np.zeros(count, dtype=np.int64)
        np.minimum.at(first, of_point, frame_of)
        np.maximum.at(last, of_point, frame_of)
        often = np.bincount(frame_of[of_point < self.groups.frequent], minlength=len(self.clouds))
        look = np.zeros(count, dtype=np.int64)
        for group in range(count):
            frames = frame_of[of_point == group]
            look[group] = frames[np.argmax(often[frames])]
        return first, last, look

    def apply(self, group: int, marker: str | None) -> CorrectionChange:
        """Name a group, or take its name away.

        Raises AsterismError where there is no such group, the text is no marker's name, or a group that is seen at the same time has the
        name; nothing changes then.
        """
        return self._take(_Named(self._checked(group), None if marker is None else self._fitting(group, marker)))

    def undo(self) -> CorrectionChange:
        """Take the last name back. Raises AsterismError where there is none."""
        before, said = self.names, self._last_done()
        self._take_back()
        return self._changed(before, said.group)

    def redo(self) -> CorrectionChange:
        """Take again what was taken back last. Raises AsterismError where there is nothing."""
        before, said = self.names, self._last_undone()
        self._take_again()
        return self._changed(before, said.group)

    def candidates(self, group: int, marker_set: MarkerSet | None = None) -> list[tuple[str, str]]:
        """Names that a group may have, and what to say of each: its mirror image first, then what is not given yet.

        marker_set: whose names are offered. Raises AsterismError where there is no such group.
        """
        self._checked(group)
        names, mirrored = self.names, self.mirrored_name(group, marker_set)
        given = {marker: number for number, marker in names.items() if number != group}
        offered = dict.fromkeys([*([] if mirrored is None else [mirrored]), *(() if marker_set is None else marker_set.names), *given])
        rows = [(name, "mirrored" if name == mirrored else f"group {given[name] + 1}" if name in given else "") for name in offered]
        # A group that is one marker with a named one may still get its name: a marker whose track has gaps has several groups.
        return sorted(rows, key=lambda row: row[1].startswith("group"))

    def mirrored(self, group: int) -> int | None:
        """The group at the same place on the other side of the body; None where none is clearly there."""
        return self._mirrored.get(group)

    def mirrored_name(self, group: int, marker_set: MarkerSet | None = None) -> str | None:
        """What a group is called if it is the mirror image of a named one; None where it is not, or that name is given already."""
        other = self.mirrored(group)
        name = None if other is None or other not in self.names else mirrored_name(self.names[other], marker_set)
        return None if name in self.names.values() else name

    def named(self) -> Recording:
        """The recording under the names. Raises AsterismError where no group has one."""
        return name_groups(self.recording, self.groups, self.names, self.clouds)

    def attach(self, log: CorrectionLog) -> None:
        """Take what a log holds, and write to it from now on. Raises AsterismError where it is of other groups, or damaged."""
        if log.other_model:
            raise AsterismError(f"{log.path}: these names were given to other groups of points; move the log away, and name anew.")
        self._done, self._undone = self._replayed(log, self._read)
        self._log = log
        self.revision += 1

    @cached_property
    def _positions(self) -> Any:
        return body_positions(self.clouds, self.groups)

    @property
    def _mirrored(self) -> dict[int, int]:
        positions, ahead = self._positions
        # rarely seen groups are ghosts mostly, which have no other side
        shown = [group for group in range(len(self.groups)) if group < self.groups.frequent or group in self.names]
        place = {group: row for row, group in enumerate(shown)}
        pairs = [(place[left], place[right]) for left, right in self._pairs()]
        found = mirrored_groups(positions[shown], ahead, pairs)
        return {shown[one]: shown[other] for one, other in found.items()}

    def _pairs(self) -> list[tuple[int, int]]:
        """(left, right) groups that are named as each other's mirror images."""
        names = list(self.names.items())
        sides = marker_sides([name for _, name in names])
        group_of = {name: group for group, name in names}
        lefts = [(group, mirrored_name(name)) for (group, name), side in zip(names, sides, strict=True) if side == "left"]
        return [(group, group_of[name]) for group, name in lefts if name in group_of]

    def _take(self, said: _Named) -> CorrectionChange:
        before = self.names
        self._add(said)
        return self._changed(before, said.group)

    def _changed(self, before: Mapping[int, str], group: int) -> CorrectionChange:
        self.revision += 1
        was, now = before.get(group), self.names.get(group)
        first, last, _ = self.frames_of
        parts: Sequence[PieceChange] = (
            () if was == now else (PieceChange(group, int(first[group]), int(last[group]), was, now, by_person=True),)
        )
        return CorrectionChange((), tuple(parts))

    def _read(self, entry: Mapping[str, Any]) -> _Named:
        """An entry of a log. Raises ValueError and others where it is none."""
        group, marker = entry["group"] - 1, entry["marker"]
        if entry["kind"] != NAMED or not isinstance(marker, str | None):
            raise ValueError("not a name of a group")
        return _Named(self._checked(group), marker)

    def _checked(self, group: int) -> int:
        if isinstance(group, bool) or not isinstance(group, int) or not 0 <= group < len(self.groups):
            raise AsterismError(f"there is no such group; the recording has groups 1 to {len(self.groups)}.")
        return group

    def _fitting(self, group: int, marker: str) -> str:
        """A name, without blanks around it, that this group can have."""
        name = marker.strip()
        if not name or is_unnamed(name) or len(name) > _LONGEST_NAME or not name.isprintable():
            raise AsterismError(f"{name[:60]!r} is not a marker's name; give one such as LKNE, of at most {_LONGEST_NAME} characters.")
        own = self.clouds.frame_of[self.groups.of_point == group]
        for other, given in self.names.items():
            if given != name or other == group:
                continue
            both = np.intersect1d(own, self.clouds.frame_of[self.groups.of_point == other])
            if len(both):
                frame = int(both[0]) + self.recording.first_frame
                raise AsterismError(f"group {other + 1} is {name} already, and both are seen in frame {frame}; rename that one first.")
        return name
