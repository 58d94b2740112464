from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.errors import CodeValueError
from lecombus.fieldbus.lecom.protocol.addressing import (
    Form,
    encode_address,
    encode_code,
    field_length,
    fits_field,
    group_reach,
    is_code_field,
    is_drive_address,
    is_group_address,
)
from lecombus.parameters import Code
from protocol.vectors import load
from support.answers import decode_code

codes = st.builds(Code, st.integers(0, 65535), st.integers(0, 255))


def test_every_standard_code_follows_the_formula_of_the_manual() -> None:
    for number in range(6230):
        c1, c2 = encode_code(Code(number), Form.STANDARD)
        assert c1 == number % 790 // 10 + 48
        assert c2 == number % 790 % 10 + number // 790 * 10 + 48
        assert 48 <= c1 <= 126
        assert 48 <= c2 <= 127


def test_every_standard_field_leads_back_to_its_code_and_no_two_codes_share_one() -> None:
    fields = {encode_code(Code(number), Form.STANDARD): number for number in range(6230)}
    assert len(fields) == 6230
    for field, number in fields.items():
        assert decode_code(field) == (Code(number), Form.STANDARD)


def test_of_all_pairs_of_characters_exactly_the_standard_fields_are_fields() -> None:
    fields = {encode_code(Code(number), Form.STANDARD) for number in range(6230)}
    pairs = (bytes((c1, c2)) for c1 in range(256) for c2 in range(256))
    assert {pair for pair in pairs if is_code_field(pair)} == fields


def test_no_standard_field_begins_like_an_extended_one() -> None:
    assert all(encode_code(Code(number), Form.STANDARD)[0] != 0x21 for number in range(6230))


@pytest.mark.parametrize("subcode", [0, 1, 9, 10, 127, 255])
def test_extended_fields_spell_code_and_subcode_in_capitals(subcode: int) -> None:
    for number in range(0, 65536, 97):
        field = encode_code(Code(number, subcode), Form.EXTENDED)
        assert field == f"!{number:04X}{subcode:02X}".encode()
        assert decode_code(field) == (Code(number, subcode), Form.EXTENDED)


@pytest.mark.parametrize("vector", load("codes.yaml"), ids=lambda v: f"{v['code']}-{v['form']}")
def test_worked_examples_of_the_manuals(vector: dict[str, Any]) -> None:
    code, form = Code.parse(vector["code"]), Form(vector["form"])
    field = bytes.fromhex(vector["field"])
    assert encode_code(code, form) == field
    assert decode_code(field) == (code, form)


@given(codes, st.sampled_from(Form))
def test_a_form_carries_exactly_the_codes_it_knows(code: Code, form: Form) -> None:
    if form.carries(code):
        assert decode_code(encode_code(code, form)) == (code, form)
    else:
        with pytest.raises(CodeValueError, match="needs extended addressing"):
            encode_code(code, form)


@pytest.mark.parametrize("code", [Code(6230), Code(0, 1), Code(6229, 1), Code(65535)])
def test_standard_addressing_refuses_what_it_cannot_reach(code: Code) -> None:
    assert not Form.STANDARD.carries(code)
    assert Form.EXTENDED.carries(code)
    with pytest.raises(CodeValueError) as caught:
        encode_code(code, Form.STANDARD)
    assert caught.value.high == 6229


@pytest.mark.parametrize(("number", "subcode"), [(-1, 0), (65536, 0), (0, -1), (0, 256)])
def test_there_is_no_code_outside_the_ranges(number: int, subcode: int) -> None:
    with pytest.raises(CodeValueError):
        Code(number, subcode)


@pytest.mark.parametrize(
    "field",
    [b"", b"4", b"461", b"vv", b"/0", b"0/", b"\x7f0", b"!03EA0", b"!03EA000", b"!03ea00",
     b"!03EG00"],
)  # fmt: skip
def test_what_is_no_field_is_not_taken_for_one(field: bytes) -> None:
    assert not is_code_field(field)


@given(st.binary(min_size=1, max_size=8))
def test_a_field_is_one_exactly_if_every_beginning_of_it_fits(start: bytes) -> None:
    fits = [fits_field(start[:length]) for length in range(1, len(start) + 1)]
    assert fits == sorted(fits, reverse=True), "once it does not fit it never fits again"
    assert is_code_field(start) == (fits[-1] and len(start) == field_length(start[0]))


def test_a_field_with_one_character_more_is_not_the_beginning_of_one() -> None:
    assert fits_field(b"!03EA00")
    assert not fits_field(b"!03EA000")
    assert not fits_field(b"460")


@given(codes, st.sampled_from(Form))
def test_every_beginning_of_a_field_fits(code: Code, form: Form) -> None:
    if form.carries(code):
        field = encode_code(code, form)
        assert all(fits_field(field[:length]) for length in range(1, len(field) + 1))


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("C0150", Code(150)),
        ("C150", Code(150)),
        ("150", Code(150)),
        ("c150", Code(150)),
        ("0", Code(0)),
        ("C0039/1", Code(39, 1)),
        ("39/255", Code(39, 255)),
        ("P425", Code(1425)),
        ("P0", Code(1000)),
        ("P999", Code(1999)),
        ("P500/8", Code(1500, 8)),
        ("C65535", Code(65535)),
    ],
)
def test_codes_are_read_as_people_write_them(text: str, code: Code) -> None:
    assert Code.parse(text) == code


@pytest.mark.parametrize(
    "text",
    ["", "C", "P", "P1000", "C-1", "C0150/", "/1", "C 150", " 150", "150\n", "C65536", "C1/256",
     "X150", "C1.5", "C15O", "٣", "C0039/1/2", "C000150"],
)  # fmt: skip
def test_what_is_no_code_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(CodeValueError) as caught:
        Code.parse(text)
    assert str(caught.value)


def test_a_refused_code_is_told_what_would_be_right() -> None:
    with pytest.raises(CodeValueError, match="write C0150, C150, 150, C0039/1"):
        Code.parse("speed")


@given(codes)
def test_a_code_as_text_is_read_back_as_itself(code: Code) -> None:
    assert Code.parse(str(code)) == code


def test_codes_are_shown_with_four_digits_and_a_subcode_only_if_they_have_one() -> None:
    assert [str(Code(46)), str(Code(39, 1)), str(Code(12345))] == ["C0046", "C0039/1", "C12345"]


@given(codes, codes)
def test_codes_compare_by_number_then_subcode_and_hash_as_they_compare(a: Code, b: Code) -> None:
    assert (a < b) == ((a.number, a.subcode) < (b.number, b.subcode))
    assert (a == b) == ((a.number, a.subcode) == (b.number, b.subcode))
    if a == b:
        assert hash(a) == hash(b)


def test_all_codes_hash_apart() -> None:
    assert len({hash(Code(n, s)) for n in range(0, 65536, 7) for s in (0, 1, 255)}) == 9363 * 3


def test_addresses_are_two_digits() -> None:
    assert [encode_address(a) for a in (0, 1, 34, 99)] == [b"00", b"01", b"34", b"99"]


@pytest.mark.parametrize("address", [-1, 100])
def test_addresses_beyond_two_digits_are_refused(address: int) -> None:
    with pytest.raises(CodeValueError):
        encode_address(address)
    assert not is_drive_address(address)
    assert not is_group_address(address)


def test_every_address_is_a_drives_or_a_groups() -> None:
    assert [a for a in range(100) if is_group_address(a)] == list(range(0, 100, 10))
    assert all(is_drive_address(a) != is_group_address(a) for a in range(100))
    assert sum(map(is_drive_address, range(100))) == 90


def test_groups_reach_their_decade_and_zero_reaches_all() -> None:
    assert group_reach(10) == tuple(range(11, 20))
    assert group_reach(90) == tuple(range(91, 100))
    assert group_reach(0) == tuple(a for a in range(100) if a % 10)
    assert set(range(1, 10)) <= set(group_reach(0)), "1..9 are reached by 00 only"


@pytest.mark.parametrize("address", [1, 11, 99, 100, -10])
def test_a_drives_address_reaches_no_group(address: int) -> None:
    with pytest.raises(CodeValueError, match="not a group address"):
        group_reach(address)
