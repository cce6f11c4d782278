"""A source and what is asked of its frames in; the session that labels them, run until it ends, out."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from asterism.cli import _clinical, _console
from asterism.cli._live_options import LiveOptions
from asterism.findings import Severity

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.labelling.live.study import StudyPlace
    from asterism.live import Health, LiveAnalysis, LiveSession, LiveSource
    from asterism.motion.clinical import SubjectMeasures
    from asterism.recording import Floats, Recording


_SPOKEN = 2.0
"""s in which what speaks while a session runs has said its last; a terminal that is stopped (Ctrl-S) takes nothing. Half and double do as
well."""


def live_session(options: LiveOptions, source: LiveSource) -> LiveSession:
    """The session that the options ask for, its outputs open. Raises AsterismError where a file or an address is none."""
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
    # Played as fast as frames are labelled, a recording would be over before a process has looked at it.
    studies: StudyPlace = "push" if options.replay is not None and options.speed == math.inf else "process"
    make = make_labeller(model, options.markers, options.delay, studies)
    analysis = _analysis(options, up)
    # Outputs are opened last, so that nothing else can fail while they are open.
    outputs = open_outputs(options.to, source.about)
    opened = own_findings([source, *outputs])
    for finding in opened:
        _console.notice(str(finding))
    # A file can wait until its frames are labelled, and for who reads the lines; a camera system does not.
    waits = options.replay is not None
    lines = ToLines()
    if options.lines:
        outputs.append(lines if waits else InOwnThread(lines))
    said = {finding.code for finding in opened}
    watch = SessionWatch(source.about.name, up, not waits, lambda finding: _console.notice(str(finding)), said)
    watch.chosen = options.markers is not None
    session = LiveSession(source, make, outputs, options.delay, waits=waits, feedback=rules, vertical=up, analysis=analysis, watch=watch)
    # Where nobody else gets the frames the session is over when the reader of its lines is.
    if not options.to and options.output is None and not options.page:
        lines.on_left = session.stop
    return session


def run_session(session: LiveSession, options: LiveOptions) -> Health:
    """Run until the source ends, the time is over, or Ctrl-C."""
    import sys

    told, stop_page = threading.Event(), None
    if options.page:
        from asterism.web.live_page import ToPage, serve_live
        from asterism.web.serving import PageAddress

        page = ToPage()
        session.outputs = [*session.outputs, page]
        stop_page = serve_live(session, page, PageAddress(options.host, options.port), _console.notice)
    speaking = [threading.Thread(target=_warn, args=(session, told), name="live findings", daemon=True)]
    if sys.stderr.isatty():
        speaking.append(threading.Thread(target=_tell, args=(session, told), name="live terminal", daemon=True))
    for thread in speaking:
        thread.start()
    try:
        return session.run(math.inf if options.seconds is None else options.seconds)
    finally:
        told.set()
        # The line on the terminal holds what is printed until it is gone: results would stand in it.
        for thread in speaking:
            thread.join(_SPOKEN)
        if stop_page is not None:
            stop_page()


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


def _warn(session: LiveSession, ended: threading.Event) -> None:
    """What the source finds wrong, as of a camera that was bumped, when it is found; the end repeats it, with all that was counted."""
    from asterism.live import own_findings

    said, pending, told = {(finding.code, finding.where) for finding in own_findings([session.source])}, "", set[str]()
    while not ended.wait(1.0):
        # Said once it lasts: what is made before was loaded in a second or two.
        before, pending = pending, session.pending
        if pending and pending == before and pending not in told:
            told.add(pending)
            _console.notice(f"{session.source.about.name}: {pending}.")
        # A source counts in another thread: what changes while it is asked is said the next time.
        with suppress(RuntimeError):
            for finding in own_findings([session.source, session]):
                if finding.severity > Severity.NOTE and (finding.code, finding.where) not in said:
                    said.add((finding.code, finding.where))
                    _console.notice(str(finding))


@contextmanager
def ended_by_signals(session: LiveSession) -> Iterator[None]:
    """What asks a program to end, ends the session and nothing else, however often it comes.

    Ctrl-C; SIGTERM, by which services and containers are stopped; and SIGHUP, of a terminal that was closed.
    """
    import signal

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    wanted = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
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

    with Live(console=Console(stderr=True), transient=True, auto_refresh=False, redirect_stdout=False) as line, suppress(OSError):
        while not ended.wait(1.0):
            health = session.health()
            state = "no frames" if health.is_silent else f"{health.arriving:.0f} frames/s"
            after = f"after {1000 * health.latency[0]:.1f} ms" if math.isfinite(health.latency[0]) else ""
            labels = session.pending.partition(",")[0].partition(" by ")[0] or f"labels: {health.labels}"
            words = [state, labels, after, f"{health.lost} lost", f"{health.dropped} left out"]
            line.update(", ".join(word for word in words if word), refresh=True)
