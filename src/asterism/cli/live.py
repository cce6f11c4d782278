"""`asterism live`: a camera system or a recording that is played in; labels of each frame, at once, out."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from asterism.cli import _clinical, _console
from asterism.cli._command import takes
from asterism.cli._options import Hip, Json, LowerBodyChoice, Measure, Overwrite, Static, Vertical
from asterism.errors import AsterismError
from asterism.findings import Severity

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.findings import Finding
    from asterism.live import Health, LiveAnalysis, LiveRecorder, LiveSession, LiveSource
    from asterism.motion.clinical import SubjectMeasures
    from asterism.recording import Floats, Recording


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
    speed: Annotated[float, typer.Option("--speed", metavar="N", help="Play N times as fast.")] = 1.0
    loop: Annotated[bool, typer.Option("--loop", help="Play it again and again.")] = False
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="The calibrated rig, where blobs of cameras come and not points.", show_default=False),
    ] = None
    model: Annotated[
        Path | None, typer.Option("--model", "-m", metavar="FILE", help="A trained model; else virtual people.", show_default=False)
    ] = None
    markers: Annotated[
        str | None,
        typer.Option(
            "--markers", metavar="SET", help="The marker set worn: a shipped one, or a TOML file; else it is found.", show_default=False
        ),
    ] = None
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Frames per second; else by the times.", show_default=False)
    ] = None
    delay: Annotated[int, typer.Option("--delay", metavar="FRAMES", min=0, help="Frames to wait for, which make labels surer.")] = 0
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
        typer.Option("--finish", metavar="FILE", help="Write what a session that was killed left behind, to --output.", show_default=False),
    ] = None
    seconds: Annotated[float | None, typer.Option("--seconds", metavar="S", min=0.0, help="Stop after so long.", show_default=False)] = None
    overwrite: Overwrite = False
    json: Json = None


@takes(LiveOptions)
def live(options: LiveOptions) -> None:
    """Label frames while they come in.

    A frame gets its labels a few milliseconds after its points arrive, or as many frames later as --delay says. Where frames come faster
    than they are labelled, the oldest that waits is left out and counted: what is passed on is never old. Frames that were lost on the way,
    came late or could not be read are counted and told at the end. Labels give angles of the joints, by the same models as `asterism gait`,
    heel strikes and toe offs a few hundredths of a second after they happened, and what the last steps were like. Stop with Ctrl-C. A
    recording holds all frames that came. Until the end they are in a file beside the output, so that a session that is killed loses half a
    second at most.

    Cameras are listed, set and watched by `asterism live cameras`.
    """
    from asterism.formats import check_suffix
    from asterism.live import LiveRecorder, OfCameras, session_findings

    if options.finish is not None:
        _finish(options)
        raise typer.Exit(0)
    if options.lines and options.json == "-":
        raise AsterismError("--lines and --json - both print to standard output; give --json a file.")
    if options.model is not None and options.markers is not None:
        raise AsterismError("a model has its own marker set; give either --model or --markers.")
    if options.rate is not None and not 0 < options.rate < math.inf:
        raise AsterismError(f"--rate {options.rate:g} is no rate; give frames per second, above 0.")
    if not options.page and (options.host != LiveOptions.host or options.port):
        raise AsterismError("--host and --port are those of the page; add --page.")
    if options.output is not None:
        check_suffix(options.output)
    unfinished = None if options.output is None else options.output.with_name(options.output.name + ".live")
    _clinical.given_measures(options.measure)
    inputs = [*_played(options), options.cameras, options.model, options.static, options.rig, *_clinical.measure_files(options.measure)]
    analog = None if options.output is None else _analog_beside(options.output)
    _console.check_outputs([options.output, analog, _cameras_beside(options), options.json], inputs, options.overwrite)
    if unfinished is not None and unfinished.exists():
        raise AsterismError(
            f"{unfinished} is there from a session that was not finished; write it with --finish {unfinished} -o FILE.c3d, or remove it."
        )
    source = _source(options)
    recorder: LiveRecorder | None = None
    try:
        session = _session(options, source)
        if unfinished is not None:
            recorder = LiveRecorder(unfinished, source.about.name, session.up, _console.notice)
            session.keeper = recorder
        health = _run(session, options)
    finally:
        source.close()
        if recorder is not None:
            recorder.close()
    parts = [source, *session.outputs, session.analysis, session.feedback, session.watch]
    findings = session_findings(health, source.about.name, recorder, parts)
    if recorder is not None and unfinished is not None and options.output is not None and recorder.kept:
        try:
            _written(unfinished, options.output, options.rate)
        except BaseException as problem:
            # Whatever hinders it, nothing that was recorded is lost.
            _console.notice(f"{options.output} was not written; {unfinished} has all: --finish {unfinished} -o {options.output} writes it.")
            raise problem
        unfinished.unlink()
    elif unfinished is not None:
        unfinished.unlink(missing_ok=True)
    tone = _tone(session) if options.page else (math.nan, math.nan, 0)
    if options.json != "-" and not options.lines:
        _show(source.about.name, health, tone)
    for finding in findings:
        _console.report(finding)
    content = {
        "command": "live",
        "source": source.about.name,
        "output": options.output,
        **dataclasses.asdict(health),
        **({"tone_ms": {"p50": tone[0], "p99": tone[1], "sounds": tone[2]}} if tone[2] else {}),
        **({"cameras": source.camera_numbers()} if isinstance(source, OfCameras) else {}),
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(options.json, content)
    raise typer.Exit(1 if any(finding.severity > Severity.NOTE for finding in findings) else 0)


def _source(options: LiveOptions) -> LiveSource:
    from asterism.live import open_source
    from asterism.live.replay import Replay

    beside = next((word for word in options.source or [] if options.replay is not None and "://" in word), None)
    if beside is not None:
        raise AsterismError(f"{beside} and --replay are two sources; give one of them.")
    given = (bool(options.source) and options.replay is None, options.replay is not None, options.cameras is not None)
    if given.count(True) != 1:
        raise AsterismError(
            "give one source: an address such as udp://127.0.0.1:5000, a recording with --replay FILE, or cameras with --cameras FILE."
        )
    if options.rig is not None:
        return _of_cameras(options, options.rig)
    if options.cameras is not None or len(_played(options)) > 1:
        raise AsterismError("points are made of several cameras' images by their rig; add --rig FILE.")
    if options.replay is not None:
        return Replay(options.replay, speed=options.speed, loop=options.loop)
    return open_source(_address(options), math.nan if options.rate is None else options.rate)


def _address(options: LiveOptions) -> str:
    first, *others = options.source or [""]
    if others:
        raise AsterismError(f"{others[0]}: give one source; several videos are played with --replay.")
    return first


def _played(options: LiveOptions) -> list[Path]:
    """What is to be played: the file of --replay, and those behind it."""
    return [] if options.replay is None else [options.replay, *(Path(word) for word in options.source or [])]


def _of_cameras(options: LiveOptions, rig_file: Path) -> LiveSource:
    from functools import partial

    from asterism.cameras.files import read_rig
    from asterism.live.blobs import ReplayBlobs, RigProcess, RigSource
    from asterism.live.sources import open_blobs

    rig, played = read_rig(rig_file), _played(options)
    if options.cameras is not None or len(played) > 1:
        return _of_images(options, rig, played)
    if played:
        blobs = ReplayBlobs(played[0], rig.names, rate=options.rate, speed=options.speed, loop=options.loop)
        return RigSource(blobs, rig, waits=True)
    opened = partial(open_blobs, _address(options), rig.names, math.nan if options.rate is None else options.rate)
    return RigProcess(opened, rig, keep=_kept_blobs(options))


def _kept_blobs(options: LiveOptions) -> Path | None:
    """Where blobs are kept beside what is recorded; a file that is there is overwritten only where that was asked for."""
    if options.output is None:
        return None
    from asterism.formats.kept_blobs import KEPT_SUFFIX

    kept = options.output.with_suffix(KEPT_SUFFIX)
    _console.check_new(kept, options.overwrite)
    kept.unlink(missing_ok=True)
    return kept


def _of_images(options: LiveOptions, rig: Rig, played: list[Path]) -> LiveSource:
    """Points of images: of cameras, or of their videos."""
    import os

    # OpenCV and FFmpeg would repeat on standard error what is said here in one sentence.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    from asterism.live.blobs import RigSource
    from asterism.live.cameras import load_cameras, with_settings
    from asterism.live.images import CameraWorkers, WorkerSettings, videos_together

    specs = videos_together(played, rig, options.speed, options.loop) if options.cameras is None else load_cameras(options.cameras)
    if options.rate is not None:
        specs = with_settings(specs, {"rate": options.rate})
    sizes = {camera.name: camera.size for camera in rig if camera.size is not None}
    settings = WorkerSettings(empty=options.empty, sizes=sizes, in_order="number" if played else "")
    workers = CameraWorkers(specs, settings, numbered_together=bool(played))
    beside = _cameras_beside(options)
    try:
        if beside is not None:
            workers.save(beside)
        return RigSource(workers, rig, waits=bool(played), keep=None if played else _kept_blobs(options))
    except BaseException:
        workers.close()
        raise


def _session(options: LiveOptions, source: LiveSource) -> LiveSession:
    from asterism.cli._options import vertical_axis
    from asterism.labelling.marker_model import MarkerModel
    from asterism.live import (
        Feedback,
        InOwnThread,
        LiveSession,
        SessionWatch,
        ToLines,
        load_feedback,
        make_labeller,
        open_outputs,
        own_findings,
    )
    from asterism.recording import MarkerSet, as_vertical

    model = None if options.model is None else MarkerModel.load(options.model)
    given = vertical_axis(options.vertical)
    up = source.about.vertical if given is None else as_vertical(given)
    rules = None
    if options.feedback is not None:
        rules = Feedback(load_feedback(options.feedback), as_vertical("z") if up is None else up, _console.notice)
        # Where the names are known before the first frame, so is what lacks.
        worn = MarkerSet.load(options.markers) if options.markers is not None else None if model is None else model.marker_set
        if worn is not None:
            rules.look_at(worn.names)
    make = make_labeller(model, options.markers, options.delay)
    analysis = _analysis(options, up)
    # Outputs are opened last, so that nothing else can fail while they are open.
    outputs = open_outputs(options.to, source.about)
    for finding in own_findings([source, *outputs]):
        _console.notice(str(finding))
    if options.lines:
        # A file waits for who reads the lines, a camera system does not.
        outputs.append(ToLines() if options.replay is not None else InOwnThread(ToLines()))
    # A file can wait until its frames are labelled.
    waits = options.replay is not None
    watch = SessionWatch(source.about.name, up, not waits, lambda finding: _console.notice(str(finding)))
    return LiveSession(source, make, outputs, options.delay, waits=waits, feedback=rules, vertical=up, analysis=analysis, watch=watch)


def _analysis(options: LiveOptions, up: Floats | None) -> LiveAnalysis | None:
    from asterism.formats import read
    from asterism.live import AngleOptions, MovementAnalysis

    if not options.analysis:
        return None
    static = None if options.static is None else read(options.static)
    model = None if options.lower_body is None else str(options.lower_body)

    def measures(recording: Recording) -> tuple[SubjectMeasures | None, tuple[Finding, ...]]:
        return _clinical.measures_of(recording, static, options.measure, options.hip)

    return MovementAnalysis(AngleOptions(static, model, measures, up, waits=options.replay is not None))


def _run(session: LiveSession, options: LiveOptions) -> Health:
    """Run until the source ends, the time is over, or Ctrl-C."""
    import sys

    told, stop_page = threading.Event(), None
    if options.page:
        from asterism.web.live_page import ToPage, serve_live
        from asterism.web.serving import PageAddress

        page = ToPage()
        session.outputs = [*session.outputs, page]
        stop_page = serve_live(session, page, PageAddress(options.host, options.port), _console.notice)
    threading.Thread(target=_warn, args=(session, told), daemon=True).start()
    if sys.stderr.isatty():
        threading.Thread(target=_tell, args=(session, told), daemon=True).start()
    try:
        with _ended_by_signals(session):
            return session.run(math.inf if options.seconds is None else options.seconds)
    finally:
        told.set()
        if stop_page is not None:
            stop_page()


def _warn(session: LiveSession, ended: threading.Event) -> None:
    """What the source finds wrong, as of a camera that was bumped, when it is found; the end repeats it, with all that was counted."""
    from asterism.live import own_findings

    said = {(finding.code, finding.where) for finding in own_findings([session.source])}
    while not ended.wait(1.0):
        for finding in own_findings([session.source]):
            if finding.severity > Severity.NOTE and (finding.code, finding.where) not in said:
                said.add((finding.code, finding.where))
                _console.notice(str(finding))


@contextmanager
def _ended_by_signals(session: LiveSession) -> Iterator[None]:
    """Ctrl-C and SIGTERM, by which services and containers are stopped, end the session with all that came, however often they come."""
    import signal

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    wanted = [signal.SIGINT, signal.SIGTERM]
    # Who started this in the background may have it ignore Ctrl-C.
    before = {number: signal.getsignal(number) for number in wanted}
    for number in wanted:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, lambda *_: session.stop())
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, handler)


def _tell(session: LiveSession, ended: threading.Event) -> None:
    """A line on the terminal, each second anew."""
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), transient=True, auto_refresh=False) as line, suppress(OSError):
        while not ended.wait(1.0):
            health = session.health()
            state = "no frames" if health.is_silent else f"{health.rate:.0f} frames/s"
            after = f"after {1000 * health.latency[0]:.1f} ms" if math.isfinite(health.latency[0]) else ""
            words = [state, f"labels: {health.labels}", after, f"{health.lost} lost", f"{health.dropped} left out"]
            line.update(", ".join(word for word in words if word), refresh=True)


def _tone(session: LiveSession) -> tuple[float, float, int]:
    """(p50, p99) ms from a frame's arrival to its sound in the page, and of how many."""
    from asterism.web.live_page import ToPage

    return next(output.tone_latency() for output in session.outputs if isinstance(output, ToPage))


def _show(name: str, health: Health, tone: tuple[float, float, int]) -> None:
    rows = [
        ("frames", _console.count(health.frames)),
        ("labelled", _console.count(health.labelled)),
        ("labels in a frame", health.labels),
        ("lost, late, damaged", f"{health.lost}, {health.late}, {health.damaged}"),
        ("left out", _console.count(health.dropped)),
        ("labels after", f"{1000 * health.latency[0]:.1f} ms, one in a thousand after {1000 * health.latency[1]:.1f} ms"),
    ]
    if not health.labelled:
        del rows[2]
    if not math.isfinite(health.latency[0]):
        rows.pop()
    if tone[2]:
        # The page's own clock ends at its sound card.
        rows.append(("sounds after", f"{tone[0]:.0f} ms, one in a hundred after {tone[1]:.0f} ms; sound card and loudspeaker add to it"))
    _console.facts(name, rows)


def _finish(options: LiveOptions) -> None:
    """Write a session that was not finished."""
    if options.output is None or options.finish is None:
        raise AsterismError("--finish needs the recording to write; add -o FILE.c3d.")
    _console.check_outputs([options.output, _analog_beside(options.output)], [options.finish], options.overwrite)
    frames = _written(options.finish, options.output, options.rate)
    _console.notice(f"{options.output} holds {frames} frames; {options.finish} is not needed any more.")


def _written(kept: Path, output: Path, rate: float | None) -> int:
    """Write what was kept; how many frames it had."""
    from asterism.formats import write
    from asterism.live import recording_of
    from asterism.live.analog import write_analog

    session = recording_of(kept, rate)
    for lost in write(output, session.recording()):
        _console.notice(f"{output} does not hold {lost}.")
    if session.analog:
        write_analog(_analog_beside(output), session.analog, session.times)
    return len(session.times)


def _cameras_beside(options: LiveOptions) -> Path | None:
    """Where it is written what was set on cameras, and what they had; None where none are set, or nothing is recorded."""
    return None if options.output is None or options.cameras is None else options.output.with_suffix(".cameras.toml")


def _analog_beside(output: Path) -> Path:
    """Where analog samples are written."""
    return output.with_suffix(".analog.npz")
