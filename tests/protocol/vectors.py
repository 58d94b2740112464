"""The vectors of tests/vectors, and what several protocol tests do with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from lecombus.fieldbus.lecom.protocol.parser import AnswerParser
from lecombus.fieldbus.lecom.protocol.telegrams import Answer

FOLDER = Path(__file__).parent.parent / "vectors"


def load(name: str) -> list[dict[str, Any]]:
    """Return the vectors of one file."""
    vectors: list[dict[str, Any]] = yaml.safe_load((FOLDER / name).read_text("utf-8"))
    assert vectors, f"{name} holds nothing"
    return vectors


def named(name: str) -> list[Any]:
    """Return the vectors of one file as pytest parameters that carry their names."""
    return [pytest.param(vector, id=vector["name"]) for vector in load(name)]


def wire(vector: dict[str, Any]) -> bytes:
    """Return the vector's bytes."""
    return bytes.fromhex(vector["hex"])


def feed_all(parser: AnswerParser, pieces: Sequence[bytes]) -> Answer | None:
    """Feed every piece; return the one answer they gave, or None."""
    answers = [answer for piece in pieces if (answer := parser.feed(piece)) is not None]
    assert len(answers) <= 1, f"one answer at a time, not {answers}"
    return answers[0] if answers else None


def splits(data: bytes) -> Iterator[tuple[bytes, ...]]:
    """Yield the data whole, in every two pieces, and byte by byte."""
    yield (data,)
    for at in range(1, len(data)):
        yield (data[:at], data[at:])
    yield tuple(data[at : at + 1] for at in range(len(data)))
