"""What a bridge believes of a line: changes once each, and nothing old as fresh."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from decimal import Decimal
from types import SimpleNamespace
from typing import Any

import anyio
import httpx2
import pytest

from client.conftest import line_of
from lecombus.bridges import line_follower
from lecombus.bridges.line_follower import AWAY_AFTER_S, LineFollower
from lecombus.client import Event, Line, Quality, UnreachableError
from support.virtual_loop import run

OFFSET_S = 1_795_000_000.0
"""The time of day when the loop's time is 0."""


def rfc3339(at_s: float) -> str:
    return datetime.fromtimestamp(OFFSET_S + at_s, UTC).isoformat().replace("+00:00", "Z")


async def until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 - nothing says when it comes true
        await anyio.sleep(0.05)


class Daemon:
    """A daemon of one line with the drive `feeder`, as far as a follower asks it."""

    def __init__(self) -> None:
        self.state = "online"
        self.states: list[str] | None = ["ready"]
        self.fault: dict[str, Any] | None = None
        self.remarks: dict[str, str] = {}
        self.motion_is_old = False
        self.number: Any = 35.4
        self.read_at_s = 0.0
        self.quality = "good"
        self.code = "C0050"
        self.every_s = 1.0
        self.planned_stretch = 1.0
        self.drives = ["feeder"]
        self.silenced: set[str] = set()
        self.lease_s = 2.0
        self.is_silent = False
        self.is_gone = False
        self.reads_itself = True
        self.asked: list[str] = []
        self.after: list[str] = []
        self._events: list[bytes] = []
        self._came = anyio.Event()
        self._number = 0

    @asynccontextmanager
    async def connect(self, socket: str) -> AsyncIterator[Line]:
        if self.is_gone:
            raise UnreachableError(f"no daemon answers at {socket}")
        line = line_of(httpx2.MockTransport(lambda request: self.answer(request)))
        async with line.connection.http:
            yield line

    async def answer(self, request: httpx2.Request) -> httpx2.Response:
        path = request.url.path
        self.asked.append(path)
        if self.is_gone:
            raise httpx2.ConnectError("gone")
        await until(lambda: not self.is_silent)
        if path == "/v1/events":
            self.after.append(request.headers.get("last-event-id", ""))
            return httpx2.Response(200, content=self.stream())
        if path == "/v1/drives":
            documents = [self.drive(name) for name in self.drives]
            return httpx2.Response(200, json={"drives": documents})
        return httpx2.Response(200, json={
            "/v1/line": {"line": "hall-3", "state": "open", "stretch": 3.5,
                         "planned_stretch": self.planned_stretch},
            "/v1/plan": {"roster": {"drives": [
                {"name": name, "cyclic": [{"code": "C0050", "every_s": self.every_s}]}
                for name in self.drives]}},
            "/v1/leases": {"leases": [], "drives": [
                {"drive": name, "silenced": name in self.silenced, "time_s": self.lease_s}
                for name in self.drives]},
        }[path])  # fmt: skip

    def value(self) -> dict[str, Any]:
        now_s = anyio.current_time()
        if self.reads_itself:
            self.read_at_s = now_s
        return {"drive": "feeder", "code": self.code, "subcode": 0, "value": self.number,
                "unit": "Hz", "quality": self.quality, "time": rfc3339(self.read_at_s),
                "age_s": round(now_s - self.read_at_s, 3)}  # fmt: skip

    def drive(self, name: str) -> dict[str, Any]:
        return {"drive": name, "address": 11, "family": "8200vector", "state": self.state,
                "reason": None, "since": rfc3339(0), "states": self.states, "fault": self.fault,
                "remarks": self.remarks,
                "motion": {"doing": "stopped", "stale": self.motion_is_old},
                "values": [self.value()]}  # fmt: skip

    def say(self, kind: str, **data: Any) -> None:
        self._number += 1
        text = json.dumps({"drive": "feeder", **data})
        self._events.append(f"id: R-{self._number}\nevent: {kind}\ndata: {text}\n\n".encode())
        self._came.set()

    async def stream(self) -> AsyncGenerator[bytes, None]:
        yield b": \nid: R-0\n\n"
        while not self.is_gone:
            self._came = anyio.Event()
            while self._events and not self.is_silent:
                yield self._events.pop(0)
            with anyio.move_on_after(0.05):
                await self._came.wait()


class Followed:
    """A follower, and what it gave."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.given: list[Event] = []
        self.follower = LineFollower(
            "/run/x.sock",
            wall=lambda: OFFSET_S + anyio.current_time(),
            connect_to=daemon.connect,
        )
        self.follower.listeners.append(self.given.append)

    def kinds(self) -> list[str]:
        return [event.kind for event in self.given if event.kind != "looked"]

    def good(self, code: str = "C0050") -> bool:
        value = self.follower.value("feeder", code)
        return value is not None and value.is_good(anyio.current_time())


def follow(script: Callable[[Followed], Any]) -> None:
    """Run a script beside a follower in virtual time."""

    async def work() -> None:
        followed = Followed(Daemon())
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(followed.follower.run)
            await script(followed)
            tasks.cancel_scope.cancel()

    run(work())


def test_a_fault_is_over_only_when_the_states_of_its_drive_are_known() -> None:
    """A daemon that was started again has not yet read the drive that is still tripped."""

    async def script(seen: Followed) -> None:
        daemon, feeder = seen.daemon, seen.follower.drives
        daemon.fault = {"kind": "trip", "keypad": "OC1", "number": 11, "stale": False}
        await anyio.sleep(1.5)
        before = seen.kinds()
        assert before[-1] == "trip"
        daemon.states, daemon.fault, daemon.state = None, None, "starting"
        await anyio.sleep(2)
        assert feeder["feeder"].fault == {
            "kind": "trip", "keypad": "OC1", "number": 11, "stale": True
        }  # fmt: skip
        daemon.states, daemon.state = ["fault"], "online"
        daemon.fault = {"kind": "trip", "keypad": "OC1", "number": 11, "stale": False}
        await anyio.sleep(2)
        assert "trip" not in seen.kinds()[len(before) :]
        daemon.fault = None
        await anyio.sleep(2)
        assert seen.kinds()[-1] == "trip"
        assert feeder["feeder"].fault is None

    follow(script)


def test_what_a_drive_did_before_it_fell_silent_is_not_what_it_does() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        assert seen.follower.drives["feeder"].doing == "stopped"
        seen.daemon.motion_is_old = True
        await anyio.sleep(1.5)
        feeder = seen.follower.drives["feeder"]
        assert feeder.doing == "unknown"
        assert feeder.motion == {"doing": "stopped", "stale": True}

    follow(script)


def test_it_gives_what_is_known_once_and_then_changes() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        assert seen.follower.is_connected
        assert seen.kinds() == ["connected", "state"]
        assert seen.follower.drives["feeder"].state == "online"
        assert seen.follower.drives["feeder"].doing == "stopped"
        value = seen.follower.value("feeder", "C0050")
        assert value is not None
        assert str(value.reading.value) == "35.4"
        assert 2.0 < value.left_s(anyio.current_time()) <= 3.0  # twice its second, and one more
        await anyio.sleep(5)
        assert seen.kinds() == ["connected", "state"]

    follow(script)


def test_a_change_is_given_once_by_an_event_or_by_a_look() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        daemon = seen.daemon
        fault = {"kind": "trip", "keypad": "OC1", "number": 11, "stale": False}
        daemon.fault = fault
        daemon.say("trip", active=True, fault=fault)
        daemon.state = "degraded"  # no event says it
        daemon.remarks = {"wear": "much"}
        await anyio.sleep(3)
        assert seen.kinds()[2:] == ["trip", "state", "remark"]
        daemon.fault = None
        await anyio.sleep(3)
        daemon.say("trip", active=False, fault=fault)  # late: a look has shown it
        await anyio.sleep(3)
        assert seen.kinds()[5:] == ["trip"]
        assert not seen.given[-1].data.get("active")
        assert seen.follower.drives["feeder"].fault is None

    follow(script)


def test_it_knows_which_drives_are_silenced_on_purpose() -> None:
    async def script(seen: Followed) -> None:
        daemon, follower = seen.daemon, seen.follower
        daemon.silenced = {"feeder"}
        await anyio.sleep(0.5)
        assert follower.silenced == {"feeder"}
        daemon.silenced = set()
        daemon.say("lease", what="silence-ended", drives=["feeder"])
        await anyio.sleep(0.1)
        assert not follower.silenced
        daemon.say("lease", what="silenced", drives=["feeder"])
        await anyio.sleep(0.1)
        assert follower.silenced == {"feeder"}, "before its state is said"
        await anyio.sleep(5)
        assert not follower.silenced, "as a look shows"
        daemon.silenced = {"feeder"}
        daemon.say("lease", what="silenced", drives=["feeder"])
        await anyio.sleep(5)
        daemon.drives = []
        await anyio.sleep(5)
        assert not follower.silenced
        daemon.drives, daemon.silenced = ["feeder"], {"feeder"}
        daemon.say("lease", what="silenced", drives=["feeder"])
        await anyio.sleep(5)
        daemon.is_silent = True
        await anyio.sleep(AWAY_AFTER_S + 3)
        assert not follower.silenced

    follow(script)


def test_what_an_event_said_is_newer_than_a_look_under_way() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(1.9)
        daemon = seen.daemon
        slow = daemon.answer

        async def slow_page(request: httpx2.Request) -> httpx2.Response:
            found = await slow(request)
            if request.url.path == "/v1/drives":
                daemon.state, daemon.quality = "offline", "stale"
                daemon.say("state", state="offline", reason="silent", states=None)
                daemon.say("value", **{**daemon.value(), "age_s": 0.5})
                await anyio.sleep(0.3)
            return found

        daemon.answer = slow_page  # type: ignore[method-assign]
        await until(lambda: seen.follower.drives["feeder"].state != "online")
        for _ in range(40):
            await anyio.sleep(0.05)
            assert seen.follower.drives["feeder"].state == "offline"
            assert not seen.good()

    follow(script)


@pytest.mark.parametrize("how", ["is_gone", "is_silent"])
def test_nothing_is_fresh_while_the_daemon_is_away(how: str) -> None:
    async def script(seen: Followed) -> None:
        seen.daemon.every_s = 60.0
        await anyio.sleep(0.5)
        assert seen.good()
        setattr(seen.daemon, how, True)
        await anyio.sleep(AWAY_AFTER_S + 1.5)
        assert not seen.follower.is_connected
        assert seen.follower.why_away
        assert seen.follower.line is None
        assert not seen.good()
        value = seen.follower.value("feeder", "C0050")
        assert value is not None
        assert value.quality(anyio.current_time()) is Quality.STALE
        assert value.age_s(anyio.current_time()) > AWAY_AFTER_S
        drive = seen.follower.drives["feeder"]
        assert (drive.state, drive.states, drive.doing) == ("unknown", None, "unknown")
        setattr(seen.daemon, how, False)
        await anyio.sleep(8)
        assert seen.good()
        assert drive.state == "online"
        assert seen.kinds() == ["connected", "state", "away", "connected"]

    follow(script)


def test_it_asks_for_the_events_that_it_missed() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        seen.daemon.say("remark", subject="x", text="y")
        await anyio.sleep(0.5)
        seen.daemon.is_gone = True
        await anyio.sleep(3)
        seen.daemon.is_gone = False
        await anyio.sleep(8)
        assert seen.daemon.after[0] == ""
        assert seen.daemon.after[-1] == "R-1"

    follow(script)


def test_a_value_ends_to_be_good_by_time_alone() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        seen.daemon.reads_itself = False
        read_at_s = seen.daemon.read_at_s
        await until(lambda: not seen.good())
        assert 2.7 < anyio.current_time() - read_at_s <= 3.05

    follow(script)


def test_an_event_that_waited_on_its_way_is_as_old_as_it_is() -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(0.5)
        daemon = seen.daemon
        daemon.code = "C0051"  # seen by no look before
        old = {**daemon.value(), "code": "C0052", "time": rfc3339(anyio.current_time() - 9.5)}
        daemon.say("value", **{**old, "age_s": 0.0})
        await anyio.sleep(0.1)
        assert seen.good("C0052")  # read once: good for 10 s
        await anyio.sleep(0.5)
        assert not seen.good("C0052")

    follow(script)


def test_a_value_is_not_taken_before_it_is_known_how_often_it_is_read() -> None:
    async def script() -> None:
        daemon = Daemon()
        seen = Followed(daemon)
        event = Event("R-1", "value", "feeder", {**daemon.value(), "value": Decimal("35.4")})
        seen.follower._take_event(event)
        assert seen.follower.value("feeder", "C0050") is None
        assert seen.kinds() == []

    run(script())


def test_a_stretched_line_keeps_values_good_for_longer() -> None:
    async def script(seen: Followed) -> None:
        seen.daemon.planned_stretch = 2.0
        await anyio.sleep(0.5)
        value = seen.follower.value("feeder", "C0050")
        assert value is not None
        assert 4.0 < value.left_s(anyio.current_time()) <= 5.0

    follow(script)


def test_a_password_is_not_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    secret = SimpleNamespace(is_secret=lambda code: str(code) == "C0094")
    monkeypatch.setattr(line_follower, "family", lambda name: secret)
    line_follower.is_secret_code.cache_clear()

    async def script(seen: Followed) -> None:
        seen.daemon.code = "C0094"
        await anyio.sleep(1.5)
        seen.daemon.say("value", **seen.daemon.value())
        await anyio.sleep(0.2)
        assert seen.follower.value("feeder", "C0094") is None
        assert "value" not in seen.kinds()

    try:
        follow(script)
    finally:
        line_follower.is_secret_code.cache_clear()


def test_a_drive_taken_out_of_the_roster_goes() -> None:
    async def script(seen: Followed) -> None:
        seen.daemon.drives = ["feeder", "belt"]
        await anyio.sleep(0.5)
        seen.daemon.drives = ["feeder"]
        await anyio.sleep(2)
        assert list(seen.follower.drives) == ["feeder"]
        last = [event for event in seen.given if event.kind == "state"][-1]
        assert (last.kind, last.drive, last.data["state"]) == ("state", "belt", None)

    follow(script)


@pytest.mark.parametrize(
    ("how", "within_s"),
    [("a remark by an event", 1.5), ("a remark by a look", 2.5), ("nothing says it", 62)],
)
def test_a_reload_changes_leases_without_an_event_of_theirs(how: str, within_s: float) -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(2.5)
        seen.daemon.lease_s = 1.0
        if how == "a remark by an event":
            seen.daemon.say("remark", subject="lease", text="latched (no lease was taken yet)")
        elif how == "a remark by a look":
            seen.daemon.remarks = {"lease": "latched (no lease was taken yet)"}
        await anyio.sleep(within_s)
        assert [one["time_s"] for one in seen.follower.leases["drives"]] == [1.0]

    follow(script)


@pytest.mark.parametrize("by_event", [False, True])
def test_of_a_drive_that_a_reload_adds_all_is_asked(by_event: bool) -> None:
    async def script(seen: Followed) -> None:
        await anyio.sleep(2.5)
        asked = len(seen.daemon.asked)
        seen.daemon.drives = ["feeder", "belt"]
        if by_event:
            seen.daemon.say("state", drive="belt", state="starting")
        await anyio.sleep(2.5)
        assert seen.follower.period_s("belt", "C0050") == seen.daemon.every_s
        assert [one["drive"] for one in seen.follower.leases["drives"]] == ["feeder", "belt"]
        assert seen.daemon.asked[asked:].count("/v1/plan") == 1

    follow(script)


def test_it_waits_for_a_daemon_with_bounded_pauses() -> None:
    async def script(seen: Followed) -> None:
        seen.daemon.is_gone = True
        await anyio.sleep(120)
        assert seen.kinds() == ["away"]
        seen.daemon.is_gone = False
        await anyio.sleep(5.5)
        assert seen.follower.is_connected

    follow(script)
