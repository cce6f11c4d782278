"""`asterism rig plan`: a volume and a number of cameras in; a rig file that says where to hang them out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from asterism.cli import _console
from asterism.cli._options import Json, Overwrite, Report, image_size
from asterism.cli.rig.report import print_map
from asterism.errors import AsterismError


def plan(
    volume: Annotated[
        str,
        typer.Option(
            "--volume",
            metavar="BOX",
            help="Width x depth x height on the floor (6x4x2.5), or spans (-3:3,-2:2,0:2.5), in metres; z is up.",
            show_default=False,
        ),
    ],
    cameras: Annotated[int, typer.Option("--cameras", metavar="N", min=2, help="How many cameras.", show_default=False)],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The rig to write, .toml.", show_default=False)],
    size: Annotated[str, typer.Option("--image-size", "--size", metavar="WxH", help="Their images, in pixels.")] = "1280x1024",
    fov: Annotated[float | None, typer.Option("--fov", metavar="DEGREES", help="Horizontal angle of view.", show_default=False)] = None,
    focal_mm: Annotated[
        float | None, typer.Option("--focal-mm", metavar="MM", help="Focal length, with --pixel-um.", show_default=False)
    ] = None,
    pixel_um: Annotated[
        float | None, typer.Option("--pixel-um", metavar="UM", help="Pitch of the sensor's pixels.", show_default=False)
    ] = None,
    room: Annotated[
        str | None,
        typer.Option("--room", metavar="BOX", help="The walls that carry cameras. Else 1.5 m around the volume.", show_default=False),
    ] = None,
    heights: Annotated[
        str | None,
        typer.Option(
            "--heights",
            metavar="LOW:HIGH",
            help="Between which heights they may hang. Else 2.2 to 2.6 m, or the volume's.",
            show_default=False,
        ),
    ] = None,
    ceiling: Annotated[bool, typer.Option("--ceiling", help="They may also hang from the ceiling, at the highest height.")] = False,
    noise: Annotated[float, typer.Option("--noise", metavar="PX", help="Standard deviation of a blob's x and y.")] = 0.3,
    report: Report = None,
    overwrite: Overwrite = False,
    json: Json = None,
) -> None:
    """Propose where to hang cameras for a volume.

    Most of the volume seen by three cameras, markers on a body seen by two from the side that they face, and that exactly; cameras out of
    each other's sight. Compared with the plain ring on the same mounts, than which it is never worth less.
    """
    for path in (output, report, json):
        _console.check_new(path, overwrite)
    from asterism.cameras.accuracy import Volume, map_rig
    from asterism.cameras.files import write_rig
    from asterism.cameras.plan import Mounts, focal_length, plan_rig

    box = Volume.parse(volume)
    pixels = image_size(size, "--image-size")
    focal = focal_length(pixels[0], fov=fov, focal_mm=focal_mm, pixel_um=pixel_um)
    mounts = Mounts.around(box, None if room is None else Volume.parse(room), _span(heights), ceiling=ceiling)
    with _console.progress("planning") as progress:
        proposal = plan_rig(box, cameras, pixels, focal, mounts=mounts, noise=noise, progress=progress)
    write_rig(proposal.rig, output)
    ours, ring = (map_rig(rig, box, noise=noise) for rig in (proposal.rig, proposal.ring))
    if json != "-":
        _console.table(
            "Where to hang them (m, degrees)",
            ["camera", "x", "y", "z", "turned", "tilted down"],
            [[camera.name, *(f"{v:.2f}" for v in camera.position), *_angles(camera.rotation[2])] for camera in proposal.rig],
        )
        print_map(proposal.rig, ours)
        print_map(proposal.ring, ring)
        _console.result(
            f"The second is the plain ring. Worth {proposal.worth:.3f}, the ring {proposal.ring_worth:.3f}; {output} is written."
        )
    if report is not None:
        from asterism.report.rig import rig_report

        settings = {"volume": volume, "focal length px": round(focal, 1), "noise px": noise}
        rig_report(report, proposal.rig, ours, title=f"Where to hang {cameras} cameras", plan=proposal, settings=settings)
    _console.write_json(
        json,
        {
            "command": "rig plan",
            "rig": output,
            "worth": proposal.worth,
            "map": ours.to_dict(),
            "lamps_in_sight": proposal.glare,
            "ring": {"worth": proposal.ring_worth, "map": ring.to_dict(), "lamps_in_sight": proposal.ring_glare},
            "cameras": [{"name": camera.name, "position_m": camera.position, "looks_along": camera.rotation[2]} for camera in proposal.rig],
        },
    )


def _span(given: str | None) -> tuple[float, float] | None:
    if given is None:
        return None
    try:
        low, high = (float(number) for number in given.split(":"))
    except ValueError:
        raise AsterismError(f"--heights {given} is no span; give two heights in metres, such as 2.2:2.8.") from None
    return low, high


def _angles(ahead: list[float]) -> list[str]:
    """Where a direction points: degrees anticlockwise from x seen from above, and degrees below the horizon."""
    from math import asin, atan2, degrees

    return [f"{degrees(atan2(ahead[1], ahead[0])) % 360:.0f}", f"{degrees(asin(-ahead[2])):.0f}"]
