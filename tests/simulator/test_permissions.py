"""What drives refuse, acknowledge without doing, or do only in a certain state."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from lecombus.fieldbus.lecom.simulator.families.f93xx import Drive93XX
from support.sim_host import Host


def single(family: str, **codes: str) -> Host:
    presets = {int(key[1:]): value for key, value in codes.items()}
    return switched_on(SimDrive(11, family, "d", presets))


def switched_on(drive: SimDrive, *, baud: int = 19200) -> Host:
    host = Host(SimLine([drive], baud=baud))
    host.wait(0)
    return host


def errors(host: Host) -> tuple[int, str]:
    """Communication error of C0068 and fault number of C1962."""
    return host.word(11, 68) >> 4 & 0xF, host.read(11, 1962)


@pytest.mark.parametrize(
    ("family", "codes", "write", "expected"),
    [
        ("822x", {}, (50, "1"), (6, "9")),
        ("822x", {}, (12, "1301"), (5, "13")),
        ("822x", {}, (12, "H0001"), (5, "3")),
        ("822x", {}, (12, "1.005"), (5, "13")),
        ("822x", {}, (4711, "1"), (4, "5")),
        ("822x", {"c1": "0"}, (46, "1"), (6, "8")),
        ("822x", {"c1": "2"}, (135, "H0000"), (6, "8")),
        ("93xx", {}, (5, "4001"), (6, "7")),
        ("93xx", {}, (46, "10"), (6, "9")),
        ("8200vector", {}, (127, "1"), (4, "5")),
    ],
)
def test_a_refusal_leaves_its_reason(
    family: str, codes: dict[str, str], write: tuple[int, str], expected: tuple[int, str]
) -> None:
    host = single(family, **codes)
    assert host.write(11, *write) == "NAK"
    assert errors(host) == expected


def test_a_wrong_subcode_is_named_as_such() -> None:
    host = single("93xx")
    assert host.read(11, 39, 16, extended=True) == "EOT"
    assert errors(host) == (4, "4")


@pytest.mark.parametrize("family", ["820x", "822x", "8200vector", "93xx"])
def test_an_open_enable_terminal_keeps_the_controller_inhibited(family: str) -> None:
    host = single(family, c135="H0000")
    drive = host.line["d"]
    drive.set_terminal(high=False)
    assert host.write(11, 40, "1") == "ACK"
    assert host.write(11, 135, "H0000") == "ACK"
    assert host.read(11, 40) == "0", "C0040 has no effect"
    assert host.word(11, 150) & 0x0082 == 0x0082
    assert not host.word(11, 68) & 0x0900
    drive.set_terminal(high=True)
    assert host.read(11, 40) == "1"
    assert not host.word(11, 150) & 0x0082


def test_a_parameter_of_another_set_is_acknowledged_and_changes_nothing() -> None:
    host = single("822x", c46="40", c135="H0000", c12="5", c2012="5")
    assert host.write(11, 2012, "1300", extended=True) == "ACK"
    host.wait(2)
    drive = host.line["d"]
    assert drive.model.motor.speed == pytest.approx(20, abs=1)
    assert host.write(11, 135, "H1000") == "ACK"
    assert host.word(11, 150) & 1, "set 2 is active"
    host.wait(2)
    assert drive.model.motor.speed == pytest.approx(20, abs=2), "now the slow ramp acts"


def test_a_drive_that_listens_to_its_terminals_does_not_follow_the_line() -> None:
    host = single("822x", c46="40", c1="0", c12="0")
    drive = host.line["d"]
    host.wait(1)
    assert drive.model.motor.speed == 0
    assert host.word(11, 135) == 0x0008, "it was switched on while the line controlled it"
    drive.power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert host.word(11, 135) == 0, "no quick stop at switch-on without C0001 = 3"


def test_the_ramp_generator_can_be_held_and_led_to_zero() -> None:
    host = single("822x", c46="40", c135="H0000", c12="5", c13="5")
    drive = host.line["d"]
    host.wait(2)
    host.write(11, 135, "H0010")
    held = drive.model.motor.speed
    host.wait(1)
    assert drive.model.motor.speed == held == pytest.approx(20, abs=1)
    host.write(11, 135, "H0020")
    host.wait(3)
    assert drive.model.motor.speed == 0


# 93XX


def test_a_93xx_without_a_configuration_for_the_line_acknowledges_and_does_nothing() -> None:
    host = single("93xx", c5="1000", c12="0")
    drive = host.line["d"]
    host.write(11, 40, "1")
    for number, text in ((135, "H0000"), (141, "50"), (135, "H0200")):
        assert host.write(11, number, text) == "ACK"
        assert host.read(11, number) == text
    host.wait(1)
    assert drive.model.motor.speed == 0
    assert not host.word(11, 150) & 0x0080, "bit 9 did not inhibit"
    assert host.write(11, 40, "0") == "ACK"
    assert host.word(11, 150) & 0x0080, "C0040 does not depend on it"


def test_a_93xx_under_its_terminals_runs_on_whatever_the_control_word_says() -> None:
    host = single("93xx", c5="1000", c12="0", c135="H0000")
    model = host.line["d"].model
    model.terminal_rpm = 900.0  # type: ignore[attr-defined]
    model.control = 0
    model.steer()
    assert host.write(11, 135, "H0008") == "ACK"
    host.wait(3)
    assert host.read(11, 135) == "H0008", "it reads back as written"
    assert host.read(11, 51) == "900"
    assert host.write(11, 40, "0") == "ACK"
    host.wait(3)
    assert host.read(11, 51) == "0", "C0040 stops it all the same"


def test_terminal_e1_is_a_quick_stop_in_configuration_1011_only() -> None:
    for configuration, speed in (("1011", 0), ("1001", 1500)):
        host = single("93xx", c5=configuration, c12="0", c105="0", c135="H0000", c141="50")
        drive = host.line["d"].model
        assert isinstance(drive, Drive93XX)
        drive.terminal_e1 = False
        drive.steer()
        host.wait(1)
        assert drive.motor.speed == speed


@pytest.mark.parametrize(
    ("configuration", "word", "percent"),
    [
        ("1001", "H0002", 20),
        ("5001", "H0002", 20),
        ("4001", "H8000", 20),
        ("4001", "H0002", 100),
        ("6001", "H0002", 50),
        ("7001", "H8002", 50),
    ],
)
def test_the_control_word_of_a_93xx_means_what_the_configuration_says(
    configuration: str, word: str, percent: int
) -> None:
    presets: dict[int | tuple[int, int], str] = {
        5: configuration, 12: "0", (102, 1): "0", (39, 2): "20", 141: "50", 135: word,
    }  # fmt: skip
    host = switched_on(SimDrive(11, "93xx", "d", presets))
    host.wait(1)
    assert host.line["d"].model.motor.speed == 3000 * percent / 100


def test_bits_14_and_15_choose_further_ramps_for_speed_control() -> None:
    presets: dict[int | tuple[int, int], str] = {
        12: "0", (102, 1): "3", 141: "100", 135: "H4000",
    }  # fmt: skip
    host = switched_on(SimDrive(11, "93xx", "d", presets))
    host.wait(1)
    assert host.line["d"].model.motor.speed == pytest.approx(1000, abs=1)


def test_status_bits_of_a_93xx_follow_the_configuration() -> None:
    shown = {}
    for configuration in ("1001", "4001", "5001", "6001", "7001"):
        host = single("93xx", c5=configuration)
        shown[configuration] = host.word(11, 150) & 0x0028
    assert shown == {"1001": 0x20, "4001": 0x20, "5001": 0, "6001": 0x08, "7001": 0x08}


# SMVector


@pytest.mark.parametrize("mode", ["2", "5"])
def test_an_smvector_under_its_keypad_takes_stops_only(mode: str) -> None:
    host = single("smvector", c1100=mode, c135="H0000")
    assert host.write(11, 1104, "10") == "NAK"
    assert host.word(11, 68) >> 4 & 0xF == 6
    assert host.write(11, 1061, "10") == "NAK"
    assert host.write(11, 135, "H0008") == "ACK"


def test_an_smvector_needs_its_network_enable_terminal() -> None:
    host = single("smvector", c135="H0000")
    drive = host.line["d"]
    assert host.word(11, 68) & 0x0100
    assert host.read(11, 1530) == "64", "TB-13A"
    drive.set_terminal(high=False)
    assert host.read(11, 1530) == "0"
    assert host.write(11, 1061, "10") == "NAK"
    assert not host.word(11, 68) & 0x0100
    assert host.write(11, 40, "0") == "ACK"
    drive.set_terminal(high=True)
    assert host.write(11, 1121, "0") == "ACK"
    assert host.write(11, 1061, "10") == "NAK", "no terminal is set to network enable any more"


@pytest.mark.parametrize("level", ["0", "1", "2"])
def test_below_level_3_a_stop_word_only_stops(level: str) -> None:
    host = single("smvector", c135="H0200", c1061="10")
    drive = host.line["d"]
    drive.model.preset(1420, level)
    drive.trip(13)
    assert host.write(11, 135, "H0808") == "ACK"
    assert host.word(11, 135) == 0x0208, "inhibit was not lifted"
    assert host.word(11, 68) & 0x8000, "and the fault was not reset"


def test_an_smvector_keeps_speed_commands_within_p102_and_p103() -> None:
    host = single("smvector", c1102="5", c1103="50")
    assert [host.write(11, 1061, text) for text in ("4.9", "5", "50", "50.1")] == [
        "NAK", "ACK", "ACK", "NAK",
    ]  # fmt: skip
    assert host.word(11, 68) >> 4 & 0xF == 5


def test_p403_puts_the_module_back_to_its_defaults() -> None:
    host = switched_on(SimDrive(11, "smvector", "d", {1425: "500", 1104: "7"}), baud=9600)
    assert host.write(11, 1403, "1") == "ACK"
    drive = host.line["d"]
    assert drive.address == 1
    assert drive.text(1425) == "50"
    assert drive.text(1420) == "0"
    assert drive.text(1104) == "7", "the drive's own parameters stay"
    assert drive.text(1403) == "0"


def test_an_smvector_set_to_another_protocol_is_silent() -> None:
    host = single("smvector")
    assert host.write(11, 1400, "2") == "ACK"
    assert host.read(11, 150) == ""
    assert host.write(0, 40, "0") == ""


def test_an_smvector_whose_module_talks_shows_it_online() -> None:
    assert single("smvector").read(11, 1402) == "3"
