"""Body models as TOML: files and shipped names in, `ArticulatedBody` out, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from asterism.errors import AsterismError, guarded_reading
from asterism.files.toml import tables_of_toml, toml_text
from asterism.skeleton.body import ArticulatedBody, BodyMarker, Bone, Capsule, Hinge, Point

_VERSION = 1
_MOST = 2000
"""Entries of one kind that a file may have."""


def shipped_bodies() -> tuple[str, ...]:
    """Names of the body models that come with Asterism."""
    folder = resources.files("asterism").joinpath("bodies")
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


def load_body(source: str | Path | ArticulatedBody) -> ArticulatedBody:
    """A shipped body by name ("gait15"), a TOML file by path, or a body model as it is.

    Raises AsterismError where the name is not shipped, or the file is missing, damaged or of a later version.
    """
    if isinstance(source, ArticulatedBody):
        return source
    if isinstance(source, str) and source in shipped_bodies():
        text = resources.files("asterism").joinpath("bodies", f"{source}.toml").read_text(encoding="utf-8")
        return body_from_toml(text, source)
    path = Path(source)
    if not path.is_file():
        raise AsterismError(f"body {str(source)!r} is neither shipped ({', '.join(shipped_bodies())}) nor a TOML file that exists.")
    with guarded_reading(path):
        return body_from_toml(path.read_text(encoding="utf-8", errors="replace"), str(path))


def save_body(body: ArticulatedBody, path: str | Path) -> None:
    """Write a body as TOML, to be read back to the same numbers within 0.1 mm and 0.1 degrees. Raises AsterismError where it cannot be."""
    from asterism.files.atomic import write_atomically

    write_atomically(Path(path), body_to_toml(body).encode())


def body_from_toml(text: str, origin: str) -> ArticulatedBody:
    """A body model from its TOML text; `origin` names it in messages. Raises AsterismError that names the first entry that is wrong."""
    try:
        table = tables_of_toml(text)
        if table.get("format") != "asterism body":
            raise ValueError('it does not begin with format = "asterism body"')
        if table.get("version") != _VERSION:
            raise ValueError(f"its version is {table.get('version')!r}, and this Asterism reads {_VERSION}")
        return _body(table, origin)
    except (RecursionError, ValueError, TypeError) as problem:
        raise AsterismError(f"{origin} is not a body model ({problem}); make one with `asterism body fit`.") from problem


def _body(table: Mapping[str, Any], origin: str) -> ArticulatedBody:
    bones = tuple(_bone(entry) for entry in _tables(table, "bones"))
    hinges = [hinge.name for bone in bones for hinge in bone.hinges]
    poses = {}
    for entry in _tables(table, "poses", needed=False):
        angles = _mapping(entry.get("angles_deg", {}), "angles_deg")
        # A pose with a misspelt hinge would silently leave that hinge at rest.
        unknown = next((name for name in angles if name not in hinges), None)
        if unknown is not None:
            raise ValueError(f"the pose {entry.get('name')!r} turns {unknown!r}, which is no hinge")
        poses[_text(entry, "name")] = tuple(math.radians(_number(angles.get(name, 0.0), "angles_deg")) for name in hinges)
    markers = tuple(
        BodyMarker(_text(entry, "name"), _text(entry, "bone"), _point(entry, "place"), _number(entry.get("spread", 0.015), "spread"))
        for entry in _tables(table, "markers")
    )
    capsules = tuple(
        Capsule(_text(entry, "name"), _text(entry, "bone"), _point(entry, "start"), _point(entry, "end"), _pair(entry, "radii"))
        for entry in _tables(table, "capsules", needed=False)
    )
    aliases = {
        name: tuple(str(spelling) for spelling in spelled)
        for name, spelled in _mapping(table.get("aliases", {}), "aliases").items()
        if isinstance(spelled, list)
    }
    spread = _pair(table, "scale_spread") if "scale_spread" in table else (0.12, 0.04)
    title = table.get("title", origin)
    return ArticulatedBody(str(title), _number(table.get("height"), "height"), bones, markers, capsules, poses, aliases, spread)


def _bone(entry: Mapping[str, Any]) -> Bone:
    hinges = tuple(
        Hinge(
            _text(hinge, "name"),
            _unit(_point(hinge, "axis")),
            *(
                math.radians(_number(hinge.get(key, usual), key))
                for key, usual in (("usual_deg", 0.0), ("spread_deg", 30.0), ("low_deg", -170.0), ("high_deg", 170.0))
            ),
        )
        for hinge in _tables(entry, "hinges", needed=False)
    )
    return Bone(_text(entry, "name"), str(entry.get("parent", "")), _point(entry, "pivot"), hinges)


def _unit(axis: Point) -> Point:
    length = math.sqrt(sum(x * x for x in axis))
    # Rounded numbers are brought to length 1; a vector far from it is a mistake.
    if not 0.5 < length < 2.0:
        raise ValueError("an axis does not have length 1")
    return (axis[0] / length, axis[1] / length, axis[2] / length)


def _tables(table: Mapping[str, Any], key: str, needed: bool = True) -> list[Mapping[str, Any]]:
    found = table.get(key, [])
    # A bound on the entries, so that a hostile file cannot take the memory.
    if not isinstance(found, list) or len(found) > _MOST or any(not isinstance(entry, dict) for entry in found) or (needed and not found):
        raise ValueError(f"`{key}` is no list of tables")
    return found


def _mapping(value: Any, key: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"`{key}` is no table")
    return value


def _text(entry: Mapping[str, Any], key: str) -> str:
    value = entry.get(key)
    if not isinstance(value, str) or not value or len(value) > 200:
        raise ValueError(f"`{key}` is missing or no short text")
    return value


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"`{key}` is missing or no finite number")
    return float(value)


def _numbers(entry: Mapping[str, Any], key: str, count: int) -> list[float]:
    value = entry.get(key)
    if not isinstance(value, list) or len(value) != count:
        raise ValueError(f"`{key}` is no list of {count} numbers")
    return [_number(item, key) for item in value]


def _point(entry: Mapping[str, Any], key: str) -> Point:
    x, y, z = _numbers(entry, key, 3)
    return (x, y, z)


def _pair(entry: Mapping[str, Any], key: str) -> tuple[float, float]:
    first, second = _numbers(entry, key, 2)
    return (first, second)


def body_to_toml(body: ArticulatedBody) -> str:
    """The body as the text of its TOML file."""
    lines = ['format = "asterism body"', f"version = {_VERSION}", f"title = {toml_text(body.title)}", f"height = {body.height:.4f} # m"]
    lines += [f"scale_spread = [{body.scale_spread[0]:.4f}, {body.scale_spread[1]:.4f}]"]
    lines += ["# Lengths in metres, in the rest pose: x ahead, y left, z up, the floor at z = 0."]
    for bone in body.bones:
        parent = [f"parent = {toml_text(bone.parent)}"] if bone.parent else []
        lines += ["", "[[bones]]", f"name = {toml_text(bone.name)}", *parent, f"pivot = {_list(bone.pivot)}"]
        if bone.hinges:
            lines += ["hinges = ["]
            for hinge in bone.hinges:
                usual, spread, low, high = (math.degrees(angle) for angle in (hinge.usual, hinge.spread, hinge.low, hinge.high))
                degrees = f"usual_deg = {usual:.1f}, spread_deg = {spread:.1f}, low_deg = {low:.1f}, high_deg = {high:.1f}"
                lines += [f"    {{ name = {toml_text(hinge.name)}, axis = {_list(hinge.axis)}, {degrees} }},"]
            lines += ["]"]
    for marker in body.markers:
        place = f"place = {_list(marker.place)}\nspread = {marker.spread:.4f}"
        lines += ["", "[[markers]]", f"name = {toml_text(marker.name)}", f"bone = {toml_text(marker.bone)}", place]
    for part in body.capsules:
        ends = f"start = {_list(part.start)}\nend = {_list(part.end)}\nradii = {_list(part.radii)}"
        lines += ["", "[[capsules]]", f"name = {toml_text(part.name)}", f"bone = {toml_text(part.bone)}", ends]
    for name, angles in body.poses.items():
        turned = ", ".join(f"{toml_text(h)} = {math.degrees(a):.1f}" for h, a in zip(body.hinge_names, angles, strict=True))
        lines += ["", "[[poses]]", f"name = {toml_text(name)}", f"angles_deg = {{ {turned} }}"]
    if body.aliases:
        lines += ["", "[aliases]"]
        lines += [f"{toml_text(name)} = [{', '.join(map(toml_text, spelled))}]" for name, spelled in body.aliases.items()]
    return "\n".join(lines) + "\n"


def _list(numbers: tuple[float, ...]) -> str:
    # Adding zero turns -0.0 into 0.0, so that a body written twice is the same file.
    return "[" + ", ".join(f"{round(number, 4) + 0.0:.4f}" for number in numbers) + "]"
