"""Holds, parked drives, a lost line."""

from __future__ import annotations

import sys

import pytest

from lecombus.schedule import Outcome, Priority
from schedule.world import World

P = Priority


def test_a_held_drive_waits_and_others_go_on() -> None:
    world = World().drives("a", "b")
    world.schedule.hold("a", 0.23, 0.0)
    waiting = world.submit("a", P.CONTROL)
    other = world.submit("b", P.BACKGROUND)
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [other, waiting]
    assert world.sent[1].at_s == pytest.approx(0.23)


def test_a_hold_can_be_prolonged_but_not_shortened() -> None:
    world = World().drives("a")
    world.schedule.hold("a", 0.5, 0.0)
    world.schedule.hold("a", 0.9, 0.1)
    world.schedule.hold("a", 0.2, 0.1)
    world.submit("a")
    world.run(2.0)
    assert world.sent[0].at_s == pytest.approx(0.9)


def test_what_was_held_comes_back_to_its_place() -> None:
    world = World().drives("a", "b")
    world.schedule.hold("a", 0.5, 0.0)
    first = world.submit("a")
    world.step()
    rest = [world.submit("b"), world.submit("a"), world.submit("b")]
    world.now_s = 0.5
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [first, *rest]


def test_a_multicast_waits_while_any_member_is_held() -> None:
    world = World().drives("a", "b", "c")
    world.schedule.hold("b", 0.5, 0.0)
    group = world.submit("group", P.CONTROL, members=("a", "b"))
    other = world.submit("group", P.CONTROL, members=("a", "b"))
    free = world.submit("c")
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [free, group, other]


def test_held_lanes_cost_the_same_however_long() -> None:
    world = World().drives("a", "b")
    for _ in range(5000):
        world.submit("a", P.BACKGROUND)
    last = world.submit("b", P.BACKGROUND)
    world.schedule.hold("a", 1.0, 0.0)
    calls = 0

    def counted(*_: object) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(counted)
    try:
        assert world.step() is last
    finally:
        sys.setprofile(None)
    assert calls < 1000, "one lane is moved, not 5000 requests"


def test_parking_refuses_what_waits_but_stops_and_other_drives() -> None:
    world = World().drives("a", "b")
    gone = [world.submit("a", priority) for priority in (P.CONTROL, P.INTERACTIVE, P.BACKGROUND)]
    deferred = world.submit("a", P.CONTROL)
    stop, other = world.submit("a", P.STOP), world.submit("b")
    world.schedule.withdraw(gone.pop(), Outcome.REFUSED, "x")
    assert world.step() is stop
    assert world.schedule.next(world.now_s) is gone[0]
    world.schedule.defer(gone[0], 5.0, world.now_s)
    world.schedule.park("a", world.now_s, "no answer for 10 s")
    for request in [*gone, deferred]:
        assert world.outcome(request) == (Outcome.REFUSED, "no answer for 10 s")
    assert world.step() is other
    assert all(depth == 0 for depth in world.schedule.stats(1.0).depth.values())


def test_a_parked_drive_takes_nothing_but_stops() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.cyclic("a", 0.1)
    world.schedule.park("a", 0.0, "silent")
    world.schedule.park("a", 0.0, "still silent")
    late = world.submit("a")
    assert world.outcome(late) == (Outcome.REFUSED, "still silent")
    world.run(5.0)
    assert world.sent == []
    assert world.schedule.stats(5.0).feeds["a"].paused
    stop = world.submit("a", P.STOP)
    assert world.step() is stop


def test_a_repeat_for_a_drive_parked_meanwhile_is_refused() -> None:
    world = World().drives("a")
    reading = world.submit("a")
    world.schedule.next(0.0)
    world.schedule.park("a", 0.05, "silent")
    world.schedule.finished(reading, 0.0, 0.1, False)
    world.schedule.again(reading, 0.1)
    assert world.outcome(reading) == (Outcome.REFUSED, "silent")


def test_feeding_resumes_from_the_return() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.schedule.park("a", 0.2, "silent")
    world.now_s = 50.0
    world.schedule.unpark("a", 50.0)
    world.schedule.unpark("a", 50.0)
    world.run(50.9)
    # 1 s from then: over by 50.9, with three vain attempts of 0.1 s before that.
    assert [sent.at_s for sent in world.sent] == [pytest.approx(50.6, abs=0.0201)]
    feed = world.schedule.stats(50.9).feeds["a"]
    assert (feed.misses, feed.lapses) == (0, 1), "it ran out while the drive was parked"


def test_a_lost_line_refuses_all_and_keeps_cycles_and_feeding() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.cyclic("b", 0.5)
    world.schedule.hold("b", 100.0, 0.0)
    waiting = [world.submit("a"), world.submit("b", P.CONTROL), world.submit("a", P.STOP)]
    later = world.submit("a", P.CONTROL)
    assert world.schedule.next(0.0) is waiting[2]
    world.schedule.defer(waiting[2], 9.0, 0.0)
    assert world.schedule.next(0.0) is later
    world.schedule.defer(later, 9.0, 0.0)
    world.schedule.fail_all(0.1, "the line is lost")
    for request in [*waiting, later]:
        assert world.outcome(request) == (Outcome.REFUSED, "the line is lost")
    world.now_s = 0.1
    world.run(3.0)
    assert {sent.request.drive for sent in world.sent} == {"a", "b"}
    assert world.schedule.stats(3.0).stretch == 1.0


def test_a_write_that_may_have_happened_is_not_called_refused() -> None:
    world = World().drives("a")
    write = world.submit("a", P.CONTROL, writes=True)
    world.schedule.next(0.0)
    world.schedule.finished(write, 0.0, 0.1, False)
    world.schedule.again(write, 0.1, not_before_s=1.0)
    world.schedule.fail_all(0.2, "the line is lost")
    reason = "the line is lost; it was sent before, and not proven"
    assert world.outcome(write) == (Outcome.UNKNOWN, reason)


def test_a_removed_drive_leaves_nothing_behind() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.cyclic("a", 0.1)
    world.probe("a")
    waiting = world.submit("a")
    world.schedule.hold("a", 1.0, 0.0)
    world.schedule.remove_drive("a", 0.0, "not in the roster any more")
    assert world.outcome(waiting)[0] is Outcome.REFUSED
    world.run(5.0)
    assert world.sent == []
    world.schedule.add_drive("a")
    assert world.submit("a") is world.step()


def test_a_settle_callback_may_submit() -> None:
    world = World().drives("a")
    first = world.submit("a", expires_at_s=1.0)
    inner = first.settle

    def settle(outcome: Outcome, reason: str) -> None:
        inner(outcome, reason)
        world.submit("a", P.CONTROL)

    first.settle = settle
    world.now_s = 2.0
    request = world.step()
    assert request is not None
    assert request.priority is P.CONTROL
