"""`asterism retarget`: a person's movement and a character in; the character that moves as the person, with feet that stand, out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, LengthUnit, Markers, Missing, MissingBones, Overwrite, Vertical, vertical_axis
from asterism.errors import AsterismError
from asterism.findings import exit_status

if TYPE_CHECKING:
    from asterism.skeleton.retargeting import Retargeted


_SHOWN = 12
"""Names in a line."""


@dataclass(frozen=True)
class RetargetOptions:
    """What `asterism retarget` is asked to do."""

    source: Annotated[Path, typer.Argument(metavar="IN", help="A labelled recording, or a BVH or glTF file.", show_default=False)]
    character: Annotated[
        Path, typer.Option("--character", "-c", metavar="FILE", help="The character: a BVH or glTF file.", show_default=False)
    ]
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="OUT", help="The file to write: .bvh, .glb or .gltf.", show_default=False)
    ]
    static: Annotated[Path | None, typer.Option("--static", metavar="FILE", help="A standing trial of the person.", show_default=False)] = (
        None
    )
    bones: Annotated[
        Path | None,
        typer.Option("--bones", metavar="FILE", help="A TOML file that says which bone is which part of the body.", show_default=False),
    ] = None
    hands: Annotated[bool, typer.Option("--hands", help="Put hands where the person's are, instead of turning arms alike.")] = False
    feet: Annotated[bool, typer.Option("--feet/--no-feet", help="Whether feet are held where they stand.")] = True
    missing: Missing = MissingBones.HOLD
    unit: LengthUnit = None
    markers: Markers = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(RetargetOptions)
def retarget(options: RetargetOptions) -> None:
    """Move a character of other proportions as a person moved.

    Bones turn as those of the person do, whatever pose the character rests in; its hips go as far as its legs are long. Feet stay where
    they stand, by the foot strikes and offs of the file and by how they move, and do not go through the floor. Which bone is which is told
    by the names that animation programs use, else by where bones hang, and is printed. How far feet slip and sink is measured before and
    after.
    A character in BVH keeps its hierarchy, channels and axes; one in glTF its meshes and all else, and the movement is its first animation.
    """
    import numpy as np

    from asterism import formats
    from asterism.cli._skeletons import person_motion
    from asterism.skeleton.retargeting import retarget as map_to

    source, target = options.source, options.output
    _console.check_outputs([target, options.json], [source, options.character, options.static, options.bones], options.overwrite)
    for path, what in ((target, "the output"), (options.character, "the character")):
        if not formats.is_skeleton_file(path):
            raise AsterismError(f"{path}: {what} is a BVH or glTF file; give one with .bvh, .glb or .gltf.")
    bones = {} if options.bones is None else _bones(options.bones)
    character = formats.read_skeleton(options.character, unit=options.unit)
    person = person_motion(source, options.static, options.markers, vertical_axis(options.vertical), options.unit)
    motion, filled = formats.fill_missing_bones(person.motion, options.missing.value)
    result = map_to(motion, character.motion, events=person.events, bones=bones, hands=options.hands, feet=options.feet)
    same = (target.suffix.casefold() == ".bvh") == (options.character.suffix.casefold() == ".bvh")
    lost = formats.write_skeleton(target, result.motion, like=options.character if same else None, unit=options.unit or "cm")
    findings = [*character.findings, *person.findings, *result.findings]
    for finding in findings:
        _console.report(finding)
    for phrase in filled:
        _console.notice(f"{source}: {phrase}")
    for phrase in lost:
        _console.notice(f"{target} does not hold {phrase}")
    if options.json != "-":
        _show(options, result)
    _console.write_json(
        options.json,
        {
            "command": "retarget",
            "file": source,
            "character": options.character,
            "output": target,
            "frames": len(result.motion),
            "scale": result.scale,
            "bones": [dict(zip(("part", "bone", "from", "found_by"), one, strict=True)) for one in result.correspondence],
            "free": list(result.free),
            "contacts_from": result.contacts.source,
            "belt_m_per_s": result.contacts.belt.tolist(),
            "feet_copied": result.before.to_dict(),
            "feet": result.after.to_dict(),
            "hips_moved_m": float(np.linalg.norm(result.moved, axis=1).max(initial=0.0)),
            "filled": filled,
            "not_carried": lost,
            "findings": [finding.to_dict() for finding in findings],
        },
    )
    raise typer.Exit(exit_status(findings))


def _show(options: RetargetOptions, result: Retargeted) -> None:
    rows = [list(one) for one in result.correspondence]
    _console.table(f"{options.character}: bones", ["part", "bone", "moved as", "found by"], rows)
    if result.free:
        more = " ..." if len(result.free) > _SHOWN else ""
        _console.result(f"{len(result.free)} bones stay on the bone above as they rest: {', '.join(result.free[:_SHOWN])}{more}")
    before, after = result.before.to_dict(), result.after.to_dict()
    told = "events and movement" if result.contacts.source == "events" else "movement"
    _console.result(
        f"{options.source} -> {options.output}: {len(result.motion)} frames; legs are {result.scale:.2f} times as long. "
        f"Heels and balls of the feet stand {after['contacts']} times, told by {told}. They slip by up to {after['slip_mm']:.1f} mm (bones "
        f"only copied: {before['slip_mm']:.1f} mm) and sink by up to {after['penetration_mm']:.1f} mm ({before['penetration_mm']:.1f} mm)."
    )


def _bones(path: Path) -> Mapping[str, Mapping[str, str]]:
    """Which bone is which part, from a TOML file with tables `character` and `person`. Raises AsterismError where it holds other things."""
    from asterism.files.toml import read_toml
    from asterism.skeleton.retargeting.body_parts import PART_NAMES

    content: dict[str, Any] = read_toml(path)
    for table, entries in content.items():
        if table not in ("character", "person") or not isinstance(entries, dict):
            raise AsterismError(f"{path}: {table!r} is not known; give tables [character] and [person].")
        for part, name in entries.items():
            if part not in PART_NAMES or not isinstance(name, str):
                raise AsterismError(f'{path}: {part!r} = {name!r} is no part with the name of a bone; write "left thigh" = "LeftUpLeg".')
    return content
