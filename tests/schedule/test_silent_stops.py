"""Stops of drives that do not answer: what goes before them, and what does not."""

from __future__ import annotations

from itertools import pairwise

import pytest

from lecombus.schedule import Priority, Request
from lecombus.schedule.watchdog_deadline import HARD_PART, FaultHypothesis
from schedule.world import COST_S, WORST_S, World

P = Priority


def full_line(count: int = 20, time_s: float = 1.2) -> World:
    """A line on which feeding takes a good part, with somebody who wants all the rest."""
    world = World()
    for number in range(count):
        name = f"d{number}"
        world.drives(name)
        world.feed(name, time_s)
    world.drives("other")
    world.saturate(P.INTERACTIVE, ["other"])
    return world


def repeat(world: World, stop: Request, times: int, *, pause_s: float = 0.0) -> None:
    """Say a stop again until it was said so often."""
    earlier = world.after

    def after(request: Request, reached: bool) -> bool:
        if request is stop and stop.attempts < times:
            world.schedule.again(stop, world.now_s, world.now_s + pause_s)
            return True
        return earlier(request, reached) if earlier is not None else False

    world.after = after


def fired(world: World, *but: str) -> list[str]:
    feeds = world.schedule.stats(world.now_s).feeds
    return [name for name, feed in feeds.items() if feed.lapses and name not in but]


def test_the_first_telegram_waits_for_nothing_though_it_makes_feeds_late() -> None:
    world = full_line()
    world.run(5.0)
    world.silent = {"d3"}
    stop = world.submit("d3", P.STOP, worst_s=5.0)
    assert world.step() is stop


@pytest.mark.parametrize("known", [False, True])
def test_stopping_a_silent_drive_again_and_again_costs_nobody_a_watchdog(known: bool) -> None:
    world = full_line()
    world.run(5.0)
    world.silent = {"d3"}
    if known:
        world.schedule.park("d3", world.now_s, "silent")
    stop = world.submit("d3", P.STOP)
    repeat(world, stop, 40)
    world.run(20.0)
    assert stop.attempts == 40
    assert fired(world, "d3") == []


def test_without_the_slack_check_it_would_cost_watchdogs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lecombus.schedule.silent_stops.SilentStops.goes", lambda *_: True)
    world = full_line()
    world.run(5.0)
    world.silent = {"d3"}
    stop = world.submit("d3", P.STOP)
    repeat(world, stop, 40)
    world.run(20.0)
    assert fired(world, "d3")


def test_nothing_but_feeds_goes_before_a_repetition_and_no_more_than_one_for_every_drive() -> None:
    world = full_line()
    world.run(5.0)
    world.silent = {"d3"}
    world.submit("d5", P.CONTROL)
    stop = world.submit("d3", P.STOP)
    repeat(world, stop, 40)
    world.run(20.0)
    at = [number for number, sent in enumerate(world.sent) if sent.request is stop]
    assert len(at) == 40
    between = [world.sent[a + 1 : b] for a, b in pairwise(at)]
    assert {sent.request.priority for some in between for sent in some} == {P.WATCHDOG}
    assert max(len(some) for some in between) <= 20


def test_where_no_slack_is_ever_enough_it_goes_after_one_feed_of_every_drive() -> None:
    world = World().drives("a", "b", "c")
    world.feed("a", 0.2)
    world.feed("b", 0.2)
    world.run(1.0)
    world.silent = {"c"}
    stop = world.submit("c", P.STOP, worst_s=3.0)
    repeat(world, stop, 5)
    world.run(20.0)
    at = [number for number, sent in enumerate(world.sent) if sent.request is stop]
    assert len(at) == 5
    assert max(b - a - 1 for a, b in pairwise(at)) <= 2


def test_it_does_not_wait_longer_because_others_fail_to_answer_too() -> None:
    world = full_line()
    world.run(5.0)
    world.silent = {f"d{number}" for number in range(3, 20)}
    stop = world.submit("d3", P.STOP)
    repeat(world, stop, 20)
    world.run(15.0)
    at = [sent for sent in world.sent if sent.request is stop]
    waits = [b.at_s - a.end_s for a, b in pairwise(at)]
    assert len(waits) == 19
    assert max(waits) <= 20 * COST_S + 3 * WORST_S + WORST_S, "a round, and one drive that goes"


def test_stops_of_drives_that_answer_go_before_those_of_silent_ones() -> None:
    world = World().drives("a", "b", "c")
    world.schedule.park("a", 0.0, "silent")
    silent = world.submit("a", P.STOP)
    alive = world.submit("b", P.STOP)
    later = world.submit("c", P.STOP)
    assert [world.step(), world.step(), world.step()] == [alive, later, silent]


def test_a_stop_that_waits_goes_behind_the_others_when_its_drive_does_not_answer_another() -> None:
    world = World(silent={"a"}).drives("a", "b", "c")
    first, waits = world.submit("a", P.STOP), world.submit("a", P.STOP)
    others = [world.submit("b", P.STOP), world.submit("c", P.STOP)]
    world.run(1.0)
    assert [sent.request for sent in world.sent] == [first, *others, waits]


def test_a_drive_that_answers_again_has_its_stop_said_at_once() -> None:
    world = World().drives("a", "b")
    world.feed("b", 1.0, worst_s=0.3)
    world.run(0.85)
    world.schedule.park("a", world.now_s, "silent")
    stop = world.submit("a", P.STOP, worst_s=0.3)
    other = world.submit("b", P.STOP, worst_s=0.3)
    world.schedule.unpark("a", world.now_s)
    assert world.schedule.stop_goes(world.now_s)
    assert [world.step(), world.step()] == [stop, other]


def test_an_answer_to_anything_ends_the_silence_of_a_drive() -> None:
    world = World().drives("a")
    world.silent = {"a"}
    stop = world.submit("a", P.STOP)
    repeat(world, stop, 2, pause_s=1.0)
    world.step()
    assert "a" in world.schedule.silent
    world.silent = set()
    world.submit("a", P.INTERACTIVE)
    world.step()
    assert "a" not in world.schedule.silent


def test_living_drives_that_are_fed_too_late_are_spoken_to_between_stops_of_silent_ones() -> None:
    """The first telegrams to ten drives that just died cost others their watchdogs, but once."""
    world = full_line()
    world.run(5.0)
    dead = [f"d{number}" for number in range(10)]
    world.silent = set(dead)
    stops = [world.submit(name, P.STOP) for name in dead]
    for stop in stops:
        repeat(world, stop, 40)
    oldest_s = 0.0
    while world.now_s < 15.0:
        world.step()
        feeds = world.schedule.stats(world.now_s).feeds
        oldest_s = max(oldest_s, *(feeds[name].age_s for name in feeds if name not in dead))
    assert fired(world, *dead)
    assert all(feeds[name].lapses <= 1 for name in fired(world, *dead))
    assert oldest_s < 2.0
    assert min(stop.attempts for stop in stops) >= 5


def test_a_feed_of_a_drive_that_is_left_alone_is_waited_for() -> None:
    world = World().drives("a", "b")
    world.feed("b", 1.0)
    world.schedule.park("a", 0.0, "silent")
    world.now_s = HARD_PART - WORST_S
    world.schedule.hold("b", world.now_s + 0.05, world.now_s)
    stop = world.submit("a", P.STOP)
    started_s = world.now_s
    assert world.step() is None
    assert not world.schedule.stop_goes(world.now_s)
    assert world.schedule.wake_at_s(world.now_s) == pytest.approx(started_s + 0.05)
    world.run(2.0)
    first, second = world.sent[:2]
    assert (first.request.drive, second.request) == ("b", stop)
    assert second.at_s == pytest.approx(started_s + 0.05 + COST_S)


def test_a_lost_line_is_no_silence() -> None:
    world = World().drives("a", "b")
    world.schedule.park("b", 0.0, "silent")
    stop = world.submit("a", P.STOP)
    assert world.schedule.next(0.0) is stop
    world.schedule.finished(stop, 0.0, 0.1, reached=False)
    world.schedule.fail_all(0.1, "lost")
    assert world.schedule.silent == {"b"}


def test_a_multicast_is_no_drive_and_never_silent() -> None:
    world = World().drives("a", "b")
    shared = world.submit("all", P.STOP, stops=("a", "b"), members=("a", "b"))
    assert world.schedule.next(0.0) is shared
    world.schedule.finished(shared, 0.0, 0.1, reached=False)
    assert world.schedule.silent == set()


def test_the_feed_of_a_held_drive_is_not_waited_for_until_the_own_watchdog_acts() -> None:
    world = World().drives("a", "b")
    world.schedule.expect(FaultHypothesis(1))
    world.feed("a", 1.0)
    world.feed("b", 1.2)
    world.now_s = 0.3
    lose_one(world, "a", worst_s=0.4)
    world.schedule.hold("b", 1.03, world.now_s)
    world.run(2.0)
    assert world.sent[1].at_s == pytest.approx(0.7)
    assert fired(world) == []


@pytest.mark.parametrize("is_gone", [False, True])
def test_a_drive_that_missed_what_is_tolerated_is_stopped_before_its_watchdog_acts(
    is_gone: bool,
) -> None:
    world = World().drives("a", *(names := [f"d{number}" for number in range(20)]))
    world.schedule.expect(FaultHypothesis(1))
    world.feed("a", 1.0)
    for name in names:
        world.feed(name, 2.0)
    world.now_s = 0.1
    stop = lose_one(world, "a", worst_s=0.65)
    world.silent = {"a"} if is_gone else set()
    world.run(3.0)
    first, second, third = (at for at, sent in enumerate(world.sent) if sent.request is stop)
    assert world.sent[second].at_s <= HARD_PART * 1.0 - COST_S
    assert {sent.request.priority for sent in world.sent[first + 1 : second]} == {P.WATCHDOG}
    if is_gone:
        assert third > second + 1, "it missed more than is tolerated: feeds go before its stop"
    else:
        assert fired(world) == []


def lose_one(world: World, drive: str, worst_s: float) -> Request:
    """Say a stop to a drive that does not hear it; it is said again at once."""
    world.silent = {drive}
    stop = world.submit(drive, P.STOP, worst_s=worst_s)
    repeat(world, stop, 3)
    world.step()
    world.silent = set()
    return stop


def test_what_is_due_before_the_drive_that_is_stopped_goes_before_its_stop() -> None:
    world = World().drives("a", "b")
    world.schedule.expect(FaultHypothesis(1))
    world.feed("b", 1.0)
    world.now_s = 0.05
    world.feed("a", 1.0)
    world.now_s = 0.4
    lose_one(world, "a", worst_s=0.54)
    world.run(2.0)
    assert [sent.request.drive for sent in world.sent[1:3]] == ["b", "a"]
    assert fired(world) == []


def test_where_the_answered_stop_takes_too_long_for_others_the_feed_of_its_drive_goes() -> None:
    world = World().drives("a", *(names := [f"d{number}" for number in range(10)]))
    world.schedule.expect(FaultHypothesis(1, stop_s=0.3, stop_failed_s=0.53))
    world.now_s = 0.09
    world.feed("a", 1.0)
    for name in names:
        world.now_s += 0.01
        world.feed(name, 1.0)
    world.now_s = 0.3
    world.silent = {"a"}
    stop = world.submit("a", P.STOP, cost_s=0.25, worst_s=0.53)
    repeat(world, stop, 2)
    world.step()
    world.silent = set()
    world.run(3.0)
    first, second = (at for at, sent in enumerate(world.sent) if sent.request is stop)
    between = world.sent[first + 1 : second]
    assert {sent.request.priority for sent in between} == {P.WATCHDOG}
    assert [sent.request.drive for sent in between].count("a") == 1
    assert sorted(sent.request.drive for sent in between) == sorted(["a", *names])
    assert fired(world) == []
    assert "a" not in world.schedule.silent


def test_more_proof_of_a_stop_waits_for_feeds_though_its_drive_answers() -> None:
    world = World().drives("a", "b", "c")
    world.feed("b", 1.0)
    world.feed("c", 1.0)
    world.now_s = HARD_PART - WORST_S
    stop = world.submit("a", P.STOP)
    assert world.schedule.stop_goes(world.now_s)
    stop.yields = True
    assert not world.schedule.stop_goes(world.now_s)
    assert world.schedule.look_ahead(None, world.now_s, world.now_s) is None
    first, second, third = world.step(), world.step(), world.step()
    assert first is not None
    assert second is not None
    assert ({first.drive, second.drive}, third) == ({"b", "c"}, stop)


def test_more_proof_waits_for_no_more_room_than_feeds_can_make() -> None:
    names = [f"d{number}" for number in range(7)]
    world = World().drives("a", *names)
    world.schedule.expect(FaultHypothesis(1, stop_s=0.32, stop_failed_s=0.55))
    for name in names:
        world.feed(name, 1.0)
    stop = world.submit("a", P.STOP, yields=True, cost_s=0.07, worst_s=0.55)
    feeds = world.schedule.watchdogs
    assert stop.worst_s < feeds.most_s("a")[0] < feeds.need_s(stop)
    world.now_s = 0.05
    assert world.step() is stop, "feeds would make no more room than there is"
    again = world.submit("a", P.STOP, yields=True, cost_s=0.07, worst_s=0.55)
    world.now_s = 0.5
    world.run(2.0)
    between = [sent.request for sent in world.sent[1:]]
    assert 0 < between.index(again) <= len(names), "the feeds that make room, and no more"


def test_a_stop_that_came_later_goes_before_more_proof_and_before_feeds() -> None:
    world = World().drives("a", "b", "c")
    world.feed("b", 1.0)
    world.feed("c", 1.0)
    first = world.submit("a", P.STOP)

    def wants_proof(request: Request, _answered: bool) -> bool:
        if request is not first or first.attempts > 1:
            return False
        request.yields = True
        world.schedule.again(request, world.now_s, world.now_s, behind=True)
        return True

    world.after = wants_proof
    world.now_s = HARD_PART - WORST_S
    assert world.step() is first
    later = world.submit("b", P.STOP)
    assert world.schedule.stop_goes(world.now_s)
    assert world.step() is later


LONG_STOP = FaultHypothesis(3, stop_s=0.28, stop_failed_s=0.53)  # of an 820X


def lose(world: World, drives: list[str], until_s: float) -> None:
    """Lose the answers of the next exchanges with these drives, one each in this order."""
    while world.now_s < until_s:
        world.silent = set(drives[:1])
        count = len(world.sent)
        if world.step() is None:
            wake_s = world.schedule.wake_at_s(world.now_s)
            world.now_s = min(until_s, until_s if wake_s is None else wake_s)
        elif len(world.sent) > count and not world.sent[-1].reached:
            drives = drives[1:]
    world.silent = set()


@pytest.mark.parametrize("first", [["a"], ["b"], ["a", "b"], ["b", "a"], ["a", "a"]])
@pytest.mark.parametrize("after_ms", range(0, 900, 20))
def test_a_stop_lost_in_the_pause_after_lost_answers_makes_no_watchdog_act(
    first: list[str], after_ms: int
) -> None:
    world = World().drives("a", "b")
    world.schedule.expect(LONG_STOP)
    world.feed("a", 1.05)
    world.feed("b", 1.05)
    lose(world, [], 2.0)
    lose(world, first, at_s := 2.0 + after_ms / 1000)
    world.run(at_s)
    world.silent = {"a"}
    stop = world.submit("a", P.STOP, cost_s=0.25, worst_s=0.53)
    repeat(world, stop, 2)
    while not stop.attempts:
        world.step()
    world.silent = set()
    world.run(6.0)
    assert fired(world) == []


def test_a_stop_whose_lost_answer_others_do_not_outlast_does_not_go_before_them_a_third_time() -> (
    None
):
    """To keep its drive's own watchdog it would go, and answered it would not be too long."""
    world = World().drives("a", "b", "c")
    world.schedule.expect(LONG_STOP)
    world.feed("a", 1.06)
    world.now_s = 0.34
    world.feed("b", 1.06)
    world.feed("c", 1.06)
    world.now_s = 0.4
    world.silent = {"a"}
    stop = world.submit("a", P.STOP, cost_s=0.06, worst_s=0.1)
    repeat(world, stop, 4)
    assert world.step() is stop
    stop.worst_s = 0.53
    assert world.step() is stop
    assert world.now_s + COST_S > HARD_PART * 1.06, "its own feed is late already"
    for _ in range(10):
        world.step()
        if not world.sent[-1].reached:
            world.silent = set()
    assert stop.attempts == 4
    assert fired(world, "a") == []


@pytest.mark.parametrize("tolerate", [2, 3])
@pytest.mark.parametrize("time_s", [1.25, 1.5, 2.0])
def test_a_stop_lost_behind_a_long_write_that_was_lost_makes_no_watchdog_act(
    tolerate: int, time_s: float
) -> None:
    world = World().drives("a", "b", "c")
    world.schedule.expect(FaultHypothesis(tolerate, stop_s=0.296, stop_failed_s=0.544))
    world.feed("c", time_s, cost_s=0.05, worst_s=0.18)
    write = world.request("b", P.CONTROL, cost_s=0.25, worst_s=0.544)
    need_s = world.schedule.watchdogs.need_s(write)
    world.now_s = HARD_PART * time_s - 0.05 - need_s - 1e-6
    world.schedule.submit(write, world.now_s)
    world.silent = {"a", "b"}
    assert world.step() is write, "at the last moment at which there is room"
    stop = world.submit("a", P.STOP, cost_s=0.25, worst_s=0.544)
    assert world.step() is stop
    world.run(world.now_s + 1.0)
    assert fired(world) == []


@pytest.mark.parametrize("lost", [["b"], ["b", "b"], ["c"], ["c", "c"], ["b", "c"]])
@pytest.mark.parametrize("after_ms", range(0, 300, 30))
def test_a_stop_that_was_lost_does_not_go_again_before_a_late_drive_whose_watchdog_can_be_kept(
    lost: list[str], after_ms: int
) -> None:
    world = World().drives("a", "b", "c", "d")
    world.schedule.expect(LONG_STOP)
    for name in ("a", "b", "c", "d"):
        world.feed(name, 1.136, cost_s=0.05, worst_s=0.158)
    world.saturate(P.INTERACTIVE, ["a", "b", "c", "d"], cost_s=0.04, worst_s=0.145)
    world.run(2.0 + after_ms / 1000)
    world.silent = {"a"}
    stop = world.submit("a", P.STOP, cost_s=0.235, worst_s=0.535)
    repeat(world, stop, 2)
    world.step()
    lose(world, lost, world.now_s + 1.5)
    assert fired(world) == []


def test_the_own_feed_in_place_of_a_stop_goes_behind_a_late_drive_that_would_not_outlast_it() -> (
    None
):
    world = World().drives("a", "b", "c")
    world.schedule.expect(FaultHypothesis(1, stop_s=0.24, stop_failed_s=0.53))
    world.feed("a", 1.4, cost_s=0.04)
    world.now_s = 0.1
    world.feed("b", 1.4, cost_s=0.07)
    world.now_s = 0.84
    for _ in range(2):
        world.submit("c", P.STOP, cost_s=0.255, worst_s=0.53)
    world.submit("b", P.STOP, cost_s=0.04, yields=True)
    world.run(1.9)
    assert sum(feed.lapses for feed in world.schedule.stats(world.now_s).feeds.values()) == 0


def test_a_drive_whose_watchdog_can_be_kept_goes_before_one_whose_watchdog_has_acted() -> None:
    world = World().drives("lapsed", "kept", "s", "c")
    world.feed("lapsed", 1.0, cost_s=0.06)
    world.now_s = 0.2
    world.feed("kept", 1.0, cost_s=0.04)
    world.now_s = 0.6
    for _ in range(2):
        world.submit("c", P.STOP, cost_s=0.2775, worst_s=0.2775)
    world.submit("s", P.STOP, cost_s=0.04, yields=True)
    world.run(1.6)
    feeds = world.schedule.stats(world.now_s).feeds
    assert (feeds["lapsed"].lapses, feeds["kept"].lapses) == (1, 0)
