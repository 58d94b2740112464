"""What an interrupted restore leaves behind is read as far as it is whole."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lecombus.backups import Progress, done_line, head_line, read_progress, stops_line
from lecombus.parameters import Code, Value

HEAD = Progress("feeder.yaml", "0123456789abcdef", "2026-11-22T01:54:43Z", enabled=True)
TEXT = (
    head_line(HEAD)
    + done_line(Code(11), Value.parse("60.5"))
    + done_line(Code(39, 2), Value.parse("H0008"))
)


def test_what_is_noted_is_read_back() -> None:
    found = read_progress(TEXT)
    assert found is not None
    assert (found.file, found.digest, found.begun, found.enabled) == (
        HEAD.file, HEAD.digest, HEAD.begun, True,
    )  # fmt: skip
    assert found.done == {Code(11): "60.5", Code(39, 2): "H0008"}


@pytest.mark.parametrize("length", range(len(TEXT)))
def test_a_line_that_was_torn_by_a_kill_is_left_out(length: int) -> None:
    found = read_progress(TEXT[:length])
    lines = TEXT[:length].count("\n")
    if found is None:
        assert lines == 0
    else:  # a line that is whole but for its end counts
        assert lines - 1 <= len(found.done) <= lines


@pytest.mark.parametrize("text", ["", "\n", "{}\n", "[1]\n", "words\n", '{"code": "C0011"}\n'])
def test_what_is_none_is_none(text: str) -> None:
    assert read_progress(text) is None


@pytest.mark.parametrize("line", ['{"code": "C0011"}', '{"code": "x", "value": "1"}', "7"])
def test_a_line_that_somebody_damaged_is_left_out(line: str) -> None:
    found = read_progress(TEXT + line + "\n")
    assert found is not None
    assert len(found.done) == 2


def test_the_last_mark_of_the_stops_counts() -> None:
    found = read_progress(head_line(replace(HEAD, stops="r-a-1")))
    assert found is not None
    assert found.stops == "r-a-1"
    text = TEXT + stops_line("r-a-2") + done_line(Code(12), Value.parse("5"))
    found = read_progress(text)
    assert found is not None
    assert (found.stops, len(found.done)) == ("r-a-2", 3)
