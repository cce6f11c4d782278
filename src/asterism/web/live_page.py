"""Labelled frames of a live session in; a page that shows them, and sounds, out."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live import AnalysedFrame, Health, LabelledFrame, LiveSession, own_findings, session_findings
from asterism.live.frames import CameraControl, WithCameraControl
from asterism.live.outputs import cue_as_json, event_as_json
from asterism.live.packages import packages_for
from asterism.recording.sides import marker_sides
from asterism.report.skeleton import marker_bones
from asterism.web.serving import PageAddress, address_of, bound, is_open_to_others

_PICTURES = 60.0
"""Frames per second that the page gets at most, as many as screens show. What comes between is left out, but for events and what begins.
Half of them are seen to jerk; twice as many are drawn by few screens, and cost twice as much."""
_AHEAD = 6
"""Pictures on their way to a page that has not told yet that it drew them: a tenth of a second. With half of it a network of 50 ms and back
shows fewer pictures; with twice as much a slow one shows what is a fifth of a second old."""
_TO_BONES = 50
"""Frames by which the lines between markers are chosen: half a second at 100 Hz, in which a body moves. They are chosen once."""
_HEALTH = 0.5
"""s between two sets of counts. Half of it flickers; with twice as much a cable that is out is seen a second late."""
_STALE = 0.5
"""s after which a sound or an event is not sent any more: who hears it then takes it for what they do now. Half of it loses sounds of a
radio network that pauses; with twice as much the next step is there."""
_ASLEEP = 0.5
"""s without a word from a page whose pictures are all on their way, after which it sleeps and gets no sounds. Half of it holds them back
while a radio network pauses, until the page has answered; with twice as much a page that wakes has a second of sounds to pass over."""
_MOMENTS = 200
"""Events and beginnings that wait for pages: seconds of them in a fast run with ten rules. Half and double do as well, since old ones are
not sent."""
_SETTABLE = ("exposure", "gain", "threshold")
"""What a page can set on cameras: what does not change their calibration, nor when they take their images."""
_SOUNDED = 4096
"""Sounds whose latency is kept, so that one in a hundred is forty. Half of them make it twenty; with twice as many a session's begin counts
for longer."""
_RECENT = 5.0
"""s over which what goes missing is judged while it runs. Half of it tells of a single pause; with twice as much a cable that is loose is
told when it is tight again."""
_MISSING = 0.05
"""Share of the frames of these seconds that are lost, late, left out or damaged from which on it is said in words, and not by a count
alone: one in 20 is seen as a jerk. Half of it is what a radio network loses all day; with twice as much steps are told late before it is
said."""
_LONGEST = 60_000.0
"""ms; a page that tells of a longer latency has a clock that was set. Half and double do as well."""


class ToPage:
    """The newest labelled frame, for all pages that are open. A page that is slow gets fewer frames, and holds nobody back.

    Events, and what a rule begins to tell, wake the pages at once; they do not wait for the next picture.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._newest: AnalysedFrame | None = None
        self._count = 0
        self._picture: tuple[int, str] = (0, "")
        self._shown: deque[LabelledFrame] = deque(maxlen=_TO_BONES)
        self._body: dict[str, Any] | None = None
        self._has_lines = False
        self._moments: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_MOMENTS)
        self._moment_count = 0
        self._wakers: list[Callable[[], object]] = []
        self._sounded: deque[float] = deque(maxlen=_SOUNDED)
        self.late = 0
        self._counts: deque[tuple[float, dict[str, int]]] = deque()

    def send(self, frame: AnalysedFrame) -> None:
        """Keep a frame as the newest one."""
        stamps = {"at": _ms(frame.labelled.frame.arrived), "done": _ms(frame.labelled.done), "time": frame.labelled.frame.time}
        moments = [{"cue": cue_as_json(cue), **stamps} for cue in frame.cues if cue.began]
        moments += [{"event": event_as_json(event), **stamps} for event in frame.analysis.events]
        with self._guard:
            self._count += 1
            self._newest = frame
            for moment in moments:
                self._moment_count += 1
                self._moments.append((self._moment_count, moment))
            self._look_at(frame.labelled)
        if moments:
            self._wake()

    def _look_at(self, labelled: LabelledFrame) -> None:
        """Keep what tells of the body: at first, and anew with other markers."""
        markers = labelled.markers
        if not markers:
            return
        if self._body is None or self._body["markers"] != markers:
            self._shown.clear()
            self._has_lines = False
            self._body = {"markers": markers, "sides": marker_sides(markers), "bones": []}
        if not self._has_lines:
            self._shown.append(labelled)

    def close(self) -> None:
        """The session has ended; what was shown last stays."""
        self._wake()

    def follow(self, wake: Callable[[], object]) -> Callable[[], None]:
        """Have a function called, from any thread, when something is to be sent at once; gives what ends that."""
        with self._guard:
            self._wakers.append(wake)

        def end() -> None:
            with self._guard:
                self._wakers.remove(wake)

        return end

    def _wake(self) -> None:
        with self._guard:
            wakers = list(self._wakers)
        for wake in wakers:
            # the server of the page may have ended meanwhile
            with contextlib.suppress(RuntimeError):
                wake()

    @property
    def last_moment(self) -> int:
        """The number of the newest event or beginning: a page that is opened begins after it."""
        return self._moment_count

    def moments(self, after: int) -> tuple[int, list[dict[str, Any]]]:
        """The events and beginnings after one, by its number, and the number of the newest; those that are too old are counted as late."""
        with self._guard:
            now, found = self._moment_count, [moment for number, moment in self._moments if number > after]
        fresh = [moment for moment in found if _ms(time.monotonic()) - moment["done"] < 1000 * _STALE]
        self.late += now - after - len(fresh)
        return now, fresh

    def picture(self, after: int) -> tuple[int, str] | None:
        """The number and the JSON of the newest frame, where it is newer than one, by its number. Written once for all pages."""
        with self._guard:
            if self._newest is None or self._count <= after:
                return None
            now, analysed = self._count, self._newest
            if self._picture[0] == now:
                return self._picture
        frame = analysed.labelled
        content: dict[str, Any] = {
            "picture": now,
            "frame": frame.frame.number,
            "time": round(frame.frame.time, 4),
            "at": _ms(frame.frame.arrived),
            "points": np.round(1000 * frame.frame.points).astype(int).tolist(),
            "indices": frame.indices.tolist(),
            "latency": round(1000 * (frame.done - frame.frame.arrived), 2),
            "cues": [[_plain(cue.value), cue.shown, int(cue.on), _plain(cue.tone), cue.text if cue.on else ""] for cue in analysed.cues],
            "values": [_plain(value) for value in analysed.analysis.values.values()],
        }
        made = (now, json.dumps(content, separators=(",", ":")))
        with self._guard:
            self._picture = max(self._picture, made)
        return made

    def names(self) -> dict[str, Any]:
        """What the values and the rules of pictures are called, in their order."""
        with self._guard:
            newest = self._newest
        if newest is None:
            return {"values": [], "units": [], "rules": []}
        values = newest.analysis.values
        return {
            "values": list(values),
            "units": [newest.analysis.units.get(name, "") for name in values],
            "rules": [
                {
                    "name": cue.rule.name,
                    "colour": cue.rule.colour,
                    "sound": cue.rule.sound,
                    "unit": cue.unit,
                    "bounds": [bound for bound in (cue.rule.above, cue.rule.below) if not math.isnan(bound)],
                }
                for cue in newest.cues
            ],
        }

    def body(self) -> dict[str, Any] | None:
        """Names, sides and lines of the markers, the same object until that changes; None while no marker is known.

        There are no lines until enough frames showed the markers.
        """
        with self._guard:
            body, shown = self._body, list(self._shown)
        if body is None or len(shown) < _TO_BONES:
            return body
        markers = body["markers"]
        made = {**body, "bones": marker_bones(np.array([each.places for each in shown]), markers)}
        with self._guard:
            # Other markers may have come meanwhile.
            if self._body is body:
                self._body, self._has_lines = made, True
                self._shown.clear()
            return self._body

    def sounded(self, latencies: object) -> None:
        """Take what a page tells of its sounds: ms from the arrival of the frame to the beginning of the sound, each."""
        if isinstance(latencies, list):
            self._sounded.extend(float(ms) for ms in latencies[:100] if isinstance(ms, int | float) and 0 <= ms < _LONGEST)

    def missing(self, health: Health) -> list[str]:
        """Codes of the findings on frames that go missing just now, by the counts of the last seconds. From the server's thread alone."""
        counts = {"live-lost": health.lost, "live-late": health.late, "live-dropped": health.dropped, "live-damaged": health.damaged}
        now = time.monotonic()
        self._counts.append((now, {**counts, "": health.frames + health.lost + health.late + health.damaged}))
        while len(self._counts) > 1 and self._counts[1][0] < now - _RECENT:
            self._counts.popleft()
        before, after = self._counts[0][1], self._counts[-1][1]
        return [code for code in counts if after[code] - before[code] > _MISSING * (after[""] - before[""])]

    def findings(self) -> list[Finding]:
        """Whether sounds or events did not reach a page in time."""
        if not self.late:
            return []
        sentence = f"the page: {self.late} sounds or events were too late for a page that was slow or asleep, and were left out."
        return [Finding("live-page-late", Severity.NOTE, "the page", sentence, "Keep the page in front, on a network that is not busy.")]

    def tone_latency(self) -> tuple[float, float, int]:
        """(p50, p99) ms from the arrival of a frame to the beginning of its sound in the page, and of how many; NaN without any."""
        known = list(self._sounded)
        if not known:
            return math.nan, math.nan, 0
        p50, p99 = np.quantile(np.array(known), (0.5, 0.99))
        return float(p50), float(p99), len(known)


def _ms(seconds: float) -> float:
    """ms on this machine's `time.monotonic`."""
    return round(1000 * seconds, 3)


def _plain(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None


def serve_live(session: LiveSession, page: ToPage, place: PageAddress, say: Callable[[str], None]) -> Callable[[], None]:
    """Serve the page of a session from a thread; gives what stops it.

    say: told the page's address. Raises AsterismError where the port is taken, or the extra `web` is not installed.
    """
    with packages_for("the page", "web"):
        import uvicorn

        from asterism.web.guard import Guard
    # The shipped marker sets are read now, for a twentieth of a second, and not while frames wait for their labels.
    marker_sides(())
    token = secrets.token_urlsafe(24)
    listening = bound(place)
    port = listening.getsockname()[1]
    address, is_open = address_of(place.host, port, token), is_open_to_others(listening)
    config = uvicorn.Config(
        Guard(_app(session, page, address if is_open else ""), token, place.host, port),
        log_level="critical",
        access_log=False,
        lifespan="off",
        server_header=False,
        ws_max_size=1 << 12,
        # Each message would be packed and unpacked, 0.15 ms; a page takes a megabit a second as it is.
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=2,
    )
    server = uvicorn.Server(config)
    # Ctrl-C is the session's, which then stops the server.
    server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, name="live page", daemon=True)
    thread.start()
    say(f"The page is at {address}")
    if is_open:
        say("Whoever has this address and reaches this machine sees the session and sets its cameras, and nothing is encrypted on the way.")

    def stop() -> None:
        server.should_exit = True
        thread.join(timeout=3.0)
        listening.close()

    return stop


@dataclass
class _Follower:
    """One page that is open. Lives in the server's event loop.

    picture, moment  the numbers of what was sent last
    ahead, seen      pictures that the page has not told of, and when it told of one, s on `time.monotonic`
    """

    session: LiveSession
    page: ToPage
    send: Callable[[str], Any]
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    picture: int = 0
    moment: int = 0
    ahead: int = 0
    seen: float = -math.inf
    gone: bool = False
    _names: dict[str, Any] = field(default_factory=dict)
    _body: dict[str, Any] | None = None
    _told_end: bool = False
    _health_at: float = -math.inf
    _picture_at: float = -math.inf

    async def run(self) -> None:
        """Send what there is until the page is gone."""
        loop = asyncio.get_running_loop()
        end = self.page.follow(lambda: loop.call_soon_threadsafe(self.wake.set))
        self.moment = self.page.last_moment
        try:
            while not self.gone:
                self.wake.clear()
                await self._moments()
                await self._rest(loop.time())
                due = min(self._picture_at + 1 / _PICTURES, self._health_at + _HEALTH) - loop.time()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(max(0.001, due)):
                        await self.wake.wait()
        finally:
            end()

    async def _moments(self) -> None:
        # A page that sleeps gets none until they are fresh again. One that is only far away gets them at once.
        if self.ahead >= _AHEAD and time.monotonic() - self.seen > _ASLEEP:
            return
        self.moment, moments = self.page.moments(self.moment)
        if moments:
            await self._say({"moments": moments, "sent": _ms(time.monotonic())})

    async def _rest(self, now: float) -> None:
        """A picture, and from time to time what is around it; at first that, since a picture says nothing without it."""
        if now >= self._health_at + _HEALTH or (self.session.has_ended and not self._told_end):
            self._health_at, self._told_end = now, self.session.has_ended
            await self._say({"health": _plain_health(self.session, self.page)})
            if (control := _camera_control(self.session)) is not None:
                await self._say({"cameras": control.camera_states()})
        if now >= self._picture_at + 1 / _PICTURES and self.ahead < _AHEAD:
            self._picture_at = max(now - 1 / _PICTURES, self._picture_at + 1 / _PICTURES)
            if (found := self.page.picture(self.picture)) is not None:
                if (names := self.page.names()) != self._names:
                    self._names = names
                    await self._say({"names": names})
                if (body := self.page.body()) is not self._body:
                    self._body = body
                    await self._say({"body": body})
                self.picture, text = found
                self.ahead += 1
                await self.send(text)
        elif self.ahead >= _AHEAD:
            self._picture_at = now

    async def told(self, text: str) -> None:
        """Take what the page says; what is not understood is passed over."""
        try:
            news = json.loads(text)
        except ValueError:
            return
        if not isinstance(news, dict):
            return
        if isinstance(news.get("seen"), int):
            self.ahead, self.seen = max(0, self.ahead - 1), time.monotonic()
            if self.ahead == _AHEAD - 1:
                self.wake.set()
        if isinstance(news.get("ping"), int | float):
            await self._say({"pong": news["ping"], "now": _ms(time.monotonic())})
        self.page.sounded(news.get("sounded"))
        if isinstance(news.get("set"), dict):
            await self._set(news["set"])

    async def _set(self, asked: dict[str, Any]) -> None:
        """Set cameras as the page asks; what became of it comes with their states."""
        control = _camera_control(self.session)
        for name, value in asked.items():
            if control is None or name not in _SETTABLE:
                continue
            try:
                control.set(name, value)
            except AsterismError as problem:
                await self._say({"refused": str(problem)})

    async def _say(self, content: dict[str, Any]) -> None:
        await self.send(json.dumps(content, separators=(",", ":")))


def _app(session: LiveSession, page: ToPage, address: str) -> Any:
    from starlette.applications import Starlette
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect

    from asterism.web.app import static_file

    async def follow(socket: WebSocket) -> None:
        await socket.accept()
        up = session.up
        upwards = [0, 0, 1] if up is None else up.tolist()
        hello = {"source": session.source.about.name, "up": upwards, "address": address, "code": _code_of(address)}
        follower = _Follower(session, page, socket.send_text)

        async def listen() -> None:
            try:
                async for text in socket.iter_text():
                    await follower.told(text)
            except (WebSocketDisconnect, RuntimeError):
                pass
            finally:
                follower.gone = True
                follower.wake.set()

        # Both end when the page is closed: sending raises, and nothing more is heard.
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.send_text(json.dumps(hello))
            listening = asyncio.create_task(listen())
            try:
                await follower.run()
            finally:
                listening.cancel()

    return Starlette(
        routes=[
            Route("/", lambda request: static_file("live.html")),
            Route("/static/{name}", lambda request: static_file(request.path_params["name"])),
            WebSocketRoute("/ws", follow),
        ]
    )


def _camera_control(session: LiveSession) -> CameraControl | None:
    """Where the cameras of a session are set; None where there are none, or another program has them."""
    return session.source.control if isinstance(session.source, WithCameraControl) else None


def _code_of(address: str) -> str:
    """An address as a QR code, the address of a picture in itself; "" for no address, or where the package for it is not installed."""
    try:
        import segno
    except ModuleNotFoundError:
        return ""
    return str(segno.make(address, micro=False).svg_data_uri(omitsize=True)) if address else ""


def _told(session: LiveSession, page: ToPage, health: Health) -> tuple[list[Finding], list[Finding]]:
    """What a person should know now: what calls for an act, the gravest first, and what is only worth knowing."""
    # A source counts in another thread: what changes while it is asked is told the next time.
    with contextlib.suppress(RuntimeError):
        found = own_findings([session.source, session, session.analysis, session.feedback])
        now = [] if session.watch is None else list(session.watch.now)
        if lost := str(getattr(session.recorder, "problem", "")):
            mend = str(getattr(session.recorder, "mend", ""))
            now.append(Finding("live-not-recorded", Severity.ERROR, session.source.about.name, lost, mend))
        # A source that sends nothing says in a note what to press.
        comes, goes_missing = bool(health.frames), page.missing(health)
        now += [each for each in session_findings(health, session.source.about.name, None, [session.source]) if each.code in goes_missing]
        found = [finding for finding in found if finding.code not in goes_missing]
        acts = [*now, *(finding for finding in found if finding.severity > Severity.NOTE or not comes)]
        return sorted(acts, key=lambda finding: -finding.severity), [finding for finding in found if finding not in acts]
    return [], []


def _plain_health(session: LiveSession, page: ToPage) -> dict[str, Any]:
    health = session.health()
    acts, notes = _told(session, page, health)
    p50, p999 = health.latency
    return {
        "rate": round(health.arriving, 1),
        "frames": health.frames,
        "lost": health.lost,
        "late": health.late,
        "damaged": health.damaged,
        "dropped": health.dropped,
        "labels": health.labels,
        "silent": health.is_silent,
        "p50": None if np.isnan(p50) else round(1000 * p50, 2),
        "p999": None if np.isnan(p999) else round(1000 * p999, 2),
        "not sounded": page.late,
        "problem": health.problem,
        "pending": session.pending,
        "problems": [str(finding) for finding in acts],
        "notes": [str(finding) for finding in notes],
        "ended": session.has_ended,
    }
