"""A Unix socket that takes commands to a running simulator.

Strategy: one command a connection. The client sends a line and ends its half; the answer is `ok`
or `error` on one line, then text, then the end. Each connection has a thread, since
`unplug 3s` takes three seconds. The socket is its owner's alone (mode 0600).
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

from .control import ControlError

__all__ = ["LONGEST_PATH", "ControlSocket", "send_to_simulator"]

LONGEST_PATH: Final = 107
"""Bytes that a Unix socket's path may have on Linux."""

_LONGEST_LINE: Final = 4096
_READ_S: Final = 5.0


class ControlSocket:
    """Serves a control on a Unix socket, from construction until `close`.

    Args:
        path: Where; a socket without a server is replaced.
        do: Does a line, see `Control.do`.

    Raises:
        OSError: It cannot be made there, or another process serves it.
    """

    def __init__(self, path: Path, do: Callable[[str], str]) -> None:
        self._path = path
        self._do = do
        _make_way(path)
        self._server = socket.socket(socket.AF_UNIX)
        try:
            os.fchmod(self._server.fileno(), 0o600)
            self._server.bind(str(path))
            self._server.listen()
        except OSError:
            self._server.close()
            raise
        self._thread = threading.Thread(
            target=self._serve, name="lecombus-sim-control", daemon=True
        )
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Serve no more; a command under way ends by itself."""
        # Only a shutdown wakes a thread that waits in accept.
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._server.close()
        self._path.unlink(missing_ok=True)

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._answer, args=(client,), daemon=True).start()

    def _answer(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError):
            client.settimeout(_READ_S)
            line = _read_to_end(client, _LONGEST_LINE).decode("utf-8", "replace").strip()
            client.settimeout(None)
            try:
                answer = f"ok\n{self._do(line)}"
            except ControlError as exc:
                answer = f"error\n{exc}"
            client.sendall(answer.encode())


def send_to_simulator(path: Path, line: str) -> str:
    """Send one line to a running simulator.

    Args:
        path: Its control socket.
        line: The command.

    Returns:
        What it answers.

    Raises:
        ControlError: It says that the line is wrong or cannot be done.
        OSError: The socket has no server, or the server is not a simulator.
    """
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        client.sendall(line.encode())
        client.shutdown(socket.SHUT_WR)
        verdict, _, text = _read_to_end(client, 1 << 20).decode().partition("\n")
    if verdict == "error":
        raise ControlError(text)
    if verdict != "ok":
        raise ConnectionError("what answers there is no simulator")
    return text


def _read_to_end(end: socket.socket, most: int) -> bytes:
    pieces = bytearray()
    while len(pieces) < most and (piece := end.recv(most - len(pieces))):
        pieces += piece
    return bytes(pieces)


def _make_way(path: Path) -> None:
    """Take a socket away that a dead simulator left; leave anything else alone."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
