"""A child: many clients that read the events of a daemon, and some that read nothing.

`python -m benchmarks.readers_child SOCKET`. Questions: `open` connects them, `taken` says how many
bytes came to those that read since it was asked last and how many connections there are, `close`
ends them.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Any

from support.children import answer_lines

__all__ = ["main"]

ASK = b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n"


class Reader(asyncio.Protocol):
    """One client.

    Args:
        count: Gets how many bytes came.
        is_silent: It reads nothing.
    """

    def __init__(self, taken: list[int], *, is_silent: bool) -> None:
        self._taken = taken
        self._is_silent = is_silent

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Ask for events."""
        assert isinstance(transport, asyncio.Transport)
        transport.write(ASK)
        if self._is_silent:
            transport.pause_reading()

    def data_received(self, data: bytes) -> None:
        """Count what came."""
        self._taken[0] += len(data)


class Readers:
    """All clients.

    Args:
        socket: The daemon's.
    """

    def __init__(self, socket: str) -> None:
        self._socket = socket
        self._taken = [0]
        self._transports: list[asyncio.BaseTransport] = []

    async def answer(self, question: dict[str, Any]) -> Any:
        """Answer one question."""
        what = question.pop("what")
        return await getattr(self, what)(**question)

    async def open(self, count: int, silent: int) -> int:
        """Connect clients, of which some read nothing."""
        loop = asyncio.get_running_loop()
        for number in range(count):
            transport, _ = await loop.create_unix_connection(
                lambda is_silent=number < silent: Reader(self._taken, is_silent=is_silent),  # type: ignore[misc]
                self._socket,
            )
            self._transports.append(transport)
        return len(self._transports)

    async def taken(self) -> int:
        """Say how many bytes came since this was asked last."""
        taken, self._taken[0] = self._taken[0], 0
        return taken

    async def close(self) -> bool:
        """End all clients."""
        for transport in self._transports:
            assert isinstance(transport, asyncio.Transport)
            transport.abort()
        self._transports.clear()
        return True


def main() -> None:
    """Answer until the input ends."""
    readers = Readers(sys.argv[1])
    asyncio.run(answer_lines(readers.answer))


if __name__ == "__main__":
    main()
