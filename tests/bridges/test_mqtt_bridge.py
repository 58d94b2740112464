"""Which events an MQTT bridge asks of the daemon again after a crash."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue
from lecombus.bridges.mqtt.bridge import MqttBridge, SentPosition
from lecombus.bridges.mqtt.broker import BrokerError, Limits
from lecombus.bridges.mqtt.retained import Message
from lecombus.client import Event, Reading
from lecombus.parameters import Code
from lecombus.roster import MqttEntry
from support.virtual_loop import run


def made(directory: Path) -> Any:
    roster: Any = SimpleNamespace(
        line=SimpleNamespace(name="hall-3"), api=SimpleNamespace(socket="/run/x.sock"),
        mqtt=MqttEntry(host="127.0.0.1", port=1, tls=False),
        drives=(SimpleNamespace(name="feeder", writable={Code(46)}),
                SimpleNamespace(name="belt", writable={Code(46), Code(39, 1)})),
        groups={"all": SimpleNamespace(members=("feeder", "belt"))},
    )  # fmt: skip
    return MqttBridge(roster, directory)


def hear(bridge: Any, identifier: str) -> None:
    bridge._heard(Event(identifier, "trip", "feeder", {"active": True}))


def test_without_wildcards_drives_and_groups_take_the_commands_of_the_roster(
    tmp_path: Path,
) -> None:
    broker = SimpleNamespace(limits=Limits(wildcards=False))
    filters = made(tmp_path)._filters(broker)
    assert len(set(filters)) == len(filters) == 3 * 5 + 1 + 2 + 2
    for one in ("all/do/quick-stop", "feeder/do/enable", "feeder/set/C0046", "all/set/C0039/1"):
        assert f"lecombus/hall-3/{one}" in filters


def test_events_count_as_had_when_they_were_sent_or_are_on_the_disk(tmp_path: Path) -> None:
    position = tmp_path / "last-event"

    class SlowBroker:
        sent = 0

        async def publish(self, message: Message) -> bool:
            await anyio.sleep(5)
            self.sent += 1
            return True

    async def script() -> None:
        bridge, broker = made(tmp_path), SlowBroker()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(bridge._send_events, broker)
            await anyio.sleep(1)
            hear(bridge, "R-1")
            hear(bridge, "R-2")
            await anyio.sleep(6)
            bridge._position.write()
            assert broker.sent == 1
            assert not position.exists(), "a crash now would lose R-2"
            await anyio.sleep(6)
            bridge._position.write()
            assert position.read_text() == "R-2\n"
            hear(bridge, "R-3")
            tasks.cancel_scope.cancel()
        bridge._position.write()
        assert position.read_text() == "R-2\n"
        bridge._keep_events()  # the broker is lost
        bridge._position.write()
        assert position.read_text() == "R-3\n"
        hear(bridge, "R-4")
        bridge._position.write()
        assert position.read_text() == "R-4\n"
        assert len(made(tmp_path)._events) == 2

    run(script())


def test_a_gap_is_said_again_where_the_broker_is_lost_before_it_has_it(tmp_path: Path) -> None:
    said: list[Any] = []

    async def publish(message: Message) -> bool:
        said.append(json.loads(message.payload))
        if len(said) == 1:
            raise BrokerError("gone")
        return True

    async def script() -> None:
        bridge, broker = made(tmp_path), SimpleNamespace(publish=publish)
        bridge._events.lost = 7
        with pytest.raises(BrokerError):
            await bridge._send_events(broker)
        with anyio.move_on_after(1):
            await bridge._send_events(broker)
        assert [one["missed"] for one in said] == [7, 7]
        assert bridge._events.lost == 0

    run(script())


def test_what_stood_before_an_outage_of_the_broker_is_removed_after_it(tmp_path: Path) -> None:
    """Values that are not good any more, and drives that left the roster meanwhile."""

    class KeepingBroker:
        limits = Limits()

        def __init__(self) -> None:
            self.standing: dict[str, bytes] = {}

        async def publish(self, message: Message) -> bool:
            await anyio.lowlevel.checkpoint()
            if message.is_retained:
                self.standing.pop(message.topic, None)
                if message.payload:
                    self.standing[message.topic] = message.payload
            return True

        async def subscribe(self, filters: object, **how: Any) -> None:
            pass

    async def serve(bridge: Any, broker: Any) -> None:
        await bridge._begin(broker)
        with anyio.move_on_after(5):
            await bridge._show(broker)

    async def script() -> None:
        bridge, broker = made(tmp_path), KeepingBroker()
        for name in ("feeder", "belt"):
            reading = Reading.of({"drive": name, "code": "C0161", "value": 0, "quality": "good"})
            at_s = anyio.current_time()
            bridge.follower.drives[name] = FollowedDrive(
                name, 11, "8200vector", "online",
                values={"C0161": FollowedValue(reading, at_s, at_s + 150)},
            )  # fmt: skip
        await serve(bridge, broker)
        assert {"lecombus/hall-3/feeder/value/C0161", "lecombus/hall-3/belt/state"} <= {
            *broker.standing
        }
        await anyio.sleep(10)
        del bridge.follower.drives["belt"]
        bridge.follower._lose("no daemon answers")
        await serve(bridge, broker)
        assert {topic.removeprefix("lecombus/hall-3/") for topic in broker.standing} == {
            "state",
            "summary",
            "feeder/state",
            "feeder/json",
        }

    run(script())


@pytest.mark.parametrize(
    ("kept", "read"),
    [(b"a1b2-77\n", "a1b2-77"), (b"", ""), (b"\0" * 12, ""), (b"a-1\nb-2\n", ""),
     ("a-\u20ac".encode(), ""), (b"\xff\xfe", "")],
)  # fmt: skip
def test_a_place_that_was_spoiled_is_not_asked_for(tmp_path: Path, kept: bytes, read: str) -> None:
    """It becomes a header of a request, which was refused for as long as the file was there."""
    (tmp_path / "last-event").write_bytes(kept)
    assert SentPosition(tmp_path / "last-event").read() == read


@pytest.mark.real
def test_a_disk_that_stalls_does_not_hold_up_the_bridge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[threading.Thread] = []

    def write(path: Path, text: str) -> int:
        threads.append(threading.current_thread())
        return len(text)

    async def script() -> None:
        position = SentPosition(tmp_path / "last-event")
        position.last_id = "R-1"
        monkeypatch.setattr(Path, "write_text", write)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(position.keep)
            while not threads:  # noqa: ASYNC110
                await anyio.sleep(0.05)
            tasks.cancel_scope.cancel()

    anyio.run(script)
    assert threading.main_thread() not in threads
