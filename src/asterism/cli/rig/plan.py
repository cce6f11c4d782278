"""`asterism rig plan`: a volume and a number of cameras in; a rig file that says where to hang them out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json, Overwrite, Report, image_size
from asterism.cli.rig.report import print_map
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cameras.accuracy import RigMap, Volume
    from asterism.cameras.plan import RigPlan


@dataclass(frozen=True)
class RigPlanOptions:
    """What `asterism rig plan` is asked to do."""

    volume: Annotated[
        str,
        typer.Option(
            "--volume",
            metavar="BOX",
            help="Width x depth x height on the floor (6x4x2.5), or spans (-3:3,-2:2,0:2.5), in metres; z is up.",
            show_default=False,
        ),
    ]
    cameras: Annotated[int, typer.Option("--cameras", metavar="N", min=2, help="How many cameras.", show_default=False)]
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The rig to write, .toml.", show_default=False)]
    size: Annotated[str, typer.Option("--image-size", "--size", metavar="WxH", help="Their images, in pixels.")] = "1280x1024"
    fov: Annotated[float | None, typer.Option("--fov", metavar="DEGREES", help="Horizontal angle of view.", show_default=False)] = None
    focal_mm: Annotated[
        float | None, typer.Option("--focal-mm", metavar="MM", help="Focal length, with --pixel-um.", show_default=False)
    ] = None
    pixel_um: Annotated[
        float | None, typer.Option("--pixel-um", metavar="UM", help="Pitch of the sensor's pixels.", show_default=False)
    ] = None
    room: Annotated[
        str | None,
        typer.Option("--room", metavar="BOX", help="The walls that carry cameras. Else 1.5 m around the volume.", show_default=False),
    ] = None
    heights: Annotated[
        str | None,
        typer.Option(
            "--heights",
            metavar="LOW:HIGH",
            help="Between which heights they may hang. Else 2.2 to 2.6 m, or the volume's.",
            show_default=False,
        ),
    ] = None
    ceiling: Annotated[bool, typer.Option("--ceiling", help="They may also hang from the ceiling, at the highest height.")] = False
    noise: Annotated[float, typer.Option("--noise", metavar="PX", help="Standard deviation of a blob's x and y.")] = 0.3
    report: Report = None
    overwrite: Overwrite = False
    json: Json = None


@takes(RigPlanOptions)
def plan(options: RigPlanOptions) -> None:
    """Propose where to hang cameras for a volume.

    Most of the volume seen by three cameras, markers on a body seen by two from the side that they face, and that exactly; cameras out of
    each other's sight. Compared with the plain ring on the same mounts, than which it is never worth less.
    """
    for path in (options.output, options.report, options.json):
        _console.check_new(path, options.overwrite)
    from asterism.cameras.accuracy import Volume, map_rig
    from asterism.cameras.files import write_rig
    from asterism.cameras.plan import focal_length

    box, pixels = Volume.parse(options.volume), image_size(options.size, "--image-size")
    # of three ways to say how wide a lens sees, one is enough
    focal = focal_length(pixels[0], fov=options.fov, focal_mm=options.focal_mm, pixel_um=options.pixel_um)
    proposal = _proposal(options, box, pixels, focal)
    # before the maps, which take longer than the plan is worth losing
    write_rig(proposal.rig, options.output)
    # the plain ring is what a laboratory would do without a plan
    ours, ring = (map_rig(rig, box, noise=options.noise) for rig in (proposal.rig, proposal.ring))
    if options.json != "-":
        _print(proposal, ours, ring, options.output)
    if options.report is not None:
        from asterism.report.rig import rig_report

        settings = {"volume": options.volume, "focal length px": round(focal, 1), "noise px": options.noise}
        title = f"Where to hang {options.cameras} cameras"
        rig_report(options.report, proposal.rig, ours, title=title, plan=proposal, settings=settings)
    _console.write_json(options.json, {"command": "rig plan", "rig": options.output, **_as_json(proposal, ours, ring)})


def _proposal(options: RigPlanOptions, box: Volume, pixels: tuple[int, int], focal: float) -> RigPlan:
    from asterism.cameras.accuracy import Volume
    from asterism.cameras.plan import Mounts, plan_rig

    room = None if options.room is None else Volume.parse(options.room)
    # where cameras may hang is decided by the room, not by the plan
    mounts = Mounts.around(box, room, _span(options.heights), ceiling=options.ceiling)
    with _console.progress("planning") as progress:
        return plan_rig(box, options.cameras, pixels, focal, mounts=mounts, noise=options.noise, progress=progress)


def _print(proposal: RigPlan, ours: RigMap, ring: RigMap, output: Path) -> None:
    _console.table(
        "Where to hang them (m, degrees)",
        ["camera", "x", "y", "z", "turned", "tilted down"],
        [[camera.name, *(f"{v:.2f}" for v in camera.position), *_angles(camera.rotation[2])] for camera in proposal.rig],
    )
    print_map(proposal.rig, ours)
    print_map(proposal.ring, ring)
    _console.result(f"The second is the plain ring. Worth {proposal.worth:.3f}, the ring {proposal.ring_worth:.3f}; {output} is written.")


def _as_json(proposal: RigPlan, ours: RigMap, ring: RigMap) -> dict[str, Any]:
    return {
        "worth": proposal.worth,
        "map": ours.to_dict(),
        "lamps_in_sight": proposal.glare,
        "ring": {"worth": proposal.ring_worth, "map": ring.to_dict(), "lamps_in_sight": proposal.ring_glare},
        "cameras": [{"name": camera.name, "position_m": camera.position, "looks_along": camera.rotation[2]} for camera in proposal.rig],
    }


def _span(given: str | None) -> tuple[float, float] | None:
    if given is None:
        return None
    try:
        low, high = (float(number) for number in given.split(":"))
    except ValueError:
        raise AsterismError(f"--heights {given} is not a span; give two heights in metres, such as 2.2:2.8.") from None
    return low, high


def _angles(ahead: list[float]) -> list[str]:
    """Where a direction points: degrees anticlockwise from x seen from above, and degrees below the horizon."""
    from math import asin, atan2, degrees

    return [f"{degrees(atan2(ahead[1], ahead[0])) % 360:.0f}", f"{degrees(asin(-ahead[2])):.0f}"]
