"""What keeps a line at its baud rate: every obstacle is named, and nothing is written."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.rebaud import DrivePlace, Subject
from lecombus.fieldbus.lecom.simulator import SimDrive
from lecombus.fieldbus.lecom.simulator.motor import Motor
from lecombus.parameters import Code
from support.golden import Golden
from support.rebauding import RebaudLine, Write, subject_of

FAMILIES = ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")


def standing(*families: str, **more: object) -> RebaudLine:
    """Drives that are inhibited."""
    drives = [(kind, 11 + place, kind) for place, kind in enumerate(families)]
    subjects = [subject_of(name, address, kind, **more) for name, address, kind in drives]
    line = RebaudLine(drives, subjects=subjects)
    for drive in line.drives.values():
        if drive.family != "generic":
            line.scanned.host.write(drive.address, 40, "0")
    return line


def turning(family: str, monkeypatch: pytest.MonkeyPatch) -> RebaudLine:
    """One drive whose motor turns, and would coast for long."""
    monkeypatch.setattr(Motor, "COAST_S", 60.0)
    line = standing(family)
    host, address = line.scanned.host, line[family].address
    setpoint = {"93xx": (141, "50"), "smvector": (1061, "30")}.get(family, (46, "50"))
    for code, text in (setpoint, (135, "H0000"), (40, "1")):
        assert host.write(address, code, text) == "ACK"
    host.wait(20.0)
    return line


def test_drives_of_all_families_that_stand_pass_and_nothing_is_written() -> None:
    line = standing(*FAMILIES).check()
    assert line.work.obstacles == []
    assert set(line.places.values()) == {DrivePlace.OLD}
    assert not [one for one in line.steps if isinstance(one, Write)]


def test_every_obstacle_of_every_drive_is_named_at_once() -> None:
    line = standing("822x", "93xx", "smvector", "8200vector")
    line["822x"].present = False
    for code, text in ((40, "1"), (135, "H0000")):
        line.scanned.host.write(line["93xx"].address, code, text)
    line["smvector"].model.params.set(1420, "0")
    line.check()
    assert {one.drive: one.kind for one in line.work.obstacles} == {
        "822x": "no-answer",
        "93xx": "not-stopped",
        "smvector": "locked",
    }
    silent = next(one for one in line.work.obstacles if one.drive == "822x")
    assert "(address 11) does not say its baud rate (C0125)" in silent.problem
    assert "neither at 9600 nor at 19200" in silent.problem


@pytest.mark.parametrize("family", ["821x", "8200vector", "smvector"])
def test_quick_stop_at_a_frequency_of_0_is_enough(family: str) -> None:
    line = standing(family)
    host, address = line.scanned.host, line[family].address
    host.write(address, 40, "1")
    host.write(address, 135, "H0008")
    line.check()
    assert (line.kinds, line.places) == ([], {family: DrivePlace.OLD})
    said = "in quick stop, output frequency 0; whether its motor still turns it does not measure"
    assert line.work.drives[0].motion == said


@pytest.mark.parametrize("family", [one for one in FAMILIES if one != "93xx"])
def test_a_coasting_inverter_passes_and_is_not_called_standing(
    family: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = turning(family, monkeypatch)
    host, address = line.scanned.host, line[family].address
    host.write(address, 40, "0")
    line.check()
    assert line[family].model.motor.speed != 0.0
    assert line.kinds == []
    assert line.work.drives[0].motion == (
        "inhibited; whether its motor still turns it does not measure"
    )


def test_a_93xx_measures_its_speed_and_must_have_come_to_rest(
    monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    line = turning("93xx", monkeypatch)
    host, address = line.scanned.host, line["93xx"].address
    host.write(address, 40, "0")
    line.check()
    assert line.kinds == ["not-stopped"]
    obstacle = line.work.obstacles[0]
    golden(obstacle.problem, obstacle.remedy)
    host.wait(60.0)
    line.work.obstacles.clear()
    line.check()
    assert line.kinds == []
    golden(line.work.drives[0].motion)


@pytest.mark.parametrize(("configuration", "kinds"), [("1001", []), ("2001", ["not-stopped"])])
def test_a_93xx_in_quick_stop_passes_where_its_configuration_tells_its_speed(
    configuration: str, kinds: list[str]
) -> None:
    line = standing("93xx")
    host, address = line.scanned.host, line["93xx"].address
    line["93xx"].model.preset(5, configuration)
    for code, text in ((40, "1"), (135, "H0008")):
        assert host.write(address, code, text) == "ACK"
    line.check()
    assert line.kinds == kinds
    if kinds:
        assert "is neither inhibited nor in quick stop" in line.work.obstacles[0].problem


def test_quick_stop_is_not_enough_while_it_still_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    line = turning("8200vector", monkeypatch)
    line.scanned.host.write(line["8200vector"].address, 135, "H0008")
    line.check()
    assert line.kinds == ["not-stopped"]
    assert "its output frequency (C0050) is not 0 yet" in line.work.obstacles[0].problem


def test_an_820x_must_be_inhibited_to_store_it() -> None:
    line = standing("820x")
    host, address = line.scanned.host, line["820x"].address
    host.write(address, 135, "H0008")
    host.write(address, 40, "1")
    host.wait(20.0)
    line.check()
    assert line.kinds == ["not-stopped"]
    assert "would not store its baud rate" in line.work.obstacles[0].problem


def test_another_drive_than_the_one_recorded_is_refused() -> None:
    line = standing("8200vector", expected={Code(1810): "33S2102I_99999"}).check()
    assert line.kinds == ["swapped"]
    assert "C1810 reads 33S2102I_10000, not 33S2102I_99999" in line.work.obstacles[0].problem


@pytest.mark.parametrize(("accepted", "kinds"), [((), ["locked"]), (("1.30",), [])])
def test_software_that_no_manual_vouches_for_is_left_alone(
    accepted: tuple[str, ...], kinds: list[str]
) -> None:
    line = standing("smvector", accept_software=accepted)
    line["smvector"].model.params.set(1494, "1.30")
    assert line.check().kinds == kinds


def test_a_code_bank_does_not_matter_in_extended_addressing() -> None:
    line = standing("8200vector")
    line["8200vector"].model.params.set(249, "1")
    assert line.check().kinds == []


def test_a_code_bank_stands_against_standard_addressing() -> None:
    known = subject_of("8200vector", 11, "8200vector")
    plain = Subject(known.name, known.address, known.family, Form.STANDARD)
    line = RebaudLine([("8200vector", 11, "8200vector")], subjects=[plain])
    params = line["8200vector"].model.params
    specs = params.specs
    assert isinstance(specs, dict)
    specs[375, 0] = specs[125, 0]  # what a read of C0125 reaches reads like a baud rate
    params.set(375, "0")
    params.set(249, "1")
    locked = [one for one in line.check().work.obstacles if one.kind == "locked"]
    assert "C0249 of 8200vector reads 1" in locked[0].problem


def test_a_rate_that_waits_for_a_power_cycle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    line = standing("822x")
    monkeypatch.setattr(SimDrive, "baud", property(lambda _: 9600))
    line["822x"].model.params.set(125, "4")
    assert line.check().kinds == ["wrong-rate"]
    assert "answers at 9600 baud, but its C0125 reads 4, not 0" in line.work.obstacles[0].problem


def test_a_drive_that_an_earlier_attempt_left_at_the_new_rate_passes() -> None:
    line = standing("822x", "8200vector")
    line["822x"].model.params.set(125, "4")
    line.check()
    assert line.work.obstacles == []
    assert line.places == {"822x": DrivePlace.NEW, "8200vector": DrivePlace.OLD}


@pytest.mark.parametrize(
    ("family", "setting", "note"),
    [
        ("822x", {1922: "2", 1923: "2000"}, "its watchdog will act (quick-stop after 2s)"),
        ("822x", {1922: "0", 1923: "2000"}, ""),
        ("smvector", {1426: "3", 1425: "65000"}, "shows a fault until `lecombus reset-fault`"),
        ("smvector", {1426: "1", 1425: "0"}, ""),
    ],
)
def test_what_watchdogs_will_do_is_said(family: str, setting: dict[int, str], note: str) -> None:
    line = standing(family)
    for code, text in setting.items():
        line[family].model.params.set(code, text)
    line.check()
    assert line.kinds == []
    told = line.work.drives[0].note
    assert note in told
    assert bool(told) == bool(note)


def test_an_interruption_ends_it_before_the_next_telegram() -> None:
    line = standing("822x", "8200vector")

    def interrupt(_: object) -> None:
        line.work.line.interrupted = len(line.steps) == 3

    line.before = interrupt
    line.check()
    assert len(line.steps) == 3
    assert set(line.places.values()) == {DrivePlace.UNSEEN}
