"""Who follows the operations may hold up what moves a drive or refuse it, and never a stop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import anyio
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.errors import OperationError
from lecombus.operations.actions import Act
from lecombus.operations.write_kinds import WriteKinds
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, with_plant

ROSTER = roster_text(
    [("a", 11, "821x"), ("b", 12, "821x")],
    drive="cyclic: [{code: C0150, every: 1s}], writable: [C0001, C0040, C0046, C0135]",
    sections="groups:\n  two: {members: [a, b], multicast: yes}\n",
)
TAKES_S = 0.5
Operation = Callable[[Plant], Awaitable[object]]

STARTS: Mapping[str, Operation] = {
    "write": lambda plant: plant.site.operations.write("a", Code(46), 20),
    "group write": lambda plant: plant.site.operations.write_group("two", Code(46), 20),
    "verb": lambda plant: plant.site.operations.verb("a", Verb.ENABLE),
}
STOPS: Mapping[str, Operation] = {
    "stop": lambda plant: plant.site.operations.stop(StopAction.INHIBIT, "a"),
    "verb": lambda plant: plant.site.operations.verb("a", Verb.QUICK_STOP),
    "plain write": lambda plant: plant.site.operations.write("a", Code(40), 0),
    "plain group write": lambda plant: plant.site.operations.write_group("two", Code(40), 0),
}


class Slow:
    """A follower that takes its time over each begin, as a slow disk does."""

    def __init__(self, plant: Plant, *, refuses: bool = False) -> None:
        self.heard: list[tuple[str, str, str]] = []
        self.acts: list[Act] = []
        self._refuses = refuses
        plant.site.operations.actions.followers = (self,)

    def begun(self, act: Act) -> Awaitable[None] | None:
        self.heard.append(("begun", act.event, act.target))
        self.acts.append(act)
        return None if act.is_stop else self._wait()

    async def _wait(self) -> None:
        await anyio.sleep(TAKES_S)
        if self._refuses:
            raise OperationError("no room", kind="journal", remedy="")

    def ended(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        self.heard.append((outcome, act.event, act.target))


def writes(plant: Plant) -> list[tuple[int, str]]:
    return [
        (one.code, one.text)
        for name in "ab"
        for one in plant.line[name].log
        if one.kind in ("write", "group")
    ]


@pytest.mark.parametrize("operation", STARTS.values(), ids=STARTS)
def test_what_moves_a_drive_is_sent_after_its_followers_have_it(operation: Operation) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        follower, before = Slow(plant), writes(plant)
        task = asyncio.ensure_future(operation(plant))
        await anyio.sleep(TAKES_S * 0.9)
        assert writes(plant) == before
        report = await task
        assert len(writes(plant)) > len(before)
        assert [kind for kind, *_ in follower.heard] == ["begun", str(report.outcome)]  # type: ignore[attr-defined]

    with_plant(scenario, ROSTER)


@pytest.mark.parametrize("operation", STARTS.values(), ids=STARTS)
def test_a_stop_that_comes_while_a_follower_takes_its_time_ends_what_waits(
    operation: Operation,
) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        Slow(plant)
        task = asyncio.ensure_future(operation(plant))
        await anyio.sleep(TAKES_S * 0.5)
        await plant.site.operations.stop(StopAction.INHIBIT, "all")
        stopped = writes(plant)
        report = await task
        assert report.outcome is Outcome.SUPERSEDED  # type: ignore[attr-defined]
        await anyio.sleep(2)
        assert writes(plant) == stopped

    with_plant(scenario, ROSTER)


@pytest.mark.parametrize("operation", STARTS.values(), ids=STARTS)
@pytest.mark.parametrize("stop", ["H0008", "group"])
def test_a_plain_write_that_stops_is_not_undone_by_what_was_asked_for_before_it(
    operation: Operation, stop: str
) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        Slow(plant)
        task = asyncio.ensure_future(operation(plant))
        await anyio.sleep(TAKES_S * 0.5)
        if stop == "group":
            await plant.site.operations.write_group("two", Code(40), 0)
        else:
            await plant.site.operations.write("a", Code(135), stop)
        stopped = writes(plant)
        report = await task
        members: tuple[Any, ...] = getattr(report, "members", (report,))
        assert {one.outcome for one in members if one.drive == "a"} == {Outcome.SUPERSEDED}
        await anyio.sleep(2)
        # A group's other member was not stopped by a write to the one.
        later = [one for one in writes(plant) if one not in stopped]
        assert not later or (stop == "H0008" and len(members) == 2)

    with_plant(scenario, ROSTER)


def test_an_older_stop_ends_no_later_write_of_the_same_task() -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        Slow(plant)
        await plant.site.operations.write("a", Code(46), 20)
        await plant.site.operations.stop(StopAction.INHIBIT, "a")
        await anyio.sleep(1)
        report = await plant.site.operations.write("a", Code(46), 30, verify=True)
        assert report.outcome.is_good

    with_plant(scenario, ROSTER)


@pytest.mark.parametrize("operation", STOPS.values(), ids=STOPS)
def test_a_stop_waits_for_no_follower_and_is_refused_by_none(operation: Operation) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        follower = Slow(plant, refuses=True)
        asked_s = anyio.current_time()
        before = writes(plant)
        task = asyncio.ensure_future(operation(plant))
        while writes(plant) == before:  # noqa: ASYNC110 - the virtual clock
            await anyio.sleep(0.001)
        assert anyio.current_time() - asked_s < TAKES_S * 0.9
        assert (await task).outcome.is_good  # type: ignore[attr-defined]
        assert follower.acts[0].is_stop

    with_plant(scenario, ROSTER)


@pytest.mark.parametrize("operation", STARTS.values(), ids=STARTS)
def test_what_a_follower_refuses_is_not_sent(operation: Operation) -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        follower, before = Slow(plant, refuses=True), writes(plant)
        with pytest.raises(OperationError, match="no room"):
            await operation(plant)
        assert writes(plant) == before
        assert [kind for kind, *_ in follower.heard] == ["begun", "refused"]

    with_plant(scenario, ROSTER)


def test_a_write_expires_by_when_it_was_asked_for() -> None:
    async def scenario(plant: Plant) -> None:
        await plant.online()
        Slow(plant)
        report = await plant.site.operations.write("a", Code(46), 20, expires_s=TAKES_S / 2)
        assert report.outcome is Outcome.EXPIRED
        report = await plant.site.operations.write("a", Code(46), 20, expires_s=TAKES_S * 3)
        assert report.outcome is Outcome.DONE

    with_plant(scenario, ROSTER)


def test_followers_get_the_value_that_was_known_before_but_no_password(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(WriteKinds, "is_secret", lambda kinds, target, code: code == Code(1))

    async def scenario(plant: Plant) -> None:
        await plant.online()
        follower = Slow(plant)
        await plant.site.operations.write("a", Code(46), 20, verify=True)
        await plant.site.operations.write("a", Code(46), 30, verify=True)
        await plant.site.operations.write_group("two", Code(46), 10)
        assert [act.old for act in follower.acts] == ["", "20", "a:30"]
        await plant.site.operations.write("a", Code(1), 2, verify=True)
        await plant.site.operations.write("a", Code(1), 3)
        assert [(act.said["value"], act.old) for act in follower.acts[3:]] == [("***", "")] * 2

    with_plant(scenario, ROSTER)
