"""Controllers that take a drive from each other all the time: only the newest token moves it.

What each did is recorded with the telegrams that had gone out by then, and a checker goes through
the history. Without the check directly before a telegram it must find writes of old tokens.
"""

from __future__ import annotations

import asyncio
import random
from dataclasses import dataclass, field
from itertools import count

import anyio
import pytest

from lecombus.drives import Verb
from lecombus.errors import LecombusError, OperationError
from lecombus.operations.lease_operations import LEASE
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Request
from support.rosters import roster_text
from support.site_host import Plant, with_plant

SETPOINT = Code(46)
ROSTER = roster_text(
    [("a", 11, "8200vector"), ("b", 12, "8200vector")],
    own={"a": "lease: {required: true, time: 2s, on_lapse: inhibit}"},
    drive="cyclic: [{code: C0150, every: 50ms}, {code: C0050, every: 50ms}]",
)
NAMES = ("one", "two", "three")


@dataclass
class History:
    """What was granted and asked, each with how many telegrams had gone out before.

    Args:
        grants: The telegrams by then, and the number of the token.
        written: By the value written: the number of the token that it was asked with.
        ends: By the value: how the write ended.
    """

    grants: list[tuple[int, int]] = field(default_factory=list)
    written: dict[str, int] = field(default_factory=dict)
    ends: dict[str, str] = field(default_factory=dict)


def violations(plant: Plant, history: History) -> list[str]:
    """Find each telegram to the drive that carries a value of a token that was not the newest."""
    found = []
    for index, telegram in enumerate(plant.end.sent):
        data = telegram.data
        if data[1:3] != b"11" or b"\x02" not in data or b"C1" in data:
            continue
        for value, number in history.written.items():
            if data[:-2].endswith(value.encode()):
                newest = max((one for at, one in history.grants if at <= index), default=0)
                if number != newest:
                    found.append(f"telegram {index}: {value} of {number}, the newest is {newest}")
    return found


class Controller:
    """Takes the drive over, or moves it, as chance will have it."""

    def __init__(self, plant: Plant, name: str, history: History, values: count[int]) -> None:
        self.plant, self.name, self.history, self.values = plant, name, history, values
        self.rng = random.Random(name)
        self.token = ""

    async def fight(self, until_s: float) -> None:
        async with anyio.create_task_group() as tasks:
            while self.plant.now_s < until_s:
                if not self.token or self.rng.random() < 0.15:
                    self.take()
                else:
                    tasks.start_soon(self._write)
                await anyio.sleep(self.rng.uniform(0.0, 0.06))

    def take(self) -> None:
        leases = self.plant.site.operations.leases
        over = next((one.name for one in leases.held()), "")
        try:
            lease = leases.take(self.name, ("a",), ("a",), 2.0, 1, take_over=over)
        except OperationError as exc:
            assert exc.kind == "lease-held"  # noqa: PT017 - its own name is held by nobody else
            return
        self.token = lease.token
        self.history.grants.append((len(self.plant.end.sent), lease.number))

    async def _write(self) -> None:
        ops, value = self.plant.site.operations, f"{next(self.values) / 10:.1f}"
        LEASE.set(self.token)
        self.history.written[value] = int(self.token.split("-")[0])
        try:
            report = await ops.write("a", SETPOINT, value)
            self.history.ends[value] = report.kind or report.outcome.value
        except LecombusError as exc:
            self.history.ends[value] = getattr(exc, "kind", "error")


def fight() -> tuple[list[str], History]:
    history, found = History(), []

    async def test(plant: Plant) -> None:
        await plant.online()
        values = count(101)
        until_s = plant.now_s + 12.0
        fighters = [Controller(plant, name, history, values) for name in NAMES]
        fighters[0].take()
        LEASE.set(fighters[0].token)
        await plant.site.operations.verb("a", Verb.ENABLE)
        reads = [asyncio.ensure_future(busy(plant, until_s)) for _ in range(3)]
        async with anyio.create_task_group() as tasks:
            for fighter in fighters:
                tasks.start_soon(fighter.fight, until_s)
        await asyncio.gather(*reads)
        found.extend(violations(plant, history))

    with_plant(test, ROSTER)
    return found, history


async def busy(plant: Plant, until_s: float) -> None:
    """Keep the line in the middle of exchanges, so that writes wait."""
    while plant.now_s < until_s:
        await plant.site.operations.read("b", Code(150))


def test_only_the_newest_token_moves_the_drive() -> None:
    found, history = fight()
    assert found == []
    ends = set(history.ends.values())
    assert {Outcome.DONE.value, "lease-lost"} <= ends
    assert len(history.grants) > 20
    moved = {number for value, number in history.written.items() if history.ends[value] == "done"}
    assert len(moved) > 5, "each had its turn"


def test_the_checker_finds_writes_of_old_tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Request, "why_unwanted", lambda self, *, writes: "")
    found, _ = fight()
    assert found, "without the check before each telegram an old token moves the drive"
