"""The event loop keeps fractions of a millisecond, and still does all a loop must do."""

from __future__ import annotations

import asyncio
import os
import resource
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import anyio
import pytest

from lecombus.line.event_loop import FineSelector, new_event_loop, run

pytestmark = pytest.mark.clock


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    made = new_event_loop()
    yield made
    made.close()


async def _lateness(delay_s: float, times: int) -> list[float]:
    loop = asyncio.get_running_loop()
    late = []
    for _ in range(times):
        fired: asyncio.Future[float] = loop.create_future()
        asked = loop.time()
        loop.call_later(delay_s, lambda: fired.set_result(loop.time()))  # noqa: B023
        late.append(await fired - asked - delay_s)
    return late


@pytest.mark.parametrize("delay_s", [0.0005, 0.0026, 0.0036])
def test_a_timer_between_milliseconds_is_not_rounded_up(
    loop: asyncio.AbstractEventLoop, delay_s: float
) -> None:
    """Epoll alone is 0.4 ms late at best here, whatever the machine: it counts milliseconds."""
    late = sorted(loop.run_until_complete(_lateness(delay_s, 60)))
    assert late[len(late) // 10] < 0.00035


@pytest.mark.parametrize("delay_s", [0.0, 0.0005, 0.002, 0.003, 0.0041, 0.02])
def test_a_timer_is_never_early(loop: asyncio.AbstractEventLoop, delay_s: float) -> None:
    late = loop.run_until_complete(_lateness(delay_s, 20))
    assert min(late) > -1e-6, "asyncio itself runs timers one clock tick early at most"


def test_waiting_for_a_timer_does_not_spin(loop: asyncio.AbstractEventLoop) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF)
    loop.run_until_complete(asyncio.sleep(0.3))
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.1


def test_timers_below_a_millisecond_do_not_spin(loop: asyncio.AbstractEventLoop) -> None:
    began, used = time.monotonic(), time.process_time()
    loop.run_until_complete(_lateness(0.0009, 300))
    assert time.process_time() - used < 0.5 * (time.monotonic() - began)


@pytest.mark.parametrize("timeout", [None, 0.0005, 0.002, 0.004, 5.0])
def test_a_descriptor_that_is_ready_ends_the_wait(timeout: float | None) -> None:
    read_end, write_end = os.pipe()
    selector = FineSelector()
    try:
        key = selector.register(read_end, 1, "mine")
        os.write(write_end, b"x")
        assert selector.select(timeout) == [(key, 1)]
    finally:
        selector.close()
        os.close(read_end)
        os.close(write_end)


@pytest.mark.parametrize("timeout", [-1.0, 0.0, 0.0005, 0.004])
def test_nothing_ready_gives_an_empty_list(timeout: float) -> None:
    with FineSelector() as selector:
        assert selector.select(timeout) == []


def test_past_1024_descriptors_the_plain_way_is_taken() -> None:
    """`select` raises for such a descriptor: the selector must not use it then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 1200
    if hard != resource.RLIM_INFINITY:
        assert hard >= wanted, "this machine allows too few open files for the test"
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))
    opened: list[int] = []
    try:
        while not opened or opened[-1] < 1030:
            opened.append(os.open(os.devnull, os.O_RDONLY))
        with FineSelector() as selector:
            assert not selector.fine
            assert selector.select(0.0005) == []
    finally:
        for fd in opened:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_run_gives_anyio_code_a_fine_loop_and_its_result() -> None:
    async def main(word: str) -> tuple[str, bool]:
        with anyio.fail_after(5):
            await anyio.sleep(0.001)
        selector = asyncio.get_running_loop()._selector  # type: ignore[attr-defined]
        return word, isinstance(selector, FineSelector) and selector.fine

    assert run(main, "done") == ("done", True)


def test_run_asks_the_kernel_for_prompt_timers() -> None:
    run(anyio.sleep, 0)
    assert Path("/proc/self/timerslack_ns").read_text(encoding="ascii").strip() == "1000"


def test_the_median_timer_of_2_ms_is_far_below_a_millisecond_late() -> None:
    async def main() -> float:
        return statistics.median(await _lateness(0.002, 80))

    assert run(main) < 0.0007
