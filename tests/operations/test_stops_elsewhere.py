"""Stops of drives that do not take them as usual: another master's code bank, modes, terminals.

The drives are simulated ones, whose behaviour comes from the manuals by other code; what counts is
what they do, not what the report says.
"""

from __future__ import annotations

import anyio
import pytest

from lecombus.drives import FAMILY_NAMES, StopAction
from lecombus.schedule import Outcome
from support.rosters import roster_text
from support.site_host import Plant, with_plant

DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]
BANKED = ("820x", "822x", "8200vector", "93xx", "smvector")
BITS = {StopAction.QUICK_STOP: 0x0008, StopAction.INHIBIT: 0x0200}


def stopped(family: str, codes: dict[int, str], action: StopAction, *, known: bool = True) -> None:
    """Let a drive run, change codes behind the master's back, and stop it."""

    async def test(plant: Plant) -> None:
        await plant.online()
        model = plant.line["a"].model
        model.control = 0
        for number, text in codes.items():
            model.params.set(number, text)
        model.steer()
        report = await plant.site.operations.stop(action, "a" if known else "all")
        plant.line.advance(plant.now_s)
        assert report.outcome is Outcome.VERIFIED, report.reason
        assert model.control & (BITS[action] | BITS[StopAction.INHIBIT])

    with_plant(test, roster_text([("a", 11, family)]))


@pytest.mark.parametrize("action", StopAction)
@pytest.mark.parametrize("code", [248, 249])
@pytest.mark.parametrize("family", BANKED)
def test_a_code_bank_or_selection_that_somebody_left_loses_no_stop(
    family: str, code: int, action: StopAction
) -> None:
    stopped(family, {code: "1"}, action)


@pytest.mark.parametrize("bank", range(1, 8))
def test_no_bank_of_an_smvector_loses_a_stop(bank: int) -> None:
    stopped("smvector", {249: str(bank)}, StopAction.QUICK_STOP)


@pytest.mark.parametrize("family", ["822x", "smvector"])
def test_a_multicast_that_a_code_bank_led_astray_is_made_good(family: str) -> None:
    stopped(family, {249: "1"}, StopAction.INHIBIT, known=False)


@pytest.mark.parametrize(
    ("family", "codes"),
    [
        ("822x", {1: "0"}),
        ("smvector", {1420: "0"}),
        ("smvector", {1121: "0"}),
        ("smvector", {1100: "2"}),
    ],
)
@pytest.mark.parametrize("action", StopAction)
def test_a_drive_that_the_line_may_not_control_is_stopped_all_the_same(
    family: str, codes: dict[int, str], action: StopAction
) -> None:
    stopped(family, codes, action)


@pytest.mark.parametrize("configuration", ["1000", "2001"])
def test_a_93xx_that_does_not_follow_its_control_word_is_inhibited(configuration: str) -> None:
    async def test(plant: Plant) -> None:
        drive = plant.line["a"]
        drive.model.params.set(5, configuration)
        await plant.online()
        drive.model.terminal_rpm = 900.0  # type: ignore[attr-defined]
        drive.model.control = 0
        drive.model.steer()
        report = await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        assert drive.model.inhibited(), report.reason
        assert report.outcome is Outcome.VERIFIED
        assert "C0135 reads H0008; inhibit" in report.reason

    with_plant(test, roster_text([("a", 11, "93xx")]))


@pytest.mark.parametrize("family", DESCRIBED)
def test_a_quick_stop_leaves_an_inhibit_that_somebody_set_at_the_drive(family: str) -> None:
    async def test(plant: Plant) -> None:
        await plant.online()
        model = plant.line["a"].model
        model.control = 0
        model.steer()
        await anyio.sleep(12.0)  # C0135 was read since, and is so every 10 s
        plant.line.advance(plant.now_s)
        model.control = 0x0200
        model.steer()
        await anyio.sleep(1.2)  # C0150 was read since
        report = await plant.site.operations.stop(StopAction.QUICK_STOP, "a")
        assert report.outcome is Outcome.VERIFIED
        assert model.control & BITS[StopAction.INHIBIT]

    with_plant(test, roster_text([("a", 11, family)]))
