"""What is refused again and again is counted, and what is permitted then is carried out."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import anyio
import pytest

from lecombus.api.answers import RefusedRequestError
from lecombus.api.refusals import FEW, MANY, WINDOW_S, AskedWrite, Refusals
from lecombus.drives import StopAction, Verb
from lecombus.errors import LecombusError
from lecombus.operations.actions import Act
from lecombus.operations.lease_operations import LEASE
from lecombus.parameters import Code
from support.rosters import roster_text
from support.site_host import Plant, with_plant

ROSTER = roster_text(
    [("a", 11, "8200vector"), ("b", 12, "8200vector")], drive="also_writable: [C0012]",
    own={"b": "lease: {required: true, time: 5s, on_lapse: quick-stop}"},
)  # fmt: skip


class Books:
    """A journal that counts, and a follower of operations that counts those that began."""

    def __init__(self, plant: Plant) -> None:
        self.begun_: list[str] = []
        self.counted: list[tuple[str, str, Mapping[str, str]]] = []
        self.ops = plant.site.operations
        self.ops.actions.followers += (self,)
        journal: Any = self
        self.refusals = Refusals(lambda: plant.now_s, self.ops, journal)

    def begun(self, act: Act) -> Awaitable[None] | None:
        self.begun_.append(act.target)
        return None

    def ended(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        pass

    def count(self, kind: str, drive: str, fields: Mapping[str, str], who: str) -> None:
        assert who
        self.counted.append((kind, drive, fields))

    async def write(self, drive: str, code: int, value: int | str) -> str:
        asked = AskedWrite(drive, Code(code), value)
        return await ended(lambda: self.refusals.write(
            "write", asked, lambda: self.ops.write(drive, Code(code), value)
        ))  # fmt: skip

    async def verb(self, drive: str, verb: Verb, **more: Any) -> str:
        return await ended(lambda: self.refusals.verb(
            drive, verb, lambda: self.ops.verb(drive, verb, **more)
        ))  # fmt: skip


async def ended(act: Callable[[], Awaitable[Any]]) -> str:
    try:
        return str((await act()).outcome)
    except RefusedRequestError as exc:
        return exc.problem.kind
    except LecombusError as exc:
        return str(getattr(exc, "kind", exc))


def with_books(test: Callable[[Plant, Books], Awaitable[None]]) -> None:
    async def run(plant: Plant) -> None:
        await plant.online()
        await test(plant, Books(plant))

    with_plant(run, ROSTER)


@pytest.mark.parametrize(("drive", "kind"), [("a", "not-writable"), ("x", "no-such-drive")])
def test_of_equal_refusals_a_few_begin_and_the_others_are_counted(drive: str, kind: str) -> None:
    async def test(plant: Plant, books: Books) -> None:
        assert {await books.write(drive, 37, 5) for _ in range(200)} == {kind}
        assert len(books.begun_) == FEW
        assert len(books.counted) == 200 - FEW
        assert books.counted[0][:2] == ("write", drive)
        assert books.counted[0][2]["code"] == "C0037"
        await anyio.sleep(WINDOW_S)
        assert await books.write(drive, 37, 5) == kind
        assert len(books.begun_) == FEW + 1, "a minute later a few begin again"

    with_books(test)


def test_what_is_permitted_meanwhile_is_carried_out_at_the_next_request() -> None:
    async def test(plant: Plant, books: Books) -> None:
        async def tried() -> tuple[str, str]:
            speed = books.verb("b", Verb.SET_SPEED, value=20, unit="Hz")
            return await books.write("b", 46, 20), await speed

        for _ in range(4 * MANY):
            assert await tried() == ("lease-required", "lease-required")
        LEASE.set(books.ops.leases.take("plc", ["b"], ["b"], 5.0, 1).token)
        assert await tried() == ("latched", "latched")
        await books.ops.stop(StopAction.QUICK_STOP, "b")
        assert await tried() == ("done", "done")
        assert await books.verb("b", Verb.ENABLE) == "verified"

    with_books(test)


def test_refusals_that_need_the_drive_are_answered_429_until_the_window_is_over() -> None:
    async def test(plant: Plant, books: Books) -> None:
        plant.trip("a", 50)
        await anyio.sleep(5.0)
        found = [await books.verb("a", Verb.ENABLE) for _ in range(MANY + 10)]
        assert found == ["fault-active"] * MANY + ["too-many-refusals"] * 10
        assert len(books.begun_) == MANY
        assert await books.verb("a", Verb.RESET_FAULT) == "verified", "it is counted apart"
        assert await books.write("a", 46, 10) == "done"
        await anyio.sleep(WINDOW_S)
        assert await books.verb("a", Verb.ENABLE) == "verified"

    with_books(test)


def test_a_plain_write_that_stops_and_what_another_client_asks_are_not_counted() -> None:
    async def test(plant: Plant, books: Books) -> None:
        for _ in range(2 * MANY):
            await books.write("a", 37, 5)
        assert await books.write("a", 40, 0) == "done"
        assert await books.write("b", 40, 0) == "done"
        assert len(books.begun_) == FEW + 2

    with_books(test)
