"""A simulated line behind a TCP port, as a serial device server offers one.

Strategy: listens on 127.0.0.1, serves one client at a time with the same pacing as a pseudo
terminal, and sends every due byte immediately (no Nagle delay).
"""

from __future__ import annotations

import contextlib
import socket
import time

from .line import SimLine
from .pacing import PacedEnd

__all__ = ["TcpEnd"]


class TcpEnd(PacedEnd):
    """A line on a TCP port, served from construction until `close`.

    Args:
        line: The line.
        port: Where to listen on 127.0.0.1; 0 lets the system choose.
    """

    def __init__(self, line: SimLine, port: int = 0) -> None:
        super().__init__(line)
        self._client: socket.socket | None = None
        self._server: socket.socket | None = socket.create_server(("127.0.0.1", port))
        self.port: int = self._server.getsockname()[1]
        self._start()

    @property
    def url(self) -> str:
        """What a host opens."""
        return f"socket://127.0.0.1:{self.port}"

    @property
    def connected(self) -> bool:
        """Whether a client is served."""
        return self._client is not None

    def drop(self) -> None:
        """Cut the client off; what is under way is lost."""
        with self.lock:
            self._hang_up()
            self.line.drop_everything(time.monotonic())
        self._settle()

    def unplug(self) -> None:
        """Cut the client off and take no other until `replug`."""
        self.refuse(True)
        self.drop()

    def replug(self) -> None:
        """Take clients again, on the same port."""
        self.refuse(False)

    def refuse(self, refusing: bool) -> None:
        """Stop listening, so that connecting is refused, or listen again on the same port."""
        with self.lock:
            if refusing and self._server is not None:
                self._server.close()
                self._server = None
            elif not refusing and self._server is None:
                self._server = socket.create_server(("127.0.0.1", self.port))
        self._settle()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _descriptor(self) -> int | None:
        return None if self._client is None else self._client.fileno()

    def _listener(self) -> int | None:
        return None if self._server is None else self._server.fileno()

    def _connect(self) -> None:
        """Take a client, or turn it away when there is one already."""
        if self._server is None:
            return
        with contextlib.suppress(OSError):
            client, _ = self._server.accept()
            if self._client is not None:
                client.close()
                return
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client

    def _gone(self) -> bool:
        self._hang_up()
        self.line.drop_everything(time.monotonic())
        return False

    def _release(self) -> None:
        self._hang_up()
        if self._server is not None:
            self._server.close()
