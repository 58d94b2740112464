"""Drives that come and go, and how what is known of their watchdogs outlasts that."""

from __future__ import annotations

import pytest

from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.watchdog_deadline import WatchdogDeadline
from schedule.world import World

P = Priority


def fed_for(seconds: float = 10.0) -> World:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    return world.run(seconds)


def taken_out(world: World) -> WatchdogDeadline:
    left = world.schedule.remove_drive("a", world.now_s, "not in the roster any more")
    assert left is not None
    world.schedule.add_drive("a")
    return left


def watchdog(world: World) -> WatchdogDeadline:
    return world.schedule.watchdogs.by_drive["a"]


def test_a_drive_that_is_back_keeps_count_and_deadline() -> None:
    world = fed_for()
    fed, hard_s = watchdog(world).fed, watchdog(world).hard_s
    left = taken_out(world)
    world.feed("a", 1.0)
    world.schedule.resume_feeding("a", left, is_same=True)
    assert fed > 5
    assert (watchdog(world).fed, watchdog(world).hard_s) == (fed, hard_s)


@pytest.mark.parametrize(("time_s", "counted_s"), [(5.0, 1.0), (0.5, 0.5)])
def test_a_longer_time_does_not_count_before_it_is_set_in_the_drive(
    time_s: float, counted_s: float
) -> None:
    world = fed_for()
    left = taken_out(world)
    world.feed("a", time_s)
    world.schedule.resume_feeding("a", left, is_same=True)
    assert watchdog(world).time_s == counted_s


def test_after_a_pause_the_new_time_counts_from_now() -> None:
    world = fed_for()
    world.schedule.park("a", world.now_s, "silent")
    world.now_s = 50.0
    left = taken_out(world)
    world.feed("a", 5.0)
    world.schedule.resume_feeding("a", left, is_same=True)
    assert (watchdog(world).time_s, watchdog(world).fed_at_s) == (5.0, 50.0)


def test_another_drive_at_its_place_takes_the_counts_and_no_deadline() -> None:
    world = fed_for()
    fed = watchdog(world).fed
    left = taken_out(world)
    world.now_s = 50.0
    world.feed("a", 2.0)
    world.schedule.resume_feeding("a", left, is_same=False)
    assert (watchdog(world).fed, watchdog(world).fed_at_s) == (fed, 50.0)


def test_counts_wait_for_a_drive_that_is_not_fed_yet() -> None:
    world = fed_for()
    fed = watchdog(world).fed
    left = taken_out(world)
    world.schedule.resume_feeding("a", left, is_same=True)
    assert world.schedule.watchdogs.by_drive == {}
    world.feed("a", 1.0)
    assert watchdog(world).fed == fed


def test_a_group_that_was_changed_has_its_writes_refused_and_its_stop_sent() -> None:
    """At a reload: the name of the group means other drives now."""
    world = World().drives("a", "b")
    assert world.submit("a") is world.schedule.next(0.0)
    to_group = world.submit("both", P.CONTROL, writes=True, members=("a", "b"))
    put_off = world.request("both", P.INTERACTIVE, writes=True, members=("a", "b"))
    world.schedule.again(put_off, 0.0, 1.0)
    to_other = world.submit("all", P.CONTROL, writes=True, members=("a", "b"))
    alone = world.submit("a", P.CONTROL, writes=True)
    stop = world.submit("both", P.STOP, members=("a", "b"))
    world.schedule.refuse_group("both", "the group both was changed")
    for refused in (to_group, put_off):
        assert world.outcome(refused) == (Outcome.REFUSED, "the group both was changed")
    world.run(2.0)
    assert [sent.request for sent in world.sent] == [stop, to_other, alone]


def test_a_write_to_a_group_of_which_a_drive_is_taken_out_ends_with_the_reason() -> None:
    world = World().drives("a", "b", "c")
    to_group = world.submit("both", P.CONTROL, writes=True, members=("a", "b"))
    to_others = world.submit("others", P.CONTROL, writes=True, members=("b", "c"))
    world.schedule.remove_drive("a", 0.0, "not in the roster any more")
    assert world.outcome(to_group) == (Outcome.REFUSED, "not in the roster any more")
    assert world.step() is to_others


def test_a_telegram_to_a_group_that_was_chosen_beforehand_is_not_sent_when_it_was_changed() -> None:
    world = World().drives("a", "b")
    to_group = world.submit("both", P.CONTROL, writes=True, members=("a", "b"))
    assert world.schedule.look_ahead(None, 0.0, 0.0) is to_group
    world.schedule.refuse_group("both", "the group both was changed")
    assert world.schedule.planned(0.0) is None
    assert world.step() is None


@pytest.mark.parametrize("is_back", [False, True])
def test_what_is_under_way_to_a_drive_that_is_taken_out_ends_behind_its_telegram(
    is_back: bool,
) -> None:
    """A drive of the same name may be another device."""
    world = World().drives("a")
    reading, writing = world.submit("a"), world.submit("a", writes=True)
    taken_up = [world.schedule.next(0.0)]
    world.schedule.finished(reading, 0.0, 0.02, reached=False)
    taken_up.append(world.schedule.next(0.02))
    assert taken_up == [reading, writing]
    world.schedule.remove_drive("a", 0.03, "gone")
    if is_back:
        world.schedule.add_drive("a")
    world.schedule.finished(writing, 0.02, 0.04, reached=False)
    world.schedule.again(reading, 0.04)
    world.schedule.again(writing, 0.04)
    assert world.outcome(reading) == (Outcome.REFUSED, "a was taken out of the roster")
    outcome, reason = world.outcome(writing)
    assert outcome is Outcome.UNKNOWN, "it may have been received"
    assert reason.startswith("a was taken out of the roster; ")
    world.now_s = 0.04
    assert world.step() is None


def test_a_drive_that_was_never_fed_leaves_nothing() -> None:
    world = World().drives("a")
    assert world.schedule.remove_drive("a", 0.0, "gone") is None


@pytest.mark.parametrize("longer", [True, False])
def test_measured_times_change_what_a_feed_is_reckoned_to_take(longer: bool) -> None:
    costs = [(0.02, 0.1)]

    def make() -> Request:
        return world.request("a", P.WATCHDOG, *costs[-1])

    world = fed_for()
    watchdog(world).feeding = type(watchdog(world).feeding)(1.0, make)
    if longer:
        costs.append((0.03, 0.2))
    world.schedule.costs_changed("a")
    assert (watchdog(world).cost_s, watchdog(world).worst_s) == costs[-1]


def test_measured_times_of_a_drive_that_is_not_fed_change_nothing() -> None:
    world = fed_for()
    world.schedule.costs_changed("b")
    assert list(world.schedule.watchdogs.by_drive) == ["a"]


def test_a_drive_that_is_parked_is_asked_nothing_cyclic_until_it_is_back() -> None:
    world = World().drives("a")
    world.schedule.park("a", 0.0, "silent")
    world.cyclic("a", 0.5)
    assert world.run(3.0).sent == []
    world.schedule.unpark("a", 3.0)
    world.run(4.1)
    assert [sent.at_s for sent in world.sent] == pytest.approx([3.0, 3.5, 4.0])


def test_a_drive_that_was_not_parked_joins_no_cycle_twice() -> None:
    world = World().drives("a")
    entry = world.cyclic("a", 0.5)
    world.schedule.polling.join(entry)
    world.run(1.1)
    assert len(world.sent) == 3


def test_a_probe_set_for_a_parked_drive_begins_and_its_replacement_goes_on() -> None:
    world = World(silent={"a"}).drives("a")
    world.schedule.park("a", 0.0, "silent")
    world.probe("a")
    world.run(20.0)
    before = len(world.sent)
    assert before > 1
    world.probe("a")
    world.run(100.0)
    assert len(world.sent) > before


def test_a_hold_of_a_drive_that_has_left_is_nothing() -> None:
    world = World().drives("a")
    world.schedule.hold("b", 5.0, 0.0)
    world.submit("a")
    assert world.step() is not None


def test_what_can_be_seen_of_it() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 0.5)
    world.schedule.hold("a", 1.0, 0.0)
    stop = world.submit("b", P.STOP)
    assert world.schedule.is_held("a")
    assert not world.schedule.is_held("b")
    assert world.schedule.stops() == [stop]
    assert list(world.schedule.polling.by_drive) == ["a"]


def test_a_stop_of_a_drive_that_has_left_goes_out_all_the_same() -> None:
    world = World().drives("a")
    stop = world.submit("group", P.STOP, stops=("a", "gone"), members=("a", "gone"))
    assert world.step() is stop
    assert world.outcome(stop)[0] is Outcome.DONE
