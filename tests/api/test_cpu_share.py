"""What comes over TCP is begun one client after the other, and rests in between."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from itertools import pairwise

import anyio
import pytest

from lecombus.api.tcp_connection import LONGEST_REST_S, CpuShare, fairest

pytestmark = [pytest.mark.anyio, pytest.mark.clock]


class Processor:
    """A clock of processor time that only tests move."""

    def __init__(self) -> None:
        self.used_s = 0.0

    def __call__(self) -> float:
        return self.used_s

    def piece(self, seconds: float, then: Callable[[], object]) -> Callable[[], None]:
        def begin() -> None:
            self.used_s += seconds
            then()

        return begin


async def until(holds: Callable[[], bool]) -> None:
    for _ in range(10_000):
        if holds():
            return
        await anyio.sleep(0.001)
    pytest.fail("never")


async def test_after_a_piece_nothing_is_begun_for_several_times_as_long() -> None:
    processor, begun = Processor(), list[float]()
    share, now = CpuShare(0.25, processor), asyncio.get_running_loop().time
    for client in range(4):
        share.take(client, processor.piece(0.005, lambda: begun.append(now())))
    assert begun == [], "never at once"
    await until(lambda: len(begun) == 4)
    rests = [late - early for early, late in pairwise(begun)]
    assert min(rests) >= 0.02 - 1e-6


async def test_clients_take_turns_however_much_one_of_them_asks() -> None:
    begun: list[str] = []
    share = CpuShare(1.0, Processor())
    for name in ("greedy",) * 3 + ("other",) * 2:
        share.take(name, lambda name=name: begun.append(name))  # type: ignore[misc]
    await until(lambda: len(begun) == 5)
    assert begun == ["greedy", "other", "greedy", "other", "greedy"]


async def test_nothing_is_begun_for_who_is_gone_and_nothing_of_them_is_kept() -> None:
    begun: list[str] = []
    share = CpuShare(1.0, Processor())
    for name in ("gone", "gone", "here"):
        share.take(name, lambda name=name: begun.append(name))  # type: ignore[misc]
    share.forget("gone")
    for _ in range(5):
        await asyncio.sleep(0)
    assert begun == ["here"]
    assert not share._waiting


async def test_every_step_of_a_request_under_way_counts_and_waiting_does_not() -> None:
    processor, begun = Processor(), list[float]()
    share, now = CpuShare(0.5, processor), asyncio.get_running_loop().time

    async def answer() -> None:
        for _ in range(3):
            processor.used_s += 0.01
            await asyncio.sleep(0)
        await asyncio.sleep(0.05)

    began_s = now()
    await share.timed(answer())
    assert processor.used_s == pytest.approx(0.03)
    share.take("next", lambda: begun.append(now()))
    await until(lambda: bool(begun))
    assert begun[0] - began_s >= 0.06 - 1e-6


async def test_being_cancelled_and_failing_reach_the_request() -> None:
    share, seen = CpuShare(1.0, Processor()), list[str]()

    async def waits() -> None:
        try:
            await anyio.sleep_forever()
        finally:
            seen.append("ended")

    async def fails() -> None:
        raise ValueError("wrong")

    async with anyio.create_task_group() as tasks:

        async def run() -> None:
            await share.timed(waits())

        tasks.start_soon(run)
        await anyio.sleep(0.01)
        tasks.cancel_scope.cancel()
    assert seen == ["ended"]
    with pytest.raises(ValueError, match="wrong"):
        await share.timed(fails())


async def test_the_longest_piece_keeps_nobody_waiting_for_ever() -> None:
    share = CpuShare(0.001, Processor())
    share.spend(1000.0)
    begun: list[float] = []
    began_s = asyncio.get_running_loop().time()
    share.take("next", lambda: begun.append(asyncio.get_running_loop().time()))
    await until(lambda: bool(begun))
    assert begun[0] - began_s >= LONGEST_REST_S - 0.01


async def test_connections_opened_without_end_and_clients_have_turns_by_turns() -> None:
    begun: list[str] = []
    share = CpuShare(1.0, Processor())

    def opened() -> None:
        begun.append("opened")
        if begun.count("opened") < 4:
            share.open(opened)

    share.open(opened)
    for _ in range(2):
        share.take("client", lambda: begun.append("client"))
    await until(lambda: len(begun) == 6)
    assert begun == ["opened", "client", "opened", "client", "opened", "opened"]


async def test_what_is_counted_postpones_the_next_turn_also_after_an_error() -> None:
    processor, begun = Processor(), list[float]()
    share, now = CpuShare(0.5, processor), asyncio.get_running_loop().time
    began_s = now()
    with contextlib.suppress(ValueError), share.counting():
        processor.used_s += 0.02
        raise ValueError
    share.open(lambda: begun.append(now()))
    await until(lambda: bool(begun))
    assert begun[0] - began_s >= 0.04 - 1e-6


class Waiting:
    """A client as the choice sees it."""

    def __init__(self, address: str, *, known: bool = False) -> None:
        self.address, self.is_known = address, known


def test_the_next_turn_is_that_of_a_known_client_then_of_the_address_with_fewest() -> None:
    flood = [Waiting("192.0.2.66") for _ in range(5)]
    other, plc = Waiting("192.0.2.2"), Waiting("192.0.2.66", known=True)
    assert fairest([*flood, other, plc]) is plc
    assert fairest([*flood, other]) is other
    assert fairest(flood) is flood[0]
