"""`asterism convert`: a file in one format in, the same in another format out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._filling import (
    Fill,
    Filter,
    as_values,
    cleaned,
    fill_limit,
    filled,
    filled_text,
    filter_choice,
    filter_values,
)
from asterism.cli._options import (
    ForProgram,
    Json,
    LengthUnit,
    Markers,
    Missing,
    MissingBones,
    Overwrite,
    Vertical,
    marker_names,
    vertical_axis,
)
from asterism.errors import AsterismError
from asterism.findings import Finding, exit_status

if TYPE_CHECKING:
    from asterism.motion.filters import FilteredRecording
    from asterism.motion.gaps import Filled


@dataclass(frozen=True)
class ConvertOptions:
    """What `asterism convert` is asked to do."""

    source: Annotated[Path, typer.Argument(metavar="IN", help="The file to read.", show_default=False)]
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write; its suffix says the format.", show_default=False)]
    markers: Markers = None
    vertical: Vertical = None
    program: ForProgram = None
    fill: Fill = "none"
    trials: Annotated[
        list[str],
        typer.Option(
            "--trials",
            metavar="auto|none|FILE",
            help="Other recordings of the person that tell --fill; auto takes those beside IN that show the same person.",
        ),
    ] = field(default_factory=lambda: ["auto"])
    filter: Filter = "none"
    static: Annotated[
        Path | None,
        typer.Option(
            "--static", metavar="FILE", help="A standing trial of the person, for the bones of a BVH or glTF file.", show_default=False
        ),
    ] = None
    stream: Annotated[
        str | None,
        typer.Option("--stream", metavar="NAME", help="Of an XDF the stream to read; else that with the most markers.", show_default=False),
    ] = None
    unit: LengthUnit = None
    euler: Annotated[str, typer.Option("--euler", metavar="ORDER", help="The order of a BVH's angles, the outermost axis first.")] = "ZXY"
    missing: Missing = MissingBones.HOLD
    overwrite: Overwrite = False
    json: Json = None


@takes(ConvertOptions)
def convert(options: ConvertOptions) -> None:
    """Write a file in another format.

    The suffix of OUT says which: C3D, TRC, CSV, TSV, MAT or NPZ; tables of numbers are MOT, STO or CSV.
    Rigs become .toml (Asterism's), *anipose.toml, camera_array.toml, .yml, .xml, .xcp, .qca.txt or .ori.
    BVH, .glb and .gltf hold bones: the person's skeleton is fitted to the markers, best with --static, or read from another such file.
    What the other format cannot carry is named on standard error.
    --for turns the recording as the next program takes it: opensim TRC with y up, visual3d and blender C3D with z up.
    For opensim the force plates of a C3D file go beside it: OUT_grf.mot, and OUT_grf.xml with the foot on which each acts.
    --fill fills gaps from the markers around them, and from other trials of the person, which --trials names. In C3D a filled sample has
    the residual 0 or, where measured samples have that, too, its standard deviation, and no camera; the processing log names all filled
    gaps. What is too uncertain stays missing, and is said. --filter smooths named markers, after gaps are filled; the log says how far.
    """
    from asterism import formats
    from asterism.cli._recordings import is_rig, not_carried

    source, target = options.source, options.target
    _console.check_new(target, options.overwrite)
    _console.check_new(options.json, options.overwrite)
    for beside in formats.companions(target) if options.program is not None and options.program.value == "opensim" else ():
        _console.check_new(beside, options.overwrite)
    axis, wanted, limit = vertical_axis(options.vertical), marker_names(options.markers), fill_limit(options.fill)
    choice = None if options.filter == "none" else filter_choice(options.filter)
    fill: Filled | None = None
    done, findings = list[str](), list[Finding]()
    clean: FilteredRecording | None = None
    changes = (wanted, options.program, limit, choice, options.stream)
    # rigs and recordings share suffixes, so that this is asked first
    if is_rig(source):
        findings, lost = _convert_rig(source, target, axis, next((one for one in changes if one is not None), None))
    elif formats.is_skeleton_file(target):
        findings, lost = _convert_skeleton(options, axis)
    # the whole file, with all that the formats have in common
    elif all(one is None for one in changes):
        findings, lost = formats.convert_and_tell(source, target, axis)
    else:
        recording = formats.read(source, wanted, axis, options.stream)
        findings = list(recording.warnings)
        if limit is not None:
            fill = filled(recording, limit, _trials(options), options.vertical)
            recording, done = fill.recording, [filled_text(fill)]
            findings += fill.findings
        if choice is not None:
            clean = cleaned(recording, choice)
            recording, done = clean.recording, [*done, str(clean)]
            findings += clean.findings
        if options.program is not None:
            lost = formats.write_for_program(recording, options.program.value, target)
        else:
            lost = formats.write(target, recording)
        # Tables have no place for it, and a guess that looks measured misleads.
        if fill is not None and fill.gaps and target.suffix.lower() not in (".c3d", ".npz"):
            lost = [*lost, "which samples were filled"]
    findings += not_carried(target, lost)
    for finding in findings:
        _console.report(finding)
    if options.json != "-":
        _console.result(f"{source} -> {target}{': ' if done else ''}{'; '.join(done)}")
    _console.write_json(
        options.json,
        {
            "command": "convert",
            "file": source,
            "output": target,
            "for": options.program,
            "filled": None if fill is None else as_values(fill),
            "filter": None if clean is None else filter_values(clean),
            "not_carried": lost,
            "findings": [finding.to_dict() for finding in findings],
        },
    )
    raise typer.Exit(exit_status(findings))


def _convert_skeleton(options: ConvertOptions, axis: Any) -> tuple[list[Finding], list[str]]:
    """Write the bones of a person, or those of another file; returns what was found, and what the other format cannot carry."""
    from asterism import formats
    from asterism.cli._skeletons import person_motion

    if options.program is not None or options.fill != "none" or options.filter != "none":
        raise AsterismError(f"{options.target} holds bones and no markers; leave out --for, --fill and --filter.")
    if options.stream is not None:
        raise AsterismError(f"{options.target} holds bones; write the stream as .c3d first, and convert that.")
    # before the skeleton is fitted, which takes seconds
    formats.check_skeleton_form(options.unit or "cm", options.euler)
    person = person_motion(options.source, options.static, options.markers, axis, options.unit)
    lost = formats.write_skeleton(
        options.target, person.motion, unit=options.unit or "cm", order=options.euler, missing=options.missing.value
    )
    return list(person.findings), lost


def _trials(options: ConvertOptions) -> list[Path]:
    """The other recordings that --trials names, without the one that is written. Raises AsterismError where one is not there."""
    from asterism.session import trials_of

    if options.trials == ["none"]:
        return []
    if options.trials == ["auto"]:
        return trials_of(options.source, without=[options.target])
    missing = [name for name in options.trials if not Path(name).is_file()]
    if missing:
        raise AsterismError(f"--trials {missing[0]}: there is no such file; give auto, none, or recordings of the same person.")
    return [Path(name) for name in options.trials]


def _convert_rig(source: Path, target: Path, vertical: Any, markers: Any) -> tuple[list[Finding], list[str]]:
    """Write a rig in another format; returns what had to be assumed of it, and what the other format cannot carry."""
    from asterism.cameras.files import read_rig, write_rig
    from asterism.cli._recordings import assumptions
    from asterism.recording import as_vertical

    if markers is not None:
        raise AsterismError(f"{source} is a rig and has no markers; leave out --markers, --for, --fill and --filter.")
    rig = read_rig(source)
    # a guess that is written down looks like a fact in the next program
    findings = assumptions(source, rig)
    return findings, write_rig(rig if vertical is None else replace(rig, vertical=as_vertical(vertical)), target)
