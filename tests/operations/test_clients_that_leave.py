"""What waits in the schedule when its client leaves is not sent, unless it stops a drive."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import anyio
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.operations.awaited_requests import IS_GONE
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

ROSTER = roster_text(
    [("a", 11, "821x"), ("b", 12, "821x"), ("c", 13, "821x")],
    drive="cyclic: [{code: C0150, every: 1s}], writable: [C0001, C0040, C0046, C0135]",
    sections="groups:\n  two: {members: [a, b], multicast: yes}\n  three: {members: [a, b]}\n",
)
RUN = "H0000"
Act = Callable[[Plant], Awaitable[object]]


def writing(code: int, value: int | str) -> Act:
    return lambda plant: plant.site.operations.write("a", Code(code), value)


def verb(verb: Verb) -> Act:
    return lambda plant: plant.site.operations.verb("a", verb)


def group(name: str, code: int, value: int | str) -> Act:
    return lambda plant: plant.site.operations.write_group(name, Code(code), value)


class Client:
    """Somebody who asks, and may leave."""

    def __init__(self) -> None:
        self.has_left = False
        self.asked = 0

    def is_gone(self) -> bool:
        self.asked += 1
        return self.has_left

    def begin(self, plant: Plant, act: Act) -> asyncio.Task[object]:
        async def doing() -> object:
            IS_GONE.set(self.is_gone)
            return await act(plant)

        return asyncio.create_task(doing())


async def busy(plant: Plant) -> None:
    """Let the line be in the middle of an exchange, so that what is asked for now waits."""
    plant.reads = [  # type: ignore[attr-defined]
        asyncio.ensure_future(plant.site.operations.read("c", Code(150))) for _ in range(3)
    ]
    await anyio.sleep(0.03)


def said(plant: Plant) -> list[tuple[str, int, str]]:
    return [
        (name, one.code, one.text)
        for name in "ab"
        for one in plant.line[name].log
        if one.kind == "write"
    ]


STARTS = {
    "setpoint": writing(46, 20),
    "control word": writing(135, RUN),
    "enable code": writing(40, 1),
    "setting": writing(1, 0),
    "multicast": group("two", 135, RUN),
    "one by one": group("three", 46, 20),
}


@pytest.mark.parametrize("act", STARTS.values(), ids=STARTS)
@pytest.mark.parametrize("leaves", [True, False])
def test_a_write_that_waits_is_not_sent_when_its_client_leaves(
    act: Act, leaves: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await busy(plant)
        before, client = said(plant), Client()
        doing = client.begin(plant, act)
        await anyio.sleep(0.001)
        assert said(plant) == before, "it waits"
        client.has_left = leaves
        report = await doing
        await anyio.sleep(2.0)
        assert (said(plant) == before) is leaves
        if leaves:
            assert report.outcome is Outcome.REFUSED  # type: ignore[attr-defined]
            members = getattr(report, "members", (report,))
            assert {one.kind for one in members} == {"client-gone"}  # type: ignore[union-attr]

    with caplog.at_level("INFO", "lecombus.operations.actions"):
        with_plant(test, ROSTER)
    if leaves:
        assert "outcome=refused" in caplog.text


STOPS = {
    "inhibit": writing(40, 0),
    "quick stop": writing(135, "H0008"),
    "group": group("two", 40, 0),
    "verb": verb(Verb.QUICK_STOP),
    "verb inhibit": verb(Verb.INHIBIT),
    "stop": lambda plant: plant.site.operations.stop(StopAction.QUICK_STOP, "a"),
}


@pytest.mark.parametrize("act", STOPS.values(), ids=STOPS)
@pytest.mark.parametrize("early", [True, False])
def test_what_stops_is_sent_whatever_its_client_does(act: Act, early: bool) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await busy(plant)
        before, client = said(plant), Client()
        client.has_left = early
        doing = client.begin(plant, act)
        await anyio.sleep(0.001)
        client.has_left = True
        report = await doing
        assert report.outcome in (Outcome.DONE, Outcome.VERIFIED)  # type: ignore[attr-defined]
        assert said(plant) != before

    with_plant(test, ROSTER)


def test_an_enable_is_not_begun_once_its_client_has_left() -> None:
    """Its questions take a while; what it would write waits behind them."""

    async def test(plant: Plant) -> None:
        await plant.online()
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        before, client = said(plant), Client()
        doing = client.begin(plant, verb(Verb.ENABLE))
        await anyio.sleep(0.1)
        client.has_left = True
        report = await doing
        await anyio.sleep(2.0)
        assert said(plant) == before
        assert (report.outcome, report.kind) == (Outcome.REFUSED, "client-gone")  # type: ignore[attr-defined]
        assert (await plant.site.operations.why("a")).last_enable is None, (
            "the drive is not at fault"
        )

    with_plant(test, ROSTER)


def test_an_enable_that_was_begun_goes_on() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        operations = plant.site.operations
        await operations.stop(StopAction.QUICK_STOP, "a")
        await operations.stop(StopAction.INHIBIT, "a")
        before, client = said(plant), Client()
        doing = client.begin(plant, verb(Verb.ENABLE))
        await until(lambda: said(plant) != before)
        client.has_left = True
        report = await doing
        assert report.outcome is Outcome.VERIFIED  # type: ignore[attr-defined]
        assert len(said(plant)) >= len(before) + 2, "both of its steps"

    with_plant(test, ROSTER)


def test_the_client_is_asked_when_the_telegram_goes_and_not_all_the_time() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await busy(plant)
        client = Client()
        await client.begin(plant, writing(46, 20))
        assert client.asked <= 3

    with_plant(test, ROSTER)


def test_another_drives_write_behind_one_that_was_withdrawn_is_sent() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await busy(plant)
        gone, there = Client(), Client()
        first = [gone.begin(plant, writing(46, 20)), gone.begin(plant, writing(135, RUN))]
        await anyio.sleep(0.001)
        gone.has_left = True
        second = there.begin(plant, lambda plant: plant.site.operations.write("b", Code(46), 30))
        assert (await second).outcome is Outcome.DONE  # type: ignore[attr-defined]
        assert {(await one).kind for one in first} == {"client-gone"}  # type: ignore[attr-defined]

    with_plant(test, ROSTER)
