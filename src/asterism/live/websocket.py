"""Frames as JSON over WebSocket in, labelled frames as the same out; either side may be the one that connects."""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.live.addresses import Query, in_words
from asterism.live.analysis import AnalysedFrame
from asterism.live.clock import StreamTimes
from asterism.live.datagrams import JsonSource, frame_of_json, overflow
from asterism.live.frames import LiveFrame, SourceAbout
from asterism.live.outputs import WAITING, labels_as_json, leave_one_out, tells_more
from asterism.live.packages import packages_for
from asterism.live.reporting import reconnected, times_made

_LARGEST = 1 << 18
"""Bytes of a message that is believed: twice what the most points that a frame may have take with their names. Half of it refuses verbose
senders; twice as much only costs memory."""
_BUFFER = 1 << 16
"""Bytes that the system keeps for a receiver that is slow, ten frames of 59 markers. Twice as many make what it shows older by as much; at
half a frame of many markers waits for its own beginning."""
_PULSE = 5.0
"""s between two questions whether the other side is there, and s until it counts as gone. Half of it gives up a busy phone; twice as long
nobody knows that a cable is out."""
_AGAIN = 1.0
"""s between two attempts to connect. Half of it fills the log of who refuses; twice as long delays what comes back."""
_PATIENCE = 2.0
"""s in which a connection is made, or given up until the next attempt. Radio needs tenths; twice as long makes sessions end late."""
_GOODBYE = 0.5
"""s in which the other side may answer a goodbye. Radio needs tenths; twice as long makes sessions end late."""
_MOST_RECEIVERS = 16
"""Receivers at once: the screens of a laboratory. Each costs a buffer; half and double of it do as well."""


@dataclass(frozen=True)
class WebSocketPlace:
    """Where the other side is, or where to wait for it.

    address  as given, for who connects; it may hold a password
    name     the same for a person, without what is secret
    listens  whether this side waits for the other
    host, port  of either
    origins  pages whose browser may connect; none by default, since any page that is open in a browser could
    token    what who connects must know; "" for nothing
    """

    address: str
    name: str
    listens: bool
    host: str
    port: int
    origins: tuple[str, ...] = ()
    token: str = ""


def websocket_place(address: str) -> WebSocketPlace:
    """The place that an address means: ws:// or wss:// of who waits for us, ws-listen:// of where we wait. Raises AsterismError."""
    example = "ws://192.168.1.5:8765, or ws-listen://127.0.0.1:8765?token=SECRET to wait there for the other side"
    try:
        parts = urlsplit(address)
        host, port, listens = parts.hostname, parts.port, parts.scheme.lower() == "ws-listen"
    except ValueError:
        host, port, listens = None, None, False
    if not host or (listens and port is None):
        raise AsterismError(f"{address} names no host and port; write for example {example}.")
    port = (443 if parts.scheme.lower() == "wss" else 80) if port is None else port
    name = f"{parts.scheme.lower()}://{host}:{port}{parts.path}"
    origins, token = tuple[str, ...](), ""
    # What is said to who waits elsewhere is theirs to understand.
    if listens:
        query = Query(address, bare=True)
        origins, token = query.texts("origin"), query.text("token", "")
        query.check_all_used()
    return WebSocketPlace(address, name, listens, host, port, origins, token)


class _Endpoint:
    """Connects or waits, again and again, in a thread of its own; what is done with a connection is `talk`, until it is lost.

    most     connections at once
    Raises AsterismError where the package is missing, or this machine cannot wait there.
    """

    def __init__(self, place: WebSocketPlace, talk: Callable[[Any], Coroutine[Any, Any, None]], most: int) -> None:
        with packages_for(f"{place.address.partition(':')[0]}://"):
            import websockets.asyncio.client
            import websockets.asyncio.server  # noqa: F401
        self.place, self._talk, self._most = place, talk, most
        self.connected, self.made, self.refused, self.problem = 0, 0, 0, ""
        self._links = set[Any]()
        self._tried = threading.Event()
        self._listening = _listening(place) if place.listens else None
        self.port = place.port if self._listening is None else int(self._listening.getsockname()[1])
        self.loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name=place.name, daemon=True)
        self._thread.start()
        # Whether somebody answers is known at once, or said as not known yet.
        self._tried.wait(_PATIENCE)

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        self._task = self.loop.create_task(self._wait() if self._listening is not None else self._connect())
        with suppress(asyncio.CancelledError):
            self.loop.run_until_complete(self._task)
        left = asyncio.all_tasks(self.loop)
        for task in left:
            task.cancel()
        self.loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
        self.loop.close()

    async def _connect(self) -> None:
        from websockets.asyncio.client import connect

        while True:
            try:
                async with connect(self.place.address, open_timeout=_PATIENCE, proxy=None, **_LIMITS) as link:
                    await self._hold(link)
                self.problem = "it was closed by the other side"
            # The other side may refuse, be no WebSocket, vanish, or send what is too large: nothing of it ends the attempts.
            except Exception as problem:
                self.problem = in_words(problem)
            self._tried.set()
            await asyncio.sleep(_AGAIN)

    async def _wait(self) -> None:
        from websockets.asyncio.server import serve
        from websockets.exceptions import WebSocketException

        async def taken(link: Any) -> None:
            if self.connected >= self._most:
                self.refused += 1
                await link.close(1013, "no room for another one")
                return
            with suppress(OSError, WebSocketException):
                await self._hold(link)

        def known(link: Any, request: Any) -> Any:
            said = dict(parse_qsl(urlsplit(request.path).query)).get("token", "")
            if secrets.compare_digest(said.encode(), self.place.token.encode()) or not self.place.token:
                return None
            return link.respond(401, "The token is missing or another one.\n")

        origins: list[Any] = [None, *self.place.origins]
        limits = {"open_timeout": _PATIENCE, "process_request": known, **_LIMITS}
        async with serve(taken, sock=self._listening, origins=origins, **limits):
            self._tried.set()
            await asyncio.get_running_loop().create_future()

    async def _hold(self, link: Any) -> None:
        own = link.transport.get_extra_info("socket")
        with suppress(OSError):
            own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
            # Else the system waits up to 40 ms whether more is to be sent.
            own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._links.add(link)
        self.connected += 1
        self.made += 1
        self._tried.set()
        try:
            await self._talk(link)
        finally:
            self.connected -= 1
            self._links.discard(link)

    def findings(self) -> list[Finding]:
        """That nobody was reached, that a connection was made again, that somebody was sent away."""
        found, name = list[Finding](), self.place.name
        if not self.made and not self.place.listens:
            mend = f"Look at the address, and whether who is there has begun; it is tried again every {_AGAIN:g} s."
            found.append(Finding("live-unconnected", Severity.WARNING, name, f"{name}: no connection ({self.problem}).", mend))
        if self.made > 1 and not self.place.listens:
            found.append(reconnected(name, self.made - 1, "Look at the network, or who is at the other end."))
        if self.refused:
            sentence = f"{name}: {self.refused} connections were refused, since {self._most} at a time is the most."
            found.append(Finding("live-refused", Severity.WARNING, name, sentence, "Give each sender an address of its own."))
        return found

    def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()
        # Who takes nothing any more takes no goodbye either, which would be waited for.
        self.loop.call_later(_GOODBYE, lambda: [link.transport.abort() for link in self._links])

    def close(self) -> None:
        """End all connections and the thread."""
        with suppress(RuntimeError):
            self.loop.call_soon_threadsafe(self._end)
        self._thread.join(timeout=2 * _PATIENCE)
        if self._listening is not None:
            self._listening.close()


_LOGGER = logging.getLogger("asterism.live.websocket")
# Whoever knocks at the port would otherwise be a trace of Python on the terminal.
_LOGGER.addHandler(logging.NullHandler())
_LOGGER.propagate = False
_LIMITS: dict[str, Any] = {
    "logger": _LOGGER,
    # A frame that is packed takes longer to arrive, and a small one may become a large one.
    "compression": None,
    "max_size": _LARGEST,
    "ping_interval": _PULSE,
    "ping_timeout": _PULSE,
    "close_timeout": _GOODBYE,
}


def _listening(place: WebSocketPlace) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in place.host else socket.AF_INET
        listening = socket.create_server((place.host, place.port), family=family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        return listening
    except (OSError, OverflowError) as problem:
        raise AsterismError(
            f"{place.name} cannot be listened to ({in_words(problem)}): another program has the port, or the address is not of this "
            "machine. Give another one."
        ) from problem


class FromWebSocket(JsonSource):
    """A source of frames that arrive as JSON, one a message, see `frame_of_json`.

    place  of the sender, which is connected to again when it is lost; or where to wait for one, of which there is one at a time
    rate   frames per second that the sender was told to send
    Raises AsterismError where the package is missing, or this machine cannot wait there.
    """

    def __init__(self, place: WebSocketPlace, rate: float = float("nan")) -> None:
        super().__init__()
        self.about = SourceAbout(f"JSON at {place.name}", rate)
        self._came: deque[LiveFrame] = deque(maxlen=WAITING)
        self.overflowed = 0
        self._times = StreamTimes(rate)
        self._there = threading.Condition()
        self._closed = False
        self._endpoint = _Endpoint(place, self._listen, 1)

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return self._endpoint.port

    async def _listen(self, link: Any) -> None:
        async for message in link:
            data = message.encode() if isinstance(message, str) else message
            frame = frame_of_json(data, time.monotonic())
            with self._there:
                if frame is None:
                    self._damaged.add(data)
                else:
                    # What waits too long is left out by the queue, and was not lost on the way.
                    self.overflowed += len(self._came) == WAITING
                    self._came.append(frame)
                    self._there.notify()

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame that is whole."""
        with self._there:
            if not self._came and not self._closed:
                self._there.wait(timeout)
            frame = self._came.popleft() if self._came else None
        return None if frame is None else replace(frame, time=self._times.of(frame.number, frame.time, frame.arrived))

    def findings(self) -> list[Finding]:
        """See `_Endpoint.findings`; frames without times, or left out here; and what is wrong with the first message that was not read."""
        made = [times_made(self.about.name)] if self._times.made else []
        lost = overflow(self.about.name, self.overflowed)
        return [*made, *self._endpoint.findings(), *lost, *self._damaged.findings(self.about.name)]

    def close(self) -> None:
        """Let go of the sender."""
        with self._there:
            self._closed = True
            self._there.notify_all()
        self._endpoint.close()


@dataclass(eq=False)
class _Receiver:
    """Messages that wait for one receiver, oldest first, each with whether it says what no later one does."""

    waiting: deque[tuple[bool, str]] = field(default_factory=deque)
    there: asyncio.Event = field(default_factory=asyncio.Event)


class ToWebSocket:
    """Sends each labelled frame as JSON, one a message, to who waits at a place, or to all who connect there.

    Each receiver has a short queue of its own. Where it takes frames too slowly the oldest is left out, one with events last, and counted
    in `dropped`.
    Raises AsterismError where the package is missing, or this machine cannot wait there.
    """

    def __init__(self, place: WebSocketPlace) -> None:
        self.name, self.dropped = place.name, 0
        self._receivers: list[_Receiver] = []
        self._guard = threading.Lock()
        self._listens = place.listens
        self._endpoint = _Endpoint(place, self._tell, _MOST_RECEIVERS)

    @property
    def port(self) -> int:
        """The port that is listened to: a free one where 0 was asked for."""
        return self._endpoint.port

    @property
    def receivers(self) -> int:
        """How many are connected."""
        return len(self._receivers)

    def send(self, frame: AnalysedFrame) -> None:
        """Put a frame into the queue of each receiver. Nobody there is a loss where one was named, none where all may come."""
        with self._guard:
            if not self._receivers:
                self.dropped += not self._listens
                return
            message = (tells_more(frame), labels_as_json(frame).decode())
            for receiver in self._receivers:
                receiver.waiting.append(message)
                if len(receiver.waiting) > WAITING:
                    leave_one_out(receiver.waiting)
                    self.dropped += 1
                # One call wakes who waits, however many frames do.
                if len(receiver.waiting) == 1:
                    with suppress(RuntimeError):
                        self._endpoint.loop.call_soon_threadsafe(receiver.there.set)

    async def _tell(self, link: Any) -> None:
        receiver = _Receiver()
        with self._guard:
            self._receivers.append(receiver)
        listening = asyncio.ensure_future(_ignore(link))
        telling = asyncio.ensure_future(self._pass_on(link, receiver))
        try:
            done, _ = await asyncio.wait((listening, telling), return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            listening.cancel()
            telling.cancel()
            with self._guard:
                self._receivers.remove(receiver)
                # Who goes of their own will loses nothing.
                self.dropped += 0 if self._listens else len(receiver.waiting)

    async def _pass_on(self, link: Any, receiver: _Receiver) -> None:
        while True:
            await receiver.there.wait()
            receiver.there.clear()
            while receiver.waiting:
                with self._guard:
                    _, data = receiver.waiting.popleft()
                await link.send(data)

    def findings(self) -> list[Finding]:
        """See `_Endpoint.findings`."""
        return self._endpoint.findings()

    def close(self) -> None:
        """Let go of all receivers, once they have what waits for them or a second is over."""
        until = time.monotonic() + 1.0
        while any(receiver.waiting for receiver in list(self._receivers)) and time.monotonic() < until:
            time.sleep(0.01)
        self._endpoint.close()


async def _ignore(link: Any) -> None:
    """Until the other side goes; what it says is no matter."""
    async for _ in link:
        pass
