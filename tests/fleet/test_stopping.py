"""Stops of many lines: each is sent, however long the broker takes for those before it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import anyio
import pytest

from lecombus.bridges.mqtt.broker import BridgeClient, Broker, BrokerError, Limits
from lecombus.fleet import stopping
from lecombus.roster import MqttEntry
from support.virtual_loop import run

ACKNOWLEDGED_AFTER_S = 0.3


class DistantClient(BridgeClient):
    """A client of a broker that is far away, and of which no line answers."""

    def __init__(self) -> None:
        self.sent: list[str] = []

    async def publish_for_reason(self, topic: str, *more: Any) -> int:
        self.sent.append(topic)
        await anyio.sleep(ACKNOWLEDGED_AFTER_S)
        return 0

    async def subscribe(self, *words: Any, **more: Any) -> Any:
        return (0,)


def test_each_stop_is_sent_though_the_broker_takes_longer_than_answers_are_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    client = DistantClient()

    async def never_lost(broker: Broker) -> None:
        await anyio.sleep_forever()
        raise BrokerError("lost")

    @asynccontextmanager
    async def open_broker(*words: Any, **more: Any) -> AsyncIterator[Broker]:
        yield Broker(client, Limits())

    monkeypatch.setattr(stopping, "open_broker", open_broker)
    monkeypatch.setattr(Broker, "lost", never_lost)
    roots = [f"lecombus/line-{number}" for number in range(100)]

    async def stop() -> None:
        entry = MqttEntry(host="127.0.0.1", port=1, tls=False)
        results = await stopping.send_stops(entry, roots, "all", "quick-stop", 1.0)
        assert [one.outcome for one in results] == ["unknown"] * 100

    run(stop())
    assert client.sent == [f"{root}/all/do/quick-stop" for root in roots]
