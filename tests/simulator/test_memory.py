"""The line in memory, on virtual time."""

from __future__ import annotations

import asyncio

import pytest

from lecombus.errors import LineLostError
from lecombus.fieldbus.lecom.simulator import MemoryEnd, MemoryPort, SimLine, build
from lecombus.fieldbus.lecom.simulator.wire import PARITY_TABLE
from support.sim_host import read_telegram
from support.virtual_loop import run

READ = read_telegram(11, 46).translate(PARITY_TABLE)
GOOD = bytes.fromhex("02 34 36 30 03").translate(PARITY_TABLE)


class Ear:
    def __init__(self) -> None:
        self.heard: list[tuple[float, bytes]] = []
        self.losses: list[Exception | None] = []

    def received(self, data: bytes) -> None:
        self.heard.append((asyncio.get_running_loop().time(), data))

    def lost(self, exc: Exception | None) -> None:
        self.losses.append(exc)

    @property
    def text(self) -> bytes:
        return b"".join(data for _, data in self.heard)


def line() -> SimLine:
    return build([("a", 11, "822x"), ("b", 12, "822x")], baud=9600)


def test_answers_arrive_byte_by_byte_at_their_time() -> None:
    async def main() -> None:
        ear = Ear()
        port = await MemoryEnd(line()).open(None, ear)
        start_s = asyncio.get_running_loop().time()
        port.write(READ)
        await asyncio.sleep(0.1)
        assert ear.text[:-1] == GOOD
        for place, (at_s, data) in enumerate(ear.heard):
            assert len(data) == 1
            assert at_s - start_s == pytest.approx(0.020 + (7 + place) * 10 / 9600)

    run(main())


def test_a_latency_timer_gathers_bytes() -> None:
    async def main() -> None:
        ear = Ear()
        port = await MemoryEnd(line(), latency_s=0.016).open(None, ear)
        start_s = asyncio.get_running_loop().time()
        port.write(READ)
        await asyncio.sleep(0.1)
        assert ear.text[:-1] == GOOD
        assert len(ear.heard) == 1
        assert ear.heard[0][0] - start_s <= 0.020 + 12 * 10 / 9600 + 0.016 + 1e-9

    run(main())


def test_after_abort_the_port_says_nothing() -> None:
    async def main() -> None:
        ear = Ear()
        end = MemoryEnd(line())
        port = await end.open(None, ear)
        port.write(READ)
        port.abort()
        port.abort()
        end.unplug()
        await asyncio.sleep(1)
        assert ear.heard == []
        assert ear.losses == []
        with pytest.raises(LineLostError):
            port.write(READ)

    run(main())


def test_unplugging_is_told_once_and_opening_fails_until_replugged() -> None:
    async def main() -> None:
        ear = Ear()
        end = MemoryEnd(line())
        port = await end.open(None, ear)
        port.write(READ)
        end.unplug()
        end.unplug()
        assert ear.losses == [], "lost is called from the loop, not from inside unplug"
        await asyncio.sleep(1)
        assert [type(loss) for loss in ear.losses] == [LineLostError]
        assert ear.heard == []
        with pytest.raises(LineLostError):
            await end.open(None, ear)
        end.replug()
        port = await end.open(None, ear)
        port.write(READ)
        await asyncio.sleep(1)
        assert ear.text[:-1] == GOOD
        assert end.opened == 2

    run(main())


def test_an_abort_inside_received_is_respected() -> None:
    async def main() -> None:
        class Impatient(Ear):
            def received(self, data: bytes) -> None:
                super().received(data)
                port.abort()

        ear = Impatient()
        port: MemoryPort = await MemoryEnd(line()).open(None, ear)
        port.write(READ)
        await asyncio.sleep(1)
        assert len(ear.heard) == 1

    run(main())


def test_discarding_drops_what_waits_in_the_adapter() -> None:
    async def main() -> None:
        ear = Ear()
        port = await MemoryEnd(line(), latency_s=0.016).open(None, ear)
        port.write(READ)
        await asyncio.sleep(0.020 + 12 * 10 / 9600 + 0.001)
        port.discard_input()
        await asyncio.sleep(1)
        assert ear.heard == []

    run(main())


def test_ten_thousand_exchanges_take_no_real_time() -> None:
    async def main() -> int:
        ear = Ear()
        port = await MemoryEnd(build([("a", 11, "822x")], paced=False)).open(None, ear)
        for _ in range(2000):
            port.write(READ)
            await asyncio.sleep(0.030)
        return len(ear.heard)

    assert run(main()) == 2000
