"""What a misspelt name is told."""

from __future__ import annotations

import time

import pytest

from lecombus.errors import meant


@pytest.mark.parametrize(
    ("word", "remedy"),
    [
        ("feedr", "did you mean feeder?"),
        ("FEEDER", "did you mean feeder?"),
        ("lift", "the drives are: feeder, Fan"),
        ("fann", "did you mean Fan?"),
        ("", "the drives are: feeder, Fan"),
    ],
)
def test_the_nearest_name_is_meant_or_all_are_told(word: str, remedy: str) -> None:
    assert meant(word, ["feeder", "Fan"], "the drives") == remedy


def test_where_there_is_none_that_is_said() -> None:
    assert meant("a", [], "the groups") == "the groups are: none"


def test_a_long_word_costs_no_more_than_a_short_one() -> None:
    known = [f"drive-{number}" for number in range(90)]
    begun_s = time.thread_time()
    meant("d" * 10**6, known, "the drives")
    assert time.thread_time() - begun_s < 0.5
