"""Notifies systemd of the daemon's state: ready, reloading, stopping, alive.

The protocol is one datagram to the socket named in NOTIFY_SOCKET (sd_notify(3)). It is twenty
lines here because the Python bindings for it are either unmaintained or need a compiler and
LGPL headers on the user's machine.
"""

from __future__ import annotations

import contextlib
import os
import socket

__all__ = ["Notifier"]


class Notifier:
    """Sends states to the service manager; does nothing where there is none."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_s = _watchdog_s()

    def tell(self, *states: str) -> None:
        """Send states such as `READY=1`; a manager that does not listen is not our trouble."""
        if not self._address:
            return
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock,
        ):
            sock.connect(self._address)
            sock.sendall("\n".join(states).encode())


def _watchdog_s() -> float | None:
    """The time after which systemd restarts us without a ping, seconds; None when it does not."""
    usec = os.environ.get("WATCHDOG_USEC", "")
    pid = os.environ.get("WATCHDOG_PID", "")
    if not usec.isdigit() or (pid and pid != str(os.getpid())):
        return None
    return int(usec) / 1e6 or None
