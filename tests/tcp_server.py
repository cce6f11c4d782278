"""A server on this machine for the tests of sources that connect: what it says to a client is its own."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading


class TcpServer(threading.Thread):
    """Listens on a free port until its socket is closed; each client is served in a thread of its own. Begun when it is made."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.start()

    def run(self) -> None:
        while True:
            try:
                client, _ = self.socket.accept()
            except OSError:
                return
            threading.Thread(target=self._served, args=(client,), daemon=True).start()

    def _served(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError, struct.error):
            self.serve(client)

    def serve(self, client: socket.socket) -> None:
        """Talk to a client until it is gone, or enough was said."""
        raise NotImplementedError
