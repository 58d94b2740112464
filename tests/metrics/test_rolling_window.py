"""What the last minutes keep, and that it is bounded."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest

from lecombus.api.decimal_json import encode
from lecombus.metrics.rolling_window import MARKS_S, SLOTS, WINDOW_S, Highest, RollingWindow
from lecombus.parameters import Code
from lecombus.schedule.request import Priority


def told(minutes: RollingWindow, now_s: float) -> Any:
    return json.loads(encode(minutes.as_json(now_s)))


def test_the_highest_is_remembered_for_the_window_and_no_longer() -> None:
    highest = Highest()
    assert highest.most(0.0) is None
    highest.note(3.0, 5.0)
    highest.note(1.0, 6.0)
    highest.note(2.0, 200.0)
    assert highest.most(5.0 + WINDOW_S) == 3.0
    assert highest.most(21.0 + WINDOW_S) == 2.0
    assert highest.most(200.0, within_s=30.0) == 2.0
    assert highest.most(1000.0) is None


def test_a_slot_is_used_again_after_a_round() -> None:
    highest = Highest()
    highest.note(9.0, 1.0)
    highest.note(1.0, 1.0 + SLOTS * 10.0)
    assert highest.most(1.0 + SLOTS * 10.0) == 1.0


def test_half_of_the_waits_lie_within_the_median() -> None:
    minutes = RollingWindow(100.0)
    for number in range(101):
        minutes.exchange(Priority.CONTROL, 0.02, number / 100, 150.0, good=number != 7)
    minutes.exchange(Priority.CONTROL, 0.02, None, 150.0, good=True)
    found = told(minutes, 200.0)["classes"]["control"]
    assert 0.5 <= found["wait_median_s"] <= 0.5 * 1.2
    assert (found["wait_most_s"], found["waits"]) == (1.0, 101)
    assert (found["exchanges"], found["failed"]) == (102, 1)
    assert found["utilisation"] == pytest.approx(102 * 0.02 / 100.0, rel=1e-3)


def test_half_of_the_waits_are_never_longer_than_the_longest() -> None:
    minutes = RollingWindow()
    minutes.exchange(Priority.WATCHDOG, 0.02, 0.0004, 1.0, good=True)
    found = told(minutes, 2.0)["classes"]["watchdog"]
    assert found["wait_median_s"] == found["wait_most_s"] == 0.0004


@pytest.mark.parametrize("now_s", [150.0, 400.0, 404.0, 409.0])
def test_half_of_the_line_is_half_of_the_line_whenever_it_is_asked_for(now_s: float) -> None:
    minutes = RollingWindow()
    for at_s in range(int(now_s)):
        minutes.exchange(Priority.CYCLIC, 0.5, None, float(at_s), good=True)
    found = told(minutes, now_s)["classes"]["cyclic"]
    assert found["utilisation"] == pytest.approx(0.5, abs=0.005)


def test_waits_off_both_ends_of_the_marks_count() -> None:
    minutes = RollingWindow()
    minutes.exchange(Priority.CYCLIC, 0.02, 0.0, 1.0, good=True)
    assert told(minutes, 1.0)["classes"]["cyclic"]["wait_median_s"] == 0.0
    for _ in range(3):
        minutes.exchange(Priority.CYCLIC, 0.02, 3600.0, 1.0, good=True)
    found = told(minutes, 1.0)["classes"]["cyclic"]
    assert (found["wait_most_s"], found["wait_median_s"]) == (3600.0, round(MARKS_S[-1], 6))


def test_gaps_are_those_of_expected_codes_and_an_open_one_counts() -> None:
    minutes = RollingWindow()
    minutes.expect("a", (Code(150), Code(50)))
    for at_s in (10.0, 11.0, 14.0, 14.5):
        minutes.value("a", Code(150), at_s)
    minutes.value("a", Code(12), 14.0)
    minutes.value("stranger", Code(150), 14.0)
    assert told(minutes, 15.0)["gaps_s"] == {"a": {"C0150": 3.0, "C0050": None}}
    assert told(minutes, 20.0)["gaps_s"]["a"]["C0150"] == 5.5
    minutes.forget("a")
    assert told(minutes, 20.0)["gaps_s"] == {}


def test_least_margins_and_slack_are_kept_not_highest() -> None:
    minutes = RollingWindow()
    for margin_s in (0.4, 0.2, 0.9):
        minutes.margin("a", margin_s, 10.0)
        minutes.slack(margin_s - 0.5, 10.0)
    found = told(minutes, 10.0)
    assert (found["margins_s"], found["slack_s"]) == ({"a": 0.2}, -0.3)


def test_the_least_margin_of_the_last_half_minute_forgets_what_was_before() -> None:
    minutes = RollingWindow()
    for margin_s, at_s in ((0.1, 10.0), (0.4, 200.0), (0.3, 201.0), (0.7, 210.0)):
        minutes.margin("a", margin_s, at_s)
    minutes.margin("b", -0.5, 100.0)
    assert minutes.lowest_margins_s(211.0, 30.0) == {"a": 0.3}
    assert minutes.lowest_margins_s(102.0, 30.0)["b"] == -0.5
    minutes.forget("a")
    assert minutes.lowest_margins_s(211.0, 30.0) == {}


def test_what_is_kept_does_not_grow_with_the_exchanges() -> None:
    def size(minutes: RollingWindow) -> int:
        slots = [slot for of_class in minutes._classes.values() for slot in of_class]
        return len(slots) + sum(sys.getsizeof(slot.waits) for slot in slots)

    minutes = RollingWindow()
    before = size(minutes)
    for number in range(20_000):
        minutes.exchange(Priority.CYCLIC, 0.02, 0.001 * (number % 977), number * 0.05, good=True)
    assert size(minutes) == before
