"""When what waits is called back, and how late that was."""

from __future__ import annotations

import asyncio

from lecombus.line.timers import Lateness, WakeableSleep, WakeableTimer
from support.virtual_loop import run


def test_the_most_is_taken_once() -> None:
    lateness = Lateness()
    for late_s in (0.001, 0.004, -2.0, 0.003):
        lateness.note(late_s)
    assert (lateness.take_s(), lateness.take_s()) == (0.004, 0.0)


def test_who_is_nudged_early_or_woken_in_time_is_not_late() -> None:
    async def main() -> None:
        lateness, loop = Lateness(), asyncio.get_running_loop()
        nap = WakeableSleep(lateness)
        loop.call_later(1.0, nap.nudge)
        await nap.until(loop.time() + 5.0)
        await nap.until(loop.time() + 0.5)
        assert lateness.take_s() == 0.0
        await nap.until(loop.time() - 0.25)
        assert lateness.take_s() == 0.25

    run(main(), limit_s=60.0)


class Paused:
    """A pause, and the times at which it called back."""

    def __init__(self) -> None:
        self.lateness = Lateness()
        self.pause = WakeableTimer(self._over, self.lateness)
        self.at_s: list[float] = []

    def _over(self) -> None:
        self.at_s.append(asyncio.get_running_loop().time())

    async def run(self, *, deaf: bool, nudges: tuple[float, ...] = ()) -> float:
        """Pause for a second, nudged at some times; gives how long that took."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        self.pause.until(began_s + 1.0, deaf=deaf)
        for after_s in nudges:
            loop.call_later(after_s, self.pause.nudge)
        await asyncio.sleep(2.0)
        (at_s,) = self.at_s
        self.at_s.clear()
        return at_s - began_s


def test_a_pause_calls_back_once_at_its_time_or_when_nudged_unless_it_is_deaf() -> None:
    async def main() -> None:
        paused = Paused()
        assert await paused.run(deaf=False) == 1.0
        assert await paused.run(deaf=False, nudges=(0.25, 0.25, 0.5)) == 0.25
        assert await paused.run(deaf=True, nudges=(0.25,)) == 1.0
        assert paused.lateness.take_s() == 0.0

    run(main(), limit_s=60.0)


def test_a_nudge_calls_back_from_the_loop_and_not_from_inside() -> None:
    async def main() -> None:
        paused = Paused()
        paused.pause.until(asyncio.get_running_loop().time() + 1.0)
        paused.pause.nudge()
        assert paused.at_s == []
        assert paused.pause.is_on
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert len(paused.at_s) == 1
        assert not paused.pause.is_on

    run(main(), limit_s=60.0)


def test_a_pause_that_was_cleared_calls_nobody_even_when_it_was_nudged_before() -> None:
    async def main() -> None:
        paused = Paused()
        paused.pause.until(asyncio.get_running_loop().time() + 1.0)
        paused.pause.nudge()
        paused.pause.clear()
        paused.pause.nudge()
        await asyncio.sleep(2.0)
        assert paused.at_s == []

    run(main(), limit_s=60.0)


def test_a_pause_whose_time_had_passed_before_it_began_is_late() -> None:
    async def main() -> None:
        paused = Paused()
        paused.pause.until(asyncio.get_running_loop().time() - 0.25)
        await asyncio.sleep(1.0)
        assert paused.lateness.take_s() == 0.25

    run(main(), limit_s=60.0)
