"""A reload on a running line: what it does not concern is not touched, and no deadline slips."""

from __future__ import annotations

from itertools import pairwise

import anyio
import pytest

from lecombus.drive_state.readings import DriveState, Quality
from lecombus.drives import StopAction
from lecombus.fieldbus.requests import StepKind
from lecombus.parameters import Code
from lecombus.schedule import Priority
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DRIVES = [(name, address, "8200vector") for address, name in enumerate("abcdef", 11)]
NAMES = "abcdef"
STATUS, OUTPUT = Code(150), Code(52)
WATCHDOG_S = 2.0
GUARD = "{time: 2s, action: quick-stop, configure: true}"


def roster(cyclic: str, *, more: str = "", guard: str = GUARD) -> str:
    return roster_text(DRIVES, watchdog=guard, drive=f"cyclic: [{cyclic}]{more}")


EVERY_2_S = "{code: C0150, every: 2s}"
BEFORE = roster(EVERY_2_S)


def longest_silence_s(plant: Plant, since_s: float) -> float:
    """How long a drive was not spoken to at most, from one telegram to the next."""
    longest_s = 0.0
    for _, address, _ in DRIVES:
        times = [one.at_s for one in plant.sent_to(address)]
        before = max(at_s for at_s in times if at_s < since_s)
        row = [before, *(at_s for at_s in times if at_s >= since_s), plant.now_s]
        longest_s = max(longest_s, *(b - a for a, b in pairwise(row)))
    return longest_s


def states(plant: Plant) -> list[DriveState]:
    return [plant.state(name) for name in NAMES]


@pytest.mark.parametrize(
    "after",
    [
        roster("{code: C0150, every: 3s}"),
        roster("{code: C0150, every: 2s}, {code: C0052, every: 1s}"),
        roster(EVERY_2_S, more=", writable: [C0046], stored_writes: {burst: 5, every: 1min}"),
    ],
    ids=["period", "code", "use"],
)
def test_what_is_read_and_allowed_changes_without_an_audit(after: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(21.3)
        at_s, first = plant.now_s, len(plant.reports)
        plant.apply(after)
        for _ in range(80):
            assert states(plant) == [DriveState.ONLINE] * len(DRIVES)
            readings = [plant.site.store.reading(name, STATUS) for name in NAMES]
            assert {one.quality for one in readings if one} == {Quality.GOOD}
            await anyio.sleep(0.1)
        assert {one.priority for one in plant.reports[first:]} <= {
            Priority.CYCLIC,
            Priority.WATCHDOG,
        }
        assert longest_silence_s(plant, at_s) < 0.9 * WATCHDOG_S

    with_plant(test, BEFORE)


def test_a_reload_exchanges_the_cyclic_reads() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.apply(roster("{code: C0052, every: 1s}"))
        await anyio.sleep(3.0)
        now = plant.site.store.reading("a", OUTPUT)
        assert now is not None
        assert now.quality is Quality.GOOD
        first = len(plant.reports)
        await anyio.sleep(10.0)
        read = [one.step.code for one in plant.reports[first:] if one.drive == "a"]
        assert 9 <= read.count(OUTPUT) <= 11
        assert plant.site.store.drive("a").state is DriveState.ONLINE

    with_plant(test, BEFORE)


def test_what_users_may_do_counts_at_once_after_a_reload() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.apply(roster(EVERY_2_S, more=", restore: true"))
        assert plant.site.drives.get("a").entry.restore
        plant.apply(roster(EVERY_2_S, more=", identity: {C0200: x}"))
        assert plant.state("a") is DriveState.STARTING

    with_plant(test, BEFORE)


@pytest.mark.parametrize(
    "after",
    [
        roster(EVERY_2_S, more=", answer_time: 30ms"),
        roster(EVERY_2_S, guard="{time: 2s, action: inhibit, configure: true}"),
    ],
    ids=["answer_time", "watchdog"],
)
def test_a_changed_drive_is_fed_by_the_time_it_was_last_fed(after: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        await until(lambda: plant.site.schedule.stats(plant.now_s).feeds["a"].age_s > 1.0)
        before = plant.site.schedule.stats(plant.now_s).feeds
        at_s = plant.now_s
        plant.apply(after)
        feeds = plant.site.schedule.stats(plant.now_s).feeds
        assert {name: feed.age_s for name, feed in feeds.items()} == {
            name: feed.age_s for name, feed in before.items()
        }
        await anyio.sleep(10.0)
        assert longest_silence_s(plant, at_s) < 0.9 * WATCHDOG_S

    with_plant(test, BEFORE)


def test_a_longer_watchdog_time_counts_once_the_drive_has_it() -> None:
    async def test(plant: Plant) -> None:
        def time_s() -> float:
            return plant.site.schedule.stats(plant.now_s).feeds["a"].time_s

        await plant.online()
        at_s = plant.now_s
        plant.apply(roster(EVERY_2_S, guard="{time: 4s, action: quick-stop, configure: true}"))
        assert time_s() == WATCHDOG_S
        await until(lambda: time_s() > WATCHDOG_S)
        assert longest_silence_s(plant, at_s) < 0.9 * WATCHDOG_S
        await plant.online()
        assert time_s() == 2 * WATCHDOG_S

    with_plant(test, BEFORE)


def test_a_drive_at_another_address_is_counted_from_now_on() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("a")
        await until(lambda: plant.site.schedule.stats(plant.now_s).feeds["a"].age_s > 1.0)
        plant.apply(BEFORE.replace("address: 11", "address: 21"))
        assert plant.site.schedule.stats(plant.now_s).feeds["a"].age_s == 0.0

    with_plant(test, BEFORE)


def test_no_counter_falls_at_a_reload() -> None:
    async def test(plant: Plant) -> None:
        def counts() -> tuple[int, int]:
            figures = plant.site.metrics.snapshot()
            return figures.watchdog_misses["a"], figures.cyclic_skipped

        await plant.online()
        plant.site.schedule.hold("a", plant.now_s + 5.0, plant.now_s)
        await anyio.sleep(6.0)
        before = counts()
        assert min(before) > 0

        def fell() -> bool:
            return any(now < was for now, was in zip(counts(), before, strict=True))

        plant.apply(roster("{code: C0150, every: 3s}"))
        assert not fell()
        plant.apply(roster(EVERY_2_S, more=", answer_time: 30ms"))
        assert not fell()
        plant.apply(roster(EVERY_2_S, guard=""))
        assert plant.site.metrics.snapshot().cyclic_skipped >= before[1]
        plant.apply(BEFORE.replace("address: 11", "address: 21"))
        assert not fell()

    with_plant(test, BEFORE)


def with_group(name: str) -> str:
    """Return the usual roster with two drives in one more decade, which are a group."""
    drives = [*DRIVES, ("y", 21, "8200vector"), ("z", 22, "8200vector")]
    group = f"groups:\n  {name}: {{members: [y, z], multicast: true}}"
    return roster_text(drives, drive=f"cyclic: [{EVERY_2_S}]", sections=group)


def test_a_group_may_leave_the_roster_while_its_multicast_is_on_the_wire() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("y", "z")
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(plant.site.operations.stop, StopAction.QUICK_STOP, "pair")
            await until(lambda: any(b"\x0420" in one.data for one in plant.end.sent))
            plant.apply(with_group("others"))
        kinds = [one.step.kind for one in plant.reports]
        assert StepKind.MULTICAST in kinds
        first = len(plant.reports)
        await anyio.sleep(5.0)
        assert {one.drive for one in plant.reports[first:]} >= {"y", "z"}

    with_plant(test, with_group("pair"))


def test_a_drive_may_get_the_name_of_a_group_that_leaves_the_roster() -> None:
    async def test(plant: Plant) -> None:
        await plant.online("y")
        plant.apply(with_group("others").replace("name: y", "name: pair").replace("[y,", "[pair,"))
        await plant.online("pair")
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        of_drive = 'lecombus_telegrams_total{line="test",drive="pair",kind='
        counts = {line[len(of_drive) :] for line in page.splitlines() if line.startswith(of_drive)}
        assert any(line.startswith('"read",outcome="answered"') for line in counts)
        assert not any(line.startswith('"multicast"') for line in counts)

    with_plant(test, with_group("pair"))


def test_a_trip_that_ended_over_a_reload_is_shown_no_more() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.trip("a", 50)
        await until(lambda: plant.site.store.drive("a").fault is not None)
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        plant.power_cycle("a")
        plant.apply(roster(EVERY_2_S, more=", answer_time: 30ms"))
        plant.line.faults.absent = set()
        await plant.online()
        await anyio.sleep(10.0)
        info = plant.site.store.drive("a")
        assert info.fault is None
        assert "fault" not in info.remarks
        assert "trip" not in [one.name for one in plant.site.store.motion("a").stops]

    with_plant(test, BEFORE)


def test_a_trip_that_lasts_over_a_reload_is_the_same_trip() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        plant.trip("a", 50)
        await until(lambda: plant.site.store.drive("a").fault is not None)
        await anyio.sleep(5.0)
        before = plant.site.store.drive("a").fault
        assert before is not None
        plant.apply(roster(EVERY_2_S, more=", answer_time: 30ms"))
        await plant.online()
        await anyio.sleep(10.0)
        after = plant.site.store.drive("a").fault
        assert after is not None
        assert (after.since_s, after.number) == (before.since_s, 50)

    with_plant(test, BEFORE)
