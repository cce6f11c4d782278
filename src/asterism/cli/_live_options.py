"""What `asterism live` is asked to do: the options of the command."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from asterism.cli._options import Hip, Json, LowerBodyChoice, Measure, Overwrite, Static, Vertical


@dataclass(frozen=True)
class LiveOptions:
    """What `asterism live` is asked to do."""

    source: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SOURCE]",
            help="Where frames come from: natnet://HOST (Motive), qtm://HOST, vicon://HOST, lsl://NAME; udp:// or ws://HOST:PORT (JSON).",
            show_default=False,
        ),
    ] = None
    replay: Annotated[
        Path | None,
        typer.Option(
            "--replay",
            metavar="FILE",
            help="Play a recording instead, at its own rate; with --rig also blobs, or the videos of several cameras, one after the other.",
            show_default=False,
        ),
    ] = None
    cameras: Annotated[
        Path | None,
        typer.Option("--cameras", metavar="FILE", help="The cameras to look through, in TOML; needs --rig.", show_default=False),
    ] = None
    empty: Annotated[
        float,
        typer.Option("--empty", metavar="S", min=0.0, help="Nobody is in view for so long: lights that the cameras see then are masked."),
    ] = 0.0
    stream: Annotated[
        str | None,
        typer.Option("--stream", metavar="NAME", help="Of an XDF the stream to play; else that with the most markers.", show_default=False),
    ] = None
    speed: Annotated[float, typer.Option("--speed", metavar="N", help="Play N times as fast.")] = 1.0
    loop: Annotated[bool, typer.Option("--loop", help="Play it again and again.")] = False
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="The calibrated rig, if blobs of cameras come instead of points.", show_default=False),
    ] = None
    model: Annotated[
        Path | None,
        typer.Option("--model", "-m", metavar="FILE", help="A trained model; without one, virtual people label.", show_default=False),
    ] = None
    markers: Annotated[
        str | None,
        typer.Option(
            "--markers",
            metavar="SET",
            help="The marker set worn: a shipped one, or a TOML file. Without it and --model, it is found in the first second.",
            show_default=False,
        ),
    ] = None
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", help="Frames per second, if the source does not say them; else its times tell.", show_default=False
        ),
    ] = None
    delay: Annotated[
        int, typer.Option("--delay", metavar="FRAMES", min=0, help="Label a frame when so many later ones are known: surer, and later.")
    ] = 0
    vertical: Vertical = None
    analysis: Annotated[
        bool, typer.Option("--analysis/--no-analysis", help="Angles of joints, heel strikes and toe offs, and what steps are like.")
    ] = True
    static: Static = None
    measure: Measure = field(default_factory=list)
    lower_body: LowerBodyChoice = None
    hip: Hip = None
    to: Annotated[
        list[str],
        typer.Option(
            "--to",
            metavar="ADDRESS",
            help="Pass labelled frames on: udp://, ws:// or ws-listen://HOST:PORT (JSON), osc://HOST:PORT, lsl://NAME, natnet://HOST.",
        ),
    ] = field(default_factory=list)
    feedback: Annotated[
        str | None,
        typer.Option(
            "--feedback",
            metavar="FILE|NAME",
            help="What the person is told, and when: rules in TOML, or gait-symmetry, squat-depth, bike-knee, golf-tempo.",
            show_default=False,
        ),
    ] = None
    page: Annotated[bool, typer.Option("--page", help="Show the body and the counts in a browser, with sounds.")] = False
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="Where the page is served; this machine only.")] = "127.0.0.1"
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="Its port; 0 for a free one.")] = 0
    lines: Annotated[bool, typer.Option("--lines", help="Print each labelled frame as a line of JSON.")] = False
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Record, and write the labelled recording at the end.", show_default=False),
    ] = None
    finish: Annotated[
        Path | None,
        typer.Option(
            "--finish", metavar="FILE", help="Write the recording that a killed session left (FILE.live) to --output.", show_default=False
        ),
    ] = None
    seconds: Annotated[float | None, typer.Option("--seconds", metavar="S", min=0.0, help="Stop after so long.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None
