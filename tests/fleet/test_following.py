"""The connection of the fleet to a real broker that stands, refuses, or is late."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import anyio
import pytest

from lecombus.bridges.mqtt.broker import BrokerError, Incoming
from lecombus.fleet import following
from lecombus.fleet.following import FleetFollower, follow_once
from lecombus.fleet.lines import FleetLines
from lecombus.fleet.stopping import send_stops
from lecombus.roster import MqttEntry
from support.daemon_host import free_port, short_dir
from support.mqtt_parts import Broker, broker

pytestmark = pytest.mark.real

SUMMARY = json.dumps(
    {"bridge": "x", "state": "online", "stands_s": 30, "drives": {"online": 1}, "attention": []}
)


def entry(port: int) -> MqttEntry:
    return MqttEntry(host="127.0.0.1", port=port, tls=False)


@contextmanager
def hub(more: str = "") -> Iterator[tuple[Broker, Path]]:
    with short_dir() as folder, broker(folder, more=more) as made:
        yield made, folder


def show(made: Broker, *names: str) -> None:
    with made.client() as client:
        for name in names:
            client.publish(f"lecombus/{name}/state", "online", retain=True, expiry_s=60)
            client.publish(f"lecombus/{name}/summary", SUMMARY, retain=True, expiry_s=30)


async def until(condition: Callable[[], bool], within_s: float = 15.0) -> None:
    with anyio.fail_after(within_s):
        while not condition():  # noqa: ASYNC110
            await anyio.sleep(0.02)


def statuses(lines: FleetLines) -> dict[str, str]:
    return {one.name: one.status for one in lines.views(following.now_s())}


def test_all_that_stands_at_the_broker_is_read_however_much_it_is() -> None:
    """With QoS 1 mosquitto drops what is beyond its queue of a thousand messages."""
    with hub() as (made, _):
        names = [f"l{at:04}" for at in range(1500)]
        show(made, *names)
        lines = FleetLines(("lecombus",))
        anyio.run(lambda: follow_once(entry(made.port), lines, connect_within_s=20, quiet_s=0.2))
        assert statuses(lines) == dict.fromkeys(names, "ok")


def test_a_broker_that_does_not_answer_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "PULSE_EVERY_S", 0.2)
    monkeypatch.setattr(following, "PULSE_WITHIN_S", 0.6)

    async def follow(made: Broker) -> None:
        lines = FleetLines(("lecombus",))
        follower = FleetFollower(entry(made.port), lines)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(follower.run)
            await until(lambda: statuses(lines) == {"a": "ok"})
            assert made.process is not None
            made.process.send_signal(signal.SIGSTOP)
            await until(lambda: statuses(lines) == {"a": "unknown"})
            made.process.send_signal(signal.SIGCONT)
            await until(lambda: statuses(lines) == {"a": "ok"})
            tasks.cancel_scope.cancel()

    with hub() as (made, _):
        show(made, "a")
        anyio.run(follow, made)


def test_a_process_that_stood_does_not_take_what_waited_for_it() -> None:
    """What is in its socket was sent long ago, and says that it is fresh."""
    now_s = [100.0]

    async def follow(made: Broker) -> None:
        lines = FleetLines(("lecombus",))
        follower = FleetFollower(entry(made.port), lines, lambda: now_s[0])
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(follower.run)
            await until(lambda: [one.status for one in lines.views(now_s[0])] == ["ok"])
            now_s[0] += 60.0  # it stood
            old = Incoming("lecombus/a/summary", SUMMARY.encode(), 0, False, 0.0, 30)
            follower._take(old)
            assert [one.status for one in lines.views(now_s[0])] == ["no-news"]
            await until(lambda: lines.why_away != "")
            assert "stood" in lines.why_away
            await until(lambda: [one.status for one in lines.views(now_s[0])] == ["ok"])
            tasks.cancel_scope.cancel()

    with hub() as (made, _):
        show(made, "a")
        anyio.run(follow, made)


def test_a_broker_that_is_not_there_is_said() -> None:
    lines = FleetLines(("lecombus",))
    port = free_port()
    with pytest.raises(BrokerError, match="refused"):
        anyio.run(lambda: follow_once(entry(port), lines, connect_within_s=5, quiet_s=0.2))
    with pytest.raises(BrokerError, match="refused"):
        anyio.run(lambda: send_stops(entry(port), ["lecombus/a"], "all", "quick-stop", 1.0))


def test_stops_are_sent_before_answers_are_waited_for_and_false_answers_prove_nothing() -> None:
    """Lines `a` to `c` are heard by a client that answers with its own data or not at all."""

    async def stop(made: Broker) -> None:
        heard = []
        with made.client("lecombus/+/all/do/quick-stop") as client:
            results = await send_stops(
                entry(made.port), [f"lecombus/{name}" for name in "abc"], "all", "quick-stop", 1.0,
                lambda one: heard.append(one.root),
            )  # fmt: skip
            topics = {one.topic for one in client.heard}
        assert topics == {f"lecombus/{name}/all/do/quick-stop" for name in "abc"}
        assert all(0 < (one.expiry_s or 0) <= 10 and not one.is_retained for one in client.heard)
        assert len({one.correlation for one in client.heard}) == 3
        assert [(one.outcome, one.kind) for one in results] == [("unknown", "no-answer")] * 3
        assert sorted(heard) == ["lecombus/a", "lecombus/b", "lecombus/c"]

    with hub() as (made, _):
        anyio.run(stop, made)


def test_a_broker_that_is_lost_behind_a_stop_leaves_its_outcome_unknown() -> None:
    async def stop(made: Broker) -> None:
        with made.client("lecombus/+/all/do/quick-stop") as client:
            async with anyio.create_task_group() as tasks:

                async def lose() -> None:
                    await until(lambda: bool(client.heard))
                    made.end(kill=True)

                tasks.start_soon(lose)
                results = await send_stops(
                    entry(made.port), ["lecombus/a"], "all", "quick-stop", 20.0
                )
        (result,) = results
        assert (result.outcome, result.kind) == ("unknown", "broker-lost")
        assert "not known whether it was carried out" in result.reason

    with hub() as (made, _):
        anyio.run(stop, made)
