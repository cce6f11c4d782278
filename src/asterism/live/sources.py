"""The address of a source in; the source that reads there, out."""

from __future__ import annotations

from urllib.parse import urlsplit

from asterism.errors import AsterismError
from asterism.live.datagrams import HostPort, JsonDatagrams
from asterism.live.frames import LiveSource

ADDRESSES = {
    "udp": "udp://HOST:PORT  frames as JSON, one a datagram; 0.0.0.0 for the whole network, 127.0.0.1 for this machine",
}
"""What can be a source, by the first word of its address."""


def host_port(address: str, example: str) -> HostPort:
    """The host and the port of an address. Raises AsterismError where it has none; example: of one, for that sentence."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or port is None:
        raise AsterismError(f"{address} names no host and port; write for example {example}.")
    return HostPort(host, port)


def open_source(address: str, rate: float = float("nan")) -> LiveSource:
    """The source at an address, such as udp://127.0.0.1:5000.

    rate: frames per second, NaN where the source says it or its times show it.
    Raises AsterismError where the address is none, or nothing can be read there.
    """
    scheme = address.partition("://")[0].lower()
    if scheme not in ADDRESSES:
        known = ", ".join(ADDRESSES)
        raise AsterismError(f"{address} is no source: its address begins with {known}://, and a recording is played with --replay FILE.")
    return JsonDatagrams(host_port(address, "udp://127.0.0.1:5000"), rate)
