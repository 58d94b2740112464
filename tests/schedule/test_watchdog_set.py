"""Watchdogs are fed in time, whatever else is wanted of the line."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import pairwise
from random import Random

import pytest

from lecombus.schedule import Outcome, Priority, Request, Schedule
from lecombus.schedule.watchdog_deadline import (
    HARD_PART,
    FaultHypothesis,
    WatchdogDeadline,
    WatchdogFeeding,
)
from lecombus.schedule.watchdog_set import WatchdogSet
from schedule.world import COST_S, WORST_S, World

P = Priority


# A vain attempt takes 0.1 s in this world (WORST_S), an answered exchange 0.02 s (COST_S).


def test_a_feed_runs_while_three_vain_attempts_still_fit_before_its_deadline() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.run(5.0)
    # To be over at 1.8 s; 0.02 s of it is the feed itself, and 0.3 s three vain attempts.
    assert world.starts(lambda r: r.priority is P.WATCHDOG) == pytest.approx(
        [1.5, 3.0, 4.5], abs=0.0201 * 3
    )
    assert world.schedule.stats(5.0).feeds["a"].margin_least_s == pytest.approx(0.5, abs=0.0201)


def test_a_short_watchdog_does_not_take_the_whole_line() -> None:
    world = World().drives("a")
    world.feed("a", 0.5)
    world.run(1.1)
    # Three vain attempts before 0.45 s would begin at 0.13 s. The best slack is 0.45 s less the
    # exchange that feeds less the next one, 0.41 s: half of it is kept, from 0.43 s backwards.
    assert world.starts(lambda r: True) == pytest.approx([0.225, 0.45, 0.675, 0.9], abs=0.001)


def test_any_answered_exchange_feeds() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.cyclic("a", 0.5)
    world.run(10.0)
    assert {sent.request.priority for sent in world.sent} == {P.CYCLIC}


def test_an_unanswered_exchange_and_a_multicast_do_not_feed() -> None:
    world = World().drives("a", "b")
    world.feed("a", 2.0)
    world.feed("b", 2.0)
    world.at(1.3, lambda: world.submit("both", P.CONTROL, members=("a", "b")))
    world.silent.add("b")
    world.at(1.3, lambda: world.submit("b", P.CONTROL))
    world.run(1.6)
    stats = world.schedule.stats(1.6)
    assert stats.feeds["a"].age_s == pytest.approx(0.1, abs=0.1)
    assert stats.feeds["a"].margin_last_s == pytest.approx(0.5, abs=0.1)  # by its own feed
    assert stats.feeds["b"].fed == 0


def test_due_feeds_go_by_deadline_and_above_interactive_below_control() -> None:
    world = World().drives("a", "b")
    world.feed("a", 3.8)  # over by 3.42 s, due at 3.12 s
    world.feed("b", 3.7)  # over by 3.33 s, due at 3.03 s
    world.now_s = 3.19  # so late that feeds and interactive do not take turns
    control = world.submit("c", P.CONTROL)
    reading = world.submit("c")
    order = [world.step() for _ in range(4)]
    assert (order[0], order[3]) == (control, reading)
    assert [request.drive for request in order[1:3] if request] == ["b", "a"]


def test_urgent_feeds_and_interactive_take_turns_while_there_is_slack() -> None:
    world = World().drives(*(names := [f"d{number}" for number in range(10)]), "x")
    for name in names:
        world.feed(name, 2.0)
    world.saturate(P.INTERACTIVE, ["x"])
    # Slack at t: 1.8 - 10 * 0.02 - t. It is less than the spare of 0.3 s from 1.3 s on, and a
    # pair of a feed and a read takes 0.02 s of it: five pairs bring it to 0.2 s, two thirds.
    world.run(1.46)
    kinds = [sent.request.drive == "x" for sent in world.sent if sent.at_s > 1.29]
    first = kinds.index(False)
    assert kinds[first : first + 8] == [False, True] * 4
    world.run(20.0)
    assert sum(feed.misses for feed in world.schedule.stats(20.0).feeds.values()) == 0


def test_with_little_slack_left_feeds_no_longer_take_turns() -> None:
    world = World().drives(*(names := [f"d{number}" for number in range(10)]), "x")
    for name in names:
        world.feed(name, 2.0)
    for _ in range(20):
        world.submit("x")
    world.now_s = 1.45  # a slack of 0.15 s: half the spare
    order = [world.step() for _ in range(10)]
    assert "x" not in [request.drive for request in order if request]


def test_interactive_goes_before_feeds_that_can_still_wait() -> None:
    world = World().drives("a", "x")
    world.feed("a", 2.0)
    world.now_s = 1.3
    reading = world.submit("x")
    assert world.step() is reading
    assert world.step() is None


def test_an_idle_line_is_woken_so_early_that_all_drives_have_their_turn() -> None:
    world = World().drives(*(names := [f"d{number}" for number in range(30)]))
    for name in names:
        world.feed(name, 2.0)
    world.run(60.0)
    assert sum(feed.misses for feed in world.schedule.stats(60.0).feeds.values()) == 0
    # 1.8 s less thirty feeds of 0.02 s less the spare of 0.3 s.
    assert world.sent[0].at_s == pytest.approx(0.9, abs=0.021)


def test_a_cyclic_slot_that_feeds_soon_goes_before_one_that_does_not() -> None:
    world = World().drives("a", "b")
    world.feed("a", 2.0)
    world.cyclic("b", 0.5)
    world.cyclic("a", 5.0)
    world.run(0.1)  # both have had their first slot
    world.now_s = 1.25  # due at 1.48 s at the latest, and the next slot of a is at 5 s
    first, second = world.step(), world.step()
    assert first is not None
    assert second is not None
    assert (first.drive, second.drive) == ("a", "b")
    assert first.priority is P.CYCLIC


def test_a_slot_does_not_stand_back_for_feeding_ones_for_ever() -> None:
    world = World().drives("late", *(names := [f"d{number}" for number in range(30)]))
    for name in names:
        world.feed(name, 2.0)
        world.cyclic(name, 0.4)
    world.cyclic("late", 0.4)
    world.run(30.0)
    starts = world.starts(lambda r: r.drive == "late" and r.priority is P.CYCLIC)
    assert max(b - a for a, b in pairwise(starts)) < 4.0


def test_a_failed_feed_is_tried_again_at_once_when_time_is_short() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.silent.add("a")
    world.run(2.0)
    # Begun with three attempts of 0.1 s left until 1.8 s, the pause between them at least
    # 0.02 s; and once more before the watchdog fires at 2.0 s.
    tries = world.starts(lambda r: True)
    assert tries[:3] == pytest.approx([1.48, 1.6, 1.72], abs=0.03)
    assert len(tries) >= 4


@pytest.mark.parametrize("at_s", [1.0, 1.75])
def test_a_long_exchange_does_not_stake_the_drives_own_watchdog(at_s: float) -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    long = world.submit("a", worst_s=0.9)
    world.now_s = at_s  # not answered it would end at 1.9 s and later, and the feed after it
    feed, then = world.step(), world.step()
    assert feed is not None
    assert (feed.priority, then) == (P.WATCHDOG, long)


def test_a_drive_late_by_one_lost_answer_is_asked_again_at_once() -> None:
    world = World().drives("a")
    world.feed("a", 0.5)
    world.silent.add("a")
    world.now_s = 0.45
    world.step()
    world.silent.clear()
    world.run(0.7)
    assert world.sent[1].at_s == pytest.approx(0.55)  # when the vain attempt has ended


@pytest.mark.parametrize("tolerate", range(4))
def test_a_drive_that_lost_no_more_than_is_tolerated_is_asked_again_without_a_pause(
    tolerate: int,
) -> None:
    feed = WatchdogDeadline("a", WatchdogFeeding(1.0, World().request), 0.0)
    for lost in range(1, 5):
        now_s = 0.9 + 0.005 * lost  # late, and its watchdog has not run out
        feed.failed(now_s, tolerate)
        pauses = feed.retry_at_s > now_s + 0.001
        assert pauses is (lost > max(1, tolerate)), lost


def test_a_drive_made_late_by_its_own_lost_answer_is_fed_before_a_setpoint_goes() -> None:
    world = World().drives("a", "b")
    world.feed("a", 0.5)
    world.silent.add("a")
    world.now_s = 0.36  # over at 0.46 s, past nine tenths; the watchdog acts at 0.5 s
    world.step()
    world.silent.clear()
    setpoint = world.submit("b", P.CONTROL)
    again, then = world.step(), world.step()
    assert again is not None
    assert (again.drive, then) == ("a", setpoint)


def test_what_one_lost_answer_makes_late_is_fed_before_its_watchdog_fires() -> None:
    world = World().drives(*(names := [f"d{number}" for number in range(10)]))
    for name in names:
        world.feed(name, 2.0)
    world.now_s = 1.59  # ten feeds of 0.02 s just fit before 1.8 s, but the first is not answered
    world.silent.add("d0")
    world.step()
    world.silent.clear()
    world.run(2.0)
    stats = world.schedule.stats(2.0).feeds.values()
    assert sum(feed.lapses for feed in stats) == 0
    assert sum(feed.misses for feed in stats) > 0


def test_a_drive_made_late_by_a_stop_is_fed_before_one_that_has_its_last_tenth_yet() -> None:
    world = World().drives("a", "b", "c")
    world.feed("a", 1.0, cost_s=0.05)
    world.now_s = 0.1
    world.feed("b", 1.0, cost_s=0.05)
    world.now_s = 0.7
    world.submit("c", P.STOP, cost_s=0.24, worst_s=0.24)
    world.submit("c", P.CONTROL)
    world.run(1.3)
    stats = world.schedule.stats(world.now_s).feeds.values()
    assert [sent.request.drive for sent in world.sent[1:3]] == ["a", "b"]
    assert sum(feed.lapses for feed in stats) == 0


def test_a_drive_made_late_by_a_stop_is_fed_before_the_own_feed_of_a_longer_exchange() -> None:
    """Seed 330723 of the proof: a setpoint to another drive had that one's feed go first."""
    world = World().drives("a", "b", "c")
    world.feed("a", 1.0, cost_s=0.04)
    world.now_s = 0.08
    world.feed("b", 1.0, cost_s=0.04)
    world.now_s = 0.69
    world.submit("c", P.STOP, cost_s=0.24, worst_s=0.24)
    world.submit("b", P.CONTROL, cost_s=0.04, worst_s=0.11)
    world.run(1.3)
    stats = world.schedule.stats(world.now_s).feeds.values()
    assert [sent.request.drive for sent in world.sent[:4]] == ["c", "a", "b", "b"]
    assert sum(feed.lapses for feed in stats) == 0


def test_a_slot_is_not_run_early_before_a_drive_that_a_stop_made_late() -> None:
    world = World().drives("a", "b", "c", "d")
    world.feed("a", 1.0, cost_s=0.04)
    world.feed("b", 0.9, cost_s=0.04)
    world.cyclic("c", 0.4, cost_s=0.04)
    world.cyclic("d", 0.5, cost_s=0.06)
    world.now_s = 0.4
    world.feed("d", 0.9, cost_s=0.06)
    world.run(0.51)
    for takes_s in (0.24, 0.17):  # b was fed last: then it is the turn of the slots
        world.submit("c", P.STOP, cost_s=takes_s, worst_s=takes_s)
    world.run(1.3)
    stats = world.schedule.stats(world.now_s).feeds.values()
    assert sum(feed.lapses for feed in stats) == 0


def test_each_step_of_a_request_lets_drives_that_are_late_go_first() -> None:
    world = World().drives("a", "c", "d")
    world.feed("a", 1.0, cost_s=0.04)
    request = world.request("d", P.CONTROL, cost_s=0.08)
    fed, steps = world.schedule.watchdogs.by_drive["a"], 0

    def after(done: Request, _reached: bool) -> bool:
        nonlocal steps
        if done is not request or (steps := steps + 1) == 10:
            return False
        world.schedule.again(done, world.now_s, fed.fed_at_s + 0.75)
        world.at(fed.fed_at_s + 0.2, lambda: world.submit("c", cost_s=0.02))
        world.at(fed.fed_at_s + 0.5, lambda: _stop_until(world, "c", fed.fed_at_s + 0.94))
        return True

    world.after = after
    world.now_s = 0.7
    _stop_until(world, "c", 0.94)
    world.schedule.submit(request, world.now_s)
    world.run(15.0)
    feed = world.schedule.stats(world.now_s).feeds["a"]
    assert (steps, feed.misses, feed.lapses) == (10, 10, 0), "late each time, and in time"


def test_a_late_drive_that_may_be_gone_goes_behind_the_own_feed_of_an_exchange() -> None:
    world = World().drives("gone", "b")
    world.feed("gone", 1.0, cost_s=0.04, worst_s=0.16)
    world.now_s = 0.05
    world.feed("b", 1.0, cost_s=0.04, worst_s=0.16)
    world.silent.add("gone")
    world.now_s = 0.9
    world.schedule.watchdogs.by_drive["gone"].failed(world.now_s)
    world.submit("b", P.CONTROL, cost_s=0.04, worst_s=0.17)
    world.run(1.6)
    assert [sent.request.drive for sent in world.sent[:2]] == ["b", "gone"]
    assert world.schedule.stats(world.now_s).feeds["b"].lapses == 0


def test_a_drive_that_is_late_is_asked_again_without_a_pause_after_its_first_lost_answer() -> None:
    """Else an exchange begins before the pause ends, and lasts until the watchdog has acted."""
    feed = WatchdogDeadline("a", WatchdogFeeding(3.0, World().request), 0.0)
    feed.failed(2.73)
    assert feed.free_s() <= 2.73
    feed.failed(2.83)
    assert 2.83 < feed.free_s() < feed.acts_s


@pytest.mark.parametrize("until_s", [0.93, 0.955, 0.985])
def test_a_feed_that_begins_before_the_watchdog_acts_keeps_it(until_s: float) -> None:
    """Also where less than a feed is left, and whether a setpoint waits or more proof of a stop."""
    for yields in (True, False):
        world = World().drives("a", "b", "c", "s")
        world.feed("a", 1.0, cost_s=0.05)
        world.now_s = 0.1
        world.feed("b", 1.0, cost_s=0.05)
        world.now_s = 0.7
        _stop_until(world, "c", until_s)
        world.submit("s", P.STOP if yields else P.CONTROL, cost_s=0.04, yields=yields)
        world.run(1.5)
        assert [sent.request.drive for sent in world.sent[1:3]] == ["a", "b"]
        feeds = world.schedule.stats(world.now_s).feeds.values()
        assert sum(feed.lapses for feed in feeds) == 0


def test_of_two_late_drives_the_one_whose_watchdog_acts_first_is_fed_first() -> None:
    world = World().drives("long", "short", "c")
    world.feed("long", 3.0, cost_s=0.07)  # nine tenths of it end at 2.7 s, and it acts at 3 s
    world.now_s = 1.81
    world.feed("short", 1.0, cost_s=0.05)  # at 2.71 s, and 2.81 s
    world.now_s = 2.25
    _stop_until(world, "c", 2.75)
    world.submit("c", P.CONTROL)
    world.run(3.5)
    assert sum(feed.lapses for feed in world.schedule.stats(world.now_s).feeds.values()) == 0


@pytest.mark.parametrize("lost", [2, 3])
@pytest.mark.parametrize("fed_s", [0.06, 0.3])
def test_a_drive_that_no_longer_answers_goes_behind_those_that_are_late(
    lost: int, fed_s: float
) -> None:
    """Seed 30346 of the proof: it was asked again ahead of them, and room was made for that."""
    world = World().drives("gone", "late", "others")
    world.schedule.expect(FaultHypothesis(1))
    world.feed("gone", 1.0)
    world.now_s = 0.03
    world.feed("late", 1.0)
    world.now_s = fed_s
    world.feed("others", 1.0)
    world.silent.add("gone")
    for _ in range(lost):
        world.schedule.watchdogs.by_drive["gone"].failed(0.7, 1)
    world.now_s = 0.93  # behind nine tenths; its watchdog acts at 1.03 s
    world.run(1.2)
    feeds = world.schedule.stats(world.now_s).feeds
    assert (feeds["late"].lapses, feeds["others"].lapses) == (0, 0)
    assert feeds["gone"].lapses == 1


def test_room_for_a_drive_is_not_made_until_its_own_lost_answer_would_make_it_late() -> None:
    names = [f"d{number}" for number in range(20)]
    world = World().drives("a", *names)
    world.schedule.expect(FaultHypothesis(1))
    world.feed("a", 1.0)
    for name in names:
        world.feed(name, 1.05)
    world.now_s = 0.42  # 20 feeds take until 0.82, and an answer lost then leaves no time for a
    asked = world.submit("a", P.CONTROL)
    while (sent := world.step()) is not None and sent.drive != "a":
        pass
    assert world.sent[-1].at_s + WORST_S + COST_S <= HARD_PART * 1.0
    world.run(1.5)
    assert world.outcome(asked)[0] is Outcome.DONE
    assert sum(feed.misses for feed in world.schedule.stats(1.5).feeds.values()) == 0


def test_lost_answers_do_not_make_a_full_line_late() -> None:
    world = World().drives(*(names := [f"d{number}" for number in range(30)]))
    for name in names:
        world.feed(name, 2.0, cost_s=0.03, worst_s=0.12)
    world.saturate(P.INTERACTIVE, names, depth=3, cost_s=0.03, worst_s=0.12)
    chance = Random(5)
    for tick in range(1, 2400):  # who is deaf for the next 50 ms
        world.at(tick * 0.05, lambda: _deafen(world, names, chance))
    world.run(120.0)
    assert sum(not sent.reached for sent in world.sent) > 100
    assert sum(feed.lapses for feed in world.schedule.stats(120.0).feeds.values()) == 0


def _deafen(world: World, names: list[str], chance: Random) -> None:
    world.silent.clear()
    world.silent.update(name for name in names if chance.random() < 0.04)


def test_a_feeding_that_is_set_anew_goes_on_from_the_last_exchange() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.submit("a")
    world.step()
    world.now_s = 1.0
    world.feed("a", 2.0)
    stats = world.schedule.stats(1.0).feeds["a"]
    assert (stats.age_s, stats.fed) == (1.0, 1)


@pytest.mark.parametrize("priority", [P.CONTROL, P.INTERACTIVE])
def test_a_waiting_request_of_the_drive_serves_as_its_feed(priority: Priority) -> None:
    world = World().drives("a", "b")
    world.feed("a", 2.0)
    for _ in range(3):
        world.submit("b", priority)
    wanted = world.submit("a", priority)
    world.now_s = 1.75  # so late that the feed goes before anything else
    assert world.step() is wanted


def test_the_next_cyclic_slot_serves_as_feed_and_keeps_its_grid() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    entry = world.cyclic("a", 2.5)
    world.run(9.5)
    cyclic = world.starts(lambda r: r.priority is P.CYCLIC)
    # Slots 0, 2.5, 5 ..; run early by the feed due 1.5 s after the exchange before.
    assert cyclic[:3] == pytest.approx([0.0, 1.5, 3.0], abs=0.0201 * 2)
    assert math.remainder(entry.due_v, 2.5) == pytest.approx(0.0)
    assert world.schedule.stats(9.5).feeds["a"].margin_least_s == pytest.approx(0.5, abs=0.0201)


def test_feeding_does_not_run_ahead_of_a_slow_cycle() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    entry = world.cyclic("a", 10.0)
    world.run(60.0)
    assert entry.served <= 7
    assert len(world.sent) == pytest.approx(40, abs=2)  # one in 1.5 s


def _tight(world: World) -> None:
    """Ten watchdogs of half a second, and control writes that can take long but do not."""
    names = [f"d{number}" for number in range(10)]
    world.drives(*names, "other")
    for name in names:
        world.feed(name, 0.5)
    world.saturate(P.CONTROL, ["other"], cost_s=0.15, worst_s=0.2)


def test_nothing_makes_a_feed_late() -> None:
    world = World()
    _tight(world)
    world.run(30.0)
    feeds = world.schedule.stats(30.0).feeds.values()
    assert sum(feed.misses for feed in feeds) == 0
    assert min(feed.margin_least_s for feed in feeds) >= 0.5 * (1 - HARD_PART)
    assert world.busy_s(P.CONTROL) > 5.0


def test_without_the_slack_check_feeds_would_be_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WatchdogSet, "fits", lambda *_: True)
    world = World()
    _tight(world)
    world.run(30.0)
    feeds = world.schedule.stats(30.0).feeds.values()
    assert sum(feed.lapses for feed in feeds) > 0


def test_the_own_feed_counts_before_the_others_as_a_lost_answer_feeds_nothing() -> None:
    """A feed of 0.02 s each by 0.9 s: an exchange must be over by 0.86 s, not by 0.88 s."""
    feeds = WatchdogSet()
    for name in ("a", "b"):
        feeding = WatchdogFeeding(1.0, partial(World().request, name, P.WATCHDOG))
        feeds.by_drive[name] = WatchdogDeadline(name, feeding, 0.0)
    feeds.changed()
    assert feeds.fits(0.759, 0.1, "a")
    assert not feeds.fits(0.761, 0.1, "a")
    assert feeds.latest_end_s == pytest.approx(0.86), "and nothing else may take longer"
    assert not feeds.fits(0.861, 0.0, "other")


def test_room_is_made_for_what_would_not_fit_now() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.now_s = 0.45
    slow = world.submit("b", P.CONTROL, worst_s=0.7)
    assert world.step() is not slow  # the feed, though not due before 0.5
    assert world.step() is slow


def test_what_can_never_fit_is_refused_with_figures() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    slow = world.submit("b", P.CONTROL, worst_s=0.95)
    quick = world.submit("b", P.CONTROL)
    assert world.step() is quick
    outcome, reason = world.outcome(slow)
    assert outcome is Outcome.REFUSED
    for figure in ("0.950 s", "0.860 s", "drive a", "1 s"):
        assert figure in reason
    assert world.schedule.stats(0.0).refused[P.CONTROL] == 1


@pytest.mark.parametrize(
    ("other", "most_s", "whose"),
    [
        ({"time_s": 2.0}, HARD_PART * 1.0 - 2 * COST_S, "a"),
        ({"time_s": 1.5, "cost_s": 0.3}, HARD_PART * 1.5 - 2 * (0.3 + COST_S), "b"),
    ],
    ids=["the shorter watchdog", "the longer feed"],
)
def test_most_fits_right_behind_a_round_of_feeds_the_longest_watchdog_first(
    other: dict[str, float], most_s: float, whose: str
) -> None:
    world = World().drives("a", "b", "c")
    world.feed("a", 1.0)
    world.feed("b", **other)
    asked = partial(world.request, "c", P.CONTROL)
    assert world.schedule.never(asked(worst_s=most_s - 0.001)) == ""
    reason = world.schedule.never(asked(worst_s=most_s + 0.001))
    assert f"{most_s:.3f} s is the most" in reason
    assert f"drive {whose}," in reason


def test_thousands_that_never_fit_do_not_block_the_line() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    for _ in range(1000):
        world.submit("b", P.CONTROL, worst_s=2.0)
    world.step()
    assert len(world.ended) < 50
    world.run(0.1)
    assert len(world.ended) == 1000


def test_what_is_answered_soon_may_take_longer_in_vain_than_its_own_watchdog_allows() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    slow = world.submit("a", P.CONTROL, worst_s=2.0)
    assert world.step() is slow


@pytest.mark.parametrize("others", ["none", "parked", "unwatched"])
@pytest.mark.parametrize("tolerate", [0, 1, 3])
def test_what_its_own_drives_watchdog_does_not_outlast_is_refused_with_figures(
    tolerate: int, others: str
) -> None:
    """A module's own codes take half a second, and nothing feeds their drive in that time."""
    world = World().drives(*("a" if others == "none" else "ab"))
    world.schedule.expect(FaultHypothesis(tolerate))
    world.feed("a", 0.5)
    if others == "parked":
        world.feed("b", 0.5)
        world.schedule.park("b", 0.0, "it is silent")
    slow = [world.submit("a", one, cost_s=0.43, worst_s=0.53) for one in CLASSES]
    world.run(10.0)
    for request in slow:
        outcome, reason = world.outcome(request)
        assert outcome is Outcome.REFUSED
        for figure in ("0.530 s", "0.410 s", "drive a", "0.5 s"):
            assert figure in reason
    assert {one.request.priority for one in world.sent} == {P.WATCHDOG}
    assert world.schedule.stats(10.0).feeds["a"].lapses == 0


@pytest.mark.parametrize(("cost_s", "fits"), [(WORST_S, True), (1.01 * WORST_S, False)])
def test_an_exchange_is_long_if_it_takes_longer_than_the_feed_of_its_drive_does_in_vain(
    cost_s: float, fits: bool
) -> None:
    """Only then it must fit into the time of its own drive, besides that of the others."""
    world = World().drives("a")
    world.feed("a", 0.5)
    asked = world.request("a", cost_s=cost_s, worst_s=0.6)
    assert (world.schedule.never(asked) == "") is fits


CLASSES = (P.CONTROL, P.INTERACTIVE, P.BACKGROUND)


@pytest.mark.parametrize("lost", ["nothing", "its answer", "the feed behind it"])
@pytest.mark.parametrize("tolerate", [0, 1, 2, 3])
@pytest.mark.parametrize("priority", CLASSES)
def test_what_its_own_drives_watchdog_outlasts_goes_directly_behind_a_feed(
    priority: Priority, tolerate: int, lost: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever it is asked for; also if an answer is lost."""
    for number in range(40):
        world = World().drives("a")
        world.schedule.expect(FaultHypothesis(tolerate))
        world.feed("a", 0.7)
        world.run(2.0 + number * 0.013)
        slow = world.submit("a", priority, cost_s=0.43, worst_s=0.53)

        def chosen(now_s: float, world: World = world, slow: Request = slow) -> Request | None:
            request = Schedule.next(world.schedule, now_s)
            behind = bool(world.sent) and world.sent[-1].request is slow
            if lost != "nothing" and (behind if lost != "its answer" else request is slow):
                world.silent.add("a")
            else:
                world.silent.clear()
            return request

        monkeypatch.setattr(world.schedule, "next", chosen)
        world.run(world.now_s + 3.0)
        assert world.outcome(slow)[0] is (Outcome.UNKNOWN if lost == "its answer" else Outcome.DONE)
        if tolerate or lost != "the feed behind it":
            assert world.schedule.stats(world.now_s).feeds["a"].lapses == 0


def test_a_cyclic_slot_that_never_fits_is_dropped_and_counted() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.cyclic("b", 0.5, worst_s=2.0)
    world.run(3.1)
    stats = world.schedule.stats(3.1)
    assert stats.cyclic_dropped == 7
    assert stats.stretch == 1.0
    assert {outcome for r, outcome, _, _ in world.ended if r.drive == "b"} == {Outcome.REFUSED}


def test_a_silent_drive_does_not_starve_the_other_feeds() -> None:
    world = World().drives("a", "b", "c")
    for name in "abc":
        world.feed(name, 1.0)
    world.silent.add("a")
    world.run(30.0)
    feeds = world.schedule.stats(30.0).feeds
    assert (feeds["a"].misses, feeds["a"].lapses) == (1, 1)
    assert feeds["b"].misses == feeds["c"].misses == 0
    tries = world.starts(lambda r: r.drive == "a")
    assert 30 < len(tries) < 100
    assert tries[:3] == pytest.approx([0.6, 0.72, 0.84], abs=0.1)  # at once, time is short


def test_a_lapse_is_counted_once_whatever_pauses_come_before_the_next_answer() -> None:
    def lapses() -> int:
        return world.schedule.stats(world.now_s).feeds["a"].lapses

    world = World().drives("a")
    world.feed("a", 1.0)
    world.run(5.0)
    assert lapses() == 0
    world.silent.add("a")
    world.schedule.park("a", world.now_s, "offline")
    world.run(7.0)
    assert lapses() == 1, "its watchdog runs on while it is parked"
    world.schedule.fail_all(world.now_s, "the line is lost")
    world.schedule.unpark("a", world.now_s)
    world.run(15.0)
    assert lapses() == 1
    world.schedule.set_feeding("a", None, world.now_s)
    feeding = WatchdogFeeding(1.0, lambda: world.request("a", P.WATCHDOG))
    world.schedule.set_feeding("a", feeding, world.now_s)
    world.run(20.0)
    assert lapses() == 1, "no answer came since"
    world.silent.clear()
    world.run(25.0)
    assert lapses() == 1
    world.silent.add("a")
    world.run(30.0)
    assert lapses() == 2


@pytest.mark.parametrize("answers_again", [False, True])
def test_a_lapse_across_an_opening_of_the_port_counts_when_the_drive_is_heard(
    answers_again: bool,
) -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.run(5.0)
    world.silent.add("a")
    world.schedule.port_opened()
    if answers_again:
        world.at(9.0, world.silent.clear)
    world.run(20.0)
    assert world.schedule.stats(20.0).feeds["a"].lapses == int(answers_again)


def test_a_late_feed_is_one_miss_and_one_lapse_and_shows_in_the_margin() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.silent.add("a")
    world.at(3.0, world.silent.clear)
    world.run(10.0)
    feed = world.schedule.stats(10.0).feeds["a"]
    assert (feed.misses, feed.lapses) == (1, 1)
    assert feed.margin_least_s < -1.9
    assert feed.margin_last_s == pytest.approx(0.4, abs=0.0201)  # 1 s: over by 0.9, due at 0.6


def test_the_least_margin_is_told_anew_after_each_look_and_kept_from_the_beginning() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.submit("a")
    world.now_s = 1.2
    world.step()
    feed = world.schedule.stats(1.3).feeds["a"]
    assert (feed.margin_since_s, feed.margin_least_s) == pytest.approx((0.8, 0.8))
    assert math.isinf(world.schedule.stats(1.3).feeds["a"].margin_since_s)
    world.submit("a")
    world.now_s = 1.7
    world.step()
    feed = world.schedule.stats(1.8).feeds["a"]
    assert (feed.margin_since_s, feed.margin_least_s) == pytest.approx((1.5, 0.8))
    assert feed.paused is False


def test_a_feed_of_a_held_drive_waits_and_others_go_on() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.feed("b", 1.0)
    world.at(0.4, lambda: world.schedule.hold("a", 0.7, world.now_s))
    world.run(0.75)
    assert [sent.request.drive for sent in world.sent] == ["b", "a"]
    assert world.sent[1].at_s == pytest.approx(0.7)


def test_feeding_that_is_ended_sends_nothing() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.schedule.set_feeding("a", None, 0.0)
    world.run(5.0)
    assert world.sent == []
    assert world.schedule.stats(5.0).feeds == {}


def test_mixed_watchdogs_and_long_exchanges_all_progress() -> None:
    world = World()
    for number in range(30):
        world.drives(f"d{number}")
        world.feed(f"d{number}", (0.5, 2.0, 5.0)[number % 3] if number < 3 else 5.0)
    world.drives("x")
    world.saturate(P.BACKGROUND, ["x"], depth=2, cost_s=0.05, worst_s=0.35)
    world.run(60.0)
    feeds = world.schedule.stats(60.0).feeds.values()
    assert sum(feed.misses for feed in feeds) == 0
    assert world.busy_s(P.BACKGROUND) > 20.0


def test_the_slack_is_the_time_until_the_line_must_be_free() -> None:
    feeds = WatchdogSet()
    assert math.isinf(feeds.slack_s(0.0))
    for name, time_s in (("a", 1.0), ("b", 2.0)):
        feeds.by_drive[name] = WatchdogDeadline(
            name, WatchdogFeeding(time_s, partial(slack_feed, name)), 0.0
        )
    feeds.changed()
    assert feeds.slack_s(0.0) == pytest.approx(0.9 - 0.03)
    assert feeds.fits(0.0, 0.86, "")
    assert not feeds.fits(0.0, 0.88, "")
    feeds.by_drive["a"].reached(0.5)
    assert feeds.slack_s(0.5) == pytest.approx(1.4 - 0.03 - 0.5)
    assert feeds.slack_s(1.395) == pytest.approx(1.8 - 0.03 - 1.395)
    feeds.by_drive["b"].active = False
    assert math.isinf(feeds.slack_s(1.395))


def slack_feed(name: str) -> Request:
    return Request(name, Priority.WATCHDOG, 0.03, 0.1, lambda outcome, reason: None)


def test_a_drive_is_fed_before_room_made_for_it_leaves_none_for_the_stop_of_another() -> None:
    def own(stop_failed_s: float, at_s: float) -> bool:
        feeds = WatchdogSet(FaultHypothesis(1, stop_failed_s=stop_failed_s))
        for name in "ab":
            feeding = WatchdogFeeding(1.0, partial(World().request, name))
            feeds.by_drive[name] = WatchdogDeadline(name, feeding, 0.0)
        feeds.changed()
        return feeds.own_before(at_s, feeds.by_drive["b"], "a") is feeds.by_drive["a"]

    behind_s = 0.5 - 0.1 + 2 * COST_S
    assert not own(0.5, HARD_PART - behind_s - 0.001)
    assert own(0.5, HARD_PART - behind_s + 0.001)
    assert not own(0.0, HARD_PART - behind_s + 0.001)
    assert not own(5.0, 0.0), "no room is kept for a stop that never has it"


def test_a_drive_that_was_just_fed_lets_the_others_go_though_its_lost_answers_fill_its_time() -> (
    None
):
    """Three of 0.3 s: it would be fed again and again, and room never made."""
    feeds = WatchdogSet(FaultHypothesis(3))
    for name in "ab":
        feeding = WatchdogFeeding(1.0, partial(World().request, name, worst_s=0.3))
        feeds.by_drive[name] = WatchdogDeadline(name, feeding, 0.0)
    feeds.changed()
    own, other = feeds.by_drive["a"], feeds.by_drive["b"]
    assert feeds.own_before(COST_S - 0.001, other, "a") is None
    assert feeds.own_before(COST_S + 0.001, other, "a") is own, "the other was fed in between"


@pytest.mark.parametrize("hold_s", [0.0, 0.2])
def test_a_drive_is_fed_before_a_write_whose_pause_its_watchdog_does_not_outlast(
    hold_s: float,
) -> None:
    world = World().drives("a")
    world.schedule.expect(FaultHypothesis(1))
    world.feed("a", 1.0)
    world.now_s = 0.65
    write = world.submit("a", P.CONTROL, writes=True, hold_s=hold_s)
    first = world.step()
    assert (first is write) is (hold_s == 0.0)
    assert write in (first, world.step())


def lost_stop_world(tolerate: int = 1) -> World:
    """Two watched drives; a stop of one that is not answered takes half a second."""
    world = World().drives("a", "b")
    world.schedule.expect(FaultHypothesis(tolerate, stop_failed_s=0.5))
    world.feed("a", 1.0)
    world.feed("b", 1.0)
    return world


def test_an_exchange_is_refused_if_a_lost_stop_behind_it_would_make_a_watchdog_act() -> None:
    """After it there has to be room for the stop, as far as the last tenth does not hold it."""
    most_s = HARD_PART - 3 * COST_S
    longest_s = most_s - (0.5 - 0.1)
    world = lost_stop_world()
    begun = world.submit("a", cost_s=longest_s - 0.001, worst_s=longest_s + 0.01)
    refused = world.submit("a", cost_s=longest_s + 0.001, worst_s=longest_s + 0.01)
    world.run(5.0)
    assert world.outcome(begun)[0] is Outcome.DONE
    outcome, reason = world.outcome(refused)
    assert outcome is Outcome.REFUSED
    assert "with a stop behind it and a lost answer" in reason
    assert f"{most_s:.3f} s is the most" in reason


def test_measured_times_refuse_nothing_for_a_stop_behind_it() -> None:
    """They may be wrong, and must not close the line."""
    world = lost_stop_world()
    slow = world.submit("a", cost_s=0.5, worst_s=0.6, documented=(0.3, 0.4))
    world.run(5.0)
    assert world.outcome(slow)[0] is Outcome.DONE


@pytest.mark.parametrize("tolerate", [1, 2, 3])
def test_feeds_leave_room_for_lost_answers_with_a_stop_on_an_idle_line(tolerate: int) -> None:
    world = lost_stop_world(tolerate)
    feeds = world.schedule.watchdogs
    least_s = math.inf
    while world.now_s < 20.0:
        world.run(world.now_s + 0.003)
        least_s = min(least_s, feeds.slack_s(world.now_s))
    assert least_s >= (tolerate - 1) * WORST_S + 0.5 - 0.1 - 1e-6
    assert world.schedule.stats(20.0).feeds["a"].misses == 0


def test_an_exchange_leaves_room_for_a_stop_behind_its_own_lost_answer() -> None:
    """A write to an 820X takes half a second in vain, and a stop of another one a quarter."""
    lost_s, tenth_s = 0.1, 0.1
    faults = FaultHypothesis(1, stop_s=0.28, stop_failed_s=0.3)
    assert faults.need_s(0.02, 0.5, lost_s, tenth_s) == pytest.approx(0.5 + 0.28 - 0.1)
    assert faults.least_room_s(0.02, 0.5, lost_s, tenth_s) == pytest.approx(0.5 + 0.28 - 0.1)
    assert faults.need_s(0.02, 0.1, lost_s, tenth_s) == pytest.approx(0.02 + 0.1 + 0.28 - 0.1)
    assert faults.need_s(0.02, 0.5, lost_s, 0.3) == pytest.approx(0.5), "the last tenth holds it"
    assert replace(faults, tolerate=2).need_s(0.02, 0.5, lost_s, 0.3) == pytest.approx(0.6)
    assert replace(faults, tolerate=0).least_room_s(0.02, 0.5, lost_s, tenth_s) == 0.5


@pytest.mark.parametrize("at_ms", range(0, 300, 10))
def test_a_drive_that_lost_as_many_answers_as_are_tolerated_is_still_fed_before_others(
    at_ms: int,
) -> None:
    names = [f"d{number}" for number in range(6)]
    world = World().drives(*names)
    world.schedule.expect(FaultHypothesis(3, stop_s=0.06, stop_failed_s=0.145))
    for name in names:
        world.feed(name, 0.739, cost_s=0.035, worst_s=0.128)
    world.run(2.0 + at_ms / 1000)
    lost = 0
    while lost < 3:
        world.silent = {"d1"}
        if world.step() is None:
            wake_s = world.schedule.wake_at_s(world.now_s)
            assert wake_s is not None
            world.now_s = wake_s
        elif not world.sent[-1].reached:
            lost += 1
    world.silent = set()
    world.run(6.0)
    feeds = world.schedule.stats(world.now_s).feeds
    assert [name for name, feed in feeds.items() if feed.lapses] == []


def test_after_a_lost_answer_a_longer_exchange_with_the_drive_leaves_room_for_the_others() -> None:
    faults = FaultHypothesis(3)
    feeds = WatchdogSet(faults)
    request = World().request("a", P.WATCHDOG)
    feeds.by_drive["a"] = own = WatchdogDeadline("a", WatchdogFeeding(1.0, lambda: request), 0.0)
    feeds.failed(own, 0.2)
    own.retry_at_s = -math.inf
    holds_s = HARD_PART * 1.0 - COST_S - WORST_S - 0.05 - WORST_S
    assert feeds.own_first(holds_s - 0.01, WORST_S + 0.05, "a") is None
    assert feeds.own_first(holds_s + 0.01, WORST_S + 0.05, "a") is own
    own.failures = faults.tolerate
    assert feeds.own_first(holds_s + 0.01, WORST_S + 0.05, "a") is None


# ---- what is said of a request before it is asked for -------------------------------------------


def roster_of(faults: FaultHypothesis, **times_s: float) -> WatchdogSet:
    """The watchdogs that a roster names."""
    feeds = WatchdogSet(faults)
    for name, time_s in times_s.items():
        feeding = WatchdogFeeding(time_s, partial(World().request, name))
        feeds.by_drive[name] = WatchdogDeadline(name, feeding, 0.0)
    return feeds


def test_a_read_that_does_not_fit_beside_the_roster_is_known_to_before_it_is_asked_for() -> None:
    faults = FaultHypothesis(1, stop_failed_s=0.5)
    world = World().drives("a", "b", "c")
    world.schedule.expect(faults, roster_of(faults, a=1.0, b=1.0))
    most_s = HARD_PART - 3 * COST_S
    longest_s = most_s - (0.5 - 0.1)
    ask = partial(world.request, "c", worst_s=0.4)
    assert world.schedule.never_beside_roster(ask(cost_s=longest_s - 0.001), ()) == ""
    reason = world.schedule.never_beside_roster(ask(cost_s=longest_s + 0.001), ())
    assert f"keep feeds waiting for {most_s + 0.001:.3f} s" in reason
    assert f"{most_s:.3f} s is the most" in reason
    assert "watchdog 1 s" in reason


def test_drives_that_are_not_expected_back_forbid_nothing_until_they_are() -> None:
    faults = FaultHypothesis(1, stop_failed_s=0.1)
    world = World().drives("quick", "slow", "c")
    world.schedule.expect(faults, roster_of(faults, quick=0.5, slow=2.0))
    long = world.request("c", cost_s=0.6, worst_s=0.9)
    for _ in range(2):
        assert "drive quick, watchdog 0.5 s" in world.schedule.never_beside_roster(long, ())
        assert world.schedule.never_beside_roster(long, {"quick"}) == ""
        assert world.schedule.never_beside_roster(long, {"quick", "slow"}) == ""
        assert "drive quick" in world.schedule.never_beside_roster(long, {"slow"})


def test_the_room_for_lost_answers_is_reckoned_beside_the_drives_that_count() -> None:
    """A tenth of the shortest watchdog time is there for a stop: 0.05 s, and without `quick` 0.2 s.

    That leaves 1.46 s of the 1.76 s without it, and 1.31 s if the tenth were that of `quick`.
    """
    faults = FaultHypothesis(1, stop_failed_s=0.5)
    world = World().drives("quick", "slow", "c")
    world.schedule.expect(faults, roster_of(faults, quick=0.5, slow=2.0))
    long = world.request("c", cost_s=1.4, worst_s=1.5)
    assert world.schedule.never_beside_roster(long, ()) != ""
    assert world.schedule.never_beside_roster(long, {"quick"}) == ""


def test_beside_the_roster_the_watchdog_of_the_drive_itself_counts_as_in_check() -> None:
    faults = FaultHypothesis(1)
    world = World().drives("a")
    world.schedule.expect(faults, roster_of(faults, a=1.0))
    assert world.schedule.never_beside_roster(world.request("a", worst_s=0.85), ()) == ""
    assert world.schedule.never_beside_roster(world.request("a", worst_s=0.87), ()) != ""


@pytest.mark.parametrize(
    ("documented", "fits"), [((0.3, 0.4), True), ((0.7, 0.8), False), (None, False)]
)
def test_beside_the_roster_a_request_counts_by_its_manual(
    documented: tuple[float, float] | None, fits: bool
) -> None:
    """`check` has said so of the roster; what was measured may be wrong by now."""
    faults = FaultHypothesis(1, stop_failed_s=0.3)
    world = World().drives("a", "c")
    world.schedule.expect(faults, roster_of(faults, a=1.0))
    measured = world.request("c", cost_s=0.8, worst_s=1.2, documented=documented)
    assert (world.schedule.never_beside_roster(measured, ()) == "") is fits


def test_without_a_roster_everything_fits_beside_it() -> None:
    world = World().drives("a", "c")
    world.feed("a", 0.5)
    world.schedule.expect(FaultHypothesis(1))
    long = world.request("c", cost_s=5.0, worst_s=9.0)
    assert world.schedule.never_beside_roster(long, ()) == ""
    assert world.schedule.never(long) != ""


def test_a_multicast_that_would_never_go_is_known_to_before_it_is_asked_for() -> None:
    """Its members are then spoken to one by one."""
    world = lost_stop_world()
    longest_s = HARD_PART - 3 * COST_S - (0.5 - 0.1)
    shared = partial(world.request, "both", P.CONTROL, members=("a", "b"), cost_s=COST_S)
    assert world.schedule.never(shared(worst_s=longest_s - 0.001)) == ""
    assert world.schedule.never(shared(worst_s=longest_s - 0.1, hold_s=0.099)) == ""
    reason = world.schedule.never(shared(worst_s=longest_s - 0.1, hold_s=0.101))
    assert "with the time its members are left alone" in reason
    assert world.ended == [], "it was only asked"


@pytest.mark.parametrize(
    ("tolerate", "answered_s", "failed_s"), [(0, 0.0, 0.0), (1, 0.5, 0.1), (3, 0.7, 0.6)]
)
def test_room_is_kept_behind_an_exchange_for_the_answers_that_may_yet_be_lost(
    tolerate: int, answered_s: float, failed_s: float
) -> None:
    """Behind one that is answered for all that are tolerated; its own lost answer is one of them.

    The longest feed takes 0.1 s in vain, a stop 0.2 s and 0.6 s in vain; of that a tenth of the
    shortest watchdog time, 0.1 s, is there to be used.
    """
    feeds = roster_of(FaultHypothesis(tolerate, stop_s=0.2, stop_failed_s=0.6), a=1.0, b=2.0)
    feeds.changed()
    assert feeds.behind_s() == pytest.approx((answered_s, failed_s))


def _stop_until(world: World, drive: str, until_s: float) -> None:
    takes_s = until_s - world.now_s
    world.submit(drive, P.STOP, cost_s=takes_s, worst_s=takes_s)
