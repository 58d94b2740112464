"""What is published of a line while its events are read, on whole lines on the virtual clock."""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable, Callable
from typing import Any

import anyio
import anyio.lowlevel
import pytest

from lecombus.api.decimal_json import encode
from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.event_stream import EventFilter
from lecombus.operations.actions import ACTOR, SECRET, Actor
from lecombus.operations.write_kinds import WriteKinds
from lecombus.parameters import Code
from lecombus.supervision import event_sources
from lecombus.supervision.event_sources import HEARTBEAT_S, EventSources
from support.rosters import roster_text
from support.site_host import Plant, with_plant

DRIVES = [("a", 11, "8200vector"), ("b", 12, "smvector")]
CYCLIC = "cyclic: [{code: C0150, every: 500ms}, {code: C0046, every: 2s}], also_writable: [C0012]"
ROSTER = roster_text(DRIVES, drive=CYCLIC)
STATUS, SETPOINT, TIME = Code(150), Code(46), Code(12)
DATA = re.compile(r"event: (\w+)\ndata: (.*)\n")


class Reading:
    """Reads all events of a line, and has looked for what time alone changes."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.stream = plant.site.events
        self.stream.record(encode)
        self._position = self.stream.next

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, *raised: object) -> None:
        self.stream.forget()

    async def passed(self, seconds: float) -> None:
        end_s = self.plant.now_s + seconds
        while self.plant.now_s < end_s:
            await anyio.sleep(min(1.0, end_s - self.plant.now_s))
            for _ in self.plant.site.supervision.event_sources.look():
                await anyio.lowlevel.checkpoint()

    def new(self, *kinds: str, drive: str = "") -> list[dict[str, Any]]:
        """Everything of some kinds since this was asked last."""
        frames, self._position = self.stream.batch(
            self._position, EventFilter(), until=self.stream.next, bytes_most=10**9
        )
        found = [(kind, json.loads(data)) for kind, data in DATA.findall(frames.decode())]
        return [
            data | {"kind": kind} for kind, data in found
            if (not kinds or kind in kinds) and (not drive or data.get("drive") == drive)
        ]  # fmt: skip


def reading(test: Callable[[Plant, Reading], Awaitable[None]], roster: str = ROSTER) -> None:
    async def run(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(15.0)  # what was read once at the audit is not fresh any more
        with Reading(plant) as events:
            await test(plant, events)

    with_plant(run, roster)


def codes(found: list[dict[str, Any]]) -> list[str]:
    return [f"{one['drive']} {one['code']}" for one in found]


def test_a_value_is_published_when_it_was_read_first_and_when_it_changes() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(5.0)
        first = events.new("value")
        assert sorted(codes(first)) == ["a C0046", "a C0150", "b C0046", "b C0150"]
        await events.passed(5.0)
        assert events.new("value") == []
        plant.line["a"].model.params.set(46, "12.5")
        await events.passed(3.0)
        (changed,) = events.new("value")
        assert (changed["drive"], changed["code"], changed["value"]) == ("a", "C0046", 12.5)

    reading(test)


def test_a_value_has_the_same_form_as_over_http() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(3.0)
        published = next(one for one in events.new("value", drive="a") if one["code"] == "C0150")
        known = plant.site.store.reading("a", STATUS)
        assert known is not None
        shown = json.loads(encode(known.as_json()))
        assert published.keys() - {"kind"} == shown.keys()
        changing = {"time", "age_s", "kind"}
        assert {key: published[key] for key in published.keys() - changing} == {
            key: shown[key] for key in shown.keys() - changing
        }

    reading(test)


def test_an_unchanged_value_is_published_every_half_minute() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(5.0)
        events.new()
        await events.passed(4 * HEARTBEAT_S)
        found = codes(events.new("value"))
        assert {found.count(name) for name in set(found)} <= {3, 4}
        assert len(set(found)) == 4

    reading(test)


def test_a_value_that_is_not_read_any_more_is_published_as_stale_then_every_half_minute() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(5.0)
        events.new()
        plant.power_cycle("a", 1000.0)
        await events.passed(20.0)
        found = events.new("value", drive="a")
        assert {one["quality"] for one in found[-2:]} <= {"bad", "stale"}
        assert {one["code"] for one in found} >= {"C0150", "C0046"}
        await events.passed(2 * HEARTBEAT_S + 5.0)
        again = events.new("value", drive="a")
        assert again
        assert {one["quality"] for one in again} <= {"bad", "stale"}

    reading(test)


def test_a_value_read_once_is_followed_until_it_is_no_longer_good() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await plant.site.operations.read("a", TIME)
        (now,) = [one for one in events.new("value") if one["code"] == "C0012"]
        assert now["quality"] == "good"
        await events.passed(3 * HEARTBEAT_S)
        (later,) = [one for one in events.new("value") if one["code"] == "C0012"]
        assert later["quality"] == "stale"

    reading(test)


def test_a_lost_line_is_published_with_its_drives_and_no_value_stays_good() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(5.0)
        events.new()
        plant.end.unplug()
        await events.passed(2.0)
        found = events.new()
        lines = [one for one in found if one["kind"] == "line"]
        assert {(one["line"], one["state"]) for one in lines} == {("test", "lost")}
        states = {one["drive"]: one["state"] for one in found if one["kind"] == "state"}
        assert states == {"a": "offline", "b": "offline"}
        values = [one for one in found if one["kind"] == "value"]
        assert {one["quality"] for one in values} == {"bad"}
        assert len(set(codes(values))) == 4
        plant.end.replug()
        await events.passed(20.0)
        found = events.new()
        assert [one["state"] for one in found if one["kind"] == "line"][-1] == "open"
        assert [one["state"] for one in found if one["kind"] == "state"][-1] == "online"

    reading(test)


def test_a_fault_is_published_when_it_comes_when_its_number_is_known_and_when_it_goes() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        plant.trip("a", 50)
        await events.passed(5.0)
        found = events.new("trip")
        assert [one["active"] for one in found] == [True] * len(found)
        assert (found[0]["drive"], found[-1]["fault"]["number"]) == ("a", 50)
        plant.clear_fault("a")
        await plant.site.operations.verb("a", Verb.RESET_FAULT)
        await events.passed(5.0)
        (gone,) = events.new("trip")
        assert (gone["active"], gone["fault"]["number"]) == (False, 50)

    reading(test)


def test_what_a_drive_does_is_published_with_its_states() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(2.0)
        events.new()
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        await events.passed(3.0)
        found = events.new("state", drive="a")
        assert "inhibited" in found[-1]["states"]
        assert found[-1]["state"] == "online"

    reading(test)


def test_a_remark_is_published_when_it_comes_and_when_it_goes() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        store = plant.site.store
        store.note("a", "swap", "another device")
        store.note_line("reload", "refused")
        store.note("a", "swap", None)
        store.note_line("reload", None)
        assert [(one["drive"], one["subject"], one["text"]) for one in events.new("remark")] == [
            ("a", "swap", "another device"),
            (None, "reload", "refused"),
            ("a", "swap", None),
            (None, "reload", None),
        ]

    reading(test)


def test_drives_that_come_and_go_with_a_roster_are_published() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(3.0)
        events.new()
        plant.apply(roster_text([DRIVES[0], ("c", 13, "smvector")], drive=CYCLIC))
        states = [(one["drive"], one["state"]) for one in events.new("state")]
        assert ("b", None) in states
        assert ("c", "starting") in states
        await events.passed(60.0)
        assert events.new("value", drive="b") == []

    reading(test)


def test_what_users_do_is_published_with_outcome_and_who_asked() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        ACTOR.set(Actor("tcp", client="127.0.0.1:5", token="panel"))
        await plant.site.operations.write("a", TIME, 7)
        with pytest.raises(OperationError):
            await plant.site.operations.write("a", Code(11), 50)
        await plant.site.operations.stop(StopAction.QUICK_STOP, "all")
        written, refused, stopped = events.new("write")
        assert (written["drive"], written["what"], written["outcome"]) == ("a", "write", "done")
        assert (written["code"], written["value"]) == ("C0012", "7")
        assert written["by"] == {"who": "tcp", "token": "panel", "client": "127.0.0.1:5"}
        assert (refused["outcome"], refused["code"]) == ("refused", "C0011")
        assert "not writable" in refused["reason"]
        assert (stopped["drive"], stopped["what"]) == ("all", "stop")
        for name in ("a", "b"):
            wanted = EventFilter(frozenset({name}), frozenset({"write"}))
            frames, _ = events.stream.batch(
                events.stream.first, wanted, until=events.stream.next, bytes_most=10**9
            )
            assert b'"what": "stop"' in frames
            assert (b'"code": "C0012"' in frames) is (name == "a")

    reading(test)


def test_a_lease_is_published_to_those_who_follow_its_drives() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        plant.site.supervision.event_sources.lease_changed(
            "ended", ("a",), {"lease": "ui", "end": "lapsed"}
        )
        (ended,) = events.new("lease")
        assert (ended["what"], ended["drives"], ended["end"]) == ("ended", ["a"], "lapsed")
        assert ended["time"].endswith("Z")
        for name, count in (("a", 1), ("b", 0)):
            wanted = EventFilter(frozenset({name}), frozenset({"lease"}))
            frames, _ = events.stream.batch(
                events.stream.first, wanted, until=events.stream.next, bytes_most=10**9
            )
            assert frames.count(b"event: lease") == count

    reading(test)


@pytest.mark.parametrize("uid", [None, 1000])
def test_an_event_of_a_lease_says_by_whom_as_a_write_does(uid: int | None) -> None:
    actor = Actor("socket", uid, client="plc", token="hall", subject="CN=plc")

    async def test(plant: Plant, events: Reading) -> None:
        leases = plant.site.operations.leases
        leases.followers = (plant.site.supervision.event_sources.lease_changed,)
        ACTOR.set(actor)
        lease = leases.take("ui", ["a"], ["a"], 1.0, 1)
        leases.tell("unlatched", ("a",), actor.fields())
        leases.release("ui", lease.token)
        leases.tell("hold", ("a",), {"lease": "ui"})
        *by_client, hold = events.new("lease")
        assert [one["what"] for one in by_client] == ["taken", "unlatched", "released"]
        for one in by_client:
            assert one["by"] == actor.fields()
            assert not actor.fields().keys() & one.keys()
        assert "by" not in hold

    reading(test)


def test_no_password_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WriteKinds, "is_secret", lambda kinds, drive, code: code == TIME)
    monkeypatch.setattr(EventSources, "_is_secret", lambda sources, drive, code: code == TIME)

    async def test(plant: Plant, events: Reading) -> None:
        await plant.site.operations.write("a", TIME, "47.11", verify=True)
        await plant.site.operations.read("a", TIME)
        await events.passed(12.0)
        frames, _ = events.stream.batch(
            events.stream.first, EventFilter(), until=events.stream.next, bytes_most=10**9
        )
        assert SECRET in frames.decode()
        assert b"47.11" not in frames

    reading(test)


def test_of_very_many_writes_in_a_second_only_the_number_is_published(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(event_sources, "WRITES_PER_S", 3)

    async def test(plant: Plant, events: Reading) -> None:
        await anyio.sleep(1.0 - plant.now_s % 1.0)
        for _ in range(10):
            with pytest.raises(OperationError):
                await plant.site.operations.write("a", Code(11), 50)
        await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        await events.passed(1.5)
        found = events.new("write")
        assert [one["what"] for one in found] == [*["write"] * 3, "stop", "kept-back"]
        assert found[-1]["count"] == 7

    reading(test)


def test_nothing_follows_the_store_while_no_event_is_read() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        events = plant.site.events
        assert (events.next, sum(events.published.values())) == (1, 0)
        events.record(encode)
        await anyio.sleep(5.0)
        events.forget()
        count = sum(events.published.values())
        assert count > 0
        await anyio.sleep(60.0)
        assert list(plant.site.supervision.event_sources.look()) == []
        assert sum(events.published.values()) == count

    with_plant(test, ROSTER)


def test_looking_is_done_in_small_pieces() -> None:
    async def test(plant: Plant, events: Reading) -> None:
        await events.passed(5.0)
        assert len(list(plant.site.supervision.event_sources.look())) >= len(DRIVES) + 1

    reading(test)
