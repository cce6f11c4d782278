"""The receivers of docs/live-outputs.md get what a session sends; that of the Lab Streaming Layer is in test_live_lsl.py."""

from __future__ import annotations

import socket
from collections.abc import Callable

import pytest
from receivers import KNEE, free_port, printed_by_receiver

from asterism.live import AnalysedFrame, SourceAbout, open_output


def sending(address: str) -> tuple[Callable[[AnalysedFrame], None], Callable[[], None]]:
    output = open_output(address, SourceAbout("given", 100.0))
    return output.send, output.close


# The programs end with their process, and leave their sockets open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize(
    ("heading", "address", "port", "kind", "package", "expected"),
    [
        ("JSON over UDP", "udp://127.0.0.1", 5001, socket.SOCK_DGRAM, "json", (2.5, [0.5, 0.25, 0.125], KNEE)),
        ("WebSocket", "ws-listen://127.0.0.1", 8765, socket.SOCK_STREAM, "websockets", (KNEE,)),
        ("Open Sound Control", "osc://127.0.0.1", 9000, socket.SOCK_DGRAM, "pythonosc", (KNEE,)),
    ],
    ids=["udp", "websocket", "osc"],
)
def test_a_receiver_of_the_page_prints_what_is_sent(
    heading: str, address: str, port: int, kind: socket.SocketKind, package: str, expected: tuple[object, ...]
) -> None:
    pytest.importorskip(package)
    free = free_port(kind)
    send, close = sending(f"{address}:{free}")
    try:
        assert printed_by_receiver(heading, send, (str(port), str(free))) == expected
    finally:
        close()
