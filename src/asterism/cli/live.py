"""`asterism live`: a camera system or a recording that is played in; labels of each frame, at once, out."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import typer

from asterism.cli import _clinical, _console
from asterism.cli._command import takes
from asterism.cli._live_options import LiveOptions
from asterism.cli._live_recordings import analog_beside, finish, leave_recorded, refuse_unfinished, unfinished_beside, write_recorded
from asterism.cli._live_sessions import ended_by_signals, live_session, run_session
from asterism.cli._live_sources import cameras_beside, open_live_source, played_files
from asterism.errors import AsterismError
from asterism.findings import exit_status

if TYPE_CHECKING:
    from pathlib import Path

    from asterism.live import Health, LiveRecorder, LiveSession


@takes(LiveOptions)
def live(options: LiveOptions) -> None:
    """Label frames while they come in.

    A frame gets its labels a few milliseconds after its points arrive, or as many frames later as --delay says. If frames come faster than
    they are labelled, the oldest that waits is left out and counted, so that no label is old. Frames that were lost on the way, came late
    or could not be read are counted and told at the end. Each frame also has the angles of the joints, by the same models as `asterism
    gait`, heel strikes and toe offs a few hundredths of a second after they happened, and what the last steps were like. Ctrl-C ends the
    session.

    With --output all frames that come are recorded. Until the end they are in a file beside it, so that a session that is killed loses half
    a second at most.

    Cameras are listed, set and watched by `asterism live cameras`.
    """
    from asterism.live import OfCameras, session_findings

    if options.finish is not None:
        raise typer.Exit(exit_status(finish(options, options.finish)))
    _check(options)
    unfinished = unfinished_beside(options)
    source = open_live_source(options)
    try:
        session = live_session(options, source)
        # Until the recording is written: what came is not lost to somebody who is impatient.
        with ended_by_signals(session):
            health, recorder = _run(session, options, unfinished)
    finally:
        source.close()
    parts = [source, session, *session.outputs, session.analysis, session.feedback, session.watch]
    findings = session_findings(health, source.about.name, recorder, parts)
    tone = _tone(session) if options.page else (math.nan, math.nan, 0)
    if options.json != "-" and not options.lines:
        _show(source.about.name, health, tone)
    for finding in findings:
        _console.report(finding)
    content = {
        "command": "live",
        "source": source.about.name,
        # Where no frame came there is none.
        "output": options.output if recorder is not None and recorder.kept else None,
        **dataclasses.asdict(health),
        **({"tone_ms": {"p50": tone[0], "p99": tone[1], "sounds": tone[2]}} if tone[2] else {}),
        **({"cameras": source.camera_numbers()} if isinstance(source, OfCameras) else {}),
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(options.json, content)
    raise typer.Exit(exit_status(findings))


def _run(session: LiveSession, options: LiveOptions, unfinished: Path | None) -> tuple[Health, LiveRecorder | None]:
    """Run the session, and write what it recorded; unfinished: where frames are kept meanwhile, None where nothing is recorded."""
    from asterism.live import LiveRecorder

    if unfinished is None or options.output is None:
        return run_session(session, options), None
    chosen = options.markers or "" if options.model is None else options.model.name
    about = session.source.about
    recorder = LiveRecorder(unfinished, about.name, session.up, _console.notice, chosen, about.rate)
    session.recorder = recorder
    try:
        health = run_session(session, options)
    except BaseException:
        recorder.close()
        leave_recorded(recorder, options.output)
        raise
    finally:
        recorder.close()
    write_recorded(recorder, options.output, options.rate)
    return health, recorder


def _check(options: LiveOptions) -> None:
    """Raise AsterismError where options contradict each other, or a file would be overwritten; before anything is opened."""
    from asterism.formats import check_suffix
    from asterism.recording import MarkerSet

    if options.lines and options.json == "-":
        raise AsterismError("--lines and --json - both print to standard output; give --json a file.")
    if options.model is not None and options.markers is not None:
        raise AsterismError("a model has its own marker set; give either --model or --markers.")
    if options.markers is not None:
        # A misspelt set must not wait for the first frames to be refused.
        MarkerSet.load(options.markers)
    if options.rate is not None and not 0 < options.rate < math.inf:
        raise AsterismError(f"--rate {options.rate:g} is no rate; give frames per second, above 0.")
    unused = {"--static": options.static, "--measure": options.measure, "--lower-body": options.lower_body, "--hip": options.hip}
    given = next((name for name, value in unused.items() if value and not options.analysis), None)
    if given is not None:
        raise AsterismError(f"{given} is for the angles of joints, which --no-analysis leaves out; leave one of them out.")
    if not options.page and (options.host != LiveOptions.host or options.port):
        raise AsterismError("--host and --port are those of the page; add --page.")
    if options.output is not None:
        check_suffix(options.output)
    _clinical.given_measures(options.measure)
    inputs = [
        *played_files(options),
        options.cameras,
        options.model,
        options.static,
        options.rig,
        *_clinical.measure_files(options.measure),
    ]
    analog = None if options.output is None else analog_beside(options.output)
    _console.check_outputs([options.output, analog, cameras_beside(options), options.json], inputs, options.overwrite)
    refuse_unfinished(options)


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
        ("studies of the last seconds", _console.count(health.studies)),
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
