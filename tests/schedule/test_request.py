"""Whether a request may still be sent, and how it ends when it is cut off."""

from __future__ import annotations

from typing import Any

import pytest

from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.request import CLIENT_GONE, LEASE_ENDED
from schedule.world import World


def request(**more: Any) -> Request:
    return World().request("a", Priority.CONTROL, **more)


@pytest.mark.parametrize(
    ("outcome", "good"),
    [(outcome, outcome in (Outcome.DONE, Outcome.VERIFIED)) for outcome in Outcome],
)
def test_only_done_and_verified_are_good(outcome: Outcome, good: bool) -> None:
    assert outcome.is_good is good


def test_a_client_that_left_is_looked_for_before_the_first_telegram_only() -> None:
    wanted = request(is_gone=lambda: True)
    assert wanted.why_unwanted(writes=True) == CLIENT_GONE
    wanted.attempts = 1
    assert wanted.why_unwanted(writes=True) == ""
    assert request(is_gone=lambda: False).why_unwanted(writes=True) == ""
    assert request().why_unwanted(writes=True) == ""


@pytest.mark.parametrize("attempts", [0, 1])
def test_a_lease_that_ended_keeps_writes_back_and_no_proof(attempts: int) -> None:
    wanted = request(lease_ended=lambda: True)
    wanted.attempts = attempts
    assert wanted.why_unwanted(writes=True) == LEASE_ENDED
    assert wanted.why_unwanted(writes=False) == ""
    assert request(lease_ended=lambda: False).why_unwanted(writes=True) == ""


def test_time_outs_are_shortened_to_what_the_manual_allows_and_no_further() -> None:
    wanted = request(worst_s=0.9, documented=(0.02, 0.3))
    wanted.shorten(1.0)
    assert (wanted.worst_s, wanted.cut_by_s) == (0.9, 0.0)
    wanted.shorten(0.5)
    assert (wanted.worst_s, wanted.cut_by_s) == pytest.approx((0.5, 0.4))
    wanted.shorten(0.1)
    assert (wanted.worst_s, wanted.cut_by_s) == pytest.approx((0.3, 0.6))
    plain = request(worst_s=0.9)
    plain.shorten(0.1)
    assert plain.worst_s == 0.9
