"""Control words are changed bit by bit, by name, from the word the drive holds now."""

from __future__ import annotations

import pytest

from lecombus.drives import ControlWordInfo, Family, family
from lecombus.errors import CodeValueError
from lecombus.parameters import Code
from support.golden import Golden

CONTROL = Code(135)

# EDB2102EN 8.2 and CMVLC401A table 9, column by column, bit 0 to 15: f free, r reserved.
COLUMNS = {
    "820x": "jog jog direction_ccw quick_stop r r r r r controller_inhibit r r parameter_set_2 r "
    "dc_brake r",
    "821x": "jog jog direction_ccw quick_stop ramp_stop ramp_zero up down r controller_inhibit r "
    "trip_reset parameter_set_2 r dc_brake r",
    "smvector": "jog jog direction_ccw quick_stop r r r r r controller_inhibit r trip_reset r r "
    "dc_brake r",
    "93xx": "f f f quick_stop f f f f r controller_inhibit r trip_reset f f f f",
    "93xx 1011": "jog jog f quick_stop ramp_stop ramp_zero f f r controller_inhibit r trip_reset "
    "parameter_set_odd parameter_set_load ramp_times ramp_times",
    "93xx 4001": "f f f quick_stop ramp_stop ramp_zero f f r controller_inhibit r trip_reset "
    "parameter_set_odd parameter_set_load jog jog",
    "93xx 5001": "jog jog f quick_stop ramp_stop ramp_zero f f r controller_inhibit r trip_reset "
    "parameter_set_odd parameter_set_load start_homing ramp_times_1",
    "93xx 6001": "f f f quick_stop ramp_stop ramp_zero f f r controller_inhibit r trip_reset "
    "parameter_set_odd parameter_set_load start_homing f",
}
COLUMNS |= dict.fromkeys(("822x", "824x", "8200vector"), COLUMNS["821x"])
COLUMNS |= {"93xx 7991": COLUMNS["93xx 6001"]}


def family_of(column: str) -> Family:
    name, _, number = column.partition(" ")
    return family(name).configured(int(number) if number else None)


def word_of(column: str) -> ControlWordInfo:
    return family_of(column).control_words[CONTROL]


def meanings(word: ControlWordInfo) -> list[str]:
    found = [""] * 16
    for bit in word.bits.values():
        found[bit.bit] = bit.name
    for field in word.fields.values():
        for number in range(field.low, field.high + 1):
            found[number] = field.name
    for number in word.free:
        found[number] = "f"
    for number in word.reserved:
        found[number] = "r"
    return found


@pytest.mark.parametrize("column", COLUMNS)
def test_each_bit_is_what_its_column_says(column: str) -> None:
    assert meanings(word_of(column)) == COLUMNS[column].split()


@pytest.mark.parametrize("column", COLUMNS)
@pytest.mark.parametrize("current", [0x0000, 0xFFFF, 0x5A5A, 0x0208])
def test_only_the_named_bit_changes(column: str, current: int) -> None:
    word = word_of(column)
    for name, bit in word.bits.items():
        assert word.encode(current, {name: True}) == current | 1 << bit.bit
        assert word.encode(current, {name: False}) == current & ~(1 << bit.bit)
    for name, field in word.fields.items():
        for number in field.texts:
            changed = word.encode(current, {name: number})
            assert changed & ~field.mask == current & ~field.mask
            assert word.decode(changed)[name] == number


@pytest.mark.parametrize("column", COLUMNS)
def test_nothing_named_changes_nothing(column: str) -> None:
    assert word_of(column).encode(0x1234, {}) == 0x1234


def test_several_bits_change_at_once() -> None:
    word = word_of("821x")
    assert word.encode(0x0200, {"controller_inhibit": False, "quick_stop": True}) == 0x0008
    assert word.encode(0x0000, {"jog": 2, "direction_ccw": True}) == 0x0006
    assert word.decode(0x0006) | {"jog": 2, "direction_ccw": True} == word.decode(0x0006)


@pytest.mark.parametrize(
    ("column", "name"),
    [
        ("93xx", "bit_4"),
        ("93xx 4001", "bit_0"),
        ("93xx", "jog"),
        ("820x", "trip_reset"),
        ("820x", "bit_11"),
        ("821x", "bit_99"),
        ("821x", ""),
    ],
)
def test_what_nobody_here_knows_cannot_be_changed(column: str, name: str, golden: Golden) -> None:
    with pytest.raises(CodeValueError) as caught:
        word_of(column).encode(0, {name: True})
    golden(caught.value)


def test_a_field_takes_only_the_numbers_it_has() -> None:
    with pytest.raises(CodeValueError, match=r"jog of C0135 cannot be 4: 0 \(C0046 active\), 1 "):
        word_of("821x").encode(0, {"jog": 4})


@pytest.mark.parametrize("number", [None, 0, 1000, 2001, 101, 10001, 1002, 72000, -1001])
def test_an_unknown_signal_configuration_leaves_what_holds_for_all(number: int | None) -> None:
    drive = family("93xx")
    assert drive.configured(number) is drive
    assert drive.configured(1001).configured(number) is drive


def test_a_configured_family_is_the_same_otherwise() -> None:
    drive, configured = family("93xx"), family("93xx").configured(1011)
    assert configured.configuration == "1xx1"
    assert configured is family("93xx").configured(1991)
    assert (configured.name, configured.codes, configured.stops) == (
        drive.name, drive.codes, drive.stops,
    )  # fmt: skip


def test_families_without_configurations_stay_themselves() -> None:
    drive = family("8200vector")
    assert drive.configured(1001) is drive
