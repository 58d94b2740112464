"""JSON both ways: nothing is lost, nothing is made up, nothing raises but one error."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from decimal import Decimal
from typing import get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.api.decimal_json import NotJsonError, decode, decode_texts, encode
from lecombus.parameters import Json

decimals = st.decimals(allow_nan=False, allow_infinity=False, places=4, min_value=-(10**9))
scalars = st.none() | st.booleans() | st.integers() | decimals | st.text()
documents = st.recursive(
    scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20
)


@given(documents)
def test_a_document_survives_the_way_out_and_in(document: Json) -> None:
    assert decode(encode(document).encode()) == document


@given(documents)
def test_what_is_written_is_json_to_anybody(document: Json) -> None:
    json.loads(encode(document))


@pytest.mark.parametrize("text", ["35.4", "50.10", "0.0000", "-214748.3648", "0.000001"])
def test_a_decimal_keeps_every_digit(text: str) -> None:
    assert encode(Decimal(text)) == text


@pytest.mark.parametrize(("text", "written"), [("0.0000001", "1E-7"), ("1E+3", "1E+3")])
def test_a_decimal_finer_than_any_value_is_written_exactly_with_an_exponent(
    text: str, written: str
) -> None:
    assert encode(Decimal(text)) == written
    assert decode(written.encode()) == Decimal(text)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity"])
def test_what_is_no_number_is_never_written(text: str) -> None:
    with pytest.raises(msgspec.DecodeError):
        encode({"value": Decimal(text)})


@given(st.text(st.characters(exclude_categories=())))
def test_texts_are_written_as_the_standard_library_does(text: str) -> None:
    document: Json = {"a": [text, 1, None, True], "b": {}, "c": []}
    assert encode(document) == json.dumps(document)


@given(st.binary())
def test_bytes_of_any_kind_raise_one_error_or_none(text: bytes) -> None:
    with suppress(NotJsonError):
        decode(text)


def test_a_document_has_no_float_by_its_type() -> None:
    assert float not in get_args(Json)


def test_a_document_full_of_keys_that_stand_twice_is_refused_at_once() -> None:
    distinct = 200_000  # comparing each with each would take minutes
    text = "{" + ",".join(f'"{number % distinct}":1' for number in range(2 * distinct)) + "}"
    began_s = time.process_time()
    with pytest.raises(NotJsonError) as caught:
        decode(text.encode())
    assert time.process_time() - began_s < 20
    assert len(str(caught.value)) < 120


@pytest.mark.parametrize(
    "text", ["1e9999999999999999999", "-1e-9999999999999999999", "0e1" + "9" * 99]
)
def test_an_exponent_beyond_any_decimal_is_refused(text: str) -> None:
    with pytest.raises(NotJsonError, match="too large or too small") as caught:
        decode(text.encode())
    assert len(str(caught.value)) < 150


@pytest.mark.parametrize("number", ["1E+994", "50.10", "-214748.3648"])
def test_decimals_stay_exact_beside_half_a_character(number: str) -> None:
    """A client may send one; what is beside it is no less exact for that."""
    document: Json = {"va\ud80flue": [Decimal(number), "\ud800", None, True, {}]}
    text = encode(document)
    assert text.isascii()
    assert number in text
    assert json.loads(text, parse_float=Decimal) == document


@pytest.mark.parametrize("text", [b"[" * 8000, b'{"a":' * 257, b"[[]," * 129])
def test_a_text_of_many_parts_is_refused_before_it_is_read(text: bytes) -> None:
    """Thousands of arrays made the interpreter look for garbage for milliseconds."""
    with pytest.raises(NotJsonError, match="brackets that open; at most 256 are read"):
        decode(text)
    with pytest.raises(NotJsonError, match="brackets that open; at most 256 are read"):
        decode_texts(text, ())
    assert decode(b"[" * 128 + b"]" * 128) is not None
