"""Status words against the bit tables of EDB2102EN 8.2 and CMVLC401A table 9."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import FAMILY_NAMES, OperatingState, family, german_name, join_states
from lecombus.parameters import Code

C0068, C0150 = Code(68), Code(150)
SLIP = ("821x", "822x", "824x")
DESCRIBED = [name for name in FAMILY_NAMES if name != "generic"]

# Bit 0 first; `-` stands for a bit without a name (reserved, free, or part of a number).
TABLES = {
    (SLIP, C0150): "parameter_set_2 pulse_inhibit current_limit setpoint_reached ramp_done qmin "
    "output_frequency_0 controller_inhibit - - - - overtemperature_warning dc_bus_overvoltage "
    "direction_ccw ready",
    (("820x",), C0150): "- pulse_inhibit current_limit - setpoint_reached qmin output_frequency_0 "
    "controller_inhibit - - - - overtemperature_warning dc_bus_overvoltage direction_ccw ready",
    (
        ("8200vector",),
        C0150,
    ): "- pulse_inhibit - - - - output_frequency_0 controller_inhibit - - - - warning message - -",
    (("93xx",), C0150): "- pulse_inhibit - - - - - controller_inhibit - - - - warning message - -",
    (("smvector",), C0150): "- power_stage_bit1 current_limit - setpoint_reached "
    "above_threshold_c17 output_frequency_0 controller_inhibit - - - - overtemperature_fault "
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
    assert (fields["fault_digit"].number, fields["communication_error"].text.en) == (0, "none")


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
    assert (reading.number, reading.text.en) == (error, text)


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
    reading = drive.status_fields(C0150, word).get("controller_status")
    assert reading is not None
    assert (reading.number, reading.text.en) == (number, text)
    assert drive.active_fault(C0150, word) is fault


@pytest.mark.parametrize("name", DESCRIBED)
def test_bit_15_of_the_operating_status_is_the_active_fault(name: str) -> None:
    assert family(name).active_fault(C0068, 0x8000) is True
    assert family(name).active_fault(C0068, 0x7FFF) is False


def test_a_code_that_is_no_status_word_says_nothing() -> None:
    drive = family("8200vector")
    assert drive.status_bits(Code(46), 0xFFFF) == {}
    assert drive.active_fault(Code(46), 0xFFFF) is None
    assert "controller_status" not in drive.status_fields(C0068, 0xFFFF)
    assert family("generic").status_bits(C0150, 0xFFFF) == {}


@given(word=st.integers(0, 0xFFFF), name=st.sampled_from(FAMILY_NAMES))
def test_any_word_is_taken_apart_without_complaint(word: int, name: str) -> None:
    drive = family(name)
    for code in drive.words:
        flags = drive.status_bits(code, word)
        assert sum(flags.values()) <= word.bit_count()
        assert all(one.number <= 15 for one in drive.status_fields(code, word).values())


# Signal configuration, C0150, states: EDB2102EN 8.2.
SHOWN = [
    ("820x", None, 0x8000, "ready"),
    ("820x", None, 0x0186, "inhibited pulses_inhibited current_limit fault"),
    ("820x", None, 0xD071, "ready at_setpoint output_frequency_0 below_threshold direction_ccw "
     "warning"),
    ("820x", None, 0x2000, "overvoltage"),
    ("821x", None, 0x8608, "ready enabled at_setpoint"),
    ("821x", None, 0x0000, "initialising"),
    ("821x", None, 0x0101, "start_lock parameter_set_2"),
    ("821x", None, 0x8382, "ready inhibited operation_inhibited pulses_inhibited"),
    ("821x", None, 0x0410, "ramp_done flying_restart"),
    ("821x", None, 0x4504, "current_limit direction_ccw dc_braking"),
    ("821x", None, 0x2702, "pulses_inhibited overvoltage message"),
    ("821x", None, 0x0882, "inhibited pulses_inhibited fault"),
    ("8200vector", None, 0xC63D, "enabled"),
    ("8200vector", None, 0x3742, "pulses_inhibited output_frequency_0 warning message"),
    ("8200vector", None, 0x0982, "inhibited pulses_inhibited power_off"),
    ("93xx", None, 0xC67D, "enabled"),
    ("93xx", 1001, 0x0040, "initialising zero_speed"),
    ("93xx", 4001, 0x0040, "initialising zero_speed"),
    ("93xx", 5001, 0x0040, "initialising zero_speed"),
    ("93xx", 6001, 0x0048, "initialising zero_speed"),
    ("93xx", 7001, 0x0048, "initialising zero_speed"),
    ("93xx", 1001, 0x8635, "ready enabled ramp_done below_threshold current_limit"),
    ("93xx", 4001, 0x8635, "ready enabled ramp_done below_threshold current_limit"),
    ("93xx", 5001, 0x862C, "ready enabled torque_limit homing homed"),
    ("93xx", 6001, 0x862C, "ready enabled homing homed"),
    ("93xx", 7001, 0x8600, "ready enabled torque_limit"),
    ("smvector", None, 0x8076, "ready at_setpoint output_frequency_0 above_threshold "
     "current_limit"),
    ("smvector", None, 0x3182, "inhibited overvoltage fault"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "configuration", "word", "states"), SHOWN)
def test_states_are_those_the_manual_names(
    name: str, configuration: int | None, word: int, states: str
) -> None:
    info = family(name).configured(configuration).words[Code(150)]
    assert sorted(info.shown_states(word)) == sorted(states.split())


@pytest.mark.parametrize(
    ("name", "word", "states"),
    [
        ("820x", 0x1100, "enabled quick_stop"),
        ("821x", 0xFF00, "quick_stop"),
        ("smvector", 0xFF00, "quick_stop"),
        ("8200vector", 0xFFFF, ""),
        ("93xx", 0xFFFF, ""),
    ],
)
def test_the_operating_status_adds_what_the_status_word_does_not_say(
    name: str, word: int, states: str
) -> None:
    info = family(name).words[Code(68)]
    assert sorted(info.shown_states(word)) == sorted(states.split())


@pytest.mark.parametrize(
    ("name", "configuration", "free"),
    [
        ("8200vector", None, (0, 2, 3, 4, 5, 14, 15)),
        ("93xx", None, (0, 2, 3, 4, 5, 6, 14, 15)),
        ("93xx", 1001, (3, 14)),
        ("93xx", 7001, (14,)),
        ("821x", None, ()),
    ],
)
def test_free_bits_stay_free(name: str, configuration: int | None, free: tuple[int, ...]) -> None:
    info = family(name).configured(configuration).words[Code(150)]
    assert info.free == free
    named = {mask for _, mask in info.bits}
    assert not named & {1 << bit for bit in free}


@pytest.mark.parametrize("name", DESCRIBED)
def test_an_output_frequency_of_0_is_never_called_standstill(name: str) -> None:
    """Bit 6 of C0150: a speed is measured by a 93XX alone, and only in a known configuration."""
    drive = family(name)
    states = {state for word in drive.words.values() for state in word.shown_states(0x0040)}
    assert OperatingState.ZERO_SPEED not in states
    assert (OperatingState.OUTPUT_FREQUENCY_0 in states) == (name != "93xx")
    english, german = "output_frequency_0", "Ausgangsfrequenz 0"
    assert (english in drive.status_bits(C0150, 0)) == (name != "93xx")
    assert german_name(english) == german
    assert german_name("zero_speed") == "Istdrehzahl 0"


def test_words_that_contradict_each_other_are_not_both_believed() -> None:
    ready, enabled, inhibited = (
        OperatingState.READY, OperatingState.ENABLED, OperatingState.INHIBITED,
    )  # fmt: skip
    assert join_states([(ready, inhibited), (enabled,)]) == (ready, inhibited)
    assert join_states([(ready,), (enabled,)]) == (ready, enabled)
    assert join_states([(enabled, ready), (inhibited, ready)]) == (ready, enabled)
    assert join_states([]) == ()
