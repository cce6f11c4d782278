"""Outputs of a live session, with real receivers over the loopback address, in; the processor time that a frame takes, out."""

from __future__ import annotations

import os
import socket
import struct
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from asterism.live import AnalysedFrame, FrameAnalysis, LabelledFrame, LiveFrame, SourceAbout, open_output
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

RATE, MARKERS, VALUES = 200.0, 59, 20
ABOUT = SourceAbout("benchmark", RATE)


def outputs(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """59 markers and 20 values at 200 Hz to each kind of output, somebody receiving: processor time a frame, and how late it is.

    Needs a quiet machine.
    """
    # Of all that the library of LSL could use this machine only; it reads this as it is loaded.
    config = Path(tempfile.gettempdir()) / f"asterism-lsl-{os.getpid()}.cfg"
    config.write_text("[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n[log]\nlevel = -3\n")
    os.environ["LSLAPICFG"] = str(config)
    count = 100 if benchmark.quick else 2000
    frames = [_frame(n) for n in range(count)]
    for name, address, receive in _receivers():
        arrivals = list[float]()
        with ExitStack() as stack:
            output = open_output(address(stack, arrivals), ABOUT)
            stack.callback(output.close)
            output.send(_frame(-1))
            receive(output, stack, arrivals)
            spent, own, sent = time.process_time(), 0.0, list[float]()
            begin = time.monotonic() + 0.1
            for n, frame in enumerate(frames):
                time.sleep(max(0.0, begin + n / RATE - time.monotonic()))
                before = time.thread_time()
                sent.append(time.monotonic())
                output.send(frame)
                own += time.thread_time() - before
            time.sleep(0.1)
            spent = time.process_time() - spent
        # What came first after a frame was sent is its own: they are 5 ms apart.
        came = np.searchsorted(arrivals, sent)
        late = np.array([arrivals[at] - when for at, when in zip(came.tolist(), sent, strict=True) if at < len(arrivals)])
        row = f"live out, {MARKERS} markers and {VALUES} values, {name}"
        yield Figure(f"{row}: processor time a frame, in the thread that labels", "< 0.25", 1000 * own / count, "ms", count)
        yield Figure(f"{row}: in all threads, with the receiver", "none", 1000 * spent / count, "ms", count)
        yield Figure(f"{row}: sent to received, p99", "< 2", 1000 * float(np.quantile(late, 0.99)), "ms", len(late))
        yield Figure(f"{row}: frames that did not come", "<= 0", count - len(late) + int(getattr(output, "dropped", 0)), "frames", count)
    config.unlink(missing_ok=True)


def _frame(n: int) -> AnalysedFrame:
    points = np.random.default_rng(abs(n)).normal((0.0, 0.0, 0.9), 0.4, (MARKERS, 3))
    labelled = LabelledFrame(
        LiveFrame(n, n / RATE, time.monotonic(), points),
        tuple(f"M{marker:02d}" for marker in range(MARKERS)),
        np.arange(MARKERS),
        np.full(MARKERS, 0.99),
        time.monotonic(),
    )
    return AnalysedFrame(labelled, FrameAnalysis({f"left angle {value}": 10.0 + value for value in range(VALUES)}))


Receiver = tuple[str, Callable[[ExitStack, list[float]], str], Callable[[Any, ExitStack, list[float]], None]]


def _receivers() -> list[Receiver]:
    """Name, address once a receiver is ready, and what receives once the output is open."""
    stream = f"benchmark {uuid.uuid4().hex[:8]}"
    return [
        ("JSON over UDP", lambda stack, arrivals: f"udp://127.0.0.1:{_udp(stack, arrivals)}", lambda *_: None),
        ("OSC", lambda stack, arrivals: f"osc://127.0.0.1:{_udp(stack, arrivals)}", lambda *_: None),
        ("JSON over WebSocket", lambda *_: "ws-listen://127.0.0.1:0", _page),
        ("LSL", lambda *_: f"lsl://{stream}", lambda output, stack, arrivals: _inlet(stream, stack, arrivals)),
        ("NatNet", lambda *_: "natnet://127.0.0.1:0?unicast=1", _client),
    ]


def _udp(stack: ExitStack, arrivals: list[float]) -> int:
    receiving = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    receiving.bind(("127.0.0.1", 0))
    receiving.settimeout(0.1)
    _receive(lambda: receiving.recv(65_536), stack, arrivals)
    return int(receiving.getsockname()[1])


def _page(output: Any, stack: ExitStack, arrivals: list[float]) -> None:
    from websockets.sync.client import connect

    link = stack.enter_context(connect(f"ws://127.0.0.1:{output.port}", proxy=None, close_timeout=0.1))
    while not output.receivers:
        time.sleep(0.01)
    _receive(lambda: link.recv(0.1), stack, arrivals)


def _inlet(stream: str, stack: ExitStack, arrivals: list[float]) -> None:
    import pylsl

    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", stream, timeout=10.0)[0], as_numpy=True)
    inlet.open_stream(10.0)
    _receive(lambda: inlet.pull_sample(0.1)[0], stack, arrivals)


def _client(output: Any, stack: ExitStack, arrivals: list[float]) -> None:
    client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    client.sendto(struct.pack("<HH", 0, 5) + b"Ping\0", ("127.0.0.1", output.port))
    client.settimeout(10.0)
    client.recv(65_536)
    client.settimeout(0.1)

    def take() -> bytes:
        # Who says nothing for ten seconds is sent nothing any more.
        if len(arrivals) % 200 == 199:
            client.sendto(struct.pack("<HH", 10, 1) + b"\0", ("127.0.0.1", output.port))
        return client.recv(65_536)

    _receive(take, stack, arrivals)


def _receive(take: Callable[[], object], stack: ExitStack, arrivals: list[float]) -> None:
    """Take what comes until the end, and when it came."""
    ended = threading.Event()

    def run() -> None:
        while not ended.is_set():
            try:
                came = take()
            except TimeoutError:
                continue
            except Exception:
                return
            if came is not None:
                arrivals.append(time.monotonic())

    thread = threading.Thread(target=run)
    thread.start()
    stack.callback(thread.join)
    stack.callback(ended.set)
