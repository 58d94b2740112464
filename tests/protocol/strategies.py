"""What hypothesis draws for the protocol tests."""

from __future__ import annotations

import itertools

from hypothesis import strategies as st

from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    Answer,
    NakAnswer,
    TransmissionErrorAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.parameters import Code, Value

addressed = st.one_of(
    st.tuples(st.integers(0, 6229).map(Code), st.just(Form.STANDARD)),
    st.tuples(st.builds(Code, st.integers(0, 65535), st.integers(0, 255)), st.just(Form.EXTENDED)),
)
fields = addressed.map(lambda pair: encode_code(*pair))


def string(text: str) -> Value:
    return Value.parse(f"S{text}")


def octets(block: bytes) -> Value:
    return Value.parse(f"O{block.hex().upper()}")


values = st.one_of(
    st.integers(-(2**31), 2**31 - 1).map(lambda n: Value.decimal(f"{n / 10000:.4f}")),
    st.builds(Value.hexadecimal, st.integers(0, 255), st.sampled_from((2, 4, 8))),
    st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=240).map(string),
    st.binary(min_size=1, max_size=120).map(octets),
)
sendable = values.filter(lambda value: not value.raw.startswith("S") or len(value.raw) <= 21)
answers: st.SearchStrategy[Answer] = st.one_of(
    st.builds(ValueAnswer, fields, values),
    st.builds(UnknownCodeAnswer, fields),
    st.builds(TransmissionErrorAnswer, fields),
    st.just(AckAnswer()),
    st.just(NakAnswer()),
)


def cut(data: bytes, places: list[int]) -> list[bytes]:
    """Cut data at the places given, as far as they lie within it."""
    edges = [0, *sorted({place % (len(data) + 1) for place in places}), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]
