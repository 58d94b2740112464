"""The listening socket of TCP: connections begin one by one, in the share of TCP.

asyncio begins what waits in each turn of the loop: clients that open connections without end would
take all of its time, as each connection costs about half a millisecond until it has ended. So a
connection begins as a piece of `CpuShare`; what that costs, and its handshake and its end, counts
there.

Taking a connection from the kernel costs a tenth of that. So some more are taken, and wait here:
the next that begins is one of the address with fewest, and beyond `TCP_UNBEGUN_LIMIT` one of the
address with most is closed. A flood from one address thus keeps out no client at another. A client
that is gone before its turn is closed without a handshake.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import select
import socket
from collections import deque
from collections.abc import Callable
from typing import Final

from lecombus.api.connection import is_closed
from lecombus.api.limits import TCP_UNBEGUN_LIMIT, SparseLog
from lecombus.api.tcp_connection import CpuShare

__all__ = ["TcpListener"]

RETRY_S: Final = 1.0
"""When the system has no memory or no file for a connection."""

TAKEN_AT_ONCE: Final = 16
"""Connections that are taken from the kernel in one turn, half a millisecond."""

OUTSIDE_S: Final = 0.0002
"""Processor time of a connection that asyncio takes where it is not measured, about."""

log = logging.getLogger(__name__)


class TcpListener:
    """Takes the connections of a listening socket.

    Args:
        listening: The socket.
        share: The share of the loop's time.
        make: Makes what is called by the loop for a connection.
        speaks_first: A client that sends no more may still wait for an answer; false with TLS.
    """

    def __init__(
        self,
        listening: socket.socket,
        share: CpuShare,
        make: Callable[[], asyncio.BaseProtocol],
        *,
        speaks_first: bool,
    ) -> None:
        self._listening = listening
        self._share = share
        self._make = make
        self._gone = 0 if speaks_first else select.POLLRDHUP
        self._loop = asyncio.get_running_loop()
        self._waiting: dict[str, deque[socket.socket]] = {}  # by address, the next one first
        self._connecting: set[asyncio.Task[None]] = set()
        self._retry: asyncio.TimerHandle | None = None
        self._is_closed = False
        self._failures = SparseLog(log, "accept-failed")

    def begin(self) -> None:
        """Take connections until it is closed."""
        self._listening.setblocking(False)
        self._loop.add_reader(self._listening, self._arrived)

    def close(self) -> None:
        """Take no more connections."""
        self._is_closed = True
        self._loop.remove_reader(self._listening)
        if self._retry is not None:
            self._retry.cancel()
        for waiting in self._waiting.values():
            for one in waiting:
                one.close()
        self._waiting.clear()

    def _arrived(self) -> None:
        """Let a connection wait for its turn; the loop does not look at the socket meanwhile."""
        self._loop.remove_reader(self._listening)
        self._share.open(self._turn)

    def _turn(self) -> None:
        """Take some connections from the kernel, and begin one."""
        if self._is_closed:
            return
        is_failing = False
        try:
            for _ in range(TAKEN_AT_ONCE):
                self._take()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            pass
        except OSError as exc:  # no file or no memory is left
            self._failures.log(reason=(exc.strerror or "unknown").replace(" ", "-"))
            is_failing = True
        self._begin_one()
        if self._waiting:
            self._share.open(self._turn)
        elif is_failing:
            self._retry = self._loop.call_later(RETRY_S, self.begin)
        else:
            self.begin()

    def _take(self) -> None:
        """Take a connection from the kernel; if too many wait then, close one."""
        taken, address = self._listening.accept()
        self._waiting.setdefault(address[0], deque()).append(taken)
        if sum(map(len, self._waiting.values())) > TCP_UNBEGUN_LIMIT:
            self._pop(max(self._waiting, key=self._count)).close()

    def _begin_one(self) -> None:
        """Begin a connection whose client is still there."""
        while self._waiting:
            one = self._pop(min(self._waiting, key=self._count))
            if not is_closed(one, self._gone):
                one.setblocking(False)
                connecting = self._loop.create_task(self._connect(one))
                self._connecting.add(connecting)
                connecting.add_done_callback(self._connecting.discard)
                return
            one.close()

    def _count(self, address: str) -> int:
        return len(self._waiting[address])

    def _pop(self, address: str) -> socket.socket:
        """Give the connection of an address that waits longest."""
        waiting = self._waiting[address]
        one = waiting.popleft()
        if not waiting:
            del self._waiting[address]
        return one

    async def _connect(self, taken: socket.socket) -> None:
        self._share.spend(OUTSIDE_S)
        with contextlib.suppress(OSError):  # it was reset
            await self._share.timed(self._handed_over(taken))

    async def _handed_over(self, taken: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(self._make, taken)
        except BaseException:  # cancelled too: else the socket would stay open without an owner
            taken.close()
            raise
