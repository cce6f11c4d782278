"""A sitting in; a server on this machine, its address in the person's browser, until they stop it."""

from __future__ import annotations

import errno
import html
import ipaddress
import os
import secrets
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from asterism.errors import AsterismError
from asterism.web.session import CorrectionSession


@dataclass(frozen=True)
class PageAddress:
    """Where the page is served.

    host     the address to bind to; another than the loopback address lets other machines in the same network in, with the token
    port     the port; 0 for a free one
    browser  whether to open the page in the default browser
    """

    host: str = "127.0.0.1"
    port: int = 0
    browser: bool = True


def serve(session: CorrectionSession, place: PageAddress, say: Callable[[str], None]) -> None:
    """Serve the page of a sitting until it is interrupted.

    say: told sentences for the person, the page's address among them.
    Raises AsterismError where the port is taken, the address is not of this machine, or the extra `web` is not installed.
    """
    try:
        import uvicorn

        from asterism.web.app import make_app
    except ModuleNotFoundError as problem:
        raise AsterismError(
            f"the page needs {problem.name}, which is not installed; install it with `pip install asterism[web]`."
        ) from problem
    from asterism.web.guard import Guard

    # A new secret for each run: an old address opens nothing.
    token = secrets.token_urlsafe(24)
    # Bound before anything is told, so that the address is known and the port is ours.
    with bound(place) as listening:
        port = listening.getsockname()[1]
        address = address_of(place.host, port, token)
        config = uvicorn.Config(
            Guard(make_app(session), token, place.host, port),
            log_level="critical",
            access_log=False,
            lifespan="off",
            server_header=False,
            ws_max_size=1 << 16,
            timeout_graceful_shutdown=2,
        )
        server = uvicorn.Server(config)
        # Labelling begins at once; the page shows each trial as it gets ready.
        thread = session.start()
        say(f"The page is at {address}")
        if is_open_to_others(listening):
            say("Whoever has this address and reaches this machine can see and change the labels, and nothing is encrypted on the way.")
        say("Stop with Ctrl-C. Every answer is kept in a log at once.")
        leading = _leading_to(address) if place.browser else None
        # In a thread: some browsers return only when they are closed.
        if place.browser:
            threading.Thread(target=_open, args=(leading, say), daemon=True).start()
        try:
            server.run(sockets=[listening])
        except KeyboardInterrupt:
            pass
        finally:
            if leading is not None:
                leading.unlink(missing_ok=True)
            thread.join(timeout=0.1)
            session.close()


def bound(place: PageAddress) -> socket.socket:
    """A socket that is bound."""
    try:
        resolved = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_STREAM)[0]
        # By its protocol asyncio knows TCP, and sends small messages at once; else each waits up to 40 ms for the other end's answer.
        listening = socket.socket(*resolved[:3])
    except (OSError, OverflowError) as problem:
        raise AsterismError(f"--host {place.host} is no address of this machine; leave it out, or give one of its own.") from problem
    try:
        # On Windows another program could share the port and read along.
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(resolved[4])
        listening.listen(128)
    except OSError as problem:
        listening.close()
        # Each cause has its own mend.
        if problem.errno == errno.EADDRINUSE:
            raise AsterismError(
                f"the port {place.port} is taken by another program; give another with --port, or leave it out."
            ) from problem
        if problem.errno in (errno.EACCES, errno.EPERM):
            raise AsterismError(f"the port {place.port} may not be used; give one above 1023 with --port, or leave it out.") from problem
        raise AsterismError(f"--host {place.host} is no address of this machine; leave it out, or give one of its own.") from problem
    return listening


def is_open_to_others(listening: socket.socket) -> bool:
    """Whether other machines can reach a socket that is bound."""
    return not ipaddress.ip_address(listening.getsockname()[0]).is_loopback


def address_of(host: str, port: int, token: str) -> str:
    """The address of a page, with its token."""
    return f"http://{_in_address(host)}:{port}/?token={token}"


def _in_address(host: str) -> str:
    """A host as it stands in an address that a browser can open."""
    if host in ("0.0.0.0", "::"):
        return _own_address()
    return f"[{host}]" if ":" in host else host


def _own_address() -> str:
    """An address of this machine in its network, found without sending anything."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # a datagram socket only chooses a route
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"


def _leading_to(address: str) -> Path | None:
    """A file that only this user can read and that leads a browser to an address; None where it cannot be written.

    The address itself would stand in the browser's list of arguments, which every user of the machine can read, with its token.
    """
    # A browser from a snap sees other files in the folder for temporary files than we do, and no hidden ones in the home.
    folders = [os.path.expanduser("~"), None] if os.path.isdir("/snap") else [None]
    shown = html.escape(address)
    for folder in folders:
        with suppress(OSError):
            handle, name = tempfile.mkstemp(".html", "asterism-page-", folder)
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(f'<!doctype html><meta http-equiv="refresh" content="0;url={shown}"><a href="{shown}">Asterism</a>')
            return Path(name)
    return None


def _open(leading: Path | None, say: Callable[[str], None]) -> None:
    try:
        opened = leading is not None and webbrowser.open(leading.as_uri())
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        say("No browser could be opened; open the address yourself.")
