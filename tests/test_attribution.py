"""No value is ever taken for another drive's, another code's or another time's.

Several drives are asked for the same codes while answers come late, damaged or not at all. Every
value says by itself which drive gave it, to which code and when; every write is looked up in what
the drive took. The same run without quarantine fails: that is what shows that this test bites.
"""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import anyio
import pytest

from lecombus.fieldbus.lecom.protocol.telegrams import ValueAnswer
from lecombus.fieldbus.loop_interface import ExchangeReport
from lecombus.line.worker import WorkerOptions
from lecombus.parameters import Format
from lecombus.schedule import Outcome
from support.site_host import Ended, Rig
from support.virtual_loop import run

pytestmark = pytest.mark.timeout(120)
"""Ten thousand exchanges each: 4 s of a processor, and far more where others want it too."""

logger = logging.getLogger(__name__)

FAULTS = "late=0.05:0.5s:{kind},noise=0.05,lost=0.02"
CODES = (50, 52, 61, 150)
"""Read from all drives; C0150 is a word by its description, the others are numbers."""

WRITTEN = {"93xx": (12,)}
WRITTEN_ELSEWHERE = (11, 12)
"""C0011 is a plain value and may be written again; C0012 is not described and may not."""

FAMILIES = ("8200vector", "821x", "93xx", "8200vector", "822x")
EXCHANGES = 10_000
EPOCH_S = 1000.0


def stamp(drive: int, code: int, now_s: float) -> str:
    """A value that says who gave it, to what and when (0.1 ms): 4 + 4 + 24 bits."""
    ticks = round((now_s - EPOCH_S) * 2000.0) & 0xFFFFFF
    return f"H{drive << 28 | CODES.index(code) << 24 | ticks:08X}"


@dataclass
class Tally:
    """What a run came to."""

    exchanges: int = 0
    values: int = 0
    wrong_drive: int = 0
    wrong_code: int = 0
    wrong_time: int = 0
    writes: dict[str, int] = field(default_factory=dict)
    false_writes: list[str] = field(default_factory=list)

    @property
    def wrong(self) -> int:
        return self.wrong_drive + self.wrong_code + self.wrong_time + len(self.false_writes)


def judge_value(tally: Tally, rig: Rig, report: ExchangeReport) -> None:
    answer = report.result.answer
    if type(answer) is not ValueAnswer or answer.value.format is not Format.VH:
        return
    raw = int(answer.value.raw[1:], 16)
    tally.values += 1
    station = rig.stations[report.drive]
    given_s = EPOCH_S + (raw & 0xFFFFFF) / 2000.0
    result = report.result
    if raw >> 28 != station.address:
        tally.wrong_drive += 1
    elif CODES[raw >> 24 & 0xF] != report.step.code.number:
        tally.wrong_code += 1
    elif not result.started_s - 0.001 <= given_s <= result.ended_s + 0.001:
        tally.wrong_time += 1


def judge_write(tally: Tally, rig: Rig, drive: str, code: int, text: str, ended: Ended) -> None:
    """Compare what a write was called with what the drive's own log says."""
    assert ended.outcome is not None, "a write without an end"
    tally.writes[ended.outcome.value] = tally.writes.get(ended.outcome.value, 0) + 1
    log = rig.line[drive].log
    taken = any((e.kind, e.code, e.text, e.accepted) == ("write", code, text, True) for e in log)
    claimed = ended.outcome in (Outcome.DONE, Outcome.VERIFIED)
    if (claimed and not taken) or (ended.outcome is Outcome.REFUSED and taken):
        tally.false_writes.append(f"{drive} {text} taken={taken}: {ended.outcome} {ended.reason}")


def make_talkative(rig: Rig) -> None:
    """Let every drive stamp its values with itself, the code and the time."""
    for drive in rig.line.drives:
        for code in CODES:
            drive.model.readers[code] = stamper(drive.address, code)


def stamper(address: int, code: int) -> Callable[[int], str]:
    return lambda subcode: stamp(address, code, asyncio.get_running_loop().time())


async def ask_for_long(
    *, quarantine: bool, seed: int, kind: str, baud: int, exchanges: int, latency_s: float = 0.0
) -> Tally:
    drives = [(f"d{n}", n, kind) for n, kind in enumerate(FAMILIES, start=1)]
    options = WorkerOptions(quarantine=quarantine)
    rig = Rig(
        drives, options=options, faults=FAULTS.format(kind=kind), seed=seed, baud=baud,
        spread=0.5, latency_s=latency_s,
    )  # fmt: skip
    make_talkative(rig)
    chance = random.Random(seed)
    tally = Tally()
    async with rig, anyio.create_task_group() as callers:
        for name, _, _ in drives:
            for _ in range(3):
                callers.start_soon(read_on, rig, name, chance, exchanges)
            callers.start_soon(write_on, rig, name, chance, exchanges, tally)
    for report in rig.seen.reports:
        judge_value(tally, rig, report)
    tally.exchanges = len(rig.seen.reports)
    return tally


async def read_on(rig: Rig, name: str, chance: random.Random, exchanges: int) -> None:
    while rig.worker.exchanges < exchanges:
        await rig.read(name, chance.choice(CODES)).done.wait()


async def write_on(
    rig: Rig, name: str, chance: random.Random, exchanges: int, tally: Tally
) -> None:
    """Write values none of which comes twice; some are out of range and refused by the drive."""
    count = 0
    while rig.worker.exchanges < exchanges:
        count += 1
        good = chance.random() < 0.9
        code = chance.choice(WRITTEN.get(rig.stations[name].family.name, WRITTEN_ELSEWHERE))
        text = f"{8 + count // 100}.{count % 100:02d}" if good else str(2000 + count)
        text = text.rstrip("0").rstrip(".") if "." in text else text
        ended = rig.write(name, code, text, verify=chance.random() < 0.3)
        await ended.done.wait()
        judge_write(tally, rig, name, code, text, ended)
        await anyio.sleep(chance.uniform(0.0, 0.3))


def tally_of(**how: object) -> Tally:
    settings = {"quarantine": True, "seed": 1, "kind": "adapter", "baud": 19200}
    settings |= {"exchanges": EXCHANGES} | how
    return run(ask_for_long(**settings))  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [1, 2])
def test_no_value_and_no_write_is_attributed_wrongly(seed: int) -> None:
    tally = tally_of(seed=seed)
    logger.info("%s", tally)
    assert tally.wrong == 0, tally
    assert tally.exchanges >= EXCHANGES
    assert tally.values > EXCHANGES / 2, "the run must have read much"
    assert tally.writes["done"] + tally.writes["verified"] > 100
    assert tally.writes["refused"] > 10, "the run must have had refusals"


def test_without_quarantine_the_same_run_attributes_wrongly() -> None:
    tally = tally_of(quarantine=False, seed=2)
    logger.info("%s", tally)
    assert tally.wrong_drive > 0
    assert tally.false_writes, "an old acknowledgement must have passed for a new one"


@pytest.mark.parametrize(
    ("kind", "baud", "latency_s"),
    [("stubborn", 19200, 0.016), ("drive", 9600, 0.0), ("adapter", 1200, 0.016)],
)
def test_nor_when_the_drive_is_late_or_the_line_slow_or_the_adapter_gathers_bytes(
    kind: str, baud: int, latency_s: float
) -> None:
    tally = tally_of(kind=kind, baud=baud, latency_s=latency_s, seed=5, exchanges=2000)
    assert tally.wrong == 0, tally
    assert tally.values > 1000
