"""What each family does by its manual."""

from __future__ import annotations

import pytest

from lecombus.fieldbus.lecom.simulator import SimDrive, SimLine
from lecombus.fieldbus.lecom.simulator.families import MODELS
from support.sim_host import Host, read_telegram, write_telegram

INVERTERS_82XX = ("820x", "821x", "822x", "824x", "8200vector")
BEHIND_2102 = (*INVERTERS_82XX, "93xx")


def single(family: str, **codes: str) -> Host:
    presets = {int(key[1:]): value for key, value in codes.items()}
    return Host(SimLine([SimDrive(11, family, "d", presets)], baud=19200))


def status(host: Host) -> dict[int, bool]:
    word = host.word(11, 150)
    return {bit: bool(word >> bit & 1) for bit in range(16)}


@pytest.mark.parametrize("family", MODELS)
def test_every_family_is_readable_and_its_identity_is_a_short_string(family: str) -> None:
    host = single(family)
    text = host.read(11, 200)
    assert text[0] == "S"
    assert 1 <= len(text) - 1 <= 20


@pytest.mark.parametrize("family", INVERTERS_82XX)
def test_an_82xx_starts_in_quick_stop_and_runs_once_it_is_lifted(family: str) -> None:
    host = single(family, c12="5", c13="5")
    assert host.word(11, 135) == 0x0008
    assert host.write(11, 46, "40") == "ACK"
    host.wait(1)
    assert host.read(11, 50) == "0"
    assert host.write(11, 135, "H0000") == "ACK"
    host.wait(2)
    # 50 Hz in 5 s.
    assert float(host.read(11, 50)) == pytest.approx(20, abs=1.5)
    host.wait(3)
    assert host.read(11, 50) == "40"
    assert status(host)[4]


@pytest.mark.parametrize("family", INVERTERS_82XX)
def test_c1920_makes_it_start_inhibited(family: str) -> None:
    host = single(family, c1920="1")
    assert host.word(11, 135) == 0x0200
    assert status(host)[7]
    assert host.write(11, 40, "1") == "ACK"
    assert not status(host)[7]


@pytest.mark.parametrize("family", INVERTERS_82XX)
def test_inhibit_takes_the_output_away_at_once_and_quick_stop_ramps(family: str) -> None:
    host = single(family, c46="50", c135="H0000", c12="0", c13="20", c105="5")
    host.read(11, 50)
    host.wait(0.1)
    assert host.read(11, 50) == "50"
    assert host.write(11, 135, "H0008") == "ACK"
    host.wait(2)
    assert float(host.read(11, 50)) == pytest.approx(30, abs=2)
    assert host.write(11, 40, "0") == "ACK"
    assert host.read(11, 50) == "0"
    assert host.line["d"].model.motor.speed > 0
    assert status(host)[1]
    host.wait(5)
    assert host.line["d"].model.motor.speed == 0


@pytest.mark.parametrize("family", INVERTERS_82XX)
@pytest.mark.parametrize("mode", ["0", "1", "2"])
def test_setpoint_and_control_word_want_c0001_3(family: str, mode: str) -> None:
    host = single(family, c1=mode)
    assert host.write(11, 135, "H0000") == "NAK"
    assert host.word(11, 68) >> 4 & 0xF == 6
    assert host.write(11, 46, "10") == ("ACK" if mode == "1" else "NAK")
    # Inhibiting by C0040 does not depend on it.
    assert host.write(11, 40, "0") == "ACK"
    assert host.word(11, 135) & 0x0200


@pytest.mark.parametrize("family", ["821x", "822x", "824x", "8200vector"])
def test_a_trip_is_reset_by_c0043_or_by_the_edge_of_bit_11(family: str) -> None:
    host = single(family, c46="50", c135="H0000", c12="0")
    drive = host.line["d"]
    host.read(11, 50)
    for reset in ((43, "0"), (135, "H0800")):
        drive.trip(50)
        word = host.word(11, 68)
        assert word & 0x800F == 0x8005
        assert not word & 0x0800
        assert host.word(11, 150) >> 8 & 0xF == 8
        assert host.read(11, 161) == "50"
        assert host.read(11, 43) == "1"
        assert host.write(11, *reset) == "ACK"
        assert host.read(11, 43) == "0"
        assert host.word(11, 150) >> 8 & 0xF == 6
    drive.trip(50)
    assert host.write(11, 135, "H0800") == "ACK"
    assert host.read(11, 43) == "1", "no edge: the bit was set already"


def test_an_820x_restarts_on_a_trip_reset_and_forgets_the_module() -> None:
    host = single("820x", c135="H0000", c1923="2000")
    host.line["d"].trip(50)
    assert host.write(11, 40, "0") == "ACK"
    assert host.write(11, 40, "1") == ""
    assert host.read(11, 150) == "", "still starting"
    host.wait(1.5)
    assert host.read(11, 1923) == "3000"
    assert host.word(11, 68) & 0x8000 == 0
    assert host.word(11, 135) == 0x0008


def test_an_820x_without_a_trip_acknowledges_inhibit_and_enable() -> None:
    host = single("820x")
    assert host.write(11, 40, "0") == "ACK"
    assert host.write(11, 40, "1") == "ACK"
    assert host.write(11, 135, "H0200") == "ACK"
    assert host.write(11, 135, "H0000") == "ACK"


def test_a_tripped_820x_that_was_not_inhibited_does_not_restart() -> None:
    host = single("820x", c135="H0000")
    host.line["d"].trip(50)
    assert host.write(11, 135, "H0000") == "ACK"
    assert host.write(11, 40, "1") == "ACK"
    assert host.word(11, 68) & 0x8000


def test_an_820x_restarts_on_a_trip_reset_by_a_group_telegram_too() -> None:
    host = single("820x", c135="H0200")
    host.line["d"].trip(50)
    assert host.write(0, 135, "H0000") == ""
    assert host.read(11, 150) == ""


def test_an_820x_has_no_c0043() -> None:
    assert single("820x").read(11, 43) == "EOT"


def test_an_820x_acknowledges_parameters_while_enabled_but_does_not_keep_them() -> None:
    host = single("820x", c135="H0000")
    drive = host.line["d"]
    assert host.write(11, 12, "7") == "ACK"
    assert host.read(11, 12) == "5"
    assert drive.wear == 0
    assert host.write(11, 40, "0") == "ACK"
    assert host.write(11, 12, "7") == "ACK"
    assert host.read(11, 12) == "7"
    assert drive.wear == 1


def test_an_820x_takes_a_relative_setpoint() -> None:
    host = single("820x", c11="80")
    assert host.write(11, 141, "50") == "ACK"
    assert host.read(11, 46) == "40"


@pytest.mark.parametrize("family", ["821x", "822x", "824x"])
def test_a_normalized_setpoint_comes_from_c0141(family: str) -> None:
    host = single(family, c127="1", c135="H0000", c12="0")
    assert host.write(11, 46, "10") == "NAK"
    assert host.write(11, 141, "50") == "ACK"
    host.wait(0.1)
    assert host.read(11, 50) == "25"


def test_direction_and_jog_come_from_the_control_word() -> None:
    host = single("822x", c12="0", c13="0", c37="20")
    assert host.write(11, 135, "H0005") == "ACK"
    host.wait(0.1)
    assert host.read(11, 50) == "20"
    assert host.line["d"].model.motor.speed == -20
    assert status(host)[14]
    assert host.word(11, 68) & 0x0400


@pytest.mark.parametrize(("family", "sets"), [("820x", 2), ("822x", 2), ("8200vector", 4)])
def test_parameter_sets_are_code_offsets(family: str, sets: int) -> None:
    host = single(family)
    host.write(11, 40, "0")
    for n in range(1, sets):
        assert host.write(11, 2000 * n + 12, str(n), extended=True) == "ACK"
    assert [host.read(11, 2000 * n + 12, extended=True) for n in range(sets)] == [
        "5",
        *(str(n) for n in range(1, sets)),
    ]
    assert host.read(11, 2000 * sets + 12, extended=True) == "EOT"
    assert host.read(11, 2046) == "EOT", "C0046 exists once"


def test_stored_writes_wear_and_process_data_do_not() -> None:
    host = single("822x")
    drive = host.line["d"]
    for _ in range(3):
        host.write(11, 46, "10")
        host.write(11, 135, "H0000")
    assert drive.wear == 0
    for _ in range(3):
        host.write(11, 12, "4")
    assert drive.model.params.wear == {(12, 0): 3}


@pytest.mark.parametrize("family", BEHIND_2102)
def test_a_power_cycle_forgets_the_module_and_keeps_the_drive(family: str) -> None:
    host = single(family)
    drive = host.line["d"]
    assert host.write(11, 40, "0") == "ACK"
    assert host.write(11, 1923, "500") == "ACK"
    assert host.write(11, 1922, "2") == "ACK"
    assert host.write(11, 1920, "1") == "ACK"
    host.wait(0.1)
    drive.power_cycle(host.now_s, 0.5)
    assert host.read(11, 150) == ""
    host.wait(0.6)
    assert host.read(11, 1923) == "3000"
    assert host.read(11, 1922) == "0"
    assert host.word(11, 135) == 0x0008
    assert host.read(11, 9) == "11"


def test_code_bank_and_input_selection_are_0_after_power_on() -> None:
    host = single("93xx")
    host.write(11, 248, "1")
    host.write(11, 249, "3")
    host.line["d"].power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert host.read(11, 248) == "0"
    assert host.read(11, 249) == "0"
    assert host.read(11, 11) == "3000"


@pytest.mark.parametrize(("family", "quiet_s"), [("820x", 0.230), ("822x", 0.050)])
def test_a_shortened_response_comes_before_the_value_does(family: str, quiet_s: float) -> None:
    host = single(family, c1921="1")
    drive = host.line["d"]
    start_s = host.now_s
    telegram = write_telegram(11, 46, "12")
    assert host.ask(telegram) == b"\x06"
    assert host.now_s - start_s < (len(telegram) + 1) * 10 / 19200 + 0.005
    assert drive.text(46) == "0"
    assert host.read(11, 46) == "", "the module must be left alone"
    host.wait(quiet_s)
    assert host.read(11, 46) == "12"


def test_a_shortened_response_may_still_be_refused_later() -> None:
    host = single("822x", c1921="1")
    assert host.write(11, 46, "999") == "ACK"
    host.wait(0.06)
    assert host.read(11, 46) == "0"
    host.say(write_telegram(11, 46, "999"))
    host.wait(0.1)
    assert host.word(11, 68) >> 4 & 0xF == 5


def test_a_93xx_takes_its_speed_from_c0141_and_c0046_is_read_only() -> None:
    host = single("93xx", c135="H0000", c12="2")
    assert host.write(11, 46, "100") == "NAK"
    assert host.write(11, 141, "50") == "ACK"
    host.wait(0.5)
    assert float(host.read(11, 51)) == pytest.approx(750, abs=60)
    host.wait(2)
    assert host.read(11, 51) == "1500"
    assert host.read(11, 50) == "50"


def test_a_93xx_keeps_only_what_c0003_saved() -> None:
    host = single("93xx")
    drive = host.line["d"]
    host.write(11, 12, "7")
    assert host.write(11, 3, "1") == "ACK"
    host.write(11, 13, "8")
    drive.power_cycle(host.now_s, 0.1)
    host.wait(0.2)
    assert host.read(11, 12) == "7"
    assert host.read(11, 13) == "2"


def test_a_93xx_changes_c0005_only_while_inhibited() -> None:
    host = single("93xx")
    assert host.write(11, 5, "4001") == "NAK"
    assert host.read(11, 1962) == "7"
    host.write(11, 40, "0")
    assert host.write(11, 5, "4001") == "ACK"


def test_a_93xx_keeps_its_faults_in_subcodes() -> None:
    host = single("93xx")
    host.line["d"].trip(50)
    host.write(11, 43, "0")
    host.line["d"].trip(15)
    memory = [host.read(11, 168, n, extended=True) for n in (1, 2, 3)]
    assert memory == ["15", "50", "0"], "what was before moves on when it is reset"
    host.write(11, 43, "0")
    memory = [host.read(11, 168, n, extended=True) for n in (1, 2, 3, 4)]
    assert memory == ["0", "15", "50", "0"]


@pytest.mark.parametrize(
    ("level", "parameter", "setpoint", "control"),
    [
        ("0", "NAK", "NAK", "NAK"),
        ("1", "ACK", "NAK", "NAK"),
        ("2", "ACK", "ACK", "NAK"),
        ("3", "ACK", "ACK", "ACK"),
        ("4", "ACK", "ACK", "ACK"),
    ],
)
def test_p420_decides_what_the_network_may_do_but_stops_always_pass(
    level: str, parameter: str, setpoint: str, control: str
) -> None:
    host = single("smvector", c1420=level)
    assert host.write(11, 1104, "10") == parameter
    assert host.write(11, 1061, "30") == setpoint
    assert host.write(11, 135, "H0000") == control
    assert host.write(11, 135, "H0008") == "ACK"
    assert host.write(11, 40, "0") == "ACK"
    assert host.read(11, 40) == "0"


def test_p420_4_makes_a_zero_command_a_quick_stop() -> None:
    host = single("smvector", c1420="4")
    host.write(11, 135, "H0000")
    host.write(11, 140, "0")
    assert host.word(11, 135) & 0x0008


def test_an_smvector_follows_c1061_and_c0140_and_shows_them_in_c0046() -> None:
    host = single("smvector", c1104="6", c1105="6")
    assert host.write(11, 46, "10") == "NAK"
    assert host.write(11, 135, "H0000") == "ACK"
    assert host.write(11, 1061, "30") == "ACK"
    assert host.read(11, 46) == "30"
    host.wait(1)
    assert float(host.read(11, 50)) == pytest.approx(10, abs=1.5)
    assert host.write(11, 140, "12.5") == "ACK"
    assert host.read(11, 46) == "12.5"
    host.wait(5)
    assert host.read(11, 50) == "12.5"
    word = host.word(11, 150)
    assert word & 0x0012 == 0x0012, "energised and at its setpoint"


def test_an_smvector_names_its_software_and_counts_messages() -> None:
    host = single("smvector")
    assert host.read(11, 1494) == "1.20"
    assert host.read(11, 201) == "S2008-10-18"
    before = int(host.read(11, 1427))
    host.read(11, 46)
    assert int(host.read(11, 1427)) == before + 2


def test_the_message_counter_starts_again_after_9999() -> None:
    host = single("smvector")
    model = host.line["d"].model
    for _ in range(9998):
        model.feed(host.now_s)
    assert host.read(11, 1427) == "9999"
    assert host.read(11, 1427) == "0"


def test_p424_makes_an_smvector_start_inhibited() -> None:
    host = single("smvector", c1424="1")
    assert host.read(11, 40) == "0"


def test_a_generic_device_knows_standard_addressing_only() -> None:
    host = single("generic", c10="-1.5")
    assert host.read(11, 10) == "-1.5"
    assert host.write(11, 10, "214748.3647") == "ACK"
    assert host.read(11, 10) == "214748.3647"
    assert host.read(11, 10, extended=True) == ""
    assert host.read(11, 300) == "EOT"


def test_some_devices_answer_a_bad_write_with_nothing() -> None:
    for silent, answer in ((False, b"\x15"), (True, b"")):
        drive = SimDrive(11, "generic", silent_on_bad_write=silent)
        host = Host(SimLine([drive], baud=9600))
        assert host.ask(write_telegram(11, 300, "1")) == answer
        assert host.ask(write_telegram(11, 10, "1")) == b"\x06"


def test_last_communication_error_is_shown_until_a_good_telegram() -> None:
    host = single("822x")
    host.ask(read_telegram(11, 999))
    assert host.word(11, 68) >> 4 & 0xF == 4
    assert host.word(11, 68) >> 4 & 0xF == 4
    host.read(11, 46)
    assert host.word(11, 68) >> 4 & 0xF == 0
