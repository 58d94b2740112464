"""Answer times that were measured: what counts, its bounds, and what it makes of costs."""

from __future__ import annotations

import random

import pytest

from lecombus.drives import family
from lecombus.drives.measured import (
    ATTEMPTS,
    FADE_S,
    JUDGED_EVERY_S,
    KEPT_S,
    LATENESS_S,
    MOST_CODES,
    MOST_LEAST_S,
    MOST_S,
    RECENT_S,
    MeasuredTimes,
    SlowAnswers,
    manual_s,
)
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.telegram_costs import read_cost
from lecombus.parameters import Code

FAMILY = family("8200vector")
STATUS, OTHER, THIRD = Code(150), Code(50), Code(61)
TOLD_S = manual_s(FAMILY, STATUS, write=False, answer_time_s=None)
SLOW_S = 3.0 * TOLD_S
LIMITED = Code(next(number for number, one in FAMILY.answer_times.items() if one.is_limit))


def measured(*times_s: float, code: Code = STATUS, told_s: float = TOLD_S) -> MeasuredTimes:
    found = MeasuredTimes()
    for number, time_s in enumerate(times_s):
        found.note(code, told_s, time_s, float(number), write=False)
    return found


def reckoned_s(found: MeasuredTimes, code: Code = STATUS, *, write: bool = False) -> float | None:
    return found.slow.time_s(FAMILY, code, write=write, answer_time_s=None)


def test_once_is_no_measure_and_twice_is() -> None:
    assert reckoned_s(measured(SLOW_S)) is None
    twice_s = reckoned_s(measured(SLOW_S, SLOW_S))
    assert twice_s is not None
    assert SLOW_S <= twice_s <= 1.25 * SLOW_S


@pytest.mark.parametrize(("late", "most"), [(0.05, 0), (0.1, 8), (0.25, 200)])
def test_some_answers_that_are_late_are_no_slow_drive(late: float, most: int) -> None:
    rng = random.Random(3)
    found, slow = MeasuredTimes(), 0
    for number in range(4000):
        time_s = SLOW_S if rng.random() < late else 0.01
        found.note(STATUS, TOLD_S, time_s, float(number), write=False)
        slow += reckoned_s(found) is not None
    assert slow <= most


def test_a_drive_that_becomes_slow_is_learnt_after_some_attempts_and_forgotten_as_soon() -> None:
    found = measured(*[0.01] * 100)
    for number in range(ATTEMPTS // 2 + 1):
        assert reckoned_s(found) is None
        found.note(STATUS, TOLD_S, SLOW_S, 100.0 + number, write=False)
    assert reckoned_s(found) is not None
    for number in range(ATTEMPTS):
        found.note(STATUS, TOLD_S, SLOW_S, 110.0 + number, write=False)
    for number in range(ATTEMPTS // 2):
        assert reckoned_s(found) is not None
        found.note(STATUS, TOLD_S, 0.01, 120.0 + number, write=False)
    assert found.slow == SlowAnswers()


def test_attempts_without_an_answer_speak_for_a_slow_drive_but_alone_they_prove_nothing() -> None:
    found = measured(*[0.01] * ATTEMPTS)
    for number in range(100):
        found.missed(STATUS, 10.0 + number, write=False)
    assert reckoned_s(found) is None
    for number in range(2):
        found.missed(STATUS, 110.0 + number, write=False)
        found.note_late(STATUS, TOLD_S, 0.9, 110.1 + number)
    assert reckoned_s(found) is not None
    for number in range(100):
        found.missed(STATUS, 120.0 + number, write=False)
    assert reckoned_s(found) is not None, "silence forgets nothing"


def test_one_wild_measure_among_others_does_not_count() -> None:
    found = measured(SLOW_S, SLOW_S, 30.0, SLOW_S)
    used_s = reckoned_s(found)
    assert used_s is not None
    assert used_s <= 1.25 * SLOW_S


def test_what_is_about_the_manual_s_time_changes_nothing() -> None:
    found = measured(*[TOLD_S * 1.2 + LATENESS_S / 2] * 5)
    assert reckoned_s(found) is None
    assert found.slow == SlowAnswers()
    assert [(row.code, row.slow) for row in found.rows()] == [(STATUS, False)]


def test_never_below_the_manual_and_never_far_above() -> None:
    rng = random.Random(7)
    for _ in range(500):
        told_s = rng.choice((0.003, 0.03, 0.1, 0.5, 3.0))
        found = measured(*(rng.uniform(0.0, 20.0) for _ in range(4)), told_s=told_s)
        used_s = found.slow.reads.get(STATUS, told_s)
        most_s = min(max(10.0 * told_s, MOST_LEAST_S), MOST_S)
        assert told_s <= used_s <= max(told_s, most_s)


def test_a_code_seldom_read_is_forgotten_by_its_first_answer_in_time() -> None:
    found = measured(*[SLOW_S] * ATTEMPTS)
    found.note(STATUS, TOLD_S, 0.01, FADE_S - 1.0, write=False)
    assert reckoned_s(found) is not None
    found.note(STATUS, TOLD_S, 0.01, FADE_S + ATTEMPTS, write=False)
    assert reckoned_s(found) is None
    assert found.slow == SlowAnswers()


def test_what_was_late_with_others_is_forgotten_with_them() -> None:
    found = measured(SLOW_S, SLOW_S)
    for number in range(2):
        found.note(OTHER, TOLD_S, SLOW_S, 2.0 + number, write=False)
    assert reckoned_s(found, OTHER) is not None
    for number in range(2):
        found.note(STATUS, TOLD_S, 0.01, 4.0 + RECENT_S + number, write=False)
    assert found.slow == SlowAnswers()


def test_a_code_last_answered_in_time_and_asked_for_no_more_is_forgotten() -> None:
    found = measured(*[SLOW_S] * ATTEMPTS)
    found.note(STATUS, TOLD_S, 0.01, 10.0, write=False)
    for number in range(5):
        found.note(OTHER, TOLD_S, 0.01, 11.0 + number, write=False)
    assert reckoned_s(found) is not None
    for number in range(3):
        found.note(OTHER, TOLD_S, 0.01, 25.0 + number, write=False)
    assert reckoned_s(found) is None


def test_all_is_forgotten_when_somebody_says_so() -> None:
    found = measured(SLOW_S, SLOW_S)
    found.forget()
    assert found.slow == SlowAnswers()
    assert found.rows() == []


def test_a_code_no_longer_asked_for_is_forgotten_while_the_drive_answers_others() -> None:
    found = measured(SLOW_S, SLOW_S)
    for at_s in (10.0, KEPT_S / 2, KEPT_S - 1.0):
        found.note(OTHER, TOLD_S, 0.01, at_s, write=False)
    assert reckoned_s(found) is not None
    for at_s in (KEPT_S + 2.0, KEPT_S + JUDGED_EVERY_S):
        found.note(OTHER, TOLD_S, 0.01, at_s, write=False)
    assert reckoned_s(found) is None
    assert [row.code for row in found.rows()] == [OTHER]


def test_the_adapter_s_part_is_taken_off() -> None:
    found = MeasuredTimes(latency_s=0.05)
    for _ in range(2):
        found.note(STATUS, TOLD_S, TOLD_S + 0.06, 1.0, write=False)
    assert reckoned_s(found) is None
    assert found.rows()[0].measured_s == pytest.approx(TOLD_S + 0.01)


def test_only_a_drive_slow_in_all_is_slow_in_what_was_not_measured() -> None:
    found = measured(SLOW_S, SLOW_S)
    assert reckoned_s(found, THIRD) is None
    for at_s in (3.0, 4.0):
        found.note(OTHER, TOLD_S, 2.5 * TOLD_S, at_s, write=False)
    third_s = reckoned_s(found, THIRD)
    assert third_s is not None
    assert third_s == pytest.approx(2.5 * TOLD_S, rel=0.25)
    assert reckoned_s(found, STATUS, write=True) is not None
    assert reckoned_s(found, LIMITED) is None
    for at_s in (5.0, 6.0):
        found.note(THIRD, TOLD_S, TOLD_S, at_s, write=False)
    assert reckoned_s(found, Code(46)) is None
    assert reckoned_s(found, STATUS) is not None


def test_a_late_answer_counts_however_little_it_was_late() -> None:
    found = MeasuredTimes()
    for _ in range(2):
        found.note_late(STATUS, TOLD_S, TOLD_S, 1.0)
    assert reckoned_s(found) is not None


def test_the_slowest_codes_are_remembered_and_no_more() -> None:
    found = MeasuredTimes()
    for number in range(100):
        for _ in range(2):
            found.note(Code(number), TOLD_S, TOLD_S * (1 + number), 1.0, write=False)
    rows = found.rows()
    assert len(rows) == MOST_CODES
    assert rows[0].code == Code(99)
    assert min(row.code.number for row in rows) == 100 - MOST_CODES


def test_no_stop_waits_for_more_than_two_seconds_of_a_slow_drive() -> None:
    for code in (STATUS, LIMITED):
        told_s = manual_s(FAMILY, code, write=False, answer_time_s=None)
        found = measured(30.0, 30.0, code=code, told_s=told_s)
        assert FAMILY.patience_s(code, write=False, answer_time_s=reckoned_s(found, code)) <= 2.0


def test_a_slow_drive_is_waited_for_twice_as_long_as_it_takes() -> None:
    timing = LineTiming(9600)
    usual = read_cost(timing, FAMILY, STATUS, Form.STANDARD)
    slow = read_cost(timing, FAMILY, STATUS, Form.STANDARD, reckoned_s(measured(SLOW_S, SLOW_S)))
    assert slow.first_byte_s - slow.request_s >= 2 * SLOW_S
    assert slow.expected_s > usual.expected_s
    assert slow.worst_s > usual.worst_s
