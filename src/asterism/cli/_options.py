"""The arguments and options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from asterism.errors import AsterismError


class LowerBodyModel(StrEnum):
    """How the angles of legs are computed: docs/motion.md."""

    PLUG_IN_GAIT = "plug-in-gait"
    LANDMARKS = "landmarks"


class HipRegression(StrEnum):
    """Whose regression tells the hip joint centres."""

    DAVIS = "davis"
    BELL = "bell"
    HARRINGTON = "harrington"


class SearchStrategy(StrEnum):
    """How partial solvers are searched for: thesis 4.5.3."""

    BOTTOM_UP = "bottom-up"
    TOP_DOWN = "top-down"
    GENETIC = "genetic"
    GENETIC_ALL = "genetic-all"


class KnownLabels(StrEnum):
    """What the names are worth that points of a file have already."""

    KEEP = "keep"
    CHECK = "check"
    IGNORE = "ignore"


class MissingBones(StrEnum):
    """What becomes of bones in frames in which they are not known."""

    HOLD = "hold"
    INTERPOLATE = "interpolate"


class Program(StrEnum):
    """The next program, whose files differ in axes and in what is in their way."""

    OPENSIM = "opensim"
    VISUAL3D = "visual3d"
    BLENDER = "blender"


class Rules(StrEnum):
    """How a frame is labelled: by the whole body, by the partial solvers' votes and the whole model, or by the thesis' rules."""

    WHOLE_BODY = "whole-body"
    PARTIAL_SOLVERS = "partial-solvers"
    THESIS = "thesis"


Files = Annotated[
    list[Path],
    typer.Argument(metavar="FILES", help="Recordings, or folders of them: C3D, TRC, CSV, TSV, MAT, NPZ or XDF.", show_default=False),
]
Static = Annotated[
    Path | None,
    typer.Option("--static", metavar="FILE", help="A standing trial of the person: offsets of wands, tibia and feet.", show_default=False),
]
LowerBodyChoice = Annotated[
    LowerBodyModel | None,
    typer.Option("--lower-body", help="How angles of the legs are computed. By itself by the markers that are worn.", show_default=False),
]
Hip = Annotated[
    HipRegression | None,
    typer.Option("--hip", help="Whose regression tells the hip centres. By itself the model's own.", show_default=False),
]
Measure = Annotated[
    list[str],
    typer.Option(
        "--measure",
        metavar="NAME=VALUE",
        help="A measure of the person by Plug-in-Gait's name, mm, degrees or kg: LKneeWidth=102; or a file of them: .mp, .vsk, a table.",
    ),
]
Model = Annotated[Path, typer.Option("--model", "-m", metavar="FILE", help="The model that `asterism train` wrote.", show_default=False)]
Models = Annotated[
    list[Path] | None,
    typer.Option(
        "--model",
        "-m",
        metavar="FILE",
        help="The model that `asterism train` wrote; once for each body in the room. Else one of virtual people who wear the marker set.",
        show_default=False,
    ),
]
WornSets = Annotated[
    list[str] | None,
    typer.Option(
        "--markers",
        metavar="SET",
        help="Without a model, the set worn: a shipped one such as plug-in-gait, a TOML file, or names with commas; once for each body. "
        "Else it is found.",
        show_default=False,
    ),
]
Markers = Annotated[
    str | None,
    typer.Option(
        metavar="SET",
        help="A shipped set such as helen-hayes, a TOML file, or names with commas. Else the physical points of the files.",
        show_default=False,
    ),
]
Vertical = Annotated[
    str | None,
    typer.Option(metavar="AXIS", help="What points up: x, y, z, -x, -y, -z or three numbers. Else as the file says.", show_default=False),
]
Seed = Annotated[int, typer.Option(metavar="N", min=0, help="Start of all random choices: same seed, same result.")]
VirtualPeople = Annotated[
    int | None,
    typer.Option(
        "--virtual-people",
        metavar="N",
        min=0,
        help="Virtual people who teach the body beside the real ones, where the marker set has places. By default 80; 0 for none.",
        show_default=False,
    ),
]
Workers = Annotated[int, typer.Option(metavar="N", min=1, help="Threads that share the work; the result is the same.")]
Processes = Annotated[int, typer.Option("--workers", metavar="N", min=1, help="Processes that share the work; the result is the same.")]
Dask = Annotated[
    str | None,
    typer.Option(
        "--dask", metavar="ADDRESS", help="A Dask scheduler (tcp://host:8786), or local:N, in place of --workers.", show_default=False
    ),
]
LengthUnit = Annotated[
    str | None,
    typer.Option(
        "--unit",
        metavar="UNIT",
        help="Unit of length of BVH files: m, cm, mm, in, ft, or metres per unit. By itself cm; of a file that is read, what fits a body.",
        show_default=False,
    ),
]
Missing = Annotated[
    MissingBones, typer.Option("--missing", help="What becomes of bones in frames that do not show them: BVH and glTF have no gaps.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace files that exist.")]
Json = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write all results as JSON; - prints them instead of the table.", show_default=False),
]
Report = Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write an HTML report.", show_default=False)]
PartialSolvers = Annotated[
    SearchStrategy | None,
    typer.Option(
        "--partial-solvers",
        metavar="STRATEGY",
        help="Also search the partial solvers that the rules partial-solvers and thesis need: bottom-up, top-down, genetic or genetic-all. "
        "Takes minutes.",
        show_default=False,
    ),
]
Features = Annotated[
    str | None,
    typer.Option(
        "--features",
        metavar="NAMES",
        help="What the partial solvers read, such as g2,g4,g9,g13 (docs/labelling.md lists all); implies --partial-solvers bottom-up.",
        show_default=False,
    ),
]
RulesOption = Annotated[Rules, typer.Option("--rules", help="How a frame is labelled: by the whole body, or by solvers' votes.")]
FrameWise = Annotated[bool, typer.Option("--frame-wise", "--frames", help="Each frame by itself, without time and tracks.")]
KeepLabels = Annotated[bool, typer.Option("--keep-labels", help="The same as --known-labels keep.")]
KnownLabelsOption = Annotated[
    KnownLabels | None,
    typer.Option(
        "--known-labels",
        help="Names that points already have: keep them, check them against the model's labels, or ignore them. Else check, "
        "where a file has points with the model's names and points without a name.",
        show_default=False,
    ),
]
Subjects = Annotated[
    list[Path] | None,
    typer.Option(
        "--subject",
        metavar="FILE",
        help="A trial of the person, best standing: narrows the model to this body. Of several, the nearest by folder counts.",
        show_default=False,
    ),
]
SubjectName = Annotated[
    str | None,
    typer.Option("--subject", metavar="NAME", help="All files are of this person. Else as they say, or their folder.", show_default=False),
]
ForProgram = Annotated[
    Program | None,
    typer.Option(
        "--for", help="Write what this program reads: its axis up, millimetres, and only the points that it needs.", show_default=False
    ),
]
NoStatic = Annotated[bool, typer.Option("--no-static", help="Look for no standing trials among the files.")]
DropComputed = Annotated[bool, typer.Option("--drop-computed", help="Leave out the points and angles that a model computed.")]
MarkerTargets = Annotated[
    list[str] | None,
    typer.Option(
        "--marker-target",
        metavar="NAME=SHARE",
        help="Another target hit rate for the partial solvers of one marker, such as LTHI=0.99; may be given several times.",
        show_default=False,
    ),
]
HitRate = Annotated[
    float, typer.Option("--target-hit-rate", metavar="SHARE", help="Share of the labels given that should be right, below 1.")
]


def marker_names(given: str | None) -> str | list[str] | None:
    """What --markers means to `asterism.read`: a set's name or path, or a list of names."""
    # a file may have a comma in its name, also one that is missing
    if given is None or "," not in given or Path(given).is_file() or given.casefold().endswith(".toml"):
        return given
    return [name.strip() for name in given.split(",") if name.strip()]


def vertical_axis(given: str | None) -> str | list[float] | None:
    """What --vertical means to `asterism.read`: an axis name or three numbers."""
    if given is None or "," not in given:
        return given
    try:
        return [float(number) for number in given.split(",")]
    except ValueError:
        raise AsterismError(
            f"--vertical {given} is not a direction; give an axis such as z or -y, or three numbers such as 0,0,1."
        ) from None


def numbers(given: str, option: str) -> tuple[int, ...]:
    """The numbers of a list option, each once, in order."""
    try:
        # shells hand over "0 1 2" and "0,1,2"; a number that comes twice is done once
        listed = tuple(dict.fromkeys(int(number) for number in given.replace(",", " ").split()))
    except ValueError:
        listed = ()
    if not listed or min(listed) < 0:
        raise AsterismError(f"{option} {given} is not a list of numbers; give for example {option} 0 1 2 3.")
    return listed


def metres(given: str, option: str) -> tuple[float, ...]:
    """The lengths of a list option, in order. Raises AsterismError where one is not a number."""
    try:
        return tuple(float(number) for number in given.replace(",", " ").split())
    except ValueError:
        raise AsterismError(f"{option} {given} is not a list of lengths in metres; give for example {option} 0 0.2 0.6.") from None


def image_size(given: str, option: str) -> tuple[int, int]:
    """The width and height (px) of "1280x1024". Raises AsterismError for anything else."""
    sides = given.lower().replace("×", "x").split("x")
    if len(sides) != 2 or not all(side.strip().isdigit() and int(side) > 0 for side in sides):
        raise AsterismError(f"{option} {given} is not an image size; give width x height in pixels, such as 1280x1024.")
    return int(sides[0]), int(sides[1])


def marker_targets(given: list[str] | None) -> dict[str, float]:
    """What --marker-target means to `TrainingRules`. Raises AsterismError for anything but NAME=SHARE."""
    targets = {}
    for pair in given or ():
        name, _, share = pair.partition("=")
        try:
            targets[name.strip()] = float(share)
        except ValueError:
            raise AsterismError(f"--marker-target {pair} names no share; give for example --marker-target LTHI=0.99.") from None
    return targets


def feature_names(given: str | None) -> tuple[str, ...] | None:
    """What --features means to `MarkerModel.fit`. Raises AsterismError for a name that is not known, before any file is read."""
    if given is None:
        return None
    from asterism.labelling.features.registry import kinds_of

    names = tuple(name.strip() for name in given.split(",") if name.strip())
    # a name that is not known is told before any file is read
    kinds_of(names)
    return names


def check_hit_rate(given: float) -> None:
    """Raise AsterismError where a target hit rate is not below 1 and at least 0.5."""
    if not 0.5 <= given < 1:
        raise AsterismError(f"--target-hit-rate {given} is not a share from 0.5 to below 1; give for example 0.999.")
