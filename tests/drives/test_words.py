"""Status words against the bit tables of EDB2102EN 8.2 and CMVLC401A table 9."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import FAMILY_NAMES, family
from lecombus.protocol.addressing import Code

C0068, C0150 = Code(68), Code(150)
SLIP = ("821x", "822x", "824x")
DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]

# Bit 0 first; `-` stands for a bit without a name (reserved, free, or part of a number).
TABLES = {
    (SLIP, C0150): "parameter_set_2 pulse_inhibit current_limit setpoint_reached ramp_done qmin "
    "zero_frequency controller_inhibit - - - - overtemperature_warning dc_bus_overvoltage "
    "direction_ccw ready",
    (("820x",), C0150): "- pulse_inhibit current_limit - setpoint_reached qmin zero_frequency "
    "controller_inhibit - - - - overtemperature_warning dc_bus_overvoltage direction_ccw ready",
    (("8200vector",), C0150): "- pulse_inhibit - - - - zero_frequency controller_inhibit - - - - "
    "warning message - -",
    (("93xx",), C0150): "- pulse_inhibit - - - - zero_speed controller_inhibit - - - - "
    "warning message - -",
    (("smvector",), C0150): "- power_stage_bit1 current_limit - setpoint_reached "
    "above_threshold_c17 zero_frequency controller_inhibit - - - - overtemperature_fault "
    "dc_bus_overvoltage direction_ccw ready",
    (("820x", *SLIP), C0068): "- - - - - - - - controller_enabled qmin direction_ccw "
    "pulses_enabled quick_stop current_limit setpoint_reached fault",
    (("8200vector", "93xx"), C0068): "- - - - - - - - controller_enabled - - - - - - fault",
    (("smvector",), C0068): "- - - - - - - - lecom_control_enabled above_threshold_c17 "
    "direction_ccw power_stage_bit11 quick_stop current_limit setpoint_reached fault",
}

NAMES = [
    (name, code, bit, text)
    for (names, code), row in TABLES.items()
    for name in names
    for bit, text in enumerate(row.split())
]


@pytest.mark.parametrize(("name", "code", "bit", "text"), NAMES)
def test_each_bit_sets_its_own_name_and_free_bits_none(
    name: str, code: Code, bit: int, text: str
) -> None:
    bits = family(name).status_bits(code, 1 << bit)
    assert [one for one, on in bits.items() if on] == ([] if text == "-" else [text])


@pytest.mark.parametrize("name", DESCRIBED)
def test_nothing_is_ever_called_running(name: str) -> None:
    drive = family(name)
    names = [*drive.status_bits(C0150, 0), *drive.status_bits(C0068, 0)]
    assert names
    assert not any("running" in one or "energi" in one for one in names)


def test_the_manuals_own_example_of_an_operating_status() -> None:
    # EDB2102EN 8.3.2, example 2: C0068 of the controller at address 25 is H0900.
    bits = family("821x").status_bits(C0068, 0x0900)
    assert [name for name, on in bits.items() if on] == ["controller_enabled", "pulses_enabled"]
    fields = family("821x").status_fields(C0068, 0x0900)
    assert (fields["fault_digit"].number, fields["communication_error"].text) == (0, "none")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (0, "none"),
        (1, "checksum"),
        (2, "protocol frame"),
        (4, "invalid code number"),
        (5, "invalid variable"),
        (6, "no access permission"),
        (7, "interrupted by a new telegram"),
        (9, ""),
        (15, "general fault"),
    ],
)
@pytest.mark.parametrize("name", DESCRIBED)
def test_communication_error_is_read_from_c0068(name: str, error: int, text: str) -> None:
    reading = family(name).status_fields(C0068, 0x8F05 | error << 4)["communication_error"]
    assert (reading.number, reading.text) == (error, text)


@pytest.mark.parametrize(
    ("name", "number", "text", "fault"),
    [
        ("820x", 0, "no error", False),
        ("820x", 1, "error", True),
        ("820x", 8, "", None),
        ("smvector", 0, "no error", False),
        ("smvector", 1, "error", True),
        ("821x", 1, "autostart lock", False),
        ("821x", 4, "flying-restart circuit active", False),
        ("822x", 6, "operation enable", False),
        ("824x", 8, "fault active", True),
        ("824x", 9, "", None),
        ("8200vector", 4, "", None),
        ("8200vector", 8, "fault active", True),
        ("8200vector", 9, "power off", False),
        ("93xx", 1, "switch-on inhibit", False),
        ("93xx", 7, "message active", False),
        ("93xx", 8, "active fault", True),
    ],
)
def test_controller_status_has_a_text_only_where_the_manual_gives_one(
    name: str, number: int, text: str, fault: bool | None
) -> None:
    word = 0xF0FF | number << 8
    drive = family(name)
    reading = drive.controller_status(C0150, word)
    assert reading is not None
    assert (reading.number, reading.text) == (number, text)
    assert drive.active_fault(C0150, word) is fault


@pytest.mark.parametrize("name", DESCRIBED)
def test_bit_15_of_the_operating_status_is_the_active_fault(name: str) -> None:
    assert family(name).active_fault(C0068, 0x8000) is True
    assert family(name).active_fault(C0068, 0x7FFF) is False


def test_a_code_that_is_no_status_word_says_nothing() -> None:
    drive = family("8200vector")
    assert drive.status_bits(Code(46), 0xFFFF) == {}
    assert drive.active_fault(Code(46), 0xFFFF) is None
    assert drive.controller_status(C0068, 0xFFFF) is None
    assert family("generic").status_bits(C0150, 0xFFFF) == {}


@given(word=st.integers(0, 0xFFFF), name=st.sampled_from(FAMILY_NAMES))
def test_any_word_is_taken_apart_without_complaint(word: int, name: str) -> None:
    drive = family(name)
    for code in drive.words:
        flags = drive.status_bits(code, word)
        assert sum(flags.values()) <= word.bit_count()
        assert all(one.number <= 15 for one in drive.status_fields(code, word).values())
