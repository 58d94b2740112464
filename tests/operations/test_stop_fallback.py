"""`stop_fallback: none` on whole lines: whatever way a quick stop is asked for, no inhibit follows.

The inverters refuse their control word because C0001 is not 3, and take an inhibit; a 93XX in a
signal configuration that does not end in 1 takes the word and ignores it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import anyio
import pytest

from lecombus.daemon import log_last_stop
from lecombus.drives import StopAction, Verb
from lecombus.operations.operation_reports import GroupReport, VerbReport, WriteReport
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, with_plant

QUICK, INHIBIT = StopAction.QUICK_STOP, StopAction.INHIBIT
Ask = Callable[[Plant], Awaitable[GroupReport | VerbReport]]


def roster(second: str = "821x", goodbye: str = "quick-stop") -> str:
    return roster_text(
        [("hoist", 11, "821x"), ("lift", 12, second), ("belt", 13, "821x")],
        own=dict.fromkeys(("hoist", "lift"), "stop_fallback: none"),
        sections=f"on_shutdown: {goodbye}\ngroups: {{near: {{members: [hoist, lift]}}}}",
    )


async def refusing(plant: Plant) -> None:
    """Have every drive run, and then refuse or ignore its control word."""
    await plant.online()
    await anyio.sleep(10.0)
    for name in ("hoist", "lift", "belt"):
        report = await plant.site.operations.verb(name, Verb.ENABLE)
        assert report.outcome is Outcome.VERIFIED
    for name in ("hoist", "lift", "belt"):
        is_servo = plant.site.store.family(name).configured_by is not None
        code, text = (5, "1000") if is_servo else (1, "0")
        plant.line[name].model.params.set(code, text)  # at the keypad
        await plant.site.operations.read(name, Code(code))
    await anyio.sleep(3.0)


def inhibits(plant: Plant, name: str) -> list[str]:
    """Give what a drive heard that inhibits it."""
    return [
        f"C{one.code:04d}={one.text}"
        for one in plant.line[name].log
        if one.kind == "write"
        and ((one.code == 40 and one.text == "0")
             or (one.code == 135 and int(one.text[1:], 16) & 0x0200))
    ]  # fmt: skip


def shutdown(plant: Plant) -> Awaitable[GroupReport]:
    """Do what the daemon does at its end."""
    action = StopAction(plant.site.roster.on_shutdown)
    plant.site.operations.close()
    return plant.site.operations.stop(action, "all")


WAYS: dict[str, tuple[Ask, set[str]]] = {
    "one": (lambda plant: plant.site.operations.stop(QUICK, "hoist"), {"hoist"}),
    "verb": (lambda plant: plant.site.operations.verb("hoist", Verb.QUICK_STOP), {"hoist"}),
    "group": (lambda plant: plant.site.operations.stop(QUICK, "near"), {"hoist", "lift"}),
    "all": (lambda plant: plant.site.operations.stop(QUICK, "all"), {"hoist", "lift", "belt"}),
    "shutdown": (shutdown, {"hoist", "lift", "belt"}),
}


def members(report: GroupReport | VerbReport) -> dict[str, WriteReport | VerbReport]:
    if isinstance(report, VerbReport):
        return {report.drive: report}
    return {one.drive: one for one in report.members}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("second", ["821x", "93xx"])
def test_a_quick_stop_that_is_refused_or_ignored_becomes_no_inhibit(way: str, second: str) -> None:
    ask, reached = WAYS[way]

    async def test(plant: Plant) -> None:
        await refusing(plant)
        report = await ask(plant)
        told = members(report)
        assert set(told) == reached
        await anyio.sleep(3.0)
        for name in {"hoist", "lift"} & reached:
            assert inhibits(plant, name) == [], name
            assert not plant.line[name].model.inhibited()
            ignored = name == "lift" and second == "93xx"
            assert told[name].outcome is (Outcome.UNKNOWN if ignored else Outcome.REFUSED), name
            assert "stop_fallback: none" in told[name].reason
            assert ("refused by the drive (NAK)" in told[name].reason) is not ignored
            assert "emergency stop" in told[name].remedy
        if "belt" in reached:
            assert told["belt"].outcome is Outcome.VERIFIED, "its quick stop became an inhibit"
            assert plant.line["belt"].model.inhibited()
        else:
            assert inhibits(plant, "belt") == [], "it was not asked for"
        if reached != {"hoist"}:
            assert report.outcome not in (Outcome.DONE, Outcome.VERIFIED)

    with_plant(test, roster(second))


@pytest.mark.parametrize("second", ["821x", "93xx"])
def test_an_inhibit_at_the_end_of_the_daemon_is_one(second: str) -> None:
    async def test(plant: Plant) -> None:
        await refusing(plant)
        report = await shutdown(plant)
        assert report.outcome is Outcome.VERIFIED
        assert all(plant.line[name].model.inhibited() for name in ("hoist", "lift", "belt"))

    with_plant(test, roster(second, goodbye="inhibit"))


def test_the_end_of_the_daemon_names_the_drives_that_may_run_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def test(plant: Plant) -> None:
        await refusing(plant)
        log_last_stop(QUICK, await shutdown(plant))

    with_plant(test, roster())
    (said,) = [one for one in caplog.messages if "event=shutdown-stop " in one]
    assert "hoist" in said
    assert "lift" in said
    assert "belt" not in said.partition("not-stopped=")[2]
