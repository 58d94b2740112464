"""Nothing but an enable enables a drive: every path, on both kinds of drive.

One kind reads back in C0135 every inhibit that is active; the other only what was last written to
it, so that an inhibit by C0040, a watchdog or a keypad is not in it. What counts is the simulated
power stage, looked at whenever the drive changes, not what a report says.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from decimal import Decimal

import anyio
import pytest

from lecombus.drives import FAMILY_NAMES, StopAction, Verb
from lecombus.fieldbus.lecom.simulator.model import Model
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
QUICK, INHIBIT = StopAction.QUICK_STOP, StopAction.INHIBIT
WORD, ENABLE = Code(135), Code(40)
FAULT_NUMBER = {"smvector": 4}

Path = Callable[[Plant], Awaitable[object]]


def roster(family: str) -> str:
    setpoint = {"smvector": "C0140", "93xx": "C0141"}.get(family, "C0046")
    writable = f"writable: [C0011, C0012, C0040, C0043, C0135, {setpoint}], restore: true"
    if family == "smvector":
        writable = "writable: [C0040, C0043, C0135, C0140, C1061, C1103], restore: true"
    return roster_text(
        [("a", 11, family), ("b", 12, family)], drive=writable,
        sections="groups:\n  both: {members: [a, b]}\n",
    )  # fmt: skip


def with_setpoint(model: Model, family: str) -> None:
    model.preset({"smvector": 1061, "93xx": 141}.get(family, 46), "20")


def watch(model: Model, seen: list[tuple[bool, float]]) -> None:
    """Note from now on, whenever the drive changes, whether the motor has power, and its target."""
    steer = model.steer

    def noted() -> None:
        steer()
        seen.append((model.motor.powered, model.motor.target))

    model.steer = noted  # type: ignore[method-assign]


async def by_the_line(plant: Plant) -> None:
    assert (await plant.site.operations.stop(INHIBIT, "a")).outcome is Outcome.VERIFIED


async def by_a_plain_write(plant: Plant) -> None:
    assert (await plant.site.operations.write("a", ENABLE, 0)).outcome is Outcome.DONE


async def by_the_watchdog(plant: Plant) -> None:
    model = plant.line["a"].model
    model.expire(1)
    model.steer()
    await anyio.sleep(1.2)  # C0150 was read since


async def at_the_keypad(plant: Plant) -> None:
    plant.line["a"].model.preset(40, "0")
    await anyio.sleep(1.2)


async def at_the_terminal(plant: Plant) -> None:
    plant.line["a"].set_terminal(high=False)
    await anyio.sleep(1.2)


async def quick_stop(plant: Plant) -> None:
    assert (await plant.site.operations.stop(QUICK, "a")).outcome is Outcome.VERIFIED


async def quick_stop_of_the_group(plant: Plant) -> None:
    assert (await plant.site.operations.stop(QUICK, "both")).outcome is Outcome.VERIFIED


async def quick_stop_with_nothing_known(plant: Plant) -> None:
    plant.site.drives.get("a").control_word.forget()
    await quick_stop(plant)


async def quick_stop_that_is_refused(plant: Plant) -> None:
    model = plant.line["a"].model
    setting = {"smvector": (1420, "0"), "93xx": (5, "1000")}
    model.params.set(*setting.get(plant.line["a"].family, (1, "0")))
    await quick_stop(plant)


async def inhibit(plant: Plant) -> None:
    assert (await plant.site.operations.stop(INHIBIT, "a")).outcome is Outcome.VERIFIED


async def stops_at_the_same_time(plant: Plant) -> None:
    stops = [plant.site.operations.stop(action, "a") for action in (INHIBIT, QUICK, QUICK)]
    assert {one.outcome for one in await asyncio.gather(*stops)} == {Outcome.VERIFIED}


async def shutdown(plant: Plant) -> None:
    plant.site.operations.close()
    assert (await plant.site.operations.stop(QUICK, "all")).outcome is Outcome.VERIFIED


async def verb_quick_stop(plant: Plant) -> None:
    await plant.site.operations.verb("a", Verb.QUICK_STOP)


async def verb_inhibit(plant: Plant) -> None:
    await plant.site.operations.verb("a", Verb.INHIBIT)


async def verb_set_speed(plant: Plant) -> None:
    unit = "%" if plant.line["a"].family == "93xx" else "Hz"
    await plant.site.operations.verb("a", Verb.SET_SPEED, value=Decimal(10), unit=unit)


async def reset_fault(plant: Plant) -> None:
    plant.trip("a", FAULT_NUMBER.get(plant.line["a"].family, 50))
    await anyio.sleep(1.2)
    report = await plant.site.operations.verb("a", Verb.RESET_FAULT)
    assert report.outcome is Outcome.VERIFIED, report.reason


async def reset_by_the_control_word(plant: Plant) -> None:
    """The edge of bit 11, as on a drive that does not know C0043."""
    model = plant.line["a"].model
    model.readers.pop(43, None)
    model.params.specs.pop((43, 0), None)  # type: ignore[attr-defined]
    await reset_fault(plant)


async def an_enable_that_is_taken_back(plant: Plant) -> None:
    plant.line["a"].set_terminal(high=False)
    report = await plant.site.operations.verb("a", Verb.ENABLE)
    assert report.outcome is not Outcome.VERIFIED


async def writes_of_another_code(plant: Plant) -> None:
    code = a_parameter(plant)
    await plant.site.operations.write("a", code, 55)
    await plant.site.operations.write_group("both", code, 56)


async def restore(plant: Plant) -> None:
    await plant.site.operations.stop(INHIBIT, "a")
    await plant.site.operations.write("a", a_parameter(plant), 57, verify=True, restoring=True)


def a_parameter(plant: Plant) -> Code:
    return Code(1103) if plant.line["a"].family == "smvector" else Code(12)


async def audit(plant: Plant) -> None:
    plant.site.health.audits.ask(plant.site.drives.get("a"))
    await anyio.sleep(3.0)


SOURCES: list[Path] = [
    by_the_line,
    by_a_plain_write,
    by_the_watchdog,
    at_the_keypad,
    at_the_terminal,
]
PATHS: list[Path] = [
    quick_stop, quick_stop_of_the_group, quick_stop_with_nothing_known, quick_stop_that_is_refused,
    inhibit, stops_at_the_same_time, shutdown, verb_quick_stop, verb_inhibit, verb_set_speed,
    reset_fault, reset_by_the_control_word, an_enable_that_is_taken_back,
    writes_of_another_code, restore, audit,
]  # fmt: skip

NO_STOPS = (verb_set_speed, writes_of_another_code, audit)
"""After these a terminal that is closed enables the drive, as it did before."""


def inhibited_and(
    family: str, source: Path, path: Path, *, as_written: bool
) -> list[tuple[bool, float]]:
    """Inhibit a drive that runs, take a path, close its terminal; tell what its motor got since."""
    seen: list[tuple[bool, float]] = []

    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"]
        with_setpoint(drive.model, family)
        await plant.site.operations.verb("a", Verb.ENABLE)
        plant.line.advance(plant.now_s)
        assert drive.model.motor.powered
        await source(plant)
        watch(drive.model, seen)
        await path(plant)
        if path not in NO_STOPS:
            drive.set_terminal(high=True)
        await anyio.sleep(1.2)
        plant.line.advance(plant.now_s)
        drive.model.steer()

    with_plant(test, roster(family), word_as_written=as_written)
    assert seen
    return seen


def sources_of(family: str) -> list[Path]:
    return SOURCES if family == "822x" else [by_the_line, by_the_watchdog]


BOTH_KINDS = pytest.mark.parametrize("as_written", [False, True], ids=["state", "written"])


@BOTH_KINDS
@pytest.mark.parametrize(
    ("family", "source", "path"),
    [
        (name, one, path)
        for name in DESCRIBED
        for one in sources_of(name)
        for path in PATHS
        # These two have no reset by the control word.
        if path is not reset_by_the_control_word or name not in ("820x", "smvector")
    ],
    ids=lambda one: getattr(one, "__name__", one),
)
def test_an_inhibited_drive_is_enabled_by_no_path_but_an_enable(
    family: str, source: Path, path: Path, as_written: bool
) -> None:
    seen = inhibited_and(family, source, path, as_written=as_written)
    if path is reset_fault and family == "820x":
        # Its reset is an enable, whereupon it starts anew (EDB2102EN 6.4): in quick stop.
        assert not any(target for _, target in seen)
        assert not seen[-1][0]
    else:
        assert not any(powered for powered, _ in seen)


@BOTH_KINDS
@pytest.mark.parametrize("family", DESCRIBED)
def test_nor_when_the_watchdog_acted_while_the_line_was_away(family: str, as_written: bool) -> None:
    """The quick stop comes at once, before any status was read again."""
    seen: list[tuple[bool, float]] = []

    async def test(plant: Plant) -> None:
        await plant.online()
        drive = plant.line["a"]
        with_setpoint(drive.model, family)
        await plant.site.operations.verb("a", Verb.ENABLE)
        plant.end.unplug()
        await anyio.sleep(3.0)
        plant.line.advance(plant.now_s)
        assert drive.model.inhibited()
        watch(drive.model, seen)
        plant.end.replug()
        await until(lambda: plant.site.worker.is_open)
        assert (await plant.site.operations.stop(QUICK, "a")).outcome is Outcome.VERIFIED
        drive.model.steer()
        assert seen
        assert not any(powered for powered, _ in seen)

    watchdog = "{time: 2s, action: inhibit, configure: true}"
    with_plant(
        test, roster_text([("a", 11, family)], watchdog=watchdog), word_as_written=as_written
    )


@BOTH_KINDS
@pytest.mark.parametrize("family", DESCRIBED)
def test_an_enable_still_enables_after_a_quick_stop_of_an_inhibited_drive(
    family: str, as_written: bool
) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        model = plant.line["a"].model
        with_setpoint(model, family)
        await plant.site.operations.verb("a", Verb.ENABLE)
        await by_the_line(plant)
        await quick_stop(plant)
        assert (await plant.site.operations.verb("a", Verb.ENABLE)).outcome is Outcome.VERIFIED
        plant.line.advance(plant.now_s)
        assert model.motor.powered
        assert model.motor.target

    with_plant(test, roster(family), word_as_written=as_written)


@BOTH_KINDS
@pytest.mark.parametrize("family", DESCRIBED)
def test_a_quick_stop_of_a_running_drive_is_no_inhibit(family: str, as_written: bool) -> None:
    """Also of one that was inhibited before, and whose word showed it."""

    async def test(plant: Plant) -> None:
        await plant.online()
        model = plant.line["a"].model
        with_setpoint(model, family)
        for _ in range(2):
            await plant.site.operations.verb("a", Verb.ENABLE)
            await anyio.sleep(1.2)
            await quick_stop(plant)
            plant.line.advance(plant.now_s)
            assert model.motor.powered
            assert not model.motor.target
            await by_the_line(plant)
            await quick_stop(plant)

    with_plant(test, roster(family), word_as_written=as_written)


@pytest.mark.parametrize("turnaround", ["2ms", "0ms"])
@pytest.mark.parametrize("family", ["8200vector", "93xx"])
def test_a_quick_stop_of_the_group_keeps_an_inhibit_that_is_shown_before_it_is_sent(
    family: str, turnaround: str
) -> None:
    """The exchange that is under way when the stop is asked for may show it."""
    after_showing = []

    async def test(plant: Plant) -> None:
        await plant.online()
        drive, operations = plant.line["a"], plant.site.operations
        with_setpoint(drive.model, family)
        for step in range(40):
            for name in "ab":
                assert (await operations.verb(name, Verb.ENABLE)).outcome is Outcome.VERIFIED
            await anyio.sleep(1.0)
            drive.model.preset(40, "0")  # at its keypad
            await anyio.sleep(step * 0.002)
            before = len(plant.end.heard)
            begun_s = plant.now_s
            assert (await operations.stop(QUICK, "both")).outcome is Outcome.VERIFIED
            plant.line.advance(plant.now_s)
            first = next(
                one.at_s for one in plant.end.sent
                if one.at_s >= begun_s and one.data[3:6] == b"\x02=5"
            )  # fmt: skip
            heard = b"".join(one.data for one in plant.end.heard[before:] if one.at_s < first)
            words = [int(word, 16) for word in re.findall(rb"\?0H([0-9A-F]{4})", heard)]
            shown = any(word & 0x0080 for word in words)  # controller inhibit
            if shown:
                after_showing.append(step)
                assert drive.model.inhibited()
        assert after_showing

    text = roster(family).replace("restore: true", "cyclic: [{code: C0150, every: 50ms}]")
    text = text.replace("baud: 19200", f"baud: 19200, turnaround: {turnaround}")
    with_plant(test, text, word_as_written=True)
