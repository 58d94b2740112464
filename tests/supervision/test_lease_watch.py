"""The end of a lease on whole lines: what is sent to which drive, what is not, and what follows."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Mapping, Sequence
from contextlib import asynccontextmanager
from decimal import Decimal
from typing import TypeVar

import anyio
import pytest

from lecombus.drive_state.motion import Doing
from lecombus.drive_state.readings import ADDRESSING_LOCK, ADDRESSING_MOVED, DriveState
from lecombus.drives import FAMILY_NAMES, StopAction, Verb
from lecombus.errors import OperationError
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.leases import Latch
from lecombus.operations.lease_operations import LEASE
from lecombus.operations.operation_reports import GroupReport, WriteReport
from lecombus.parameters import Code
from lecombus.saved_state import State
from lecombus.schedule import Outcome, Priority
from support.rosters import roster_text
from support.sim_host import code_field
from support.site_host import Plant, until, with_plant

KINDS = [name for name in FAMILY_NAMES if name != "generic"]
MOVED = {ADDRESSING_LOCK, ADDRESSING_MOVED}
WATCHED = "{time: 3s, action: inhibit, configure: true}"
T = TypeVar("T")


def roster(
    kind: str = "8200vector",
    policy: str = "quick-stop",
    *,
    watchdog: str = WATCHED,
    more: str = "",
    names: str = "a",
    sections: str = "",
) -> str:
    lease = f"lease: {{required: true, time: 2s, on_lapse: {policy}}}"
    drives = [(name, 11 + place, kind) for place, name in enumerate(names)]
    drive = f"{lease}, {more}" if more else lease
    return roster_text(drives, drive=drive, watchdog=watchdog, sections=sections)


UNITS = dict.fromkeys(KINDS, "Hz") | {"93xx": "%"}


def setpoint(kind: str) -> int:
    return 1061 if kind == "smvector" else 141 if kind == "93xx" else 46


class Client:
    """A controller: takes a lease, renews it, enables drives, and may fall silent."""

    def __init__(self, plant: Plant, name: str = "plc") -> None:
        self.plant = plant
        self.ops = plant.site.operations
        self.name = name
        self.counter = 1
        self.token = ""
        self.alive = True
        self.last_s = 0.0

    def take(self, drives: str = "a", take_over: str = "", time_s: float = 2.0) -> None:
        lease = self.ops.leases.take(
            self.name, drives, drives, time_s, self.counter, take_over=take_over
        )
        self.token = lease.token

    async def renewing(self) -> None:
        while self.alive:
            self.counter += 1
            self.ops.leases.renew(self.name, self.token, self.counter)
            self.last_s = self.plant.now_s
            await anyio.sleep(0.5)

    async def do(self, work: Awaitable[T]) -> T:
        """Do something with the token."""
        reset = LEASE.set(self.token)
        try:
            return await work
        finally:
            LEASE.reset(reset)

    async def run(self, drive: str = "a", speed: str = "20") -> None:
        """Enable a drive and give it a setpoint, as a controller would."""
        kind = self.plant.roster.drives[0].family
        report = await self.do(self.ops.verb(drive, Verb.ENABLE))
        assert report.outcome is Outcome.VERIFIED, report
        self.plant.line[drive].model.preset(setpoint(kind), speed)
        await anyio.sleep(10.0)
        assert output(self.plant, drive) > 0.0


def output(plant: Plant, drive: str = "a") -> float:
    plant.line.advance(plant.now_s)
    return abs(plant.line[drive].model.motor.output)


def standing(plant: Plant, drive: str = "a") -> bool:
    plant.line.advance(plant.now_s)
    return plant.line[drive].model.motor.speed == 0.0


@asynccontextmanager
async def controlled(plant: Plant, drives: str = "a") -> AsyncIterator[Client]:
    """Run drives under a lease that is renewed."""
    client = Client(plant)
    await plant.online()
    async with anyio.create_task_group() as tasks:
        client.take(drives)
        tasks.start_soon(client.renewing)
        for drive in drives:
            await client.run(drive)
        yield client
        client.alive = False


def latch(plant: Plant, drive: str = "a") -> Latch | None:
    return plant.site.operations.leases.book.drives[drive].latch


async def kind_of_refusal(work: Awaitable[object]) -> str:
    try:
        await work
    except OperationError as exc:
        return exc.kind
    return ""


@pytest.mark.parametrize("policy", ["quick-stop", "inhibit", "silence", "hold"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_policy_of_every_family_is_carried_out_when_a_client_falls_silent(
    kind: str, policy: str
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            await anyio.sleep(5.0)
            assert output(plant) > 0.0, "a lease that is renewed keeps it running"
            client.alive = False
        died_s, writes = client.last_s, len(list(plant.line["a"].log))
        await anyio.sleep(died_s + 1.999 - plant.now_s)
        assert latch(plant) is None
        await anyio.sleep(0.002)
        assert latch(plant) is Latch.LAPSED
        assert plant.site.supervision.leases.figures().lapses == {"a": 1}  # type: ignore[union-attr]
        if policy == "silence":
            last_s = max(one.at_s for one in plant.sent_to(11))
            assert last_s <= died_s + 2.0
        await anyio.sleep(20.0)
        if policy == "hold":
            assert output(plant) > 0.0
            remark = plant.site.store.drive("a").remarks["lease"]
            assert remark.startswith("runs on without a controller")
        else:
            assert standing(plant)
        said = [one for one in list(plant.line["a"].log)[writes:] if one.kind == "write"]
        assert bool(said) is (policy in ("quick-stop", "inhibit"))
        if policy == "silence":
            assert plant.sent_to(11, died_s + 2.0) == []
            assert plant.state("a") is DriveState.OFFLINE
        kinds = [await kind_of_refusal(client.do(client.ops.write("a", Code(46), 5)))]
        kinds += [await kind_of_refusal(client.do(client.ops.verb("a", Verb.ENABLE)))]
        assert kinds[1] == "lease-lost"
        assert kinds[0] in ("lease-lost", "offline", "not-writable", "no-such-code")

    with_plant(test, roster(kind, policy))


@pytest.mark.parametrize("policy", ["quick-stop", "inhibit", "silence", "hold"])
def test_nothing_moves_until_a_new_lease_is_held_and_the_drive_is_enabled(policy: str) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(25.0)
        client = Client(plant, "next")
        assert await kind_of_refusal(client.ops.verb("a", Verb.ENABLE)) == "lease-required"
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            for code in (37, 135):  # a fixed speed, and a control word
                refused = await kind_of_refusal(client.do(client.ops.write("a", Code(code), 5)))
                assert refused == "latched"
                await anyio.sleep(10.0)
            assert standing(plant) is (policy != "hold")
            report = await client.do(client.ops.verb("a", Verb.ENABLE))
            assert report.outcome is Outcome.VERIFIED
            written = await client.do(client.ops.write("a", Code(46), 25))
            assert written.outcome.is_good
            await anyio.sleep(20.0)
            assert output(plant) > 20.0
            assert "lease" not in plant.site.store.drive("a").remarks
            client.alive = False

    with_plant(test, roster("8200vector", policy, more="also_writable: [C0037]"))


@pytest.mark.parametrize("by_verb", [False, True])
@pytest.mark.parametrize("policy", ["quick-stop", "inhibit"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_setpoint_that_is_written_before_the_enable_is_the_one_that_the_motor_starts_with(
    kind: str, policy: str, by_verb: bool
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            was = output(plant)
            first.alive = False
        await anyio.sleep(25.0)
        client = Client(plant, "next")
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            assert standing(plant)
            if by_verb:
                speed = client.ops.verb("a", Verb.SET_SPEED, value=Decimal(7), unit=UNITS[kind])
                assert (await client.do(speed)).outcome.is_good
            else:
                written = client.ops.write("a", Code(setpoint(kind)), 7, verify=True)
                assert (await client.do(written)).outcome is Outcome.VERIFIED
            assert latch(plant) is not None
            for _ in range(20):
                assert standing(plant)
                await anyio.sleep(0.5)
            report = await client.do(client.ops.verb("a", Verb.ENABLE))
            assert report.outcome is Outcome.VERIFIED
            highest = 0.0
            for _ in range(100):
                await anyio.sleep(0.2)
                highest = max(highest, output(plant))
            assert 0.0 < highest < was / 2.0
            client.alive = False

    with_plant(test, roster(kind, policy))


@pytest.mark.parametrize("closed", [True, False])
def test_a_latched_drive_that_does_not_show_a_stop_of_the_line_takes_no_setpoint(
    closed: bool,
) -> None:
    """It runs, or a terminal stops it, which may let it go again."""

    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(25.0)
        plant.line["a"].model.set_terminal(high=closed)
        client = Client(plant, "next")
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            before = [one for one in plant.line["a"].log if one.code == 46 and one.kind == "write"]
            with pytest.raises(OperationError, match="does not show a stop of the line") as caught:
                await client.do(client.ops.write("a", Code(46), 5))
            assert caught.value.kind == "latched"
            after = [one for one in plant.line["a"].log if one.code == 46 and one.kind == "write"]
            assert after == before
            await client.ops.stop(StopAction.QUICK_STOP, "a")
            assert (await client.do(client.ops.write("a", Code(46), 5))).outcome.is_good
            await anyio.sleep(20.0)
            assert standing(plant)
            client.alive = False

    with_plant(test, roster("8200vector", "hold"))


def test_many_setpoints_for_a_latched_drive_read_its_stops_once() -> None:
    """Else a client that sends many keeps its own enable from the line."""

    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(25.0)
        client = Client(plant, "next")
        client.take()

        async def write(value: int) -> None:
            report = await client.do(client.ops.write("a", Code(46), value))
            assert report.outcome in (Outcome.DONE, Outcome.SUPERSEDED)

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            before = len(list(plant.line["a"].log))
            async with anyio.create_task_group() as writes:
                for value in range(20):
                    writes.start_soon(write, value)
            asked = list(plant.line["a"].log)[before:]
            assert 1 <= sum(one.kind == "read" and one.code == 1 for one in asked) <= 2
            assert (await client.do(client.ops.verb("a", Verb.ENABLE))).outcome is Outcome.VERIFIED
            client.alive = False

    with_plant(test, roster("8200vector", "quick-stop"))


@pytest.mark.parametrize("cancelled", [1, 2, 3])
def test_a_setpoint_that_is_cancelled_while_it_reads_the_stops_does_not_refuse_the_others(
    cancelled: int,
) -> None:
    """The next one of them reads, and the others wait for that."""

    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(25.0)
        client = Client(plant, "next")
        client.take()
        ended: dict[int, str] = {}
        scopes = [anyio.CancelScope() for _ in range(6)]

        async def write(value: int) -> None:
            with scopes[value]:
                ended[value] = await kind_of_refusal(
                    client.do(client.ops.write("a", Code(46), value))
                )

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            await anyio.sleep(3.0)  # what was shown before is too old
            before = len(list(plant.line["a"].log))
            async with anyio.create_task_group() as writes:
                for value in range(len(scopes)):
                    writes.start_soon(write, value)
                for scope in scopes[:cancelled]:
                    await anyio.sleep(0.02)
                    scope.cancel()
            assert ended == dict.fromkeys(range(cancelled, len(scopes)), "")
            asked = list(plant.line["a"].log)[before:]
            assert 1 <= sum(one.kind == "read" and one.code == 1 for one in asked) <= 2 + cancelled
            client.alive = False

    with_plant(test, roster("8200vector", "quick-stop"))


@pytest.mark.parametrize(("code", "value"), [(40, "0"), (135, "H0008")])
def test_a_plain_write_that_stops_a_latched_drive_waits_for_no_reading(
    code: int, value: str
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(5.0)
        client = Client(plant, "next")
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            before = len(list(plant.line["a"].log))
            report = None
            if code == 40:  # no lease is needed for it, and a token does not hold it up
                report = await client.do(client.ops.write("a", Code(code), value))
                assert report.outcome.is_good
            else:
                with pytest.raises(OperationError) as latched:
                    await client.do(client.ops.write("a", Code(code), value))
                with pytest.raises(OperationError) as needed:
                    await client.ops.write("a", Code(code), value)
                assert (latched.value.kind, needed.value.kind) == ("latched", "lease-required")
                for one in (latched.value, needed.value):
                    assert "POST /v1/stop or `lecombus stop a`" in one.remedy
                    assert "enable it" not in one.remedy
            asked = [one for one in list(plant.line["a"].log)[before:] if one.code in (1, 135)]
            assert not [one for one in asked if one.kind == "read"]
            client.alive = False

    with_plant(test, roster("8200vector", "hold"))


SPEED_SETTINGS = [
    (name, code)
    for name, codes in {"8200vector": (11, 2011), "820x": (11,), "821x": (11, 127),
                        "822x": (11, 127), "824x": (11, 127), "smvector": (1102, 1103)}.items()
    for code in codes
]  # fmt: skip


@pytest.mark.parametrize(("kind", "code"), SPEED_SETTINGS)
def test_what_a_setpoint_depends_on_changes_no_speed_of_a_latched_motor(
    kind: str, code: int
) -> None:
    """It limits the setpoint, says what 100 % are, or selects another setpoint."""

    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(25.0)
        client = Client(plant, "next")
        client.take()

        async def written(number: int) -> str:
            value = 1 if number == 127 else 15
            return await kind_of_refusal(client.do(client.ops.write("a", Code(number), value)))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            before = output(plant)
            assert await written(code) == "latched"
            restore = client.ops.write("a", Code(code), 15, restoring=True)
            assert await kind_of_refusal(client.do(restore)) == "latched"
            if kind != "smvector":
                assert await written(12) == ""  # a ramp: a setting that moves nothing
            await anyio.sleep(20.0)
            assert output(plant) == before > 0.0
            await client.ops.stop(StopAction.INHIBIT, "a")
            assert await written(code) == ""
            await anyio.sleep(20.0)
            assert standing(plant)
            client.alive = False

    more = "also_writable: [C0012]" if kind != "smvector" else "also_writable: []"
    more = more.replace("[", f"[{Code(code)}, " if kind != "smvector" else f"[{Code(code)}")
    with_plant(test, roster(kind, "hold", more=f"{more}, restore: true"))


def test_who_controls_a_latched_drive_is_changed_only_to_the_line_and_while_it_is_inhibited() -> (
    None
):
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(10.0)
        plant.line["a"].model.preset(1, "0")
        client = Client(plant, "next")
        client.take()

        async def written(value: int) -> str:
            return await kind_of_refusal(client.do(client.ops.write("a", Code(1), value)))

        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            assert [await written(0), await written(3)] == ["latched", "latched"]
            await client.ops.stop(StopAction.INHIBIT, "a")
            assert [await written(0), await written(3)] == ["latched", ""]
            await anyio.sleep(20.0)
            assert standing(plant)
            report = await client.do(client.ops.verb("a", Verb.ENABLE))
            assert report.outcome is Outcome.VERIFIED
            assert await written(0) == ""
            client.alive = False

    with_plant(test, roster("8200vector", more="also_writable: [C0001]"))


def test_a_quick_stop_that_was_just_shown_does_not_hide_that_the_inhibit_was_not_read() -> None:
    """The client has read what shows the quick stop; C0040 was read last long before."""

    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(10.0)
        client = Client(plant, "next")
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await client.ops.stop(StopAction.INHIBIT, "a")
            await anyio.sleep(10.0)
            for code in (1, 135):
                await client.ops.read("a", Code(code))
            assert await kind_of_refusal(client.do(client.ops.write("a", Code(1), 3))) == ""
            client.alive = False

    with_plant(test, roster("8200vector", more="also_writable: [C0001]"))


def test_members_of_a_group_that_lapse_together_are_stopped_by_one_telegram() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant, "abc") as client:
            client.alive = False
        lapse_s = plant.now_s
        await anyio.sleep(3.0)
        stops = [one.data for one in plant.end.sent if one.at_s >= lapse_s and b"\x02" in one.data]
        assert [one[1:3] for one in stops] == [b"10"]
        await anyio.sleep(20.0)
        assert all(standing(plant, name) for name in "abc")
        assert all(latch(plant, name) is Latch.LAPSED for name in "abc")

    with_plant(test, roster(policy="inhibit", names="abc"))


def test_drives_of_other_controllers_are_not_stopped() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant, "ab") as client:
            other = Client(plant, "other")
            other.take("c")
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(other.renewing)
                await other.run("c")
                client.alive = False
                await anyio.sleep(20.0)
                assert standing(plant, "a")
                assert standing(plant, "b")
                assert output(plant, "c") > 0.0
                other.alive = False

    with_plant(test, roster(names="abc"))


def test_a_stop_whose_answers_are_lost_is_repeated_and_proven() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            plant.line.drive_faults[11] = Faults(lost=0.4)
            client.alive = False
        await anyio.sleep(30.0)
        assert standing(plant)

    with_plant(test, roster(), seed=3)


def test_a_drive_that_does_not_show_its_stop_is_left_to_its_watchdog() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
            plant.line.drive_faults[11] = Faults(unheard=1.0)
        await anyio.sleep(9.0)
        plant.line.drive_faults.clear()  # it hears again, and is sent nothing all the same
        since_s = plant.now_s
        assert plant.site.store.drive("a").reason.startswith("quick-stop is not proven, its ")
        await anyio.sleep(10.0)
        assert plant.sent_to(11, since_s) == []
        assert standing(plant)

    with_plant(test, roster())


@pytest.mark.parametrize(
    ("watchdog", "more"),
    [
        ("", ""),
        (WATCHED, "stop_fallback: none"),
        ("{time: 3s, action: none}", ""),
        ("{time: 3s, action: inhibit}", ""),  # it is off in the drive
    ],
)
def test_a_drive_that_no_watchdog_may_stop_is_stopped_again_until_that_is_proven(
    watchdog: str, more: str
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
            plant.line.drive_faults[11] = Faults(unheard=1.0)
        await anyio.sleep(30.0)
        assert not standing(plant) or watchdog == WATCHED
        plant.line.drive_faults.clear()
        await anyio.sleep(30.0)
        assert standing(plant)
        assert plant.state("a") is DriveState.ONLINE

    with_plant(test, roster(watchdog=watchdog, more=more))


def test_the_stop_of_a_drive_that_is_switched_off_does_not_take_the_line_for_ever() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
            plant.line.faults.absent = {11}
        await anyio.sleep(600.0)
        since_s = plant.now_s
        stops = [one for one in plant.reports if one.priority is Priority.STOP]
        await anyio.sleep(600.0)
        more = [one for one in plant.reports if one.priority is Priority.STOP][len(stops) :]
        busy_s = sum(one.result.ended_s - one.result.started_s for one in more)
        assert 0.0 < busy_s < 0.03 * (plant.now_s - since_s)
        drive = plant.line["a"].model
        drive.preset(135, "H0000")
        drive.preset(40, "1")
        plant.line.faults.absent = set()
        await anyio.sleep(40.0)  # it is probed less often by now
        assert standing(plant)

    with_plant(test, roster(watchdog=""))


@pytest.mark.parametrize("watchdog", [WATCHED, "{time: 6s, action: inhibit}"])
def test_nor_is_it_left_to_one_that_was_seen_to_be_off_while_it_is_audited_anew(
    watchdog: str,
) -> None:
    """With `configure: true` the module has lost its supply, and its turn to be set comes later."""

    async def test(plant: Plant) -> None:
        drive, log = plant.site.drives.get("a"), plant.line["a"].log
        async with controlled(plant) as client:
            plant.end.unplug()
            plant.power_cycle("a", 0.5 if "configure" in watchdog else 0.0)
            await anyio.sleep(1.0)
            plant.end.replug()
            await until(lambda: plant.state("a") is DriveState.STARTING)
            if "configure" in watchdog:
                read = len(log)
                await until(lambda: 1922 in [one.code for one in list(log)[read:]])
                await anyio.sleep(0.6)
            plant.line.drive_faults[11] = Faults(nak=1.0)
            client.alive = False
            client.ops.leases.release(client.name, client.token)
        assert plant.state("a") is DriveState.STARTING
        await anyio.sleep(20.0)
        assert not drive.health.silenced
        plant.line.drive_faults[11] = Faults()
        await anyio.sleep(20.0)
        assert output(plant) == 0.0
        assert not drive.health.silenced

    with_plant(test, roster(names="abcdefgh", watchdog=watchdog))


def test_a_hoist_whose_watchdog_inhibits_though_the_roster_says_otherwise_is_not_silenced() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(1923, "3000")
        plant.line["a"].model.preset(1922, "1")
        async with controlled(plant) as client:
            client.alive = False
            plant.line.drive_faults[11] = Faults(nak=1.0)
        await anyio.sleep(20.0)
        assert not plant.site.drives.get("a").health.silenced
        assert plant.line["a"].watchdog_fired == 0

    watchdog = "{time: 3s, action: quick-stop}"
    with_plant(test, roster(watchdog=watchdog, more="stop_fallback: none"))


def test_a_hoist_that_refuses_its_quick_stop_is_never_inhibited_by_lecombus() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            plant.line["a"].model.params.set(1, "0")  # its terminals control it from now on
            client.alive = False
        await anyio.sleep(15.0)
        inhibits = [
            one
            for one in plant.line["a"].log
            if one.kind == "write" and (one.code, one.text) == (40, "0")
        ]
        assert inhibits == []
        assert plant.state("a") is not DriveState.OFFLINE, "its watchdog would inhibit it"

    with_plant(test, roster("821x", more="stop_fallback: none"))


def test_a_stop_of_a_silenced_drive_goes_out_and_it_stays_silenced() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
        await anyio.sleep(4.0)
        since_s = plant.now_s
        with pytest.raises(OperationError, match="sent nothing, so that its watchdog acts") as no:
            await client.ops.read("a", Code(150))
        assert no.value.kind == "offline"
        assert "once a lease is held for it" in no.value.remedy  # its wires are not the cause
        assert plant.sent_to(11, since_s) == []
        report = await client.ops.stop(StopAction.INHIBIT, "a")
        assert report.outcome is Outcome.VERIFIED
        assert plant.sent_to(11, since_s) != []
        since_s = plant.now_s
        await anyio.sleep(60.0)
        assert plant.sent_to(11, since_s) == []

    with_plant(test, roster(policy="silence"))


def test_why_says_that_a_drive_is_silenced_on_purpose_and_that_a_lease_ends_it() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(15.0)  # its watchdog's time has passed, and all drives are silent
        report = await plant.site.operations.why("a")
        assert [one.name for one in report.findings] == ["silenced", "latched"]
        silenced = report.findings[0]
        assert report.answer is silenced.text
        assert "nothing is sent to it on purpose since" in silenced.text.en
        assert "lease plc lapsed" in silenced.text.en
        assert silenced.remedy.en.startswith("take a lease for it")
        assert "baud" not in "".join(one.remedy.en for one in report.findings)

    with_plant(test, roster(policy="silence"))


def test_a_line_whose_drives_are_silenced_on_purpose_is_not_called_silent(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(15.0)
        assert not plant.site.store.line().remarks
        rows = {one["drive"]: one["silenced"] for one in first.ops.context.leases.drives_json()}
        assert rows["a"] is True
        with pytest.raises(OperationError, match="so that its watchdog acts") as caught:
            await first.ops.write("a", Code(46), 5)
        assert caught.value.kind == "offline"
        assert "once a lease is held for it" in caught.value.remedy

    with_plant(test, roster(policy="silence"))
    assert "event=line-silent" not in caplog.text


def test_a_silenced_drive_is_not_spoken_to_before_its_watchdog_had_its_time() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as first:
            first.alive = False
        await anyio.sleep(2.2)
        last_s = max(one.at_s for one in plant.sent_to(11))
        client = Client(plant, "next")
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await plant.online("a", within_s=30.0)
            first_s = min(one.at_s for one in plant.sent_to(11, last_s + 0.001))
            assert 3.0 <= first_s - last_s <= 4.0
            assert standing(plant)
            client.alive = False

    with_plant(test, roster(policy="silence"))


@pytest.mark.parametrize("target", ["a", "all"])
def test_a_silenced_drive_that_was_stopped_is_silent_for_its_watchdog_time_again(
    target: str,
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant, "ab") as first:
            first.alive = False
        await anyio.sleep(2.2)
        last_s = max(one.at_s for one in plant.sent_to(11))
        client = Client(plant, "next")
        client.take("ab")
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            await anyio.sleep(last_s + 2.9 - plant.now_s)
            plant.line.drive_faults[11] = Faults(lost=1.0)
            tasks.start_soon(client.ops.stop, StopAction.INHIBIT, target)
            await anyio.sleep(1.0)
            plant.line.drive_faults[11] = Faults()
            await until(lambda: not plant.site.drives.get("a").health.silenced, within_s=60.0)
            fed_s = max(one.at_s for one in plant.sent_to(11) if one.at_s < plant.now_s - 0.01)
            assert plant.now_s - fed_s >= 3.0
            client.alive = False

    with_plant(test, roster(policy="silence", names="ab"))


def test_a_reload_and_a_reopened_port_do_not_end_a_silence() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
        await anyio.sleep(4.0)
        since_s = plant.now_s
        plant.end.unplug()
        await anyio.sleep(3.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        plant.apply(roster(policy="silence", more="answer_time: 40ms"))
        await anyio.sleep(60.0)
        assert plant.sent_to(11, since_s) == []
        assert plant.state("a") is DriveState.OFFLINE

    with_plant(test, roster(policy="silence"))


def test_a_lease_that_lapses_while_the_port_is_gone_does_not_let_the_drive_run_on() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            plant.end.unplug()
            client.alive = False
        await anyio.sleep(3.0)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        since_s = plant.now_s
        await anyio.sleep(20.0)
        assert standing(plant)
        assert plant.sent_to(11, since_s) == []

    with_plant(test, roster())


def test_at_the_start_a_drive_that_runs_is_stopped_when_nobody_took_a_lease_in_time() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.preset(46, "20")
        drive.preset(135, "H0000")
        await anyio.sleep(1.5)
        assert output(plant) > 0.0
        await anyio.sleep(20.0)
        assert standing(plant)
        assert latch(plant) is Latch.STARTED

    with_plant(test, roster())


def test_at_the_start_a_drive_that_is_inhibited_is_left_alone() -> None:
    async def test(plant: Plant) -> None:
        plant.line["a"].model.preset(40, "0")
        await plant.online()
        await anyio.sleep(20.0)
        # The audit sets its watchdog (C1922, C1923) and nothing else is written.
        written = {one.code for one in plant.line["a"].log if one.kind == "write"}
        assert not written & {40, 135}
        assert plant.site.store.motion("a").doing is Doing.STOPPED

    with_plant(test, roster(policy="inhibit"))


def test_a_controller_that_is_back_in_time_after_a_restart_goes_on() -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"].model
        drive.preset(46, "20")
        drive.preset(135, "H0000")
        await plant.online(within_s=1.9)
        client = Client(plant)
        client.take()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(client.renewing)
            report = await client.do(client.ops.verb("a", Verb.ENABLE))
            assert report.outcome is Outcome.VERIFIED
            await anyio.sleep(20.0)
            assert output(plant) > 0.0
            client.alive = False

    with_plant(test, roster(watchdog=""))


def test_a_latched_drive_that_comes_back_running_is_stopped_again() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
        await anyio.sleep(20.0)
        assert standing(plant)
        plant.line.faults.absent = {11}
        await until(lambda: plant.state("a") is DriveState.OFFLINE)
        drive = plant.line["a"].model
        drive.preset(135, "H0000")  # as after its mains came back
        drive.preset(40, "1")
        await anyio.sleep(20.0)
        plant.line.faults.absent = set()
        await plant.online()
        await anyio.sleep(20.0)
        assert standing(plant)

    with_plant(test, roster(watchdog=""))


async def miss_two_exchanges(plant: Plant) -> None:
    """Keep a drive silent for so short a time that it is not offline."""
    health = plant.site.drives.get("a").health
    plant.line.faults.absent = {11}
    await until(lambda: health.misses >= 2)
    plant.line.faults.absent = set()


@pytest.mark.parametrize("code", [248, 249])
def test_one_that_stands_is_not_stopped_again_because_its_moved_addressing_is_looked_at(
    code: int,
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
        plant.line["a"].model.preset(code, "1")
        plant.end.unplug()
        await anyio.sleep(1.0)
        plant.end.replug()
        await anyio.sleep(60.0)
        assert plant.site.store.drive("a").remarks.keys() & MOVED
        ends: list[str] = []
        client.ops.leases.followers += (lambda what, drives, fields: ends.append(what),)
        asked_s = plant.now_s
        await anyio.sleep(1000.0)
        field = code_field(code, extended=True)
        assert len([one for one in plant.sent_to(11, asked_s) if field in one.data]) >= 2
        assert ends == []

    with_plant(test, roster(watchdog="", names="ab"))


@pytest.mark.parametrize(
    ("kind", "policy"),
    [
        *((kind, "quick-stop") for kind in KINDS if kind != "smvector"),
        ("8200vector", "inhibit"),
        ("8200vector", "silence"),
    ],
)
def test_a_latched_drive_that_runs_after_a_short_loss_of_its_supply_is_stopped_again(
    kind: str, policy: str
) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            if policy == "silence":  # given up in order while it stands, so that it is spoken to
                await client.ops.stop(StopAction.INHIBIT, "a")
                await anyio.sleep(5.0)
                client.alive = False
                client.ops.leases.release(client.name, client.token)
            client.alive = False
        await anyio.sleep(20.0)
        assert standing(plant)
        assert plant.state("a") is DriveState.ONLINE
        await miss_two_exchanges(plant)
        drive = plant.line["a"].model
        drive.preset(135, "H0000")  # as after its mains came back
        drive.preset(40, "1")
        await anyio.sleep(40.0)
        assert standing(plant)
        assert latch(plant) is not None

    with_plant(test, roster(kind, policy, watchdog=WATCHED if policy == "silence" else ""))


@pytest.mark.parametrize("policy", ["quick-stop", "inhibit", "hold"])
def test_a_latched_drive_that_only_missed_two_exchanges_is_left_alone(policy: str) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            client.alive = False
        await anyio.sleep(20.0)
        assert standing(plant) is (policy != "hold")
        book = plant.site.operations.leases
        ends: list[str] = []
        book.followers += (lambda what, drives, fields: ends.append(what),)
        await miss_two_exchanges(plant)
        await anyio.sleep(20.0)
        assert ends == []

    with_plant(test, roster(policy=policy, watchdog=""))


@pytest.mark.parametrize("end", ["taken over", "lapsed", "released"])
@pytest.mark.parametrize("group", [False, True])
def test_a_write_that_waits_is_not_sent_when_its_lease_has_ended(end: str, *, group: bool) -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant, "ab") as client:
            ops = client.ops
            asked = [asyncio.ensure_future(ops.read("c", Code(150))) for _ in range(3)]
            await anyio.sleep(0.005)

            async def write() -> WriteReport | GroupReport:
                if group:
                    return await ops.write_group("ab", Code(46), 33)
                return await ops.write("a", Code(46), 33)

            writing = asyncio.ensure_future(client.do(write()))
            await anyio.sleep(0.001)
            client.alive = False
            if end == "taken over":
                Client(plant, "new").take("ab", take_over="plc")
            elif end == "released":
                ops.leases.release("plc", client.token)
            else:
                lease = ops.leases.book.drives["a"].lease
                assert lease is not None
                lease.ends_at_s = plant.now_s
            report = await writing
            await asyncio.gather(*asked)
            assert report.outcome in (Outcome.REFUSED, Outcome.SUPERSEDED), report
            members = report.members if isinstance(report, GroupReport) else (report,)
            kinds = {one.kind for one in members}
            assert kinds <= {"lease-lost", "superseded"}, "the lapse may have stopped it first"
            assert "lease-lost" in kinds or end != "taken over"
            heard = [(one.code, one.text) for name in "abc" for one in plant.line[name].log]
            assert (46, "33") not in heard

    lease = "lease: {required: true}"
    with_plant(
        test,
        roster_text(
            [("a", 11, "8200vector"), ("b", 12, "8200vector"), ("c", 21, "8200vector")],
            own={"a": lease, "b": lease},
            sections="groups: {ab: {members: [a, b], multicast: yes}}",
        ),
    )


def test_a_write_whose_answer_was_lost_is_not_repeated_when_its_lease_has_ended() -> None:
    async def test(plant: Plant) -> None:
        async with controlled(plant) as client:
            plant.line.drive_faults[11] = Faults(unheard=1.0)
            since = len(plant.end.sent)
            writing = asyncio.ensure_future(client.do(client.ops.write("a", Code(46), 33)))
            await until(lambda: any(b"\x02" in x.data for x in plant.end.sent[since:]))
            await anyio.sleep(0.02)
            plant.line.drive_faults.clear()  # reading back shows that it was not written
            Client(plant, "new").take("a", take_over="plc")
            client.alive = False
            report = await writing
            assert (report.outcome, report.kind) == (Outcome.UNKNOWN, "lease-lost"), report
            written = [one for one in plant.end.sent[since:] if b"\x02" in one.data]
            assert len(written) == 1

    with_plant(test, roster(watchdog=""))


def test_plain_writes_groups_verbs_and_restores_need_the_token_and_an_inhibit_does_not() -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        ops = plant.site.operations
        for work in (
            ops.write("a", Code(46), 5),
            ops.write("a", Code(1), 3),
            ops.write("a", Code(12), 5, restoring=True),
            ops.write("a", Code(135), "H0008"),
            ops.write_group("all", Code(46), 5),
            ops.verb("a", Verb.ENABLE),
            ops.verb("a", Verb.RESET_FAULT),
            ops.verb("a", Verb.SET_SPEED, value=None, unit="Hz"),
            ops.readdress("a", 21),
        ):
            assert await kind_of_refusal(work) == "lease-required", work
        assert (await ops.write("a", Code(40), 0)).outcome.is_good
        assert (await ops.write_group("all", Code(40), 0)).outcome.is_good
        assert (await ops.verb("a", Verb.QUICK_STOP)).outcome is Outcome.VERIFIED
        assert (await ops.stop(StopAction.INHIBIT, "all")).outcome is Outcome.VERIFIED

    more = "writable: [C0001, C0040, C0046, C0135], restore: true, allow_address_change: true"
    with_plant(test, roster(more=more, names="ab"))


class Follower:
    """Remembers what happens to leases."""

    def __init__(self) -> None:
        self.heard: list[tuple[str, tuple[str, ...]]] = []
        self.texts = ""

    def lease_changed(self, what: str, drives: Sequence[str], fields: Mapping[str, str]) -> None:
        self.heard.append((what, tuple(drives)))
        self.texts += repr(fields)


def test_what_happens_to_a_lease_is_followed_and_why_and_the_metrics_say_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    follower = Follower()

    async def test(plant: Plant) -> None:
        ops = plant.site.operations
        ops.leases.followers += (follower.lease_changed,)
        async with controlled(plant) as client:
            client.alive = False
        await anyio.sleep(4.0)
        report = await ops.why("a")
        [latched] = [one for one in report.findings if one.name == "latched"]
        assert "latched (its lease lapsed): take a lease, then enable it" in latched.text.en
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        for row in (
            'lecombus_leases{line="test"} 0', 'lecombus_drive_silenced{line="test",drive="a"} 1',
            'lecombus_lease_lapses_total{line="test",drive="a"} 1',
            'lecombus_drive_latched{line="test",drive="a"} 1',
        ):  # fmt: skip
            assert row in page
        again = Client(plant, "next")
        again.take()
        await anyio.sleep(1.5)
        ops.leases.release("next", again.token)
        secrets = [client.token.split("-")[1], again.token.split("-")[1]]
        assert not any(one in follower.texts + caplog.text + page for one in secrets)

    with_plant(test, roster(policy="silence"))
    assert follower.heard == [
        ("taken", ("a",)), ("unlatched", ("a",)), ("ended", ("a",)), ("silenced", ("a",)),
        ("taken", ("a",)), ("silence-ended", ("a",)), ("released", ("a",)),
    ]  # fmt: skip


def test_numbers_grow_over_restarts() -> None:
    state = State()
    numbers: list[int] = []

    async def test(plant: Plant) -> None:
        await plant.online()
        client = Client(plant)
        client.take()
        numbers.append(int(client.token.split("-")[0]))

    for _ in range(3):
        with_plant(test, roster(), state=state)
    assert numbers == sorted(set(numbers))
    assert State.parse(state.text().encode()).lease_number == numbers[-1]


def test_without_leases_nothing_is_remarked_counted_or_kept() -> None:
    state = State()

    async def test(plant: Plant) -> None:
        await plant.online()
        await anyio.sleep(90.0)
        assert plant.site.supervision.leases.figures() is None
        assert "lease" not in plant.site.store.drive("a").remarks

    with_plant(test, roster_text([("a", 11, "8200vector")]), state=state)
    assert "lease" not in state.text()
