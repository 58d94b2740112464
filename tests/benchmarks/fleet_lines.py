"""A child: as many lines as asked for at a broker, each as its bridge would show it to the fleet.

`python -m benchmarks.fleet_lines PORT COUNT`: one connection sends the state and the summary of
each line, spread over the time in which a bridge renews them; one line in a hundred has tripped.
`python -m benchmarks.fleet_lines PORT values RATE` sends so many plain values a second, as bridges
do: retained, with an expiry and user properties. Questions: `sent`: how many messages so far.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from lecombus.bridges.mqtt.summary import STANDS_S
from support.children import answer_lines

__all__ = ["main"]

RENEW_S = 20.0
DRIVES = 31
SLICE_S = 0.02


def properties_of(expiry_s: int, *said: tuple[str, str]) -> Properties:
    found = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    found.MessageExpiryInterval = expiry_s
    if said:
        found.UserProperty = list(said)
    return found


def summary_of(number: int) -> bytes:
    trip = {"kind": "trip", "drive": "d07", "text": "trip OH (50): heat sink too hot", "for_s": 1.5}
    said = {
        "line": f"line-{number:05}", "bridge": f"{number:012x}", "host": f"cabinet-{number:05}",
        "version": "0.1.0", "state": "online", "reason": "/dev/ttyUSB0 at 19200 bit/s",
        "stands_s": STANDS_S, "drives": {"online": DRIVES}, "doing": {"running": 20, "stopped": 11},
        "more": 0, "attention": [] if number % 100 else [trip],
    }  # fmt: skip
    return json.dumps(said, separators=(",", ":")).encode()


class Sender:
    """Sends at a rate that does not depend on how late it is woken."""

    def __init__(self, port: int) -> None:
        self.client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self.client.max_queued_messages_set(0)
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        self.sent = 0

    async def lines(self, count: int) -> None:
        stands, summary = properties_of(60), properties_of(STANDS_S)
        payloads = [summary_of(number) for number in range(count)]

        def send(at: int) -> None:
            root = f"lecombus/line-{at % count:05}"
            self.client.publish(f"{root}/summary", payloads[at % count], 0, True, summary)
            if at // count % 2 == 0:  # a state is renewed half as often
                self.client.publish(f"{root}/state", b"online", 0, True, stands)
                self.sent += 1

        for at in range(count):
            send(at)
        await self._at_rate(count / RENEW_S, send)

    async def values(self, rate: float) -> None:
        said = properties_of(3, ("unit", "Hz"), ("quality", "good"),
                             ("time", "2026-11-23T10:15:02.113Z"))  # fmt: skip

        def send(at: int) -> None:
            topic = f"plant/line-{at // 124 % 50:05}/d{at // 4 % 31:02}/value/C{50 + at % 4:04}"
            self.client.publish(topic, f"{at % 50}.4", 0, True, said)

        await self._at_rate(rate, send)

    async def _at_rate(self, rate: float, send: Any) -> None:
        began_s, at = time.monotonic(), 0
        while True:
            while at < (time.monotonic() - began_s) * rate:
                send(at)
                at += 1
                self.sent += 1
            await asyncio.sleep(SLICE_S)

    async def answer(self, question: dict[str, Any]) -> Any:
        return self.sent


async def run(words: list[str]) -> None:
    sender = Sender(int(words[0]))
    work = sender.values(float(words[2])) if words[1] == "values" else sender.lines(int(words[1]))
    task = asyncio.create_task(work)
    await answer_lines(sender.answer)
    task.cancel()


def main() -> None:
    """Send until the input ends."""
    asyncio.run(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
