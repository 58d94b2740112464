"""A stop goes first, whatever happens, and nothing that moves survives it."""

from __future__ import annotations

from lecombus.schedule import Outcome, Priority, Schedule
from lecombus.schedule.request import STOPPED
from schedule.world import World

P = Priority


def test_a_stop_goes_even_to_held_and_parked_drives() -> None:
    world = World().drives("a", "b")
    world.schedule.hold("a", 5.0, 0.0)
    world.schedule.park("b", 0.0, "silent")
    stops = [world.submit("a", P.STOP), world.submit("b", P.STOP)]
    assert [world.step(), world.step()] == stops


def test_whether_a_stop_goes_is_said_of_the_one_that_comes_back_at_this_moment() -> None:
    # The line breaks a quarantine for a stop, so that no feed may come of it instead.
    world = World().drives("a")
    stop = world.submit("a", P.STOP)
    assert world.schedule.next(0.0) is stop
    world.schedule.defer(stop, 1.0, 0.0)
    assert not world.schedule.stop_goes(0.9)
    assert world.schedule.stop_goes(1.0)
    assert world.schedule.next(1.0) is stop


def test_a_stop_goes_before_feeds_that_are_late() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.now_s = 3.0
    stop = world.submit("a", P.STOP, worst_s=50.0)
    assert world.step() is stop


def test_a_stop_ends_the_waiting_motion_of_the_drives_it_stops_only() -> None:
    world = World().drives("a", "b")
    moving = world.submit("a", P.CONTROL, writes=True)
    plain = world.submit("a", P.CONTROL)
    other = world.submit("b", P.CONTROL, writes=True)
    held_back = world.submit("a", P.INTERACTIVE, writes=True)
    stop = world.submit("a", P.STOP, stops=("a",))
    assert world.outcome(moving) == (Outcome.SUPERSEDED, STOPPED)
    assert world.outcome(held_back) == (Outcome.SUPERSEDED, STOPPED)
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [stop, plain, other]


def test_a_stop_ends_deferred_motion() -> None:
    world = World().drives("a")
    moving = world.submit("a", P.CONTROL, writes=True)
    world.schedule.next(0.0)
    world.schedule.defer(moving, 1.0, 0.0)
    stop = world.submit("a", P.STOP, stops=("a",))
    assert world.outcome(moving) == (Outcome.SUPERSEDED, STOPPED)
    assert [sent.request for sent in world.run(2.0).sent] == [stop]


def test_a_stop_of_one_member_ends_the_multicast_that_would_move_it() -> None:
    world = World().drives("a", "b")
    moving = world.submit("both", P.CONTROL, writes=True, members=("a", "b"))
    world.submit("b", P.STOP, stops=("b",))
    assert world.outcome(moving) == (Outcome.SUPERSEDED, STOPPED)
    assert world.schedule.stats(0.0).depth[P.CONTROL] == 0


def test_motion_under_way_when_a_stop_comes_is_never_repeated() -> None:
    world = World().drives("a")
    moving = world.submit("a", P.CONTROL, writes=True)
    assert world.schedule.next(0.0) is moving
    stop = world.submit("a", P.STOP, stops=("a",))
    world.schedule.finished(moving, 0.0, 0.1, False)
    world.schedule.again(moving, 0.1)
    # It was on the line once, so "never sent" would be untrue.
    reason = f"{STOPPED}; it was sent before, and not proven"
    assert world.outcome(moving) == (Outcome.UNKNOWN, reason)
    assert [sent.request for sent in world.run(1.0).sent] == [stop]


def test_motion_chosen_but_not_sent_when_a_stop_comes_ends_as_never_sent() -> None:
    world = World().drives("a")
    moving = world.submit("a", P.CONTROL, writes=True)
    world.schedule.next(0.0)
    world.submit("a", P.STOP, stops=("a",))
    world.schedule.defer(moving, 0.0, 0.0)
    assert world.outcome(moving) == (Outcome.SUPERSEDED, STOPPED)


def test_motion_asked_for_after_the_stop_is_sent_and_may_be_repeated() -> None:
    world = World().drives("a")
    stop = world.submit("a", P.STOP, stops=("a",))
    world.step()
    moving = world.submit("a", P.CONTROL, writes=True)
    assert world.schedule.next(world.now_s) is moving
    world.schedule.finished(moving, 0.1, 0.2, False)
    world.schedule.again(moving, 0.2)
    assert not moving.settled
    world.now_s = 0.2
    assert world.step() is moving
    assert stop.settled


def test_stops_are_neither_superseded_nor_limited_nor_expired() -> None:
    world = World(Schedule(limits={P.STOP: 1})).drives("a")
    for _ in range(3000):
        world.submit("a", P.STOP, supersedes="stop", stops=("a",), expires_at_s=0.0, writes=True)
    world.run(100.0)
    assert len(world.sent) == 3000
    assert {outcome for _, outcome, _, _ in world.ended} == {Outcome.DONE}


def test_the_next_step_of_a_stop_goes_before_all_else_and_outlives_other_stops() -> None:
    world = World().drives("a")
    steps = []

    def after(request: object, _reached: bool) -> bool:
        steps.append(request)
        if request is stop and len(steps) < 3:
            world.schedule.again(stop, world.now_s)
            return True
        return False

    world.after = after
    world.submit("a", P.CONTROL)
    stop = world.submit("a", P.STOP, stops=("a",))
    other = world.submit("a", P.STOP, stops=("a",))
    world.run(1.0)
    assert steps[:4] == [stop, stop, stop, other]


def test_a_stop_that_was_said_is_proven_after_the_others_are_said() -> None:
    world = World().drives("a", "b", "c")
    stops = [world.submit(name, P.STOP) for name in "abc"]
    first = world.schedule.next(0.0)
    assert first is stops[0]
    world.schedule.finished(first, 0.0, 0.02, True)
    world.schedule.again(first, 0.02, behind=True)
    order = [world.schedule.next(0.02 * (n + 1)) for n in range(3)]
    assert order == [stops[1], stops[2], stops[0]]


def test_a_setpoint_for_one_drive_is_not_overtaken_by_a_multicast_that_came_before_it() -> None:
    world = World().drives("a", "b")
    world.submit("b", P.CONTROL)
    old = world.submit("a", P.CONTROL, supersedes="setpoint")
    to_all = world.submit("all", P.CONTROL, members=("a", "b"))
    newer = world.submit("a", P.CONTROL, supersedes="setpoint")
    newest = world.submit("a", P.CONTROL, supersedes="setpoint")
    assert world.outcome(old)[0] is world.outcome(newer)[0] is Outcome.SUPERSEDED
    world.run(1.0)
    assert [sent.request for sent in world.sent][-2:] == [to_all, newest]


def test_a_stop_that_waits_stands_for_a_later_one_and_ends_the_motion_that_came_between() -> None:
    world = World().drives("a")
    stop = world.submit("a", P.STOP, stops=("a",))
    moving = world.submit("a", P.CONTROL, writes=True)
    assert world.schedule.join(stop)
    assert world.outcome(moving) == (Outcome.SUPERSEDED, STOPPED)
    assert world.step() is stop
    assert not world.schedule.join(stop), "it was said: the later one must be said too"


def test_a_drive_is_spoken_to_while_its_stop_waits_and_while_it_is_under_way() -> None:
    world = World().drives("a", "b")
    assert not world.schedule.is_speaking_to("a")
    world.submit("a", P.STOP)
    assert world.schedule.is_speaking_to("a")
    during: list[bool] = []
    world.at(0.001, lambda: during.append(world.schedule.is_speaking_to("a")))
    world.step()
    assert during == [True]
    assert not world.schedule.is_speaking_to("a")
    world.submit("b", P.CONTROL)
    assert not world.schedule.is_speaking_to("b"), "what is not a stop may wait until it expires"


def test_the_members_of_a_group_are_spoken_to_while_its_stop_waits_or_is_under_way() -> None:
    world = World().drives("a", "b", "c")
    stop = world.submit("all", P.STOP, members=("a", "b"))
    assert list(map(world.schedule.is_speaking_to, "abc")) == [True, True, False], "it waits"
    during: list[bool] = []
    world.at(0.001, lambda: during.extend(map(world.schedule.is_speaking_to, "abc")))
    assert world.step() is stop
    assert during == [True, True, False]
    assert not any(map(world.schedule.is_speaking_to, "abc"))
