"""The interface between the exchange loop and what carries the bytes.

Here live the two protocols (`Port`, which the loop calls, and `Receiver`, which a port calls)
and the settings a port is opened with. A serial device, a TCP connection and the simulator all
have the same five calls and the property `carries_parity`, so that the loop, its tests and the
daemon know none of them.

Theory of operation: a port passes bytes on as they come, in any pieces, and never interprets
them. All calls happen on the one event loop thread. A lost port calls `Receiver.lost`
exactly once; after `Port.abort` it calls neither `received` nor `lost`.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from lecombus.errors import LineLostError

__all__ = ["Direction", "Framing", "Parity", "Port", "PortOpener", "PortSettings", "Receiver"]

Direction = Literal["adapter", "kernel", "rts"]
"""Who switches the RS-485 transceiver: the adapter itself, the kernel's driver, or we by RTS."""

Parity = Literal["line", "port"]
"""Who makes even parity: `line` the daemon, in bit 7 of an 8N1 port; `port` the device (7E1)."""


Framing = Literal["8N1", "7E1", "8E1"]
"""How the port frames characters: data bits, parity, stop bits."""


class Receiver(Protocol):
    """What a port calls when something happens on it; `ExchangeLoop` is one."""

    def received(self, data: bytes) -> None:
        """Take the bytes that came; never empty, in any pieces.

        Args:
            data: As they stand on the port: bit 7 is parity where `Port.carries_parity`.
        """

    def lost(self, exc: Exception | None) -> None:
        """The port is lost; called at most once, and never after `abort`.

        Args:
            exc: Why, a `LineLostError` from a port of `line`; None for a clean end.
        """


class Port(Protocol):
    """An open port: bytes out, and bytes in through the receiver it was opened with."""

    @property
    def carries_parity(self) -> bool:
        """Whether bit 7 of every byte, in and out, is even parity (8N1 port).

        False: the device frames parity itself.
        """

    def write(self, data: bytes) -> None:
        """Hand all of `data` to the operating system.

        Args:
            data: A telegram, with parity in bit 7 where `carries_parity`.

        Raises:
            LineLostError: The port is gone, now or already. `Receiver.lost` is never called from
                inside this call; for a loss found here it follows from the loop.
        """

    def discard_input(self) -> None:
        """Drop every byte the operating system holds that was not given on yet."""

    def look(self) -> None:
        """Give on, from inside this call, what has arrived and lies in the operating system.

        The loop passes bytes on only when it runs. Only this call shows that nothing has arrived
        so far. A loss found here is reported from the loop.
        """

    def abort(self) -> None:
        """Close immediately and drop what was not sent; no effect on a closed port."""

    def describe(self) -> str:
        """Say what this port is, for logs and the API, such as the path and where it leads."""


@dataclass(frozen=True, slots=True)
class PortSettings:
    """What is needed to open a port.

    Args:
        url: A device path, `socket://HOST:PORT`, or another scheme an opener knows.
        baud: Bits a second.
        direction: Who switches the RS-485 transceiver.
        framing: How the device frames characters.
        line: The line's name, for errors and logs.
    """

    url: str
    baud: int = 9600
    direction: Direction = "adapter"
    framing: Framing = "8N1"
    line: str = ""

    def error(self, why: str) -> LineLostError:
        """Return the error of a port that is lost or cannot be opened."""
        return LineLostError(f"{self.url}: {why}", line=self.line)


PortOpener = Callable[[PortSettings, Receiver], Awaitable[Port]]
"""Opens a port by its settings; raises `LineLostError` with the remedy in its message."""
