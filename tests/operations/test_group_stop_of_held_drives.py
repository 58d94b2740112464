"""A group's stop where something else holds most of its members.

Each of these gets a telegram of its own behind the multicast, because its readings would not show
that it heard it. That must cost no other drive its watchdog, and no member that runs its stop.
"""

from __future__ import annotations

import anyio
import pytest

from lecombus.drives import StopAction, Verb
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

NAMES = [f"d{number}" for number in range(1, 10)]


def written(plant: Plant, address: int, since_s: float) -> list[float]:
    """Return when an address was written to."""
    telegrams = (one for one in plant.end.sent if one.at_s >= since_s)
    begin = b"\x04%d\x02" % address
    return [one.at_s for one in telegrams if one.data.startswith(begin)]


def roster(family: str, baud: int, time: str) -> str:
    drives = [(name, 10 + int(name[1:]), family) for name in NAMES]
    return roster_text(
        [*drives, ("other", 21, "8200vector")],
        baud=baud,
        drive="cyclic: [{code: C0150, every: 5s}]",
        own={"other": f"watchdog: {{time: {time}, action: quick-stop, configure: yes}}"},
        sections=f"groups:\n  nine: {{members: [{', '.join(NAMES)}]}}\n",
    )


@pytest.mark.parametrize(
    ("family", "baud", "time"),
    [("820x", 9600, "2s"), ("820x", 4800, "2s"), ("8200vector", 9600, "1s"),
     ("8200vector", 2400, "2s")],
)  # fmt: skip
def test_the_watchdog_of_a_drive_outside_does_not_act(family: str, baud: int, time: str) -> None:
    async def test(plant: Plant) -> None:
        for name in NAMES:
            plant.line[name].set_terminal(high=False)
        await plant.online()
        await anyio.sleep(30.0)
        report = await plant.site.operations.stop(StopAction.INHIBIT, "nine")
        assert (report.outcome, report.how) == (Outcome.VERIFIED, "multicast")
        await anyio.sleep(3.0)
        plant.line.advance(plant.now_s)
        assert plant.line["other"].watchdog_fired == 0
        for name in NAMES:  # each heard a telegram of its own
            plant.line[name].set_terminal(high=True)
            assert plant.line[name].model.inhibited()

    with_plant(test, roster(family, baud, time))


def test_a_member_that_runs_and_missed_the_multicast_is_stopped_before_the_others() -> None:
    async def test(plant: Plant) -> None:
        for name in NAMES[:-1]:
            plant.line[name].set_terminal(high=False)
        await plant.online()
        await anyio.sleep(30.0)
        assert (await plant.site.operations.verb(NAMES[-1], Verb.ENABLE)).outcome.is_good
        plant.line.drive_faults[19] = Faults(unheard=1.0)
        begin_s = plant.now_s

        async def heals() -> None:
            await until(lambda: written(plant, 10, begin_s) != [])
            await anyio.sleep(0.05)
            plant.line.drive_faults[19] = Faults()

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(heals)
            report = await plant.site.operations.stop(StopAction.INHIBIT, "nine")
            assert report.outcome is Outcome.VERIFIED
        to_others = [written(plant, address, begin_s)[0] for address in range(11, 19)]
        assert written(plant, 19, begin_s)[0] < min(to_others)

    with_plant(test, roster("820x", 9600, "3s"))


def test_where_the_multicast_is_not_sent_no_member_waits_for_feeds_as_behind_it() -> None:
    """One member's control word turns out to be another one while the multicast waits."""

    async def test(plant: Plant) -> None:
        await plant.online()
        for name in NAMES:
            plant.line[name].model.write_control_word("H0008")
            for code in (135, 68):
                assert (await plant.site.operations.read(name, Code(code))).value
        plant.line["d1"].model.write_control_word("H000C")
        schedule = plant.site.requests.worker.schedule
        waits_for_feeds = list[bool]()

        async def look() -> None:
            await until(lambda: len(list(schedule.stops())) == len(NAMES) + 1)
            waits_for_feeds.append(all(one.yields for one in schedule.stops() if not one.members))
            await until(lambda: not any(one.members for one in schedule.stops()))
            waits_for_feeds.append(any(one.yields for one in schedule.stops()))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(plant.site.operations.read, "d1", Code(135))
            sent = len(plant.end.sent)
            await until(lambda: len(plant.end.sent) > sent)
            tasks.start_soon(look)
            report = await plant.site.operations.stop(StopAction.QUICK_STOP, "nine")
        assert report.outcome is Outcome.VERIFIED
        assert waits_for_feeds == [True, False]
        assert not [one for one in plant.end.sent if one.data[1:3] == b"10"], "no multicast"

    with_plant(test, roster("820x", 9600, "2s"))
