"""What was measured of drives may make exchanges longer, and never closes the line."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from lecombus.schedule import Outcome, Priority, Request, WatchdogFeeding
from lecombus.schedule.watchdog_deadline import FaultHypothesis
from schedule.world import COST_S, WORST_S, World

P = Priority
TOLD = (COST_S, WORST_S)
NAMES = [f"d{number}" for number in range(20)]


def slow_line(cost_s: float, worst_s: float, *, drives: int = 20, time_s: float = 2.0) -> World:
    """A line of which every drive was measured to be slow, and is as quick as it ever was."""
    world = World(lasts_s=COST_S).drives(*NAMES[:drives])
    for name in NAMES[:drives]:
        world.feed(name, time_s, cost_s=cost_s, worst_s=worst_s, documented=TOLD)
        world.cyclic(name, 5.0, cost_s=cost_s, worst_s=worst_s, documented=TOLD)
    return world


@pytest.mark.parametrize("priority", [P.CONTROL, P.INTERACTIVE, P.BACKGROUND])
@pytest.mark.parametrize(("cost_s", "worst_s"), [(0.25, 0.6), (0.06, 0.2), (0.08, 1.5)])
def test_a_line_that_only_seems_slow_takes_requests_of_every_class(
    priority: Priority, cost_s: float, worst_s: float
) -> None:
    world = slow_line(cost_s, worst_s)
    world.run(10.0)
    asked: list[Request] = []

    def ask() -> None:
        asked.append(
            world.submit("d3", priority, cost_s=cost_s, worst_s=worst_s, documented=(COST_S, 0.3))
        )

    for number in range(10):
        world.at(10.0 + 3.0 * number, ask)
    world.run(42.0)
    assert [world.outcome(one)[0] for one in asked] == [Outcome.DONE] * 10
    stats = world.schedule.stats(42.0)
    assert stats.cyclic_dropped == 0
    assert stats.stretch == pytest.approx(1.0, abs=0.05)
    assert sum(one.lapses for one in stats.feeds.values()) == 0


def test_a_drive_that_is_slow_is_waited_for_as_long_as_the_watchdogs_of_others_leave() -> None:
    world = World().drives("slow", "a", "b")
    world.feed("a", 2.0)
    world.feed("b", 2.0)
    world.silent.add("slow")
    request = world.submit("slow", worst_s=2.5, documented=TOLD)
    world.run(10.0)
    assert world.outcome(request)[0] is Outcome.UNKNOWN
    (sent,) = [one for one in world.sent if one.request is request]
    assert 5 * WORST_S < sent.end_s - sent.at_s < 1.0
    assert request.cut_by_s == pytest.approx(2.5 - (sent.end_s - sent.at_s))
    stats = world.schedule.stats(10.0)
    assert sum(one.misses for one in stats.feeds.values()) == 0


def test_what_only_fits_by_the_manual_goes_now_and_then() -> None:
    """Here the measures are right: feeding all takes 1 s of each 1.8 s."""
    world = World().drives(*NAMES[:10])
    for name in NAMES[:10]:
        world.feed(name, 2.0, cost_s=0.1, worst_s=0.3, documented=TOLD)
    world.run(5.0)
    began_s = world.now_s
    world.saturate(P.CONTROL, NAMES[:3], cost_s=0.1, worst_s=1.0, documented=(COST_S, 0.75))
    world.run(began_s + 60.0)
    starts = world.starts(lambda one: one.priority is P.CONTROL)
    assert 30 <= len(starts) <= 61
    assert min(b - a for a, b in pairwise(starts)) >= 1.0
    stats = world.schedule.stats(world.now_s)
    assert sum(one.lapses for one in stats.feeds.values()) == 0


@pytest.mark.parametrize("tolerate", [0, 1, 2, 3])
@pytest.mark.parametrize("worst_s", [0.2, 0.3, 0.4, 0.5])
def test_what_fits_by_the_manual_goes_though_feeds_never_leave_so_much_room(
    tolerate: int, worst_s: float
) -> None:
    world = World().drives("d0", "d1", "d2")
    world.schedule.expect(FaultHypothesis(tolerate, 0.05, 0.1))
    for name, time_s, cost_s, feed_worst_s in (
        ("d0", 1.2, 0.03, 0.5), ("d1", 0.8, 0.08, 0.3), ("d2", 0.4, 0.08, 0.2),
    ):  # fmt: skip
        world.feed(name, time_s, cost_s=cost_s, worst_s=feed_worst_s, documented=TOLD)
    world.run(5.0)
    request = world.submit("d2", P.CONTROL, worst_s=worst_s)
    world.run(10.0)
    assert world.outcome(request)[0] is Outcome.DONE
    stats = world.schedule.stats(world.now_s)
    assert sum(feed.lapses for feed in stats.feeds.values()) == 0


def test_without_measures_what_can_never_fit_is_refused_as_ever() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    request = world.submit("b", worst_s=3.0)
    world.run(1.0)
    outcome, reason = world.outcome(request)
    assert outcome is Outcome.REFUSED
    assert "keeping the watchdogs leaves" in reason


def test_a_manual_that_does_not_fit_is_refused_whatever_was_measured() -> None:
    world = slow_line(0.25, 0.6)
    request = world.submit("d3", worst_s=5.0, documented=(COST_S, 3.0))
    world.run(1.0)
    assert world.outcome(request)[0] is Outcome.REFUSED


def test_what_feeding_costs_is_reckoned_anew_when_it_changes() -> None:
    world = World().drives("a", "b")
    costs: dict[str, Any] = {"cost_s": 0.5, "worst_s": 1.2, "documented": TOLD}

    def make() -> Request:
        return world.request("a", P.WATCHDOG, **costs)

    world.schedule.set_feeding("a", WatchdogFeeding(4.0, make), 0.0)
    world.cyclic("a", 0.2)
    world.run(2.0)
    slack_s = world.schedule.stats(world.now_s).slack_s
    costs = {"cost_s": COST_S, "worst_s": WORST_S, "documented": None}
    world.schedule.costs_changed("a")
    assert world.schedule.stats(world.now_s).slack_s == pytest.approx(slack_s + 0.48)
