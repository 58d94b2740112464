"""A child: masters as people write them, without a schedule and without what is known of drives.

`python -m benchmarks.naive LINK KIND`. Asked to `run`, it asks all drives for their status word in
turn, whole rounds only, and answers how many rounds it made in how many seconds.

* `loop`: a plain asyncio loop over a stream, with one time-out of half a second;
* `client`: the way of pymodbus' client: a second to answer and three repetitions;
* `pauses`: a polling loop that sleeps 50 ms between two telegrams, as many examples do.
"""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any

import serial_asyncio

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.protocol.telegrams import read_telegram
from lecombus.parameters import Code
from support.children import answer_lines
from support.paced_line import ADDRESSES

__all__ = ["KINDS", "main"]

KINDS = {"loop": (0.5, 0, 0.0), "client": (1.0, 3, 0.0), "pauses": (0.5, 0, 0.05)}
"""Time-out and repetitions, and the pause after each exchange, seconds."""
ETX = b"\x03"


async def ask(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, telegram: bytes, timeout_s: float
) -> bool:
    """Make one exchange; False: nothing came."""
    writer.write(telegram)
    try:
        async with asyncio.timeout(timeout_s):
            heard = b""
            while len(heard) < 2 or heard[-2] & 0x7F != ETX[0]:
                heard += await reader.read(64)
    except TimeoutError:
        return False
    return True


async def rounds(link: str, kind: str, for_s: float) -> tuple[int, float]:
    """Ask everybody in turn for at least so long."""
    timeout_s, repetitions, pause_s = KINDS[kind]
    reader, writer = await serial_asyncio.open_serial_connection(url=link, baudrate=19200)
    telegrams = [with_parity(read_telegram(one, Code(150), Form.STANDARD)) for one in ADDRESSES]
    made, began_s = 0, time.monotonic()
    while time.monotonic() - began_s < for_s:
        for telegram in telegrams:
            for _ in range(repetitions + 1):
                if await ask(reader, writer, telegram, timeout_s):
                    break
            await asyncio.sleep(pause_s)
        made += 1
    elapsed_s = time.monotonic() - began_s
    writer.close()
    return made, elapsed_s


def main(link: str, kind: str) -> None:
    """Serve until the input ends."""

    async def answer(question: dict[str, Any]) -> Any:
        return await rounds(link, kind, question["for_s"])

    asyncio.run(answer_lines(answer))


if __name__ == "__main__":
    main(*sys.argv[1:])
