"""The demand bound and the response time, against what a count by hand gives."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.capacity.demand_bound import Stream, find_overload, load_of, response_s

MS = 0.001


def streams_of(*pairs: tuple[int, int]) -> list[Stream]:
    """Streams of (cost, period) in ms."""
    return [
        Stream(f"s{number}", cost * MS, every * MS) for number, (cost, every) in enumerate(pairs)
    ]


def overloads_by_hand(pairs: list[tuple[int, int]], blocking: int, until: int) -> bool:
    """Whether some stretch of whole milliseconds must hold more than it is long."""
    for t in range(1, until + 1):
        ends = any(t % every == 0 for _, every in pairs)
        demand = sum(t // every * cost for cost, every in pairs)
        later = max((cost for cost, every in pairs if every > t), default=0)
        if ends and demand + max(blocking, later) > t:
            return True
    return False


def test_two_feeds_of_39_ms_do_not_fit_into_45() -> None:
    found = find_overload(streams_of((39, 45), (39, 45)), 0.0)
    assert found is not None
    assert found.within_s == pytest.approx(0.045)
    assert found.demand_s == pytest.approx(0.078)
    assert found.whose in {"s0", "s1"}


def test_a_long_piece_with_a_late_deadline_is_in_the_way_of_a_short_one() -> None:
    assert find_overload(streams_of((1, 10), (9, 1000)), 0.0) is None
    found = find_overload(streams_of((1, 10), (10, 1000)), 0.0)
    assert found is not None
    assert found.whose == "s0"
    assert found.blocking_s == pytest.approx(0.010)


def test_what_fits_alone_does_not_fit_behind_a_longer_exchange() -> None:
    streams = streams_of((10, 100))
    assert find_overload(streams, 0.090) is None
    assert find_overload(streams, 0.091) is not None


def test_a_little_too_much_in_the_long_run_is_found() -> None:
    streams = streams_of((34, 100), (34, 100), (34, 100))
    assert load_of(streams) == pytest.approx(1.02)
    assert find_overload(streams, 0.0) is not None


def test_nothing_fits_anywhere() -> None:
    assert find_overload([], 5.0) is None


@given(
    st.lists(st.tuples(st.integers(1, 8), st.integers(2, 40)), min_size=1, max_size=4),
    st.integers(0, 12),
)
def test_it_finds_what_a_count_by_hand_finds(pairs: list[tuple[int, int]], blocking: int) -> None:
    if sum(cost / every for cost, every in pairs) > 0.97:
        return  # the count by hand would have no end
    by_hand = overloads_by_hand(pairs, blocking, 3000)
    assert (find_overload(streams_of(*pairs), blocking * MS) is not None) is by_hand


def test_the_wait_counts_what_is_under_way_and_all_that_comes_meanwhile() -> None:
    above = streams_of((10, 50), (5, 30))
    # 20 under way; then 10 + 5, and within those 35 ms another 5: 40 ms, 20 own.
    assert response_s(0.020, 0.020, above) == pytest.approx(0.060)


def test_no_bound_where_what_goes_first_takes_all() -> None:
    assert response_s(0.001, 0.0, streams_of((10, 10))) == math.inf


@given(
    st.lists(st.tuples(st.integers(1, 6), st.integers(10, 60)), max_size=3),
    st.integers(0, 20),
    st.integers(1, 10),
)
def test_no_run_by_priority_waits_longer(
    pairs: list[tuple[int, int]], blocking: int, own: int
) -> None:
    """Everything comes at the worst moment: just after the blocking exchange began."""
    bound = response_s(own * MS, blocking * MS, streams_of(*pairs))
    if math.isinf(bound):
        return
    clock, waiting = blocking, [(cost, every, 0) for cost, every in pairs]
    while True:
        ready = [entry for entry in waiting if entry[2] <= clock]
        if not ready:
            break
        cost, every, due = ready[0]
        waiting[waiting.index(ready[0])] = (cost, every, due + every)
        clock += cost
    assert (clock + own) * MS <= bound + 1e-9
