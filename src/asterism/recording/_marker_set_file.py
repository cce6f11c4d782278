"""The table of a marker set's TOML file in; the fields of a `MarkerSet`, each of its type, out. And back."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from asterism.errors import AsterismError
from asterism.recording.place import CENTRAL_SEGMENTS, SIDED_SEGMENTS, USUAL_SPREAD, Place, landmarks, other_side

_LONGEST_NAME = 200


def fields_of(table: Mapping[str, Any], origin: str) -> dict[str, Any]:
    """The fields of a marker set. Raises ValueError that names the first one of another type."""
    names = _texts("markers", table.get("markers"))
    pairs = tuple(_pair(number, pair) for number, pair in enumerate(_list("pairs", table.get("pairs", []))))
    return {
        "names": names,
        "title": _text("title", table.get("title", origin)),
        "aliases": _lists("aliases", table.get("aliases", {})),
        "pairs": pairs,
        "segments": _lists("segments", table.get("segments", {})),
        "places": _places(table.get("places", {}), names, pairs, origin),
        "optional": _texts("optional", table.get("optional", [])),
    }


def _places(table: Any, names: Sequence[str], pairs: Sequence[tuple[str, str]], origin: str) -> dict[str, Place]:
    """The place of each marker that the table [places] tells, in the order of the markers. Raises AsterismError that names the entry.

    The left marker of a pair stands for both, unless the right one has an entry of its own.
    """
    if not isinstance(table, dict):
        raise ValueError(f"`places` is {_kind(table)}, not a table of places")
    right_of = dict(pairs)
    # A file without pairs means them where names differ in a first L and R alone.
    if not pairs:
        right_of = {name: "R" + name[1:] for name in names if name[:1] == "L" and "R" + name[1:] in names}
    side_of = {**dict.fromkeys(right_of, "left"), **dict.fromkeys(right_of.values(), "right")}
    own: dict[str, Place] = {}
    for name, entry in table.items():
        where = f"{origin}, places.{name[:40]}"
        if name not in names:
            raise AsterismError(f"{where}: {name[:40]!r} is not among the markers; list it there, or drop its place.")
        try:
            own[name] = _place(entry, side_of.get(name, ""))
        except (AsterismError, ValueError) as problem:
            raise AsterismError(f"{where}: {problem}") from problem
    mirrored = {right: own[left].mirrored() for left, right in right_of.items() if left in own}
    return {name: (mirrored | own)[name] for name in names if name in mirrored or name in own}


def _place(entry: Any, side: str) -> Place:
    """One entry of the table; side: "left" or "right" for a marker of a pair, else ""."""
    if isinstance(entry, str):
        entry = {"landmark": entry}
    if not isinstance(entry, dict):
        raise ValueError(f'it is {_kind(entry)}; write {{ segment = "thigh", place = [0.02, 0.08, -0.5] }} or the name of a landmark.')
    unknown = next((key for key in entry if key not in ("landmark", "segment", "place", "spread", "wand", "plate")), None)
    if unknown is not None:
        raise ValueError(f"{unknown[:40]!r} says nothing; a place has segment and place, or landmark, and spread, wand and plate.")
    plate, wand = entry.get("plate", ""), entry.get("wand")
    if not isinstance(plate, str) or len(plate) > _LONGEST_NAME:
        raise ValueError("`plate` is not the short name of a plate; write a text.")
    if not isinstance(wand, bool | None):
        raise ValueError(f"`wand` is {_kind(wand)}; write true or false.")
    spread = None if entry.get("spread") is None else _number("spread", entry["spread"])
    if "landmark" in entry:
        segment, at, known_spread, known_wand = _landmark_of(entry)
        # A landmark of the right side is its left one, mirrored.
        if side == "right" or entry["landmark"].startswith("right "):
            at = (at[0], 0.0 - at[1], at[2])
    else:
        segment, at, known_spread, known_wand = _segment(entry.get("segment")), _three(entry.get("place")), USUAL_SPREAD, False
    if segment in SIDED_SEGMENTS:
        if not side:
            raise ValueError(f"{segment!r} is on both sides and the marker is of no pair; write 'left {segment}' or 'right {segment}'.")
        segment = f"{side} {segment}"
    elif side and segment == other_side(f"{side} {segment.partition(' ')[2]}"):
        raise ValueError(f"it is the {side} one of a pair and sits on the {segment}; exchange the pair or mend the segment.")
    # Each side has a plate of its own; one on pelvis, thorax or head is one for both.
    if plate and side and segment not in CENTRAL_SEGMENTS and not plate.startswith(("left ", "right ")):
        plate = f"{side} {plate}"
    return Place(segment, at, known_spread if spread is None else spread, known_wand if wand is None else wand, plate)


def _landmark_of(entry: Mapping[str, Any]) -> tuple[str, tuple[float, float, float], float, bool]:
    """Segment, place, spread and wand of the landmark that an entry names, as on the left side."""
    if "segment" in entry or "place" in entry:
        raise ValueError("it has a landmark and a segment or place; keep one of the two.")
    full = entry["landmark"]
    if not isinstance(full, str):
        raise ValueError(f"`landmark` is {_kind(full)}; write the name of one.")
    known = landmarks()
    name = full.removeprefix("left ").removeprefix("right ")
    if name not in known:
        near = difflib.get_close_matches(name[:80], known, n=3, cutoff=0.4)
        raise ValueError(f"no landmark is called {full[:40]!r}{'; near it: ' if near else ''}{', '.join(near)}; see docs/marker-sets.md.")
    found = known[name]
    side = full.partition(" ")[0] if full != name else ""
    segment = f"{side} {found.segment}" if side and found.segment in SIDED_SEGMENTS else found.segment
    return segment, found.at, found.spread, found.wand


def _segment(value: Any) -> str:
    known = (*CENTRAL_SEGMENTS, *SIDED_SEGMENTS)
    if not isinstance(value, str):
        raise ValueError(f"`segment` is {_kind(value)}; write one of {', '.join(known)}.")
    if value.removeprefix("left ").removeprefix("right ") not in known:
        raise ValueError(f"{value[:40]!r} is no segment of a body; write one of {', '.join(known)}.")
    return value


def _three(value: Any) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        what = f"a list of {len(value)}" if isinstance(value, list) else _kind(value)
        raise ValueError(f"`place` is {what}, not three numbers; write [ahead, left, up].")
    return _number("place", value[0]), _number("place", value[1]), _number("place", value[2])


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"`{what}` holds {_kind(value)} where a number belongs; write metres.")
    # An integer beyond all floats is no length either.
    return float(value) if abs(value) < 1e9 else float("inf")


def _text(place: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"`{place}` is {_kind(value)}, not a text")
    # A damaged file can hold a name of megabytes.
    if len(value) > _LONGEST_NAME and place != "title":
        raise ValueError(f"`{place}` has a name of {len(value)} characters, {_LONGEST_NAME} at most are one")
    return value


def _list(place: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"`{place}` is {_kind(value)}, not a list")
    return value


def _texts(place: str, value: Any) -> tuple[str, ...]:
    return tuple(_text(place, item) for item in _list(place, value))


def _lists(place: str, value: Any) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, dict):
        raise ValueError(f"`{place}` is {_kind(value)}, not a table of lists")
    return {_text(place, name): _texts(f"{place}.{name[:40]}", items) for name, items in value.items()}


def _pair(number: int, value: Any) -> tuple[str, str]:
    names = _texts(f"pairs, number {number + 1}", value)
    if len(names) != 2:
        raise ValueError(f"number {number + 1} of `pairs` has {len(names)} names, not two")
    return names[0], names[1]


def _kind(value: Any) -> str:
    kinds = {
        type(None): "missing",
        bool: "a truth value",
        int: "a number",
        float: "a number",
        str: "a text",
        list: "a list",
        dict: "a table",
    }
    # TOML has dates and times besides these.
    return kinds.get(type(value), "a date or time")


_WIDTH = 120
"""Characters in a line of a list."""


def text_of(
    title: str,
    names: Sequence[str],
    pairs: Sequence[tuple[str, str]],
    lists: Mapping[str, Mapping[str, Sequence[str]]],
    places: Mapping[str, Place],
    optional: Sequence[str] = (),
) -> str:
    """The TOML text of a marker set; lists: the tables `aliases` and `segments`."""
    lines = [f"title = {_toml(title)}", f"markers = {_list_text(names)}"]
    if pairs:
        lines.append(f"pairs = {_list_text(pairs)}")
    if optional:
        lines.append(f"optional = {_list_text(optional)}")
    for table, entries in lists.items():
        if entries:
            lines += ["", f"[{table}]", *(f"{_key(name)} = {_list_text(others)}" for name, others in entries.items())]
    if places:
        lines += ["", "[places]", *_place_lines(places, pairs)]
    return "\n".join(lines) + "\n"


def _place_lines(places: Mapping[str, Place], pairs: Sequence[tuple[str, str]]) -> list[str]:
    """One line a marker; none for the right one of a pair that mirrors its left one."""
    lines = []
    left_of, paired = {right: left for left, right in pairs}, {name for pair in pairs for name in pair}
    for name, place in places.items():
        left = left_of.get(name, "")
        if left in places and places[left].mirrored() == place:
            continue
        # A marker of a pair has its side from the pair.
        segment = place.plain_segment if name in paired else place.segment
        plate = place.plate.removeprefix(f"{place.side} ") if name in paired and place.side else place.plate
        entry = f"segment = {_toml(segment)}, place = [{', '.join(map(_number_text, place.at))}], spread = {_number_text(place.spread)}"
        entry += (", wand = true" if place.wand else "") + (f", plate = {_toml(plate)}" if plate else "")
        lines.append(f"{_key(name)} = {{ {entry} }}")
    return lines


def _number_text(value: float) -> str:
    """A number as TOML has it: 0.02, not 2e-2 without a point."""
    text = repr(float(value))
    return text if "." in text or "e" in text else f"{text}.0"


def _list_text(values: Sequence[Any]) -> str:
    """A list in one line, or one that goes on below where it is long."""
    items = [_toml(list(value) if isinstance(value, tuple) else value) for value in values]
    line = f"[{', '.join(items)}]"
    if len(line) <= _WIDTH:
        return line
    rows, row = [], "   "
    for item in items:
        if len(row) + len(item) + 2 > _WIDTH:
            rows.append(row)
            row = "   "
        row += f" {item},"
    return "\n".join(["[", *rows, row, "]"])


def _toml(value: Any) -> str:
    """A text or a list of texts; TOML's basic strings are JSON's, but for the delete character, which it wants escaped."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else _toml(name)
