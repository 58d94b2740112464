"""A port that comes and goes: told at once, then in sums, and told when it stays."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.line.port_connection import (
    FEW,
    LONGEST_PAUSE_S,
    WHILE_S,
    FlapMessage,
    LinkFlapLimiter,
)


def test_what_happens_now_and_then_is_told_each_time() -> None:
    flap_limiter = LinkFlapLimiter()
    for turn in range(20):
        assert flap_limiter.lost(turn * WHILE_S) is FlapMessage.CHANGE
        assert flap_limiter.looked(turn * WHILE_S + 1.0) is FlapMessage.CHANGE
        assert flap_limiter.opened(turn * WHILE_S + 2.0) is FlapMessage.CHANGE
        assert flap_limiter.is_steady


def test_a_port_that_flaps_is_told_in_sums_at_growing_intervals_up_to_an_hour() -> None:
    flap_limiter, told, sums = LinkFlapLimiter(), [], []
    for turn in range(12 * 3600):
        told.append(flap_limiter.lost(turn + 0.0))
        if told[-1] is FlapMessage.SUM:
            sums.append((turn, flap_limiter.losses, flap_limiter.pause_s))
        told.append(flap_limiter.opened(turn + 0.5))
    assert told[:5] == [
        FlapMessage.CHANGE,
        FlapMessage.CHANGE,
        FlapMessage.CHANGE,
        FlapMessage.CHANGE,
        FlapMessage.SUM,
    ]
    assert sums[0] == (2, FEW, 60.0)
    assert [at_s for at_s, _, _ in sums[1:5]] == [62, 182, 422, 902]
    assert [losses for _, losses, _ in sums] == [at_s + 1 for at_s, _, _ in sums]
    assert sums[-1][2] == LONGEST_PAUSE_S
    assert len(sums) < 20
    assert told.count(FlapMessage.CHANGE) == 4


@pytest.mark.parametrize("ends_open", [True, False])
def test_it_is_told_when_the_port_stays_as_it_is(ends_open: bool) -> None:
    flap_limiter = LinkFlapLimiter()
    for turn in range(10):
        flap_limiter.lost(turn + 0.0)
        if turn < 9 or ends_open:
            flap_limiter.opened(turn + 0.5)
    assert flap_limiter.looked(60.0) in (FlapMessage.NOTHING, FlapMessage.SUM)
    assert flap_limiter.looked(80.0) is FlapMessage.STEADY
    assert (flap_limiter.losses, flap_limiter.is_steady) == (10, True)
    change = flap_limiter.lost if ends_open else flap_limiter.opened
    assert change(81.0) is FlapMessage.CHANGE


@given(st.lists(st.tuples(st.sampled_from("lok"), st.floats(0.0, 100.0)), max_size=200))
def test_whoever_reads_the_log_knows_the_state_or_that_it_is_unsteady(
    happened: list[tuple[str, float]],
) -> None:
    flap_limiter, now_s, is_open, told_open = LinkFlapLimiter(), 0.0, True, True
    for what, passed_s in happened:
        now_s += passed_s
        if (what == "l") is not is_open and what != "k":
            continue  # an open port is not opened, and a lost one is not lost
        act = {"l": flap_limiter.lost, "o": flap_limiter.opened, "k": flap_limiter.looked}[what]
        tell = act(now_s)
        is_open = is_open if what == "k" else what == "o"
        if tell in (FlapMessage.CHANGE, FlapMessage.STEADY):
            told_open = is_open
        assert told_open is is_open or not flap_limiter.is_steady
        if what == "k" and flap_limiter.is_steady:
            assert told_open is is_open
