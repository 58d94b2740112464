"""Sends the events of a line to all who read along, and never makes the line wait for one of them.

Strategy: one task writes to all readers (`EventReaders.run`); the tasks of their requests only wait
for the end. A round begins `ROUND_S` after the last has ended, or later if there are many readers,
so events that came together go out together, and readers at the same position with the same filter
get the same bytes. After `READERS_AT_ONCE` readers it sleeps for `PAUSE_S`, in which telegrams are
sent and taken.

Bytes are handed to the transport only when the kernel has taken all that went before. So a reader
that takes nothing holds `BYTES_AT_ONCE` bytes here, and as much in the kernel. It is cut when it
has taken nothing for `STALLED_S`, or when the events that it still needs are no longer kept. It may
come back with the id of its last event.

Events are recorded from the first reader on and `KEPT_S` beyond the last, for those who come back.
"""

from __future__ import annotations

import contextlib
import math
import socket
from asyncio import Transport
from collections.abc import Awaitable, Callable, Iterable
from typing import Final

import anyio

from lecombus.api.answers import ProblemDocument, RefusedRequestError
from lecombus.api.decimal_json import encode
from lecombus.event_stream import EventFilter, EventStream

__all__ = [
    "BYTES_AT_ONCE",
    "IDLE_S",
    "KEPT_S",
    "LOOK_S",
    "OUTLET",
    "READERS_LIMIT",
    "STALLED_S",
    "TCP_READERS_LIMIT",
    "EventReaders",
    "Outlet",
    "Reader",
]

OUTLET: Final = "lecombus.outlet"
"""The key of the connection's outlet in the scope of a request for events."""

READERS_LIMIT: Final = 256
TCP_READERS_LIMIT: Final = 8
"""Readers over TCP: half of the connections there, so that others get through."""

ROUND_S: Final = 0.1
ROUND_OF_READER_S: Final = 0.001
"""So much for each reader, if that is more: hundreds get theirs less often, and more of it."""

READERS_AT_ONCE: Final = 8
"""Readers written to before other tasks run: about a fifth of a millisecond."""

PAUSE_S: Final = 0.002
"""After so many readers: by this, writing takes a tenth of the loop's time at the most."""

LOOK_S: Final = 1.0
"""How often it is looked what changed by time alone."""

BYTES_AT_ONCE: Final = 16 * 1024
IDLE_S: Final = 15.0
"""After so long without an event a comment is sent, so that both ends see a dead connection."""

HALF_CLOSED_IDLE_S: Final = 1.0
"""The same for a client that sends no more: most of these are gone."""

STALLED_S: Final = 10.0
KEPT_S: Final = 60.0
RETRY: Final = b"retry: 2000\n\n"
"""How long a browser waits before it comes back, milliseconds."""

Batches = dict[tuple[int, EventFilter], tuple[bytes, int]]
"""What readers at one position with one filter get in one round, and the position behind it."""

TOO_MANY: Final = ProblemDocument(
    "too-many-readers",
    "too many read events already",
    remedy="end another reader; one stream can serve many: filter it by drive and kind",
)


class Outlet:
    """Where the rest of an endless answer is written, in chunks, past the server's own sending.

    Args:
        transport: The connection's.

    Attributes:
        is_half_closed: The client sends no more; it may be gone, which a write shows.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.is_half_closed = False

    @property
    def is_closed(self) -> bool:
        """Whether nothing more can be written."""
        return self._transport.is_closing()

    @property
    def backlog(self) -> int:
        """Bytes that the kernel did not take yet."""
        return self._transport.get_write_buffer_size()

    def narrow(self) -> None:
        """Let the kernel keep little of what the client does not read."""
        peer = self._transport.get_extra_info("socket")
        with contextlib.suppress(OSError, AttributeError):  # it is closed by now
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BYTES_AT_ONCE)

    def write(self, data: bytes) -> None:
        """Write a piece of the answer, not empty."""
        self._transport.write(b"%x\r\n%b\r\n" % (len(data), data))

    def cut(self) -> None:
        """Close without waiting for a client that does not read."""
        self._transport.abort()


class Reader:
    """One who reads events.

    Args:
        outlet: Where they are written.
        wanted: Which it wants.
        position: The number of the next event to look at.
        over_tcp: Whether it came over TCP.
        now_s: Monotonic seconds.
    """

    __slots__ = ("backlog", "ended", "outlet", "over_tcp", "position", "said_s", "taken_s",
                 "wanted")  # fmt: skip

    def __init__(
        self,
        outlet: Outlet,
        wanted: EventFilter,
        position: int,
        *,
        over_tcp: bool,
        now_s: float,
    ) -> None:
        self.outlet = outlet
        self.wanted = wanted
        self.position = position
        self.over_tcp = over_tcp
        self.ended = anyio.Event()
        self.said_s = self.taken_s = now_s
        self.backlog = 0


class EventReaders:
    """All who read the events of a line.

    Args:
        stream: The events.
        look: Publishes what changed by time alone, in small pieces.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self, stream: EventStream, look: Callable[[], Iterable[None]], clock: Callable[[], float]
    ) -> None:
        self._stream = stream
        self._look = look
        self._clock = clock
        self._readers: dict[Reader, None] = {}
        self._came = anyio.Event()
        self._left_s = -math.inf
        self._is_over = False

    def __len__(self) -> int:
        """Return how many read now."""
        return len(self._readers)

    def require_room(self, *, over_tcp: bool) -> None:
        """Refuse one more reader than there may be.

        Raises:
            RefusedRequestError: `too-many-readers`.
        """
        tcp = sum(one.over_tcp for one in self._readers)
        if len(self._readers) >= READERS_LIMIT or (over_tcp and tcp >= TCP_READERS_LIMIT):
            raise RefusedRequestError(TOO_MANY)

    async def read(
        self,
        outlet: Outlet,
        wanted: EventFilter,
        last_id: str,
        check: Callable[[], Awaitable[bool]] | None = None,
        *,
        over_tcp: bool = False,
    ) -> None:
        """Write events to a client until it goes, is cut, or lecombus ends.

        Args:
            outlet: Where they are written.
            wanted: Which it wants.
            last_id: The last event it had; empty: it begins now.
            check: Asked once a second whether the client may go on reading these; it may raise as
                well. None: nothing can change that.
            over_tcp: The client came over TCP.
        """
        if self._is_over:
            return
        self._stream.record(encode)
        position, gap = self._stream.position_after(last_id)
        now_s = self._clock()
        reader = Reader(outlet, wanted, position, over_tcp=over_tcp, now_s=now_s)
        outlet.narrow()
        outlet.write(RETRY + self._stream.mark(position) + gap)
        self._readers[reader] = None
        self._stream.readers = len(self._readers)
        self._came.set()
        try:
            while check is not None and not reader.ended.is_set():
                if not await check():
                    return
                with anyio.move_on_after(LOOK_S):
                    await reader.ended.wait()
            await reader.ended.wait()
        finally:
            self._leave(reader)

    async def run(self) -> None:
        """Write events to all readers, until cancelled; then each of their answers ends."""
        looked_s = -math.inf
        try:
            while True:
                if not self._stream.is_recording:
                    await self._came.wait()
                self._came = anyio.Event()
                await self._write_all()
                if self._clock() - looked_s >= LOOK_S:
                    looked_s = self._clock()
                    await self._look_in_pieces()
                if not self._readers and self._clock() - self._left_s > KEPT_S:
                    self._stream.forget()
                await anyio.sleep(max(ROUND_S, ROUND_OF_READER_S * len(self._readers)))
        finally:
            self.close()

    def close(self) -> None:
        """Write what is left, such as the stop at the end, and end all answers in good order.

        Those that begin later end at their beginning.
        """
        self._is_over = True
        until, now_s = self._stream.next, self._clock()
        batches: Batches = {}
        for reader in tuple(self._readers):
            self._serve(reader, until, now_s, batches)
            self._end(reader)

    async def _look_in_pieces(self) -> None:
        for _ in self._look():
            await anyio.sleep(PAUSE_S)

    async def _write_all(self) -> None:
        """Write to each reader what it has not got yet."""
        until, now_s = self._stream.next, self._clock()
        batches: Batches = {}
        for number, reader in enumerate(tuple(self._readers), 1):
            self._serve(reader, until, now_s, batches)
            if number % READERS_AT_ONCE == 0:
                await anyio.sleep(PAUSE_S)

    def _serve(
        self,
        reader: Reader,
        until: int,
        now_s: float,
        batches: Batches,
    ) -> None:
        outlet = reader.outlet
        if outlet.is_closed:
            self._end(reader)
            return
        backlog = outlet.backlog
        if backlog < reader.backlog or not backlog:
            reader.taken_s = now_s
        reader.backlog = backlog
        if reader.position < self._stream.first or now_s - reader.taken_s > STALLED_S:
            self._stream.dropped += 1
            self._cut(reader)
        elif not backlog:
            self._write(reader, until, now_s, batches)

    def _write(
        self,
        reader: Reader,
        until: int,
        now_s: float,
        batches: Batches,
    ) -> None:
        """Write a batch; the same for all who stand where this reader does."""
        key = (reader.position, reader.wanted)
        batch = batches.get(key)
        if batch is None:
            batch = batches[key] = self._stream.batch(
                reader.position, reader.wanted, until=until, bytes_most=BYTES_AT_ONCE
            )
        data, reader.position = batch
        idle_s = HALF_CLOSED_IDLE_S if reader.outlet.is_half_closed else IDLE_S
        if not data and now_s - reader.said_s >= idle_s:
            data = self._stream.mark(reader.position)
        if data:
            reader.said_s = now_s
            reader.outlet.write(data)

    def _cut(self, reader: Reader) -> None:
        reader.outlet.cut()
        self._end(reader)

    def _end(self, reader: Reader) -> None:
        self._leave(reader)
        reader.ended.set()

    def _leave(self, reader: Reader) -> None:
        if self._readers.pop(reader, True) is None:
            self._left_s = self._clock()
            self._stream.readers = len(self._readers)
