"""A drive far slower than its manual is listened for, and nothing that matters waits for that."""

from __future__ import annotations

import anyio
import pytest

from lecombus.drive_state.readings import DriveState
from lecombus.drives import StopAction
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from lecombus.schedule.shares import LISTEN_S
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

TWO = [("a", 1, "8200vector"), ("b", 2, "8200vector")]
STATUS, ADDRESS = Code(150), Code(9)
BUSY = "cyclic: [{code: C0150, every: 100ms}, {code: C0046, every: 100ms}]"
"""More than the line can hold: it is never idle by itself."""
ROSTER = roster_text(TWO, drive=BUSY)
QUARANTINE_S = 0.06
MANUAL_S = 0.12
"""A time-out by the manual at this baud rate, quarantine included."""


def slow_down(plant: Plant, drive: str, to_s: float, *, code: int | None = None) -> None:
    """Let a drive think so long about every read, or about one code."""
    model = plant.line[drive].model
    usual = model.think_s

    def think_s(number: int, *, write: bool, now_s: float) -> float:
        slow = code in (None, number) and not write
        return to_s if slow else usual(number, write=write, now_s=now_s)

    model.think_s = think_s  # type: ignore[method-assign]


def is_listening(plant: Plant) -> bool:
    """Whether this busy line is silent after an exchange failed, for longer than it must be."""
    last = plant.reports[-1].result
    failed = last.kind is ResultKind.NO_REPLY and last.started_s >= plant.end.sent[-1].at_s
    return failed and last.ended_s + QUARANTINE_S < plant.now_s < last.started_s + LISTEN_S - 0.2


@pytest.mark.parametrize("addressing", ["both", "standard"])
def test_a_code_that_takes_most_of_a_second_is_learnt_on_a_busy_line(addressing: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        slow_down(plant, "b", 0.9, code=150)
        await anyio.sleep(60.0)
        settled_s = plant.now_s
        await anyio.sleep(30.0)
        assert plant.misses("b", settled_s) == 0
        assert plant.misses("a", 0.0) == 0
        assert plant.state("b") is DriveState.ONLINE
        for drive, address in (("a", "1"), ("b", "2")):
            reading = await plant.site.operations.read(drive, ADDRESS)
            assert reading.value is not None
            assert reading.value.raw.strip() == address

    with_plant(test, roster_text(TWO, drive=f"{BUSY}, addressing: {addressing}"))


def test_a_drive_that_takes_half_a_second_for_everything_comes_online() -> None:
    async def test(plant: Plant) -> None:
        slow_down(plant, "b", 0.5)
        await until(lambda: plant.state("b") is DriveState.ONLINE, within_s=400.0)
        settled_s = plant.now_s
        await anyio.sleep(60.0)
        assert plant.misses("b", settled_s) == 0

    with_plant(test, ROSTER)


def test_a_stop_and_a_read_wait_for_no_listening() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        slow_down(plant, "b", 5.0, code=150)
        await until(lambda: is_listening(plant), within_s=60.0)
        began_s = plant.now_s
        await plant.site.operations.read("a", ADDRESS)
        assert plant.now_s - began_s < 0.05
        await until(lambda: is_listening(plant), within_s=60.0)
        began_s, said = plant.now_s, len(plant.end.sent)
        report = await plant.site.operations.stop(StopAction.INHIBIT, "a")
        assert report.outcome is Outcome.VERIFIED
        assert plant.end.sent[said].at_s - began_s < 0.01

    with_plant(test, ROSTER)


def test_a_watchdog_that_presses_ends_the_listening_and_is_fed() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        fired = plant.line["a"].watchdog_fired
        slow_down(plant, "b", 5.0, code=150)
        await anyio.sleep(300.0)
        assert plant.line["a"].watchdog_fired == fired
        assert plant.site.schedule.stats(plant.now_s).feeds["a"].lapses == 0

    own = {
        "a": "cyclic: [], watchdog: {time: 1500ms, action: inhibit, configure: true}",
        "b": "cyclic: [{code: C0150, every: 100ms}]",
    }
    with_plant(test, roster_text(TWO, own=own))


def test_a_stop_waits_for_a_slow_drive_s_reading_no_longer_than_for_a_quick_one_s() -> None:
    async def test(plant: Plant) -> None:
        await plant.online(within_s=60.0)
        slow_down(plant, "b", 0.9, code=150)
        await anyio.sleep(60.0)
        station = plant.site.requests.station("b")
        assert station.answer_s(STATUS) == 0.5
        waited = []
        for tenth in range(10):
            await until(lambda: plant.is_asking(b"\x0402"), within_s=10.0)
            await anyio.sleep(0.05 * tenth)
            began_s, said = plant.now_s, len(plant.end.sent)
            report = await plant.site.operations.stop(StopAction.INHIBIT, "a")
            assert report.outcome is Outcome.VERIFIED
            waited.append(plant.end.sent[said].at_s - began_s)
        assert max(waited) < MANUAL_S
        # The reading comes all the same when no stop is there.
        await plant.online(within_s=60.0)  # ten stops may have cut its readings four times in a row
        assert (await plant.site.operations.read("b", STATUS)).value is not None

    with_plant(test, ROSTER)


def test_a_drive_that_is_away_costs_the_others_little() -> None:
    async def test(plant: Plant) -> None:
        plant.line["b"].present = False
        await anyio.sleep(60.0)
        before, began_s = len(plant.reports), plant.now_s
        listened_s = 0.0
        for _ in range(12_000):
            await anyio.sleep(0.05)
            listened_s += 0.05 if is_listening(plant) else 0.0
        rate = (len(plant.reports) - before) / (plant.now_s - began_s)
        assert 0.0 < listened_s < 4.0
        assert rate > 20.0

    with_plant(test, ROSTER)
