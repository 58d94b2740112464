"""One thing begins in each turn of the loop, in the order of asking."""

from __future__ import annotations

import asyncio

import pytest

from lecombus.api.connection import StartQueue

pytestmark = pytest.mark.anyio


async def test_who_comes_alone_begins_at_once() -> None:
    begun: list[int] = []
    queue = StartQueue()
    queue.take(lambda: begun.append(1))
    assert begun == [1]
    await asyncio.sleep(0)
    queue.take(lambda: begun.append(2))
    assert begun == [1, 2]


async def test_a_crowd_begins_one_by_one_and_the_loop_turns_between() -> None:
    begun: list[int] = []
    queue = StartQueue()
    for number in range(20):
        queue.take(lambda number=number: begun.append(number))  # type: ignore[misc]
    counts = []
    while len(begun) < 20:
        counts.append(len(begun))
        await asyncio.sleep(0)
    assert begun == list(range(20))
    assert counts == list(range(1, 20))


async def test_a_renewal_of_a_lease_begins_before_all_that_wait() -> None:
    begun: list[int] = []
    queue = StartQueue()
    for number in range(5):
        queue.take(lambda number=number: begun.append(number))  # type: ignore[misc]
    queue.take(lambda: begun.append(99), first=True)
    for _ in range(10):
        await asyncio.sleep(0)
    assert begun == [0, 99, 1, 2, 3, 4]
