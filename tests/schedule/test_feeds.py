"""Watchdogs are fed in time, whatever else is wanted of the line."""

from __future__ import annotations

import math

import pytest

from lecombus.schedule import Outcome, Priority
from lecombus.schedule.feeds import HARD_PART, SOFT_PART, Feeds
from schedule.world import World

P = Priority


class Careless(Feeds):
    """Feeds without the slack check: anything may always start."""

    def fits(self, now_s: float, worst_s: float, drive: str) -> bool:
        return True


def test_a_feed_runs_at_half_the_watchdog_time() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    world.run(5.0)
    assert world.starts(lambda r: r.priority is P.WATCHDOG) == pytest.approx([1.0, 2.0, 3.0, 4.0])
    assert world.schedule.stats(5.0).feeds["a"].margin_least_s == pytest.approx(1.0)


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
    world.at(0.9, lambda: world.submit("both", P.CONTROL, members=("a", "b")))
    world.silent.add("b")
    world.at(0.9, lambda: world.submit("b", P.CONTROL))
    world.run(1.1)
    stats = world.schedule.stats(1.1)
    assert stats.feeds["a"].age_s == pytest.approx(0.02, abs=0.1)
    assert stats.feeds["a"].margin_last_s == pytest.approx(1.0, abs=0.1)  # by its own feed
    assert stats.feeds["b"].fed == 0


def test_due_feeds_go_by_deadline_and_above_interactive_below_control() -> None:
    world = World().drives("a", "b")
    world.feed("a", 4.0)
    world.feed("b", 3.0)
    world.now_s = 2.1
    control = world.submit("c", P.CONTROL)
    reading = world.submit("c")
    order = [world.step() for _ in range(4)]
    assert (order[0], order[3]) == (control, reading)
    assert [request.drive for request in order[1:3] if request] == ["b", "a"]


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
    entry = world.cyclic("a", 1.5)
    world.run(9.5)
    cyclic = world.starts(lambda r: r.priority is P.CYCLIC)
    # Slots 0, 1.5, 3 ..; run early by the feed due 1 s after the exchange before.
    assert cyclic[:3] == pytest.approx([0.0, 1.0, 2.0])
    assert entry.due_v - math.floor(entry.due_v / 1.5) * 1.5 == pytest.approx(0.0)
    assert world.schedule.stats(9.5).feeds["a"].margin_least_s == pytest.approx(1.0)


def test_feeding_does_not_run_ahead_of_a_slow_cycle() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    entry = world.cyclic("a", 10.0)
    world.run(60.0)
    assert entry.served <= 7
    assert len(world.sent) == pytest.approx(60, abs=2)


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


def test_without_the_slack_check_feeds_would_be_late() -> None:
    world = World()
    world.schedule._feeds = Careless()
    _tight(world)
    world.run(30.0)
    feeds = world.schedule.stats(30.0).feeds.values()
    assert sum(feed.lapses for feed in feeds) > 0


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


def test_thousands_that_never_fit_do_not_block_the_line() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    for _ in range(1000):
        world.submit("b", P.CONTROL, worst_s=2.0)
    world.step()
    assert len(world.ended) < 50
    world.run(0.1)
    assert len(world.ended) == 1000


def test_the_drive_itself_may_take_longer_than_its_own_watchdog_allows() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    slow = world.submit("a", P.CONTROL, worst_s=2.0)
    assert world.step() is slow


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
    assert tries[:3] == pytest.approx([0.5, 0.75, 0.875], abs=0.1)


def test_a_late_feed_is_one_miss_and_one_lapse_and_shows_in_the_margin() -> None:
    world = World().drives("a")
    world.feed("a", 1.0)
    world.silent.add("a")
    world.at(3.0, world.silent.clear)
    world.run(10.0)
    feed = world.schedule.stats(10.0).feeds["a"]
    assert (feed.misses, feed.lapses) == (1, 1)
    assert feed.margin_least_s < -1.9
    assert feed.margin_last_s == pytest.approx(1.0 * (1 - SOFT_PART))


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
