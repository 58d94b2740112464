"""A port that comes and goes: told at once, then in sums, and told when it stays."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.line.steadiness import FEW, LONGEST_PAUSE_S, WHILE_S, Steadiness, Tell


def test_what_happens_now_and_then_is_told_each_time() -> None:
    steadiness = Steadiness()
    for turn in range(20):
        assert steadiness.lost(turn * WHILE_S) is Tell.CHANGE
        assert steadiness.looked(turn * WHILE_S + 1.0) is Tell.CHANGE
        assert steadiness.opened(turn * WHILE_S + 2.0) is Tell.CHANGE
        assert steadiness.is_steady


def test_a_port_that_flaps_is_told_in_sums_at_growing_intervals_up_to_an_hour() -> None:
    steadiness, told, sums = Steadiness(), [], []
    for turn in range(12 * 3600):
        told.append(steadiness.lost(turn + 0.0))
        if told[-1] is Tell.SUM:
            sums.append((turn, steadiness.losses, steadiness.pause_s))
        told.append(steadiness.opened(turn + 0.5))
    assert told[:5] == [Tell.CHANGE, Tell.CHANGE, Tell.CHANGE, Tell.CHANGE, Tell.SUM]
    assert sums[0] == (2, FEW, 60.0)
    assert [at_s for at_s, _, _ in sums[1:5]] == [62, 182, 422, 902]
    assert [losses for _, losses, _ in sums] == [at_s + 1 for at_s, _, _ in sums]
    assert sums[-1][2] == LONGEST_PAUSE_S
    assert len(sums) < 20
    assert told.count(Tell.CHANGE) == 4


@pytest.mark.parametrize("ends_open", [True, False])
def test_it_is_told_when_the_port_stays_as_it_is(ends_open: bool) -> None:
    steadiness = Steadiness()
    for turn in range(10):
        steadiness.lost(turn + 0.0)
        if turn < 9 or ends_open:
            steadiness.opened(turn + 0.5)
    assert steadiness.looked(60.0) in (Tell.NOTHING, Tell.SUM)
    assert steadiness.looked(80.0) is Tell.STEADY
    assert (steadiness.losses, steadiness.is_steady) == (10, True)
    change = steadiness.lost if ends_open else steadiness.opened
    assert change(81.0) is Tell.CHANGE


@given(st.lists(st.tuples(st.sampled_from("lok"), st.floats(0.0, 100.0)), max_size=200))
def test_whoever_reads_the_log_knows_the_state_or_that_it_is_unsteady(
    happened: list[tuple[str, float]],
) -> None:
    steadiness, now_s, is_open, told_open = Steadiness(), 0.0, True, True
    for what, passed_s in happened:
        now_s += passed_s
        if (what == "l") is not is_open and what != "k":
            continue  # an open port is not opened, and a lost one is not lost
        act = {"l": steadiness.lost, "o": steadiness.opened, "k": steadiness.looked}[what]
        tell = act(now_s)
        is_open = is_open if what == "k" else what == "o"
        if tell in (Tell.CHANGE, Tell.STEADY):
            told_open = is_open
        assert told_open is is_open or not steadiness.is_steady
        if what == "k" and steadiness.is_steady:
            assert told_open is is_open
