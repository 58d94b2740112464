"""Clients of the daemon in great number: an open load over the Unix socket, every end counted.

Strategy: a thread with its own loop sends so many requests a second, whether the earlier ones
have ended or not, each on a connection that is free or on a new one. HTTP is spoken by hand here,
because a client library needs more processor time for a request than the daemon does.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

__all__ = ["Asked", "Traffic", "get", "put"]

CUT = 0
"""Instead of a status: the connection ended without an answer."""

HANGING = -1
"""Instead of a status: no answer within the time allowed."""


@dataclass(frozen=True)
class Asked:
    """A request, as bytes, and what it is called in the counts."""

    kind: str
    data: bytes


def get(kind: str, path: str) -> Asked:
    """A request that reads."""
    return Asked(kind, f"GET {path} HTTP/1.1\r\nHost: lecombus\r\n\r\n".encode())


def put(kind: str, path: str, method: str = "PUT", **document: Any) -> Asked:
    """A request with a JSON document."""
    body = json.dumps(document)
    head = f"{method} {path} HTTP/1.1\r\nHost: lecombus\r\nContent-Type: application/json\r\n"
    return Asked(kind, f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())


@dataclass
class Ends:
    """How requests of one kind ended."""

    statuses: Counter[int] = field(default_factory=Counter)
    longest_s: float = 0.0
    said: dict[int, str] = field(default_factory=dict)
    """The last body that came with each status of 400 and more."""


class Traffic:
    """Sends requests from entering until leaving, then waits for the end of each.

    Args:
        socket: The daemon's Unix socket.
        asked: The requests, sent one after the other, again and again.
        per_s: How many a second.
        patience_s: After how long a request without an end counts as hanging.

    Attributes:
        issued: How many were sent.
        ends: How they ended, by kind.
        late_s: How far the sending was behind its cadence at most.
    """

    def __init__(
        self, socket: Path, asked: Sequence[Asked], per_s: float, *, patience_s: float = 15.0
    ) -> None:
        self.issued = 0
        self.ends: dict[str, Ends] = {one.kind: Ends() for one in asked}
        self.late_s = 0.0
        self._socket = socket
        self._asked = asked
        self._per_s = per_s
        self._patience_s = patience_s
        self._free: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main()), name="traffic")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def statuses(self) -> Counter[int]:
        """How all requests ended."""
        return sum((ends.statuses for ends in self.ends.values()), Counter())

    def summary(self) -> str:
        """One line for each kind."""
        return "\n".join(
            f"{kind}: {sum(ends.statuses.values())} requests, "
            f"{dict(sorted(ends.statuses.items()))}, longest {ends.longest_s:.2f} s; {ends.said}"
            for kind, ends in self.ends.items()
        )

    async def _main(self) -> None:
        begun_s = time.monotonic()
        async with asyncio.TaskGroup() as tasks:
            for number, asked in zip(itertools.count(), itertools.cycle(self._asked), strict=False):
                due_s = begun_s + number / self._per_s
                now_s = time.monotonic()
                self.late_s = max(self.late_s, now_s - due_s)
                if due_s > now_s:
                    await asyncio.sleep(due_s - now_s)
                if self._stop.is_set():
                    break
                self.issued += 1
                tasks.create_task(self._ask(asked))
        for _, writer in self._free:
            writer.close()

    async def _ask(self, asked: Asked) -> None:
        begun_s = time.monotonic()
        try:
            async with asyncio.timeout(self._patience_s):
                status = await self._exchange(asked)
        except TimeoutError:
            status = HANGING
        except (OSError, asyncio.IncompleteReadError):
            status = CUT
        ends = self.ends[asked.kind]
        ends.statuses[status] += 1
        ends.longest_s = max(ends.longest_s, time.monotonic() - begun_s)

    async def _exchange(self, asked: Asked) -> int:
        with contextlib.suppress(IndexError):
            reader, writer = self._free.pop()
            if not reader.at_eof():
                return await self._speak(asked, reader, writer)
            writer.close()
        reader, writer = await asyncio.open_unix_connection(self._socket)
        return await self._speak(asked, reader, writer)

    async def _speak(
        self, asked: Asked, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> int:
        kept = False
        try:
            writer.write(asked.data)
            head = (await reader.readuntil(b"\r\n\r\n")).lower()
            length = head.partition(b"content-length:")[2].partition(b"\r\n")[0]
            body = await reader.readexactly(int(length))
            kept = b"connection: close" not in head
            status = int(head.split(b" ", 2)[1])
            if status >= 400:
                self.ends[asked.kind].said[status] = body.decode()
            return status
        finally:
            if kept:
                self._free.append((reader, writer))
            else:
                writer.close()
