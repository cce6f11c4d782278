"""Every request to the page's server, checked before anything else sees it: who asks, from which page, by which name of this machine."""

from __future__ import annotations

import hmac
import ipaddress
import json
import socket
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs

STATIC = "/static/"
"""Files under this address hold no data, and need no token."""

_HEADERS = [
    (b"cache-control", b"no-store"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
]
_POLICY = (
    "default-src 'none'; script-src 'self'; worker-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; font-src 'self'; "
    "connect-src 'self' ws://{host}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


@dataclass(frozen=True)
class Guard:
    """An ASGI application that lets only the right requests through to another one.

    app    the application
    token  the secret of this run, in a header or in the address
    host   the address that the server is bound to
    port   its port
    """

    app: Any
    token: str
    host: str
    port: int

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer, or refuse, one request."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        problem = self._problem(scope, headers)
        # A socket is refused before it is accepted, with no reason told.
        if problem and scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        # The policy names the host that was asked for, which has been checked by then.
        policy = _POLICY.format(host=headers.get("host", "") if not problem else "").encode("latin-1", "replace")

        async def send_guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message["headers"], *_HEADERS, (b"content-security-policy", policy)]}
            await send(message)

        if problem:
            # Who opened an address reads a sentence, a script what it asks for.
            is_read = "text/html" in headers.get("accept", "")
            words = f"Asterism: {problem}" if is_read else json.dumps({"error": problem})
            body, kind = words.encode(), b"text/plain; charset=utf-8" if is_read else b"application/json"
            plain = [(b"content-type", kind), (b"content-length", str(len(body)).encode())]
            await send_guarded({"type": "http.response.start", "status": 403, "headers": plain})
            await send_guarded({"type": "http.response.body", "body": body})
            return
        await self.app(scope, receive, send_guarded)

    def _problem(self, scope: Any, headers: dict[str, str]) -> str:
        """Why a request is refused; empty where it is not."""
        host = headers.get("host", "")
        # First the name: a foreign name that points here is another page's trick.
        if not self._is_own_name(host):
            return "this address is not the one that the page was opened with; use the address that the command printed."
        # Browsers name the page that a request comes from; programs need not.
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{host}":
            return "the request came from another page; use the address that the command printed."
        # Style and script hold no data: a page can load them before it has the token.
        if scope["type"] == "http" and scope["method"] in ("GET", "HEAD") and scope["path"].startswith(STATIC):
            return ""
        given = headers.get("x-asterism-token") or parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        # In constant time: its duration must not tell how much of the token was right.
        if not hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return "the token is missing or of an earlier run; use the address that the command printed."
        return ""

    def _is_own_name(self, given: str) -> bool:
        """Whether a Host header names this server. With it, a page of another site cannot point its own name at this machine."""
        # Browsers leave out the port of the protocol; the address of IPv6 ends in a bracket, which has colons before it.
        name, _, port = given.rpartition(":") if ":" in given.rpartition("]")[2] else (given, "", "80")
        if port != str(self.port):
            return False
        name = name.strip("[]").lower()
        if name in ("127.0.0.1", "localhost", "::1", self.host.lower()):
            return True
        # Bound to one address only that one is meant; bound to all, any address of this machine.
        if self.host not in ("0.0.0.0", "::"):
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name == socket.gethostname().lower()
        return True
