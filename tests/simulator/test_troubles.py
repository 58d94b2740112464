"""Faults of drives: which there are, what they do, what ends them, what is remembered."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from lecombus.fieldbus.lecom.simulator.families import MODELS
from lecombus.fieldbus.lecom.simulator.troubles import Troubles, kinds
from support.sim_host import Host

RESETS = {"821x": (43, "0"), "8200vector": (43, "0"), "93xx": (43, "0"), "smvector": (43, "1")}


def running(family: str) -> Host:
    speed = {"93xx": 141, "smvector": 1061}.get(family, 46)
    ramp = {"smvector": 1104}.get(family, 12)
    presets = {speed: "40", 135: "H0000", ramp: "0"}
    host = Host(SimLine([SimDrive(11, family, "d", presets)], baud=19200))
    host.wait(0.1)
    return host


@pytest.mark.parametrize("family", [name for name in MODELS if name != "generic"])
def test_only_faults_of_the_family_can_occur(family: str) -> None:
    drive = running(family).line["d"]
    with pytest.raises(ValueError, match="no fault has the number 99 here: "):
        drive.trip(99)
    assert drive.model.fault == 0


def test_a_device_without_a_manual_has_no_faults() -> None:
    with pytest.raises(ValueError, match="it has none"):
        SimDrive(11, "generic").trip(1)


@pytest.mark.parametrize("family", RESETS)
def test_a_cause_that_stays_makes_a_reset_useless_until_it_is_gone(family: str) -> None:
    host = running(family)
    drive = host.line["d"]
    drive.trip(11, stays=True)
    assert host.write(11, *RESETS[family]) == "ACK"
    assert host.write(11, 135, "H0800") == "ACK"
    assert host.word(11, 68) & 0x8000
    drive.clear_fault()
    assert host.word(11, 68) & 0x8000, "it still waits for its reset"
    assert host.write(11, *RESETS[family]) == "ACK"
    assert not host.word(11, 68) & 0x8000


def test_a_cause_that_stays_trips_again_after_a_power_cycle() -> None:
    host = running("93xx")
    drive = host.line["d"]
    drive.trip(50, stays=True)
    drive.power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert [host.read(11, 168, n, extended=True) for n in (1, 2)] == ["50", "50"]


def test_an_820x_whose_cause_stays_restarts_into_the_same_fault() -> None:
    host = running("820x")
    drive = host.line["d"]
    drive.trip(15, stays=True)
    for _ in range(2):
        host.write(11, 40, "0")
        assert host.write(11, 40, "1") == ""
        host.wait(1.5)
        assert host.word(11, 68) & 0x8000
    drive.clear_fault()
    host.write(11, 40, "0")
    host.write(11, 40, "1")
    host.wait(1.5)
    assert not host.word(11, 68) & 0x8000
    assert [host.read(11, 160 + n) for n in (1, 2, 3, 4)] == ["15", "15", "15", "0"]


@pytest.mark.parametrize(("number", "digit"), [(11, 1), (91, 9), (105, 0), (140, 4), (85, 8)])
def test_c0068_shows_the_tens_digit(number: int, digit: int) -> None:
    host = running("8200vector")
    host.line["d"].trip(number)
    assert host.word(11, 68) & 0x000F == digit


@pytest.mark.parametrize("family", ["821x", "8200vector", "93xx"])
def test_a_message_takes_the_pulses_away_while_it_lasts_and_is_no_trip(family: str) -> None:
    host = running(family)
    drive = host.line["d"]
    drive.trip(1030)
    word = host.word(11, 150)
    assert word >> 8 & 0xF == 7
    assert word & 0x0002
    assert not word & 0x8000
    assert bool(word & 0x2000) == (family != "821x"), "undervoltage is not the overvoltage bit"
    assert not host.word(11, 68) & 0x8800
    assert host.read(11, 43) == "0"
    host.write(11, 43, "0")
    assert host.word(11, 150) >> 8 & 0xF == 7, "nothing resets a message"
    drive.clear_fault()
    assert host.word(11, 150) >> 8 & 0xF == 6
    memory = (161, 0) if family != "93xx" else (168, 2)
    assert host.read(11, *memory, extended=True) == "1030"


def test_a_warning_is_shown_and_stops_nothing() -> None:
    host = running("93xx")
    drive = host.line["d"]
    drive.trip(2054)
    host.wait(5)
    assert drive.model.motor.speed == 1200
    word = host.word(11, 150)
    assert word & 0x1000
    assert word >> 8 & 0xF == 6
    assert host.read(11, 168, 1, extended=True) == "2054"
    drive.trip(50)
    assert host.read(11, 168, 1, extended=True) == "50"
    host.write(11, 43, "0")
    assert [host.read(11, 168, n, extended=True) for n in (1, 2)] == ["2054", "50"]


def test_an_smvector_remembers_eight_faults_newest_first() -> None:
    host = running("smvector")
    for number in range(1, 11):
        host.line["d"].trip(number)
    memory = [host.read(11, 1500, n, extended=True) for n in range(1, 9)]
    assert memory == [str(n) for n in range(10, 2, -1)]
    assert host.read(11, 1500) == "10"


def test_an_smvector_shows_overheating_and_overvoltage_in_its_status_word() -> None:
    host = running("smvector")
    drive = host.line["d"]
    shown = {}
    for number in (4, 6, 13):
        drive.trip(number)
        shown[number] = host.word(11, 150) & 0x3000
    assert shown == {4: 0x1000, 6: 0x2000, 13: 0}


@pytest.mark.parametrize(
    ("known", "numbers"),
    [(range(1, 37), "1 to 36"), ((11, 12, 14, 16, 15), "11 to 12, 14 to 16"), ((7, 5), "5, 7"),
     ((), "it has none")],
)  # fmt: skip
def test_the_numbers_of_a_family_are_said_as_ranges(known: Iterable[int], numbers: str) -> None:
    troubles = Troubles(kinds(trips=tuple(known)))
    assert troubles.numbers() == numbers
    with pytest.raises(ValueError, match=f"number 99 here: {numbers}"):
        troubles.occur(99)
