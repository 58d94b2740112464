"""Whether a request may still be sent, and how it ends when it is cut off."""

from __future__ import annotations

from typing import Any

import pytest

from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.request import (
    CLIENT_GONE,
    LEASE_ENDED,
    OUTDATED,
    REPLACED,
    STOPPED,
)
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


def test_what_is_made_from_what_is_not_true_any_more_is_not_said_a_first_time() -> None:
    wanted = request(is_outdated=lambda: True)
    assert wanted.why_unwanted(writes=True) == OUTDATED
    assert wanted.why_unwanted(writes=False) == OUTDATED
    wanted.attempts = 1
    assert wanted.why_unwanted(writes=True) == "", "a telegram of it may have been received"
    assert request(is_outdated=lambda: False).why_unwanted(writes=True) == ""


@pytest.mark.parametrize("why", [STOPPED, REPLACED])
def test_an_overtaken_write_is_not_said_again_and_may_still_be_proven(why: str) -> None:
    wanted = request(is_gone=lambda: True)
    wanted.attempts = 1
    wanted.overtaken = why
    assert wanted.why_unwanted(writes=True) == why
    assert wanted.why_unwanted(writes=False) == ""


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
