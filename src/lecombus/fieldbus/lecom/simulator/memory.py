"""A simulated line inside the process: no device, no thread, and any clock the event loop has.

Strategy: `MemoryPort` has the shape of the line's `Port` seam and works on the running asyncio
loop with absolute timers, so it runs on a virtual-time loop as on a real one. `MemoryEnd` stands
for the plug: it opens ports for the line worker, and pulls them off. Only shapes are shared with
`line/`, which stands above this room and is not imported.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

from lecombus.errors import LineLostError

from .line import SimLine

__all__ = ["MemoryEnd", "MemoryPort"]


class _Receiver(Protocol):
    def received(self, data: bytes) -> None: ...

    def lost(self, exc: Exception | None) -> None: ...


class MemoryPort:
    """One open port of a line in memory.

    Args:
        line: The line.
        receiver: Gets the bytes, and is called once when the port is gone.
        name: The line's name, for errors.
        latency_s: How long arriving bytes are gathered before they are handed over together, as a
            USB adapter's latency timer does; 0 hands over each byte when it arrives.
    """

    def __init__(
        self, line: SimLine, receiver: _Receiver, *, name: str = "sim", latency_s: float = 0.0
    ) -> None:
        self._line = line
        self._receiver = receiver
        self._name = name
        self._latency_s = latency_s
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._open = True

    @property
    def carries_parity(self) -> bool:
        """Whether bit 7 of every byte is even parity."""
        return self._line.parity

    def write(self, data: bytes) -> None:
        """Hand bytes to the line.

        Raises:
            LineLostError: The port is closed or unplugged.
        """
        if not self._open:
            raise LineLostError("the simulated line is gone", line=self._name)
        self._line.receive(data, self._loop.time())
        self._arm()

    def discard_input(self) -> None:
        """Drop what has arrived and not been handed over yet."""
        if self._open:
            self._line.poll(self._loop.time())
            self._arm()

    def look(self) -> None:
        """Hand over what has arrived, without waiting for the loop to come to it."""
        due_s = self._line.next_event_s(gathered=self._latency_s > 0.0)
        if self._open and due_s is not None and due_s + self._latency_s <= self._loop.time():
            self._disarm()
            self._due()

    def abort(self) -> None:
        """Close; the receiver hears nothing any more. Harmless when repeated."""
        self._open = False
        self._disarm()

    def describe(self) -> str:
        """What this port is, for people."""
        count = len(self._line.drives)
        drives = "1 drive" if count == 1 else f"{count} drives"
        return f"sim: {drives} in memory at {self._line.baud} bit/s"

    def pull(self) -> None:
        """Lose the port as when it is unplugged; the receiver is called from the loop."""
        if self._open:
            self.abort()
            error = LineLostError("the simulated line was unplugged", line=self._name)
            self._loop.call_soon(self._receiver.lost, error)

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        due_s = self._line.next_event_s(gathered=self._latency_s > 0.0)
        self._timer = (
            None if due_s is None else self._loop.call_at(due_s + self._latency_s, self._due)
        )

    def _disarm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _due(self) -> None:
        self._timer = None
        data = self._line.poll(self._loop.time())
        if data:
            self._receiver.received(data)
        if self._open and self._timer is None:
            self._arm()


class MemoryEnd:
    """The plug of a line in memory: opens ports, one at a time.

    Args:
        line: The line.
        latency_s: As for `MemoryPort`.

    Attributes:
        port: The port opened last, if any.
        opened: How often a port was opened.
    """

    def __init__(self, line: SimLine, *, latency_s: float = 0.0) -> None:
        self.line = line
        self.port: MemoryPort | None = None
        self.opened = 0
        self._latency_s = latency_s
        self._plugged = True

    async def open(self, settings: object, receiver: _Receiver) -> MemoryPort:
        """Open a port; has the shape of the line's `PortOpener`.

        Args:
            settings: The line's port settings; its name (`line`) is used for errors, and its baud
                rate is what the drives hear.
            receiver: The port's receiver.

        Raises:
            LineLostError: It is unplugged.
        """
        name = str(getattr(settings, "line", "sim"))
        if not self._plugged:
            raise LineLostError("the simulated line is unplugged", line=name)
        if self.port is not None:
            self.port.abort()
        self.opened += 1
        self.line.host_baud = getattr(settings, "baud", self.line.baud)
        self.port = MemoryPort(self.line, receiver, name=name, latency_s=self._latency_s)
        return self.port

    def unplug(self) -> None:
        """Pull the plug; what is under way is lost, and opening fails until `replug`."""
        self._plugged = False
        if self.port is not None:
            self.port.pull()
            self.line.drop_everything(asyncio.get_running_loop().time())

    def replug(self) -> None:
        """Plug in again."""
        self._plugged = True
