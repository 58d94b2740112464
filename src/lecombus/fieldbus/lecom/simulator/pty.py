"""A simulated line behind a pseudo terminal: a serial device without hardware.

Strategy: the master side is ours, the slave's path is what a host opens, directly or through a
symlink whose name stays the same. Pulling the plug closes the master: the host sees a hang-up, as
it does when an adapter is unplugged; plugging in again makes a new pseudo terminal behind the same
symlink. The baud rate a host sets counts: at another than the drives' it is not understood. The
slave is not kept open here, so exclusive use by a host ends when the host closes it.
"""

from __future__ import annotations

import contextlib
import os
import termios
import time
import tty
from pathlib import Path
from typing import Final

from .line import SimLine
from .pacing import PacedEnd

__all__ = ["PtyEnd"]

_OUTPUT_SPEED: Final = 5
_BAUDS: Final = {
    termios.B1200: 1200,
    termios.B2400: 2400,
    termios.B4800: 4800,
    termios.B9600: 9600,
    termios.B19200: 19200,
}
"""The rates drives know; a new pseudo terminal is at 38400."""


class PtyEnd(PacedEnd):
    """A line on a pseudo terminal, served from construction until `close`.

    Args:
        line: The line.
        link: A symlink to make and keep pointing at the slave; replaced if it is a symlink.
    """

    def __init__(self, line: SimLine, link: Path | None = None) -> None:
        super().__init__(line)
        self._link = link
        self._master: int | None = None
        self._slave_path = ""
        self._open()
        self._start()

    @property
    def path(self) -> str:
        """What a host opens: the symlink where there is one, else the slave."""
        return str(self._link) if self._link is not None else self._slave_path

    def unplug(self) -> None:
        """Pull the plug; what is under way is lost."""
        with self.lock:
            self._hang_up()
            self.line.drop_everything(time.monotonic())
        self._settle()

    def replug(self) -> None:
        """Plug in again, as a new device behind the same symlink."""
        with self.lock:
            if self._master is None:
                self._open()
        self._wake()

    def _open(self) -> None:
        master, slave = os.openpty()
        self._slave_path = os.ttyname(slave)
        tty.setraw(slave)
        os.close(slave)
        os.set_blocking(master, False)
        self._master = master
        if self._link is not None:
            _point(self._link, self._slave_path)

    def _hang_up(self) -> None:
        if self._master is not None:
            os.close(self._master)
            self._master = None
            if self._link is not None:
                self._link.unlink(missing_ok=True)

    def _descriptor(self) -> int | None:
        return self._master

    def _host_baud(self) -> int | None:
        """The rate the host has set, by the terminal both ends share; none of ours: not set."""
        if self._master is None:
            return None
        try:
            speed = termios.tcgetattr(self._master)[_OUTPUT_SPEED]
        except termios.error:
            return None
        return _BAUDS.get(speed)

    def _gone(self) -> bool:
        # EIO: the slave is not open. It may be opened at any time.
        return True

    def _release(self) -> None:
        self._hang_up()


def _point(link: Path, target: str) -> None:
    """Make a symlink in one step, so that it is never half there."""
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        fresh.unlink()
    fresh.symlink_to(target)
    fresh.replace(link)
