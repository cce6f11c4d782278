"""Column names in, markers out: which columns of a table are the x, y and z of one point."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_UNITS = r"(?:\s*[\[(]\s*(?P<units>mm|cm|m|in|ft|meters|millimeters)\s*[\])]|[_ ](?P<bare>mm|cm|m))?"
_SUFFIXES = tuple(
    re.compile(pattern + _UNITS, re.IGNORECASE)
    for pattern in (
        r"(?P<name>.+?)[_. :\-/|]*[_. :\-/|]t?(?P<axis>[xyz])",
        r"(?P<name>.+?)[_. :\-]*pos(?:ition)?[_. :\-]*(?P<axis>[xyz])",
        r"(?P<axis>[xyz])[_. :\-/|]+(?P<name>.+?)",
        r"(?P<name>.+?)\s*[\[(](?P<axis>[xyz012])[\])]",
        r"(?P<name>.+?)(?P<axis>[XYZ])",
        r"(?P<axis>[xyz])(?P<name>\d+)",
    )
)
_EXPLICIT, _ATTACHED = 1, 4
"""The spellings with the word position, and with the axis right behind the name."""
_QUANTITY = re.compile(
    r"forces?|grfs?|moments?|torques?|powers?|impulse|angles?|angular|euler|quat(ernion)?|rot(ation)?|orientation|vel(ocity|ocities)?|speed"
    r"|omega|accel|accelerations?|accelerometer|linacc|freeacc|jerk|gyr|gyro|gyroscope|magnetometer|magnetic|gravity|emg|strain",
    re.IGNORECASE,
)
_PERHAPS_QUANTITY = re.compile("acc|mag|for|mom|cop|[agmfwveq]", re.IGNORECASE)
"""Words that name an axis of a force plate or of an inertial sensor, and a marker as well (ACC on the acromion)."""
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


@dataclass(frozen=True)
class ColumnGroup:
    """One point of a table: its name, its three columns in the order x, y, z, and the unit that its names carry."""

    name: str
    columns: tuple[int, int, int]
    units: str | None = None


def marker_groups(names: Sequence[str]) -> tuple[list[ColumnGroup], list[int]]:
    """The points that a table's column names spell out, in column order, and the other columns.

    The spellings are NAME_x, NAME.X, NAME X, NAME:x, NAME_tx, x_NAME, NAME_pos_x, NAME[0], NAMEX and X1, each with or without a unit
    after it. The first spelling that gives the most groups counts for the whole file. Forces, angles and what inertial sensors measure
    have an x, y and z as well, and are no points.
    """
    # One spelling for the whole file: mixed ones would tear the axes of a marker apart.
    found = [_positions(_groups(names, pattern), attached=i == _ATTACHED) for i, pattern in enumerate(_SUFFIXES)]
    best = max(found, key=len)
    # Where the names say which columns are positions, the others are none.
    if any(word.casefold() in ("pos", "position") for group in best for word in _WORD.findall(group.name)):
        best = found[_EXPLICIT]
    taken = {column for group in best for column in group.columns}
    return best, [i for i in range(len(names)) if i not in taken]


def _positions(groups: list[ColumnGroup], attached: bool) -> list[ColumnGroup]:
    """The groups that are no forces, angles, accelerations, ...; `attached` where the axis stands right behind the name."""
    words = [_WORD.findall(group.name) for group in groups]
    # OpenSim writes ground_force_vx and hip_rx; with a separator before the axis, such a letter is a side.
    sure = [
        any(map(_QUANTITY.fullmatch, of)) or (attached and group.name[-2:] in ("_v", "_p", "_f", "_m", "_r"))
        for group, of in zip(groups, words, strict=True)
    ]
    perhaps = [len(of) <= 2 and any(map(_PERHAPS_QUANTITY.fullmatch, of)) for of in words]
    # A doubtful word counts beside a clear one, and where there is nothing else.
    both = any(sure) or all(perhaps)
    return [group for group, no, doubtful in zip(groups, sure, perhaps, strict=True) if not no and not (both and doubtful)]


def exact_groups(names: Sequence[str], before_axis: str, start: int = 0) -> list[ColumnGroup] | None:
    """The points where all columns from `start` on are NAME + before_axis + x, y, z side by side, as Asterism writes them; else None."""
    found = []
    for i in range(start, len(names), 3):
        # Side by side and in order: only then no name can be mistaken for another's axis.
        stems = [name.removesuffix(before_axis + axis) for name, axis in zip(names[i : i + 3], "xyz", strict=False)]
        if len(stems) < 3 or len(set(stems)) != 1 or stems[0] == names[i]:
            return None
        found.append(ColumnGroup(stems[0], (i, i + 1, i + 2)))
    return found


def _groups(names: Sequence[str], pattern: re.Pattern[str]) -> list[ColumnGroup]:
    incomplete: dict[str, dict[int, int]] = {}
    found: list[tuple[int, ColumnGroup]] = []
    for column, name in enumerate(names):
        match = pattern.fullmatch(name.strip())
        if match is None:
            continue
        marker, axis = match["name"].strip(), match["axis"].lower()
        axes = incomplete.setdefault(marker, {})
        # An index of 0 to 2 stands for x to z.
        axes[("xyz".find(axis) if axis in "xyz" else int(axis))] = column
        if len(axes) == 3:
            found.append((min(axes.values()), ColumnGroup(marker, (axes[0], axes[1], axes[2]), match["units"] or match["bare"])))
            # A name may come again later in the file: it is then another point.
            del incomplete[marker]
    return [group for _, group in sorted(found, key=lambda pair: pair[0])]
