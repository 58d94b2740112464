"""Durations are read exactly, and refused in words that name the remedy."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.durations import DurationError, format_duration, parse_duration
from support.golden import Golden


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("500ms", 0.5), ("2s", 2.0), ("1.5min", 90.0), ("1h", 3600.0), ("0", 0.0), ("0s", 0.0),
        ("65.535s", 65.535), ("65535ms", 65.535), ("10 s", 10.0), ("0.5ms", 0.0005), ("+2s", 2.0),
    ],
)  # fmt: skip
def test_a_duration_is_read_in_seconds(text: str, seconds: float) -> None:
    assert parse_duration(text) == seconds


@pytest.mark.parametrize(
    "text",
    [
        "2",
        "-2s",
        "1,5s",
        "2m",
        "2sec",
        "2S",
        "2days",
        "soon",
        "11:30",
        "1e3s",
        "nans",
        "9" * 30 + "s",
        "٢s",
    ],
)
def test_what_is_no_duration_is_refused_with_the_remedy(text: str, golden: Golden) -> None:
    with pytest.raises(DurationError) as caught:
        parse_duration(text)
    golden(caught.value.what, caught.value.right)


@given(st.text(max_size=20))
def test_no_text_raises_anything_else(text: str) -> None:
    with contextlib.suppress(DurationError):
        assert parse_duration(text) >= 0


@given(st.integers(0, 86_400_000))
def test_what_is_written_reads_the_same(milliseconds: int) -> None:
    assert parse_duration(format_duration(milliseconds / 1000)) == milliseconds / 1000


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0s"), (0.05, "50ms"), (0.0005, "0.5ms"), (2.0, "2s"), (1.5, "1.5s"), (60.0, "1min"),
     (90.0, "90s"), (7200.0, "2h"), (65.535, "65.535s"), (86400.0, "24h")],
)  # fmt: skip
def test_durations_are_written_short(seconds: float, text: str) -> None:
    assert format_duration(seconds) == text
