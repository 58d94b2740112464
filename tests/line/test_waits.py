"""How late what waits for a time was woken."""

from __future__ import annotations

import asyncio

from lecombus.line.waits import Lateness, Nap
from support.virtual_loop import run


def test_the_most_is_taken_once() -> None:
    lateness = Lateness()
    for late_s in (0.001, 0.004, -2.0, 0.003):
        lateness.note(late_s)
    assert (lateness.take_s(), lateness.take_s()) == (0.004, 0.0)


def test_who_is_nudged_early_or_woken_in_time_is_not_late() -> None:
    async def main() -> None:
        lateness, loop = Lateness(), asyncio.get_running_loop()
        nap = Nap(lateness)
        loop.call_later(1.0, nap.nudge)
        await nap.until(loop.time() + 5.0)
        await nap.until(loop.time() + 0.5)
        assert lateness.take_s() == 0.0
        await nap.until(loop.time() - 0.25)
        assert lateness.take_s() == 0.25

    run(main(), limit_s=60.0)
