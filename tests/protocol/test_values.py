from __future__ import annotations

import decimal
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.errors import CodeValueError, LecombusError
from lecombus.parameters import Format, Value, ValueFormatError

counts = st.integers(-(2**31), 2**31 - 1)


@given(counts)
def test_every_count_of_a_ten_thousandth_survives_the_wire_exactly(count: int) -> None:
    number = Decimal(count).scaleb(-4)
    value = Value.decimal(number)
    again = Value.parse(value.raw)
    assert again == value
    assert again.number == number


@given(counts)
def test_decimals_are_written_canonically(count: int) -> None:
    raw = Value.decimal(Decimal(count).scaleb(-4)).raw
    whole, _, fraction = raw.removeprefix("-").partition(".")
    assert whole == str(int(whole))
    assert len(whole) <= 6
    assert len(fraction) <= 4
    assert not fraction.endswith("0")
    assert "." not in raw or fraction, "no point when there is no fraction"
    assert raw != "-0"


@pytest.mark.parametrize(
    ("given_number", "raw"),
    [
        (0, "0"),
        (-5, "-5"),
        (50, "50"),
        ("35.40", "35.4"),
        ("+7", "7"),
        ("007.0", "7"),
        ("-0.5", "-0.5"),
        ("-0", "0"),
        (Decimal("-0.0000"), "0"),
        (Decimal("1E+3"), "1000"),
        (Decimal("1E-4"), "0.0001"),
        (Decimal("35.400000000000000000000"), "35.4"),
        ("-214748.3648", "-214748.3648"),
        ("214748.3647", "214748.3647"),
    ],
)
def test_decimals_as_they_go_out(given_number: Decimal | int | str, raw: str) -> None:
    assert Value.decimal(given_number) == Value.parse(raw)
    assert Value.decimal(given_number).raw == raw


@pytest.mark.parametrize(
    "number",
    ["214748.3648", "-214748.3649", 214749, Decimal("1E+400"), Decimal("0.00001"),
     Decimal("1E-999999"), "1.00005", "nan", "Infinity", Decimal("NaN"), Decimal("-Infinity"),
     Decimal("sNaN"), "", "-", "1e3", "1_0", "٣", " 1", "1,5", "0x10", ".5", "5."],
)  # fmt: skip
def test_decimals_that_cannot_be_sent_are_refused(number: Decimal | int | str) -> None:
    with pytest.raises(CodeValueError):
        Value.decimal(number)


@pytest.mark.parametrize("number", [35.4, True])
def test_a_binary_float_is_a_programming_error(number: float) -> None:
    with pytest.raises(TypeError, match="exact"):
        Value.decimal(number)  # type: ignore[arg-type]


def test_no_decimal_context_of_the_caller_changes_a_number() -> None:
    with decimal.localcontext() as context:
        context.prec = 2
        assert Value.decimal("-214748.3648").raw == "-214748.3648"
        assert Value.parse("12345.6789").number == Decimal("12345.6789")
        assert Value.parse("999.5").means_same(Value.parse("999.50"))


@pytest.mark.parametrize(
    ("raw", "number"),
    [
        ("35.40", Decimal("35.40")),
        ("000035.4", Decimal("35.4")),
        ("0035.4", Decimal("35.4")),
        ("-0", Decimal(0)),
        ("-0.000", Decimal("0.000")),
        ("214748.3647", Decimal("214748.3647")),
        ("214748.3648", None),
        ("-214748.3648", Decimal("-214748.3648")),
        ("-214748.3649", None),
        ("999999", None),
        ("1234567", None),
        ("0000001", None),
        ("1.23456", None),
        ("", None),
        ("-", None),
        ("--1", None),
        ("+1", None),
        (" 1", None),
        ("1 ", None),
        ("1.", None),
        (".1", None),
        ("1..2", None),
        ("1,2", None),
        ("1\n", None),
        ("?", None),
    ],
)
def test_which_decimals_are_read(raw: str, number: Decimal | None) -> None:
    if number is None:
        with pytest.raises(ValueFormatError):
            Value.parse(raw)
    else:
        value = Value.parse(raw)
        assert (value.format, value.raw) == (Format.VD, raw), "the text stays as on the wire"
        assert str(value.number) == str(number)


def test_zero_is_never_shown_with_a_minus() -> None:
    assert str(Value.parse("-0.0").number) == "0.0"


@pytest.mark.parametrize("digits", [2, 4, 8])
@given(data=st.data())
def test_hexadecimals_survive_the_wire_in_every_length(data: st.DataObject, digits: int) -> None:
    number = data.draw(st.integers(0, 16**digits - 1))
    value = Value.hexadecimal(number, digits)
    assert value.raw == "H" + format(number, "X").rjust(digits, "0")
    assert Value.parse(value.raw) == value
    assert Value.parse(value.raw).number == number


@pytest.mark.parametrize(
    ("number", "digits"),
    [(256, 2), (-1, 4), (65536, 4), (2**32, 8), (0, 0), (0, 1), (0, 3), (0, 16)],
)
def test_hexadecimals_that_do_not_fit_are_refused(number: int, digits: int) -> None:
    with pytest.raises(CodeValueError):
        Value.hexadecimal(number, digits)


@pytest.mark.parametrize(
    "raw", ["H", "H0", "H123", "H12345", "H1234567", "H123456789", "HG0", "H-1"]
)
def test_hexadecimals_of_other_lengths_are_not_read(raw: str) -> None:
    with pytest.raises(ValueFormatError):
        Value.parse(raw)


def test_small_hexadecimal_digits_are_read() -> None:
    assert Value.parse("H00ff").number == 255


@given(st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=240))
def test_strings_of_printable_characters_survive_the_wire(text: str) -> None:
    value = Value.parse("S" + text)
    assert value.raw == "S" + text
    assert Value.parse(value.raw.encode("ascii")) == value
    assert value.number == text


@pytest.mark.parametrize("text", ["x" * 241, "Grün", "a\x7f", "a\n", "\x03"])
def test_strings_that_are_too_long_or_not_printable_are_refused(text: str) -> None:
    with pytest.raises(ValueFormatError):
        Value.parse("S" + text)


@given(st.binary(min_size=1, max_size=120))
def test_octets_survive_the_wire_lowest_address_first(block: bytes) -> None:
    assert Value.parse("O" + "".join(f"{byte:02X}" for byte in block)).number == block


@pytest.mark.parametrize("raw", ["O", "O1", "O123", "OXX", "O" + "00" * 121, "0F", "o00"])
def test_what_is_no_octet_string_is_not_read(raw: str) -> None:
    with pytest.raises(ValueFormatError):
        Value.parse(raw)


@given(st.binary(max_size=300) | st.text(max_size=20))
def test_any_text_is_a_value_or_a_format_error(raw: bytes | str) -> None:
    try:
        value = Value.parse(raw)
    except ValueFormatError:
        return
    assert value.raw.encode() == (raw if isinstance(raw, bytes) else raw.encode())
    assert isinstance(value.number, Decimal | int | str | bytes)


def test_a_format_error_is_a_value_error_of_lecombus_with_the_text() -> None:
    assert issubclass(ValueFormatError, ValueError)
    assert issubclass(ValueFormatError, LecombusError)
    with pytest.raises(ValueFormatError) as caught:
        Value.parse("35,4")
    assert caught.value.value == "35,4"


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("35.4", "35.40", True),
        ("0", "-0.0", True),
        ("8", "H0008", True),
        ("H08", "H0008", True),
        ("H00ff", "H00FF", True),
        ("35.4", "35.5", False),
        ("S35.4", "35.4", False),
        ("S1", "S1 ", False),
        ("O31", "S1", False),
    ],
)
def test_values_that_mean_the_same(one: str, other: str, same: bool) -> None:
    assert Value.parse(one).means_same(Value.parse(other)) is same
    assert Value.parse(other).means_same(Value.parse(one)) is same


def test_values_are_equal_by_text_and_asking_for_the_number_changes_nothing() -> None:
    asked, unasked = Value(Format.VD, "35.4"), Value(Format.VD, "35.4")
    assert asked.number is asked.number, "worked out once"
    assert asked == unasked
    assert hash(asked) == hash(unasked)
    assert Value.parse("35.40") != asked
    assert str(asked) == "35.4"
    assert repr(asked) == repr(unasked)
