"""JSON both ways: nothing is lost, nothing is made up, nothing raises but one error."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.api.exact import NotJsonError, decode, encode
from lecombus.readings import Json

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


@pytest.mark.parametrize("text", ["35.4", "50.10", "0.0000", "-214748.3648", "0.0000001"])
def test_a_decimal_keeps_every_digit(text: str) -> None:
    assert encode(Decimal(text)) == text


@given(st.binary())
def test_bytes_of_any_kind_raise_one_error_or_none(text: bytes) -> None:
    with suppress(NotJsonError):
        decode(text)


def test_a_float_is_never_written() -> None:
    with pytest.raises(KeyError):
        encode(0.1)  # type: ignore[arg-type]


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
