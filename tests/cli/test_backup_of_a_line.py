"""Backup, factory reset, restore, diff: an empty difference, for each family, line lost meanwhile.

The commands' own reading, planning and writing over the real HTTP application and a whole site,
on the virtual clock: only the socket between them is missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from decimal import Decimal

import anyio
import httpx2
import pytest
from anyio.abc import TaskGroup

from lecombus.backups import (
    Backup,
    Restored,
    Section,
    compare,
    make_plan,
    read_backup,
    restore,
    section_of,
    take,
    write_backup,
)
from lecombus.backups.restore_plan import codes_to_read
from lecombus.cli.backup import read_drive
from lecombus.cli.drive_access import HttpDrive
from lecombus.client import Line
from lecombus.client.connection import Connection
from lecombus.drives import CodeInfo, Family, family, not_restored
from lecombus.fieldbus.lecom.simulator.parameters import Refusal
from lecombus.parameters import Code
from lecombus.schedule import Priority, Request
from support.api_line import app_of
from support.fake_drive import Ear
from support.rosters import roster_text
from support.site_host import Plant, with_plant

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")
PATIENCE_S = 120.0
UNPLUGGED_S = 4.0


@contextlib.asynccontextmanager
async def behind_http(plant: Plant, name: str = "a") -> AsyncIterator[HttpDrive]:
    """The drive as the command line sees it."""
    transport = httpx2.ASGITransport(app_of(plant))
    async with httpx2.AsyncClient(transport=transport, base_url="http://localhost") as client:
        yield HttpDrive(Line(Connection(client, "here")), name, clock=anyio.current_time)


def settings(kind: Family) -> list[CodeInfo]:
    """What a restore puts back; what would stop the drive by itself is left as it is."""
    armed = set() if kind.watchdog is None else {kind.watchdog.action_code}
    left = {*armed, Code(1921), Code(1420), *map(Code, range(1121, 1125))}
    return [
        info for info in kind.described()
        if not_restored(kind, info.code) is None and info.code not in left
    ]  # fmt: skip


def change_everything(plant: Plant, kind: Family) -> int:
    """Give every setting another value than the maker's; return how many there are."""
    params = plant.line["a"].model.params
    changed = 0
    for info in settings(kind):
        number, subcode = info.code.number, info.code.subcode
        try:
            spec, now = params.find(number, subcode), params.text(number, subcode)
        except Refusal:
            continue  # the simulated drive has no such code
        for wanted in (info.low, info.high, *map(Decimal, info.selection), Decimal("7.5")):
            with contextlib.suppress(Refusal):
                if wanted is not None and spec.check(f"{wanted:f}") != now:
                    params.set(number, spec.check(f"{wanted:f}"), subcode)
                    changed += 1
                    break
    params.save()
    return changed


class Puller(Ear):
    """Pulls the plug for a while, as soon as something was done."""

    def __init__(self, plant: Plant, tasks: TaskGroup) -> None:
        super().__init__()
        self._plant = plant
        self._tasks = tasks

    def advance(self, done: int, total: int) -> None:
        if not self.advanced:
            self._plant.end.unplug()
            self._tasks.start_soon(self._replug)
        super().advance(done, total)

    async def _replug(self) -> None:
        await anyio.sleep(UNPLUGGED_S)
        self._plant.end.replug()

    @property
    def waited(self) -> bool:
        """Whether the loss was noticed."""
        return any(text.startswith("waiting: line t is lost") for text in self.said)


async def back_up(drive: HttpDrive, ear: Ear | None = None) -> Backup:
    backup, left = await read_drive(drive, (), patience_s=PATIENCE_S, listener=ear or Ear())
    assert left == []
    return read_backup(write_backup(backup), "a.yaml")


async def put_back(drive: HttpDrive, backup: Backup, ear: Ear) -> Restored:
    wanted = codes_to_read(backup, ())
    taken = await take(drive, wanted, patience_s=PATIENCE_S, listener=Ear())
    plan = make_plan(backup, backup.family, taken.answers)
    assert plan.blockers == ()
    return await restore(
        drive, plan, patience_s=PATIENCE_S, listener=ear, written=lambda code, value: None
    )


def roster(kind: str) -> str:
    drives = [("a", 11, kind), ("b", 12, "8200vector")]
    return roster_text(drives, drive="restore: true", watchdog="{time: 5s, action: inhibit}")


@pytest.mark.parametrize("kind", FAMILIES)
def test_a_drive_set_back_to_the_makers_values_is_restored_whole(kind: str) -> None:
    async def test(plant: Plant) -> None:
        described = family(kind)
        changed = change_everything(plant, described)
        assert changed >= 1
        await plant.online()
        async with behind_http(plant) as drive, anyio.create_task_group() as tasks:
            ear = Puller(plant, tasks)
            backup = await back_up(drive, ear)
            assert ear.waited

            plant.factory_reset("a")
            plant.power_cycle("a")
            await plant.online()
            differing = compare(backup, await back_up(drive)).differences
            assert len(differing) >= changed - 2  # the power cycle set the module's back

            ear = Puller(plant, tasks)
            result = await put_back(drive, backup, ear)
            assert ear.waited
            assert result.complete, (result, ear.said)
            assert set(result.written) == {one.code for one in differing}
            assert compare(backup, await back_up(drive)).differences == ()

            plant.power_cycle("a")
            await plant.online()
            kept = compare(backup, await back_up(drive)).differences
            assert {section_of(described, one.code) for one in kept} <= {Section.MODULE}

    with_plant(test, roster(kind))


def test_a_second_restore_writes_nothing() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind_http(plant) as drive:
            backup = await back_up(drive)
            wear = plant.line["a"].wear
            assert (await put_back(drive, backup, Ear())).written == {}
            assert plant.line["a"].wear == wear

    with_plant(test, roster("8200vector"))


def test_a_backup_takes_only_the_time_that_others_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        asked: list[Priority] = []
        submit = plant.site.worker.submit

        def note(request: Request) -> None:
            asked.append(request.priority)
            submit(request)

        monkeypatch.setattr(plant.site.worker, "submit", note)
        async with behind_http(plant) as drive:
            await back_up(drive)
        assert set(asked) == {Priority.BACKGROUND}

    with_plant(test, roster("8200vector"))


def test_whether_a_drive_may_be_restored_comes_from_its_daemon() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        async with behind_http(plant) as drive:
            assert (await drive.ask_which()).family == "93xx"
            rights = await drive.restore_rights()
            assert (rights.reason, rights.owned) == ("", ())

    with_plant(test, roster("93xx"))
