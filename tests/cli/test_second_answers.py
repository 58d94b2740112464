"""Whether second answers in a scan are those of two drives at one address, or of the line."""

from __future__ import annotations

from collections import Counter

import pytest

from lecombus.cli.second_answers import Place, SecondAnswers

A, B = (12, 19200), (13, 19200)


@pytest.mark.parametrize(
    ("behind", "answers", "shared"),
    [
        ({A: 5}, {A: 10, B: 10}, [A]),
        ({A: 9, B: 1}, {A: 10, B: 10}, [A]),
        ({A: 2}, {A: 2}, [A]),
        ({A: 2}, {A: 10, B: 10}, []),
        ({A: 6, B: 5}, {A: 10, B: 10}, []),
        ({}, {A: 10}, []),
    ],
)
def test_a_drive_behind_which_far_more_come_shares_its_address(
    behind: dict[Place, int], answers: dict[Place, int], shared: list[Place]
) -> None:
    second = SecondAnswers(sum(behind.values()), behind, Counter(answers))
    found = second.shared_addresses()
    assert list(found) == shared
    assert all(text.startswith("two drives at address 12?") for text in found.values())


def test_what_is_not_clear_is_said_from_three_on() -> None:
    assert SecondAnswers(2, {A: 1, B: 1}).unexplained() == ""
    assert (
        "behind those of address 12, 13: two drives" in SecondAnswers(3, {A: 2, B: 1}).unexplained()
    )
