"""What users give becomes what the wire needs, or is refused with a reason."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.drives import Family, encode_for, family
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

VECTOR = family("8200vector")
GENERIC = family("generic")


@pytest.mark.parametrize(
    ("code", "value", "raw"),
    [
        ("C0046", Decimal("35.4"), "35.4"),
        ("C0046", "35.40", "35.4"),
        ("C0046", " -5 ", "-5"),
        ("C0046", 50, "50"),
        ("C0135", 8, "H0008"),
        ("C0135", Decimal("520"), "H0208"),
        ("C0135", "H0208", "H0208"),
        ("C0135", " h0a08", "H0A08"),
        ("C0135", "0x0208", "H0208"),
        ("C0135", "0X8", "H0008"),
        ("C0135", "H08", "H0008"),
        ("C0700", Decimal("1.25"), "1.25"),
        ("C0700", "208", "208"),
        ("C0700", "-5", "-5"),
        ("C0700", "0.50", "0.5"),
        ("C0700", "H00FF", "H00FF"),
        ("C0700", "0x00ff", "H00FF"),
        ("C0700", "O01ff", "O01FF"),
    ],
)
def test_value_takes_the_codes_format_or_its_own(
    code: str, value: Decimal | int | str, raw: str
) -> None:
    assert encode_for(VECTOR, Code.parse(code), value).raw == raw


@given(number=st.integers(0, 0xFFFF), width=st.integers(1, 4), capital=st.booleans())
def test_word_is_what_its_hexadecimal_digits_say(number: int, width: int, capital: bool) -> None:
    digits = f"{number:0{width}{'X' if capital else 'x'}}"
    expected = f"H{number:04X}"
    for mark in ("H", "h", "0x", "0X"):
        assert encode_for(VECTOR, Code(135), mark + digits).raw == expected
    assert encode_for(VECTOR, Code(135), number).raw == expected
    assert encode_for(VECTOR, Code(135), Decimal(number)).raw == expected


@given(text=st.from_regex(r"[+-]?[0-9]{1,8}(\.[0-9]{0,3})?", fullmatch=True))
@pytest.mark.parametrize("last_read", [None, Value.parse("H0000")])
def test_digits_are_never_taken_for_a_word_and_both_readings_are_shown(
    text: str, last_read: Value | None
) -> None:
    code = Code(135 if last_read is None else 700)
    with pytest.raises(CodeValueError) as refused:
        encode_for(VECTOR, code, text, last_read=last_read)
    said = str(refused.value)
    if text.isdecimal() and len(text) <= 4:
        assert f"H{int(text, 16):04X}" in said
    if text.isdecimal() and int(text) <= 0xFFFF:
        assert f"H{int(text):04X}" in said


@pytest.mark.parametrize("of", [VECTOR, GENERIC])
@pytest.mark.parametrize(
    ("value", "last", "raw"),
    [
        ("H0208", "H0000", "H0208"),
        ("0x208", "H0000", "H0208"),
        (520, "H0000", "H0208"),
        (Decimal(8), "H00", "H08"),
        (8, "H00000000", "H00000008"),
        ("0208", "0", "208"),
        (208, "35.4", "208"),
        ("H0208", "35.4", "H0208"),
    ],
)
def test_undescribed_code_takes_the_format_it_was_read_in(
    of: Family, value: int | Decimal | str, last: str, raw: str
) -> None:
    assert encode_for(of, Code(700), value, last_read=Value.parse(last)).raw == raw


def test_generic_device_takes_what_it_is_given() -> None:
    assert encode_for(GENERIC, Code(135), 8).raw == "8"
    assert encode_for(GENERIC, Code(135), "H0008").raw == "H0008"


@pytest.mark.parametrize(
    ("code", "value", "why"),
    [
        ("C0046", "H0008", "decimal number"),
        ("C0046", "fast", "C0046"),
        ("C0046", "1e3", "C0046"),
        ("C0046", "", "C0046"),
        ("C0046", "300000", "214748"),
        ("C0046", Decimal("0.00001"), "4 digits"),
        ("C0046", "SFAST", "decimal number"),
        ("C0135", Decimal("1.5"), "whole number"),
        ("C0135", Decimal("1e30"), "whole number"),
        ("C0135", Decimal("NaN"), "whole number"),
        (
            "C0135",
            "0208",
            r"could be H0208 \(520\) or decimal 208 \(H00D0\); write H0208 or 0x0208, "
            "or H00D0",
        ),
        ("C0135", "208", r"could be H0208 \(520\) or decimal 208 \(H00D0\)"),
        ("C0135", "8", "write H0008 or 0x0008"),
        ("C0135", "12345", r"could be decimal 12345 \(H3039\); write H3039"),
        ("C0135", "208.0", r"could be decimal 208 \(H00D0\); write H00D0"),
        ("C0135", "99999", "too long for a word; H or 0x with up to 4"),
        ("C0135", "-5", "is not a word; H or 0x with up to 4 hexadecimal digits"),
        ("C0135", "1.5", "is not a word"),
        ("C0135", "0A08", "is not a word; H or 0x"),
        ("C0135", "H00208", "too long; H or 0x with up to 4"),
        ("C0135", "O0208", "is not a word"),
        ("C0700", "0208", r"a word \(H0208\) or decimal 208"),
        ("C0046", "0x10", "not a decimal|decimal number"),
        ("C0135", 65536, "65535"),
        ("C0135", -1, "65535"),
        ("C0135", "HXYZ", "C0135"),
        ("C0700", "Shello", "accept none"),
        ("C1810", "label", "accept none"),
        ("C0046", True, "number or a text"),
        ("C0046", 35.4, "number or a text"),
    ],
)
def test_value_that_cannot_be_sent_is_refused_with_code_and_reason(
    code: str, value: object, why: str
) -> None:
    with pytest.raises(CodeValueError, match=why) as refused:
        encode_for(VECTOR, Code.parse(code), value)  # type: ignore[arg-type]
    assert refused.value.code == code
