"""The address of an output in; what sends labelled frames there, out."""

from __future__ import annotations

from collections.abc import Sequence

from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.frames import SourceAbout
from asterism.live.outputs import ToDatagrams
from asterism.live.running import LiveOutput
from asterism.live.sources import host_port

OUTPUTS = ("udp", "ws", "wss", "ws-listen", "osc", "lsl", "natnet")
"""How labelled frames are sent, by the first word of an address: JSON in datagrams or over WebSocket; OSC; LSL; as Motive does it."""


def open_outputs(addresses: Sequence[str], about: SourceAbout) -> list[LiveOutput]:
    """The outputs at addresses; about: the source of the frames. Raises AsterismError, with none left open, where one cannot be opened."""
    outputs = list[LiveOutput]()
    try:
        for address in addresses:
            outputs.append(open_output(address, about))
    except BaseException:
        for output in outputs:
            output.close()
        raise
    return outputs


def open_output(address: str, about: SourceAbout) -> LiveOutput:
    """What sends labelled frames to an address, such as osc://127.0.0.1:9000.

    about: the source of the frames. Raises AsterismError where the address is none, or its package is not installed.
    """
    scheme = address.partition("://")[0].lower()
    if scheme not in OUTPUTS or "://" not in address:
        known = f"{', '.join(OUTPUTS[:-1])} or {OUTPUTS[-1]}"
        raise AsterismError(f"{address} is nothing to send frames to: an address begins with {known} and ://.")
    if scheme in ("udp", "osc"):
        Query(address, bare=True).check_all_used()
    if scheme == "osc":
        from asterism.live.osc import ToOsc

        return ToOsc(host_port(address, "osc://127.0.0.1:9000"))
    if scheme == "lsl":
        from asterism.live.lsl_outlet import ToLsl

        return ToLsl(address, about.rate)
    if scheme == "natnet":
        from asterism.live.natnet_server import ToNatNet

        return ToNatNet(address, about)
    if scheme in ("ws", "wss", "ws-listen"):
        from asterism.live.websocket import ToWebSocket, websocket_place

        return ToWebSocket(websocket_place(address))
    return ToDatagrams(host_port(address, "udp://127.0.0.1:5001"))
