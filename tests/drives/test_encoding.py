"""What users give becomes what the wire needs, or is refused with a reason."""

from __future__ import annotations

from decimal import Decimal

import pytest

from lecombus.drives import encode_for, family
from lecombus.errors import CodeValueError
from lecombus.protocol.addressing import Code

VECTOR = family("8200vector")
GENERIC = family("generic")


@pytest.mark.parametrize(
    ("code", "given", "raw"),
    [
        ("C0046", Decimal("35.4"), "35.4"),
        ("C0046", "35.40", "35.4"),
        ("C0046", " -5 ", "-5"),
        ("C0046", 50, "50"),
        ("C0135", 8, "H0008"),
        ("C0135", "8", "H0008"),
        ("C0135", Decimal("520"), "H0208"),
        ("C0135", "H0208", "H0208"),
        ("C0135", " h0a08", "H0A08"),
        ("C0135", "H08", "H0008"),
        ("C0700", Decimal("1.25"), "1.25"),
        ("C0700", "H00FF", "H00FF"),
        ("C0700", "O01ff", "O01FF"),
    ],
)
def test_value_takes_the_codes_format_or_its_own(
    code: str, given: Decimal | int | str, raw: str
) -> None:
    assert encode_for(VECTOR, Code.parse(code), given).raw == raw


def test_generic_device_takes_what_it_is_given() -> None:
    assert encode_for(GENERIC, Code(135), 8).raw == "8"
    assert encode_for(GENERIC, Code(135), "H0008").raw == "H0008"


@pytest.mark.parametrize(
    ("code", "given", "why"),
    [
        ("C0046", "H0008", "decimal number"),
        ("C0046", "fast", "C0046"),
        ("C0046", "1e3", "C0046"),
        ("C0046", "", "C0046"),
        ("C0046", "300000", "214748"),
        ("C0046", Decimal("0.00001"), "4 digits"),
        ("C0046", "SFAST", "decimal number"),
        ("C0135", "1.5", "whole number"),
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
    code: str, given: object, why: str
) -> None:
    with pytest.raises(CodeValueError, match=why) as refused:
        encode_for(VECTOR, Code.parse(code), given)  # type: ignore[arg-type]
    assert refused.value.code == code
