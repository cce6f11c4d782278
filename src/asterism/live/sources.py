"""The address of a source in; the source that reads there, out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from urllib.parse import urlsplit

from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.camera_frames import BlobSource
from asterism.live.datagrams import HostPort, JsonDatagrams
from asterism.live.frames import LiveSource
from asterism.live.packages import packages_for

ADDRESSES = ("udp", "ws", "wss", "ws-listen", "natnet", "qtm", "vicon", "lsl")
"""What can be a source, by the first word of its address: frames as JSON in datagrams or over WebSocket; Motive; QTM; Vicon; LSL."""

_OF_BLOBS = "it says how blobs of cameras are numbered, of which points are made by a rig: add --rig FILE"


def host_port(address: str, example: str, port_else: int | None = None, *, listens: bool = False) -> HostPort:
    """The host and the port of an address, `port_else` where it has no port. Raises AsterismError where it has none; example: of one.

    listens: whether this machine waits there, so that 0 is any free port; nobody is reached at 0
    """
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, port_else if parts.port is None else parts.port
    except ValueError:
        host, port = None, None
    if not host or port is None or not (port or listens):
        raise AsterismError(f"{address} names no host and port; write for example {example}.")
    return HostPort(host, port)


def open_source(address: str, rate: float = float("nan")) -> LiveSource:
    """The source at an address, such as udp://127.0.0.1:5000.

    rate: frames per second, NaN where the source says it or its times show it.
    Raises AsterismError where the address is none, or nothing can be read there.
    """
    scheme = address.partition("://")[0].lower()
    if scheme not in ADDRESSES:
        known = f"{', '.join(ADDRESSES[:-1])} or {ADDRESSES[-1]}"
        raise AsterismError(
            f"{address} is no source: an address begins with {known} and ://, and a recording is played with --replay FILE."
        )
    # A module is imported only where its kind of source is asked for: some need packages of their own.
    if scheme == "lsl":
        from asterism.live.lsl_source import FromLsl

        return FromLsl(address, rate)
    if scheme in ("ws", "wss", "ws-listen"):
        from asterism.live.websocket import FromWebSocket, websocket_place

        return FromWebSocket(websocket_place(address), rate)
    query = Query(address, bare=True)
    local = query.text("local", "") if scheme == "natnet" else ""
    query.check_all_used({"together": _OF_BLOBS} if scheme == "udp" else {})
    if scheme == "natnet":
        from asterism.live.natnet import COMMANDS, FromNatNet

        return FromNatNet(host_port(address, "natnet://192.168.1.5", COMMANDS), local, rate)
    if scheme == "qtm":
        with packages_for("qtm://"):
            from asterism.live.qtm import PORT, FromQtm
        return FromQtm(host_port(address, "qtm://192.168.1.5", PORT), rate)
    if scheme == "vicon":
        from asterism.live.vicon import PORT as DATASTREAM
        from asterism.live.vicon import FromVicon

        return FromVicon(host_port(address, "vicon://192.168.1.5", DATASTREAM), rate)
    return JsonDatagrams(host_port(address, "udp://127.0.0.1:5000", listens=True), rate)


def blobs_of(address: str, cameras: Sequence[str], rate: float = float("nan")) -> Callable[[], BlobSource]:
    """What opens the source of blobs at an address, here or in another process, such as udp://127.0.0.1:5000?together=1.

    cameras: the rig's names. With `together` equal numbers are one exposure. Raises AsterismError where the address is none, as does what
    is returned where nothing can be read there.
    """
    scheme = address.partition("://")[0].lower()
    if scheme not in ("udp", "qtm"):
        raise AsterismError(
            f"{address} is no source of blobs: an address begins with udp:// or qtm://, and a file is played with --replay FILE. "
            "Points need no rig: leave --rig out where it sends these."
        )
    query = Query(address, bare=True)
    together = scheme == "udp" and query.switch("together")
    query.check_all_used()
    if scheme == "qtm":
        if math.isfinite(rate):
            raise AsterismError(f"{address}: QTM says the rate of its cameras; leave --rate out.")
        with packages_for("qtm://"):
            from asterism.live.qtm import PORT, QtmBlobs
        return partial(QtmBlobs, host_port(address, "qtm://192.168.1.5", PORT))
    from asterism.live.blobs.sources import JsonBlobs

    return partial(JsonBlobs, host_port(address, "udp://127.0.0.1:5000", listens=True), cameras, rate, numbered_together=together)
