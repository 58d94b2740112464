"""A network between a client and a TCP port that can be cut: nothing is forwarded, nothing closed.

So it is with a cable that is pulled, or a switch that fails: neither end is told. What was under
way is delivered late when the network is there again.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from collections.abc import Iterator

__all__ = ["Relay", "relay_to"]

LOOK_S = 0.05
"""How long a cut network may still forward at most, seconds."""


class Relay:
    """Forwards connections to a port.

    Args:
        port: The port on the loopback interface.

    Attributes:
        port: Where clients connect.
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self._ways = selectors.DefaultSelector()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._ways.register(self._listener, selectors.EVENT_READ)
        self._whole = threading.Event()
        self._whole.set()
        self._over = False
        self._still = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Forward nothing from now on; returns when nothing is forwarded any more."""
        self._still.clear()
        self._whole.clear()
        assert self._still.wait(10.0)

    def mend(self) -> None:
        """Forward again, also what has come meanwhile."""
        self._whole.set()

    def close(self) -> None:
        """Close all connections."""
        self._over = True
        self._whole.set()
        self._thread.join(10.0)
        for key in list(self._ways.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]
        self._ways.close()

    def _run(self) -> None:
        while not self._over:
            if not self._whole.is_set():
                self._still.set()
                self._whole.wait()
                continue
            for key, _ in self._ways.select(LOOK_S):
                if key.data is None:
                    self._accept()
                else:
                    self._forward(key.fileobj, key.data)  # type: ignore[arg-type]

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        far = socket.create_connection(("127.0.0.1", self._to))
        self._ways.register(near, selectors.EVENT_READ, far)
        self._ways.register(far, selectors.EVENT_READ, near)

    def _forward(self, one: socket.socket, other: socket.socket) -> None:
        try:
            data = one.recv(65536)
            if data:
                other.sendall(data)
        except OSError:
            data = b""
        if not data:
            for end in (one, other):
                with contextlib.suppress(KeyError):
                    self._ways.unregister(end)
                end.close()


@contextlib.contextmanager
def relay_to(port: int) -> Iterator[Relay]:
    """Run a network to a port."""
    relay = Relay(port)
    try:
        yield relay
    finally:
        relay.close()
