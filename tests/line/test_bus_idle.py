"""The pauses of a line: how long, and never for ever."""

from __future__ import annotations

from lecombus.fieldbus.lecom.exchanges.idle_receive import LONGEST_CHATTER_S, BusIdleTimer

GAP_S = 0.02


def test_after_an_exchange_the_turnaround_is_kept() -> None:
    bus_idle = BusIdleTimer(0.005)
    bus_idle.exchange_ended(10.0)
    assert bus_idle.free_at_s == 10.005
    assert bus_idle.is_over(10.0), "there is no quarantine"


def test_a_missing_answer_costs_its_quarantine_and_bytes_put_its_end_off() -> None:
    bus_idle = BusIdleTimer(0.0)
    bus_idle.answer_missing(10.0, 0.06)
    assert not bus_idle.is_over(10.05)
    bus_idle.heard(10.055, GAP_S, none_is_late=False)
    assert not bus_idle.is_over(10.07)
    assert bus_idle.is_over(10.076)


def test_the_late_answer_that_was_waited_for_ends_the_quarantine_early() -> None:
    bus_idle = BusIdleTimer(0.0)
    bus_idle.answer_missing(10.0, 0.5)
    bus_idle.heard(10.1, GAP_S, none_is_late=True)
    assert bus_idle.is_over(10.13)


def test_babble_without_a_pause_does_not_keep_the_line_for_ever() -> None:
    bus_idle = BusIdleTimer(0.0)
    now_s = 10.0
    while now_s < 10.0 + 2 * LONGEST_CHATTER_S:
        bus_idle.heard(now_s, GAP_S, none_is_late=False)
        now_s += 0.001
    assert bus_idle.is_over(now_s), "it never paused, so it was given its time once"


def test_babble_that_begins_anew_after_a_pause_is_given_its_time_anew() -> None:
    bus_idle = BusIdleTimer(0.0)
    bus_idle.heard(10.0, GAP_S, none_is_late=False)
    bus_idle.heard(20.0, GAP_S, none_is_late=False)
    assert not bus_idle.is_over(20.01)


def test_what_is_longer_than_any_answer_is_not_waited_for_but_once_in_a_while() -> None:
    bus_idle = BusIdleTimer(0.0)
    bus_idle.answer_missing(10.0, 0.06)
    bus_idle.heard(10.05, GAP_S, none_is_late=False)
    bus_idle.give_up(10.05)
    assert bus_idle.is_over(10.05)
    bus_idle.heard(10.051, GAP_S, none_is_late=False)
    assert bus_idle.is_over(10.051), "it goes on, and puts nothing off any more"
    bus_idle.answer_missing(10.1, 0.06)
    bus_idle.give_up(10.15)
    assert not bus_idle.is_over(10.15), "speaking did not end it"
