"""The order of a fan-out: never worse than any other order, tried by brute force."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement, permutations

import pytest

from lecombus.drives import family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code, Value
from lecombus.schedule.fan_out import Part, least_order, took_s

SETPOINT, OTHER = Code(46), Code(11)
LONGEST = 5
"""Members of the largest groups tried: 5 kinds in every mixture, every order of each."""


def ordered_s(parts: Sequence[Part]) -> float:
    return took_s(parts[index] for index in least_order(parts))


def least_s(parts: Sequence[Part]) -> float:
    return min(took_s(order) for order in set(permutations(parts)))


def kinds_of(code: Code, baud: int) -> list[Part]:
    """What a write of a code takes of every family, its response time shortened and not."""
    maker = LecomRequestMaker(LineTiming(baud), 2, lambda priority, outcome: None)
    parts = []
    for name in ("820x", "822x", "93xx"):
        kind = family(name)
        for early in (False, True) if name != "93xx" else (False,):
            hold_s = kind.hold_after_write_s if early else 0.0
            station = Station("x", 1, kind, kind.forms, hold_s=hold_s, answers_early=early)
            parts.append(maker.part_of_write(station, code, Value.parse("12.5")))
    return parts


@pytest.mark.parametrize("code", [SETPOINT, OTHER], ids=str)
@pytest.mark.parametrize("baud", [1200, 9600, 19200])
def test_no_order_of_a_small_group_ends_sooner(code: Code, baud: int) -> None:
    kinds = kinds_of(code, baud)
    for members in range(1, LONGEST + 1):
        for parts in combinations_with_replacement(kinds, members):
            assert ordered_s(parts) == pytest.approx(least_s(parts), abs=1e-5), parts


def test_the_longest_wait_begins_first() -> None:
    parts = [Part(0.03, 0.0, 0.04), Part(0.03, 0.23, 0.06), Part(0.03, 0.05, 0.04)]
    assert least_order(parts) == [1, 2, 0]


def test_a_short_wait_goes_first_where_its_proof_fills_a_gap() -> None:
    slow, quick = Part(0.0975, 0.23, 0.16), Part(0.0825, 0.05, 0.145)
    parts = [slow, slow, quick]
    by_tails_s = took_s([slow, slow, quick])
    assert ordered_s(parts) == pytest.approx(least_s(parts))
    assert ordered_s(parts) < by_tails_s


def test_proofs_go_ahead_of_writes_as_soon_as_their_drives_may_be_spoken_to() -> None:
    a, b = Part(1.0, 1.0, 0.5), Part(1.0, 0.0, 0.5)
    # a 0..1, b 1..2, proofs of both at 2
    assert took_s([a, b]) == pytest.approx(3.0)
    # b 0..1, its proof 1..1.5, a 1.5..2.5, its proof at 3.5
    assert took_s([b, a]) == pytest.approx(4.0)


def test_members_not_read_back_and_equal_ones_keep_their_order() -> None:
    parts = [Part(0.03, 0.05, 0.04)] * 3
    assert least_order(parts) == [0, 1, 2]
    assert least_order([]) == []
    assert took_s([Part(0.03, 5.0, 0.0)] * 2) == pytest.approx(0.06)


def test_a_large_group_of_slow_drives_takes_line_time_and_not_their_waits() -> None:
    parts = [Part(0.03, 0.23, 0.06)] * 90
    assert ordered_s(parts) < sum(one.say_s + one.prove_s for one in parts) + 0.23
