"""A stop goes first, whatever happens, and nothing that moves survives it."""

from __future__ import annotations

from typing import Any

import pytest

from lecombus.schedule import Outcome, Priority, Request, Schedule
from lecombus.schedule.request import REPLACED, STOPPED
from lecombus.schedule.watchdog_deadline import HARD_PART
from schedule.world import WORST_S, World

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


@pytest.mark.parametrize(
    ("yields", "silent", "order"), [(False, False, "ab"), (True, False, "ba"), (False, True, "ba")]
)
def test_a_stop_that_only_repeats_what_is_shown_goes_first_once_it_stands_for_one_that_does_not(
    yields: bool, silent: bool, order: str
) -> None:
    """It gets the place that it came for; that of a drive which does not answer stays the last."""
    world = World().drives("a", "b")
    if silent:
        world.schedule.park("a", 0.0, "silent")
    repeats = world.submit("a", P.STOP, stops=("a",), yields=True)
    world.submit("b", P.STOP, stops=("b",))
    assert world.schedule.join(repeats, yields=yields)
    world.run(1.0)
    assert "".join(sent.request.drive for sent in world.sent) == order


def test_a_stop_that_stands_for_one_that_does_not_wait_goes_before_feeds() -> None:
    world = World().drives("a", "b")
    world.feed("b", 1.0)
    world.now_s = HARD_PART - WORST_S
    repeats = world.submit("a", P.STOP, stops=("a",), yields=True)
    assert not world.schedule.stop_goes(world.now_s)
    assert world.schedule.join(repeats)
    assert world.schedule.stop_goes(world.now_s)
    assert world.step() is repeats


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


# ---- writes that stop, and what was asked for before them ---------------------------------------


def said_in_vain(world: World, drive: str = "a", **more: Any) -> Request:
    """A write that was sent, not answered, and is to be said again in a second."""
    write = world.submit(drive, P.CONTROL, writes=True, **more)
    assert world.schedule.next(world.now_s) is write
    world.schedule.finished(write, world.now_s, world.now_s + WORST_S, reached=False)
    world.now_s += WORST_S
    world.schedule.again(write, world.now_s, world.now_s + 1.0)
    return write


def goes_out(world: World, drive: str = "a", **more: Any) -> Request:
    """A later write that goes out while the earlier one waits."""
    write = world.submit(drive, P.CONTROL, writes=True, **more)
    assert world.step() is write
    return write


def why_not(write: Request) -> str:
    return write.why_unwanted(writes=True)


@pytest.mark.parametrize("says", ["the same", "another", None])
@pytest.mark.parametrize(
    ("halts", "lifts_nothing"),
    [(False, False), (True, False), (True, True)],
    ids=["a setpoint", "a quick stop", "an inhibit"],
)
def test_a_write_that_stops_keeps_an_earlier_one_from_being_said_again_unless_it_lifts_nothing(
    halts: bool, lifts_nothing: bool, says: str | None
) -> None:
    """A lost setpoint, said again behind it, would let the drive run; a quick stop lift it."""
    world = World().drives("a")
    earlier = said_in_vain(world, says="the same", halts=halts, lifts_nothing=lifts_nothing)
    goes_out(world, says=says, halts=True)
    assert why_not(earlier) == ("" if lifts_nothing else STOPPED)
    assert earlier.why_unwanted(writes=False) == "", "what it did may still be read"


@pytest.mark.parametrize(
    ("earlier_says", "says", "why"),
    [("speed", "speed", REPLACED), ("speed", "ramp", ""), (None, None, "")],
)
def test_of_two_writes_of_the_same_the_earlier_is_not_said_again(
    earlier_says: str | None, says: str | None, why: str
) -> None:
    world = World().drives("a")
    earlier = said_in_vain(world, says=earlier_says)
    goes_out(world, says=says)
    assert why_not(earlier) == why


def test_the_first_reason_for_which_a_write_is_not_said_again_stays() -> None:
    world = World().drives("a")
    replaced = said_in_vain(world, says="speed")
    goes_out(world, says="speed")
    goes_out(world, says="stop", halts=True)
    assert why_not(replaced) == REPLACED
    world = World().drives("a")
    stopped = said_in_vain(world, says="speed")
    goes_out(world, says="stop", halts=True)
    goes_out(world, says="speed")
    assert why_not(stopped) == STOPPED


def test_a_write_asked_for_behind_the_one_that_stops_is_said_again() -> None:
    world = World().drives("a")
    stopping = world.submit("a", P.CONTROL, writes=True, says="stop", halts=True)
    assert world.schedule.next(0.0) is stopping
    later = world.submit("a", P.CONTROL, writes=True, says="stop")
    world.schedule.finished(stopping, 0.0, 0.02, reached=True)
    assert why_not(later) == ""


@pytest.mark.parametrize(
    ("may_move", "repeats", "halts", "goes_on"),
    [
        (True, False, True, False),
        (True, True, True, True),
        (False, False, True, True),
        (True, False, False, True),
    ],
    ids=["may move", "the stop is said again", "moves nothing", "no stop"],
)
def test_a_setting_that_waits_behind_a_write_that_stops_goes_on_where_it_cannot_lift_that(
    may_move: bool, repeats: bool, halts: bool, goes_on: bool
) -> None:
    world = World().drives("a")
    setting = world.submit("a", writes=True, says="source", may_move=may_move)
    goes_out(world, says="source", halts=halts, repeats=repeats)
    assert not setting.attempts
    assert why_not(setting) == ("" if goes_on else STOPPED)


@pytest.mark.parametrize(
    ("priority", "was_said", "why"),
    [(P.CONTROL, False, REPLACED), (P.INTERACTIVE, False, ""), (P.INTERACTIVE, True, REPLACED)],
)
def test_a_write_of_a_lower_class_that_was_never_said_waits_its_turn_and_was_not_overtaken(
    priority: Priority, was_said: bool, why: str
) -> None:
    world = World().drives("a")
    earlier = world.submit("a", priority, writes=True, says="speed")
    assert world.schedule.next(0.0) is earlier
    if was_said:
        world.schedule.finished(earlier, 0.0, 0.0, reached=False)
    world.schedule.defer(earlier, 1.0, 0.0)
    goes_out(world, says="speed")
    assert why_not(earlier) == why


@pytest.mark.parametrize(
    ("halts", "stops", "why"),
    [(False, False, ""), (False, True, STOPPED), (True, True, "")],
    ids=["moves, behind a write", "moves, behind a stop", "stops others, too"],
)
def test_a_multicast_is_said_to_its_other_members_unless_it_would_lift_a_stop_of_one(
    halts: bool, stops: bool, why: str
) -> None:
    world = World().drives("a", "b")
    shared = said_in_vain(world, "both", members=("a", "b"), says="speed", halts=halts)
    goes_out(world, "b", says="speed", halts=stops)
    assert why_not(shared) == why


def test_a_multicast_that_stops_overtakes_the_writes_to_each_of_its_members() -> None:
    world = World().drives("a", "b", "c")
    earlier = [said_in_vain(world, name, says="speed") for name in "abc"]
    goes_out(world, "both", members=("a", "b"), says="stop", halts=True)
    assert [why_not(one) for one in earlier] == [STOPPED, STOPPED, ""]
