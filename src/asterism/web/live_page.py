"""Labelled frames of a live session in; a page that shows them, and sounds, out."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.live import AnalysedFrame, LabelledFrame, LiveSession
from asterism.live.outputs import cue_as_json, event_as_json
from asterism.recording.sides import marker_sides
from asterism.report.skeleton import marker_bones
from asterism.web.serving import PageAddress, address_of, bound

_PICTURES = 60.0
"""Frames per second that the page gets at most, as many as screens show. Of what comes between only sounds that begin are sent."""
_TO_BONES = 50
"""Frames by which the lines between markers are chosen: half a second at 100 Hz, in which a body moves. They are chosen once."""
_HEALTH = 0.5
"""s between two sets of counts."""


class ToPage:
    """The newest labelled frame, for all pages that are open. A page that is slow gets fewer frames, and holds nobody back."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._newest: tuple[int, AnalysedFrame] | None = None
        self._count = 0
        self._shown: deque[LabelledFrame] = deque(maxlen=_TO_BONES)
        self._bones: list[list[int]] | None = None
        self._begun: deque[tuple[int, dict[str, Any]]] = deque(maxlen=100)
        self._events: deque[tuple[int, dict[str, Any]]] = deque(maxlen=100)

    def send(self, frame: AnalysedFrame) -> None:
        """Keep a frame as the newest one."""
        with self._guard:
            self._count += 1
            self._newest = (self._count, frame)
            self._begun.extend((self._count, cue_as_json(cue)) for cue in frame.cues if cue.began)
            self._events.extend((self._count, event_as_json(event)) for event in frame.analysis.events)
            if self._bones is None and frame.labelled.markers:
                self._shown.append(frame.labelled)

    def close(self) -> None:
        """The session has ended; what was shown last stays."""

    def after(self, count: int) -> tuple[int, dict[str, Any]] | None:
        """The newest frame as plain values, where it is newer than an earlier answer, with the cues that began and the events since."""
        with self._guard:
            if self._newest is None or self._newest[0] <= count:
                return None
            now, analysed = self._newest
            began = [cue for at, cue in self._begun if at > count]
            events = [event for at, event in self._events if at > count]
        frame = analysed.labelled
        content: dict[str, Any] = {
            "frame": frame.frame.number,
            "points": np.round(1000 * frame.frame.points).astype(int).tolist(),
            "indices": frame.indices.tolist(),
            "confidence": np.round(frame.confidence, 3).tolist(),
            "latency": round(1000 * (frame.done - frame.frame.arrived), 2),
            "cues": [cue_as_json(cue) for cue in analysed.cues],
            "began": began,
            "events": events,
            "values": {name: None if np.isnan(value) else round(value, 3) for name, value in analysed.analysis.values.items()},
        }
        return now, content

    def body(self) -> dict[str, Any] | None:
        """Names, sides and lines of the markers; None until enough frames showed them."""
        with self._guard:
            shown = list(self._shown)
        if len(shown) < _TO_BONES:
            return None
        markers = shown[-1].markers
        if self._bones is None:
            same = [each for each in shown if each.markers == markers]
            positions = np.full((len(same), len(markers), 3), np.nan)
            for t, each in enumerate(same):
                given = each.indices >= 0
                positions[t, given] = each.frame.points[each.indices[given]]
            self._bones = marker_bones(positions, markers)
        return {"markers": list(markers), "sides": list(marker_sides(markers)), "bones": self._bones}


def serve_live(session: LiveSession, page: ToPage, place: PageAddress, say: Callable[[str], None]) -> Callable[[], None]:
    """Serve the page of a session from a thread; gives what stops it.

    say: told the page's address. Raises AsterismError where the port is taken, or the extra `web` is not installed.
    """
    try:
        import uvicorn

        app = _app(session, page)
    except ModuleNotFoundError as problem:
        raise AsterismError(
            f"the page needs {problem.name}, which is not installed; install it with `pip install asterism[web]`."
        ) from problem
    from asterism.web.guard import Guard

    token = secrets.token_urlsafe(24)
    listening = bound(place)
    port = listening.getsockname()[1]
    config = uvicorn.Config(
        Guard(app, token, place.host, port),
        log_level="critical",
        access_log=False,
        lifespan="off",
        server_header=False,
        ws_max_size=1 << 12,
    )
    server = uvicorn.Server(config)
    # Ctrl-C is the session's, which then stops the server.
    server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="live page", daemon=True)
    thread.start()
    say(f"The page is at {address_of(place.host, port, token)}")

    def stop() -> None:
        server.should_exit = True
        thread.join(timeout=3.0)
        listening.close()

    return stop


def _app(session: LiveSession, page: ToPage) -> Any:
    from starlette.applications import Starlette
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect

    from asterism.web.app import static_file

    async def follow(socket: WebSocket) -> None:
        await socket.accept()
        up = session.up
        await socket.send_text(json.dumps({"source": session.source.about.name, "up": [0, 0, 1] if up is None else up.tolist()}))
        count, told_body, told_health = 0, False, 0.0
        loop = asyncio.get_running_loop()
        try:
            while True:
                begin = loop.time()
                if not told_body and (body := page.body()) is not None:
                    told_body = True
                    await socket.send_text(json.dumps({"body": body}))
                if (found := page.after(count)) is not None:
                    count, content = found
                    await socket.send_text(json.dumps(content, separators=(",", ":")))
                if begin - told_health > _HEALTH:
                    told_health = begin
                    await socket.send_text(json.dumps({"health": _plain_health(session)}))
                await asyncio.sleep(max(0.001, 1.0 / _PICTURES - (loop.time() - begin)))
        except (WebSocketDisconnect, RuntimeError):
            # the page was closed
            return

    return Starlette(
        routes=[
            Route("/", lambda request: static_file("live.html")),
            Route("/static/{name}", lambda request: static_file(request.path_params["name"])),
            WebSocketRoute("/ws", follow),
        ]
    )


def _plain_health(session: LiveSession) -> dict[str, Any]:
    health = session.health()
    p50, p999 = health.latency
    return {
        "rate": round(health.rate, 1),
        "frames": health.frames,
        "lost": health.lost,
        "late": health.late,
        "damaged": health.damaged,
        "dropped": health.dropped,
        "silent": health.is_silent,
        "p50": None if np.isnan(p50) else round(1000 * p50, 2),
        "p999": None if np.isnan(p999) else round(1000 * p999, 2),
        "problem": health.problem,
        "ended": session.has_ended,
    }
