import asyncio
import time

import pytest

from support.virtual_loop import DeadlockError, TimeLimitError, run


def test_an_hour_passes_at_once_and_exactly() -> None:
    async def main() -> float:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        await asyncio.sleep(3600)
        return loop.time() - start_s

    began_s = time.monotonic()
    assert run(main()) == 3600
    assert time.monotonic() - began_s < 5


def test_timers_fire_in_order_at_their_own_time() -> None:
    async def main() -> list[tuple[str, float]]:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        seen: list[tuple[str, float]] = []
        done = loop.create_future()
        loop.call_at(start_s + 0.3, lambda: seen.append(("late", loop.time())))
        loop.call_at(start_s + 0.1, lambda: seen.append(("early", loop.time())))
        loop.call_at(start_s + 0.3, lambda: done.set_result(0))
        await done
        return [(name, round(at_s - start_s, 9)) for name, at_s in seen]

    assert run(main()) == [("early", 0.1), ("late", 0.3)]


def test_a_timer_never_fires_before_its_time() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        for n in range(2000):
            due_s = loop.time() + 0.1 / (n + 3)
            await asyncio.sleep(due_s - loop.time())
            future: asyncio.Future[float] = loop.create_future()
            due_s = loop.time() + 0.1 / (n + 7)
            loop.call_at(due_s, lambda future=future: future.set_result(loop.time()))  # type: ignore[misc]
            assert await future >= due_s

    run(main())


def test_waiting_for_nothing_is_a_deadlock() -> None:
    async def main() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(DeadlockError):
        run(main())


def test_endless_timers_hit_the_limit() -> None:
    async def main() -> None:
        for _ in range(1000):
            await asyncio.sleep(1)

    with pytest.raises(TimeLimitError):
        run(main(), limit_s=100)


def test_cancelled_timers_do_not_stop_time() -> None:
    async def main() -> float:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        loop.call_later(1, lambda: None).cancel()
        await asyncio.sleep(2)
        return loop.time() - start_s

    assert run(main()) == 2
