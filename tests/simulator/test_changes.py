"""What changes who a drive is or how it is reached: address, baud rate, resets, another drive."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine, build
from lecombus.fieldbus.lecom.simulator.families import MODELS
from lecombus.fieldbus.lecom.simulator.parameters import Kept
from support.sim_host import Host, write_telegram

DESCRIBED = [name for name in MODELS if name != "generic"]
ADDRESS = {"smvector": 1410}
BAUD = {"smvector": 1411}
STORED = {"93xx": (12, "7"), "smvector": (1104, "7")}


def single(family: str, baud: int = 19200) -> Host:
    host = Host(build([("d", 11, family)], baud=baud))
    host.wait(0)
    host.write(11, 40, "0")
    return host


@pytest.mark.parametrize("family", DESCRIBED)
def test_a_new_address_counts_from_the_next_telegram(family: str) -> None:
    host = single(family)
    assert host.write(11, ADDRESS.get(family, 9), "12") == "ACK"
    assert host.read(11, 150) == ""
    assert host.read(12, 150)
    host.line["d"].power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert host.read(12, 150), "it is stored"


def test_two_drives_at_one_address_cannot_be_understood() -> None:
    host = Host(build([("a", 11, "822x"), ("b", 12, "822x")], baud=9600))
    assert host.write(12, 9, "11") == "ACK"
    host.say(b"\x041150\x05")
    host.hear()
    assert host.line.clashes > 0


@pytest.mark.parametrize("family", DESCRIBED)
def test_the_baud_rate_is_shown_and_a_new_one_counts_for_the_acknowledgement(family: str) -> None:
    host = single(family)
    code = BAUD.get(family, 125)
    assert host.read(11, code) == "4"
    host.say(write_telegram(11, code, "0"))
    rubbish = host.hear()
    assert rubbish
    assert rubbish[0] & 0x7F != 0x06
    assert host.read(11, 150) == "", "the host speaks another baud rate"
    host.line.host_baud = 9600
    assert host.read(11, code) == "0"


def test_a_drive_set_to_another_rate_than_the_line_is_not_understood() -> None:
    host = Host(SimLine([SimDrive(11, "822x", "d", {125: "0"})], baud=19200))
    assert host.read(11, 150) == ""
    host.line.host_baud = 9600
    assert host.read(11, 150)


@pytest.mark.parametrize("family", DESCRIBED)
def test_a_factory_reset_takes_parameters_back_and_leaves_the_line(family: str) -> None:
    host = single(family)
    drive = host.line["d"]
    code, value = STORED.get(family, (12, "7"))
    before = drive.model.params.find(code, 0).default
    assert host.write(11, code, value) == "ACK"
    assert host.read(11, code) == value
    drive.factory_reset()
    assert host.read(11, code) == before
    assert host.read(11, ADDRESS.get(family, 9)) == "11"
    assert host.write(11, code, value) == "ACK", "it can be written to at once"
    if family not in ("93xx", "smvector"):
        assert host.read(11, 1) == "0", "the terminals are in control, as from the maker"


def test_a_factory_reset_takes_all_parameter_sets_back() -> None:
    host = single("8200vector")
    for offset in (0, 2000, 4000, 6000):
        host.write(11, offset + 12, "7", extended=True)
    host.line["d"].factory_reset()
    for offset in (0, 2000, 4000, 6000):
        assert host.read(11, offset + 12, extended=True) == "5"


def test_a_factory_reset_of_a_93xx_forgets_what_was_saved() -> None:
    host = single("93xx")
    drive = host.line["d"]
    host.write(11, 12, "7")
    host.write(11, 3, "1")
    drive.factory_reset()
    drive.power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert host.read(11, 12) == "2"


@pytest.mark.parametrize("family", DESCRIBED)
def test_a_swapped_drive_is_new_and_stands_at_the_old_ones_place(family: str) -> None:
    host = single(family, baud=9600)
    code, value = STORED.get(family, (12, "7"))
    host.write(11, code, value)
    new = host.line.swap("d", host.now_s, overrides={200: "S33S-OTHER"})
    assert host.read(11, 200) == "", "it is starting"
    host.wait(1.5)
    assert host.read(11, 200) == "S33S-OTHER"
    assert host.read(11, code) != value
    assert host.line["d"] is new
    assert new.wear == 0


def test_a_drive_of_another_family_may_take_a_place_and_address_and_rate_are_set_on_it() -> None:
    host = single("822x")
    host.line.swap("d", host.now_s, "smvector")
    host.wait(1.5)
    assert host.read(11, 1410) == "11"
    assert host.read(11, 1411) == "4"
    assert host.read(11, 1502) == "25"


def test_what_the_old_drive_was_about_to_say_is_never_said() -> None:
    host = single("822x")
    host.say(b"\x041150\x05")
    host.wait(0.005)
    host.line.swap("d", host.now_s)
    assert host.hear() == b""


def test_an_unknown_family_leaves_the_drive_in_place() -> None:
    host = single("822x")
    old = host.line["d"]
    with pytest.raises(ValueError, match="no simulated family 'x'"):
        host.line.swap("d", host.now_s, "x")
    assert host.line["d"] is old


def test_faults_can_be_there_from_the_start() -> None:
    line = build([("a", 11, "8200vector"), ("b", 12, "93xx")], faults="trip=11:50+12:11:stays")
    assert line["a"].model.fault == 50
    line["b"].model.reset_fault()
    assert line["b"].model.fault == 11


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ("trip=11", "trip=ADDRESS:NUMBER"),
        ("trip=11:x", "trip=ADDRESS:NUMBER"),
        ("trip=11:50:forever", "trip=ADDRESS:NUMBER"),
        ("trip=13:50", "no drive has the address 13"),
        ("trip=11:99", "no fault has the number 99 here"),
    ],
)
def test_a_wrong_trip_says_what_is_right(faults: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build([("a", 11, "8200vector")], faults=faults)


@pytest.mark.parametrize("family", DESCRIBED)
def test_what_a_factory_reset_took_can_be_written_back_over_the_line(family: str) -> None:
    host = single(family)
    drive = host.line["d"]
    drive.model.preset(40, "0")
    untouched = {ADDRESS.get(family, 9), BAUD.get(family, 125), 1400, 1403, 1420, 1100}
    before = {}
    for number, subcode in stored(drive):
        if number not in untouched:
            value = another(drive, number, subcode)
            answer = host.write(11, number, value, subcode, extended=True)
            assert answer == "ACK", (number, subcode, value)
            before[number, subcode] = value
    drive.factory_reset()
    assert {key: drive.text(*key) for key in before} != before
    for (number, subcode), value in before.items():
        assert host.write(11, number, value, subcode, extended=True) == "ACK"
    assert {key: drive.text(*key) for key in before} == before


def stored(drive: SimDrive) -> list[tuple[int, int]]:
    kept = (Kept.DRIVE, Kept.MEMORY)
    specs = drive.model.params.specs
    keys = [key for key, spec in specs.items() if spec.writable and spec.kept in kept]
    # C1060 lies between P102 and P103 (CMVLC401A table 9), which therefore come first.
    return sorted(keys, key=lambda key: (key[0] == 1060, key))


def another(drive: SimDrive, number: int, subcode: int) -> str:
    """A value that a code may have, and does not."""
    spec = drive.model.params.find(number, subcode)
    now = drive.text(number, subcode)
    if 1121 <= number <= 1124:
        return "9"
    return str(spec.high if now != str(spec.high) else spec.low)
