"""Priority, order, superseding, expiry, limits."""

from __future__ import annotations

import pytest

from lecombus.errors import QueueFullError
from lecombus.schedule import Outcome, Priority, Request, Schedule
from schedule.world import World

P = Priority


def _order(world: World) -> list[Request]:
    found = []
    while (request := world.step()) is not None:
        found.append(request)
    return found


def test_classes_go_strictly_by_priority() -> None:
    world = World().drives("a")
    classes = [P.BACKGROUND, P.CYCLIC, P.INTERACTIVE, P.WATCHDOG, P.CONTROL, P.STOP]
    requests = [world.submit("a", priority) for priority in classes]
    assert _order(world) == requests[::-1]


def test_a_class_is_served_first_come_first_served_across_drives() -> None:
    world = World().drives("a", "b")
    requests = [world.submit("ab"[number * 7 % 3 % 2]) for number in range(20)]
    assert _order(world) == requests


def test_what_comes_back_goes_ahead_of_its_class_but_not_of_higher_ones() -> None:
    world = World().drives("a", "b")
    first, other = world.submit("a"), world.submit("b")
    chosen = world.schedule.next(0.0)
    assert chosen is first
    world.schedule.finished(first, 0.0, 0.1, False)
    world.schedule.again(first, 0.1)
    control = world.submit("b", P.CONTROL)
    assert _order(world) == [control, first, other]


def test_a_step_with_a_time_lets_others_go_meanwhile() -> None:
    world = World().drives("a", "b")
    first, other = world.submit("a"), world.submit("b")
    world.schedule.next(0.0)
    world.schedule.finished(first, 0.0, 0.1, True)
    world.now_s = 0.1
    world.schedule.again(first, 0.1, not_before_s=0.5)
    assert _order(world) == [other]
    assert world.schedule.wake_at_s(world.now_s) == 0.5
    world.run(1.0)
    assert world.sent[-1].request is first
    assert world.sent[-1].at_s == 0.5


def test_a_deferred_request_keeps_its_place() -> None:
    world = World().drives("a", "b")
    first = world.submit("a")
    assert world.schedule.next(0.0) is first
    world.schedule.defer(first, 0.5, 0.0)
    later = world.submit("b")
    world.now_s = 0.5
    assert _order(world) == [first, later]


def test_a_later_request_takes_the_place_of_a_waiting_one() -> None:
    world = World().drives("a", "b")
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    other = world.submit("b", P.CONTROL)
    new = world.submit("a", P.CONTROL, supersedes="setpoint")
    assert world.outcome(old)[0] is Outcome.SUPERSEDED
    assert _order(world) == [new, other]
    assert world.schedule.stats(1.0).superseded[P.CONTROL] == 1


def test_a_stream_of_setpoints_does_not_queue_itself_to_the_back() -> None:
    world = World().drives("a", "b")
    world.saturate(P.CONTROL, ["b"])
    for number in range(100):
        at_s = number * 0.01
        world.at(at_s, lambda: world.submit("a", P.CONTROL, supersedes="setpoint"))
    world.run(1.0)
    assert len(world.starts(lambda request: request.drive == "a")) >= 8


def test_what_is_under_way_is_not_superseded_and_both_run_in_order() -> None:
    world = World().drives("a")
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    assert world.schedule.next(0.0) is old
    new = world.submit("a", P.CONTROL, supersedes="setpoint")
    assert not old.settled
    world.schedule.finished(old, 0.0, 0.1, True)
    old.end(Outcome.DONE)
    assert _order(world) == [new]


def test_a_repeat_of_a_superseded_write_is_not_sent_and_its_outcome_is_unknown() -> None:
    world = World().drives("a")
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    world.schedule.next(0.0)
    new = world.submit("a", P.CONTROL, supersedes="setpoint")
    world.schedule.finished(old, 0.0, 0.1, False)
    world.schedule.again(old, 0.1)
    assert world.outcome(old)[0] is Outcome.UNKNOWN  # it has been sent once
    assert _order(world) == [new]


def test_a_deferred_write_that_was_never_sent_is_superseded() -> None:
    world = World().drives("a")
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    world.schedule.next(0.0)
    world.schedule.defer(old, 1.0, 0.0)
    new = world.submit("a", P.CONTROL, supersedes="setpoint")
    assert world.outcome(old)[0] is Outcome.SUPERSEDED
    world.run(2.0)
    assert [sent.request for sent in world.sent] == [new]


def test_an_acknowledged_write_cut_off_before_its_check_keeps_the_outcome_the_line_gave() -> None:
    world = World().drives("a")
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    world.schedule.next(0.0)
    old.cut_outcome = Outcome.DONE
    world.schedule.finished(old, 0.0, 0.1, True)
    world.schedule.again(old, 0.1, not_before_s=0.5)
    world.submit("a", P.CONTROL, supersedes="setpoint")
    assert world.outcome(old)[0] is Outcome.DONE


def test_a_superseding_request_of_another_class_counts_in_its_own() -> None:
    world = World().drives("a")
    old = world.submit("a", P.INTERACTIVE, supersedes="x")
    new = world.submit("a", P.CONTROL, supersedes="x")
    depth = world.schedule.stats(0.0).depth
    assert (depth[P.INTERACTIVE], depth[P.CONTROL]) == (0, 1)
    assert world.outcome(old)[0] is Outcome.SUPERSEDED
    assert _order(world) == [new]


def test_expired_requests_end_promptly_and_are_never_sent() -> None:
    world = World().drives("a")
    world.schedule.hold("a", 10.0, 0.0)
    late = world.submit("a", P.CONTROL, expires_at_s=0.25)
    kept = world.submit("a", P.CONTROL, expires_at_s=20.0)
    assert world.step() is None
    assert world.schedule.wake_at_s(0.0) == 0.25
    world.run(11.0)
    assert next((r, o, at) for r, o, _, at in world.ended) == (late, Outcome.EXPIRED, 0.25)
    assert [sent.request for sent in world.sent] == [kept]


def test_what_has_begun_does_not_expire_between_its_steps() -> None:
    world = World().drives("a")
    request = world.submit("a", P.CONTROL, expires_at_s=0.05)
    world.schedule.next(0.0)
    world.schedule.finished(request, 0.0, 0.1, False)
    world.schedule.again(request, 0.1, not_before_s=0.2)
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [request]
    assert world.outcome(request)[0] is Outcome.DONE


def test_a_hundred_thousand_expired_requests_do_not_block_and_all_end() -> None:
    world = World(Schedule(limits={P.BACKGROUND: 200_000})).drives("a", "b")
    for _ in range(100_000):
        world.submit("a", P.BACKGROUND, expires_at_s=1.0)
    world.now_s = 1.0
    reading = world.submit("b", P.INTERACTIVE)
    assert world.step() is reading
    assert len(world.ended) <= 300  # a batch, and the reading
    world.run(2.0)
    assert sum(outcome is Outcome.EXPIRED for _, outcome, _, _ in world.ended) == 100_000
    assert len(world.sent) == 1
    assert world.schedule.stats(2.0).depth[P.BACKGROUND] == 0


@pytest.mark.parametrize(
    ("priority", "limit"),
    [(P.CONTROL, 1000), (P.INTERACTIVE, 2000), (P.BACKGROUND, 10000)],
)
def test_a_full_class_refuses_with_figures(priority: Priority, limit: int) -> None:
    world = World().drives("a")
    for _ in range(limit):
        world.submit("a", priority)
    refused = world.request("a", priority)
    with pytest.raises(QueueFullError) as caught:
        world.schedule.submit(refused, 0.0)
    assert (caught.value.depth, caught.value.limit) == (limit, limit)
    assert not refused.settled
    assert world.schedule.stats(0.0).refused[priority] == 1
    world.step()
    world.submit("a", priority)  # there is room again


def test_limits_can_be_set_and_superseding_needs_no_room() -> None:
    world = World(Schedule(limits={P.CONTROL: 1})).drives("a")
    old = world.submit("a", P.CONTROL, supersedes="x")
    new = world.submit("a", P.CONTROL, supersedes="x")
    assert old.settled
    with pytest.raises(QueueFullError):
        world.submit("a", P.CONTROL)
    assert _order(world) == [new]


def test_a_withdrawn_request_is_not_sent() -> None:
    world = World().drives("a")
    request = world.submit("a")
    assert world.schedule.withdraw(request, Outcome.REFUSED, "the caller left")
    assert world.step() is None
    assert not world.schedule.withdraw(request, Outcome.REFUSED, "again")


def test_a_request_cannot_come_back_while_it_waits() -> None:
    world = World().drives("a")
    request = world.submit("a")
    with pytest.raises(AssertionError, match="waits already"):
        world.schedule.again(request, 0.0)
