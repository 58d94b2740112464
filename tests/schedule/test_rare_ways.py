"""Ways through the schedule that a healthy line seldom takes."""

from __future__ import annotations

import pytest

from lecombus.schedule import Outcome, Priority, Request
from lecombus.schedule.queues import EMPTY_LIMIT
from lecombus.schedule.request import QUEUED
from lecombus.schedule.waiting import EXPIRE_BATCH
from lecombus.schedule.watchdog_deadline import (
    SPARE_ATTEMPTS,
    FaultHypothesis,
    WatchdogFeeding,
)
from schedule.world import World

P = Priority


def test_a_silent_drive_whose_feed_never_fits_is_tried_again_all_the_same() -> None:
    world = World(silent={"a"}).drives("a", "b")
    world.feed("a", 1.0, worst_s=0.7)
    world.feed("b", 0.5)
    world.run(30.0)
    tries = world.starts(lambda request: request.drive == "a")
    assert len(tries) > 10
    assert tries[-1] > 25.0


def test_a_feed_counts_with_what_its_read_takes_now() -> None:
    world = World().drives("a")
    costs = [(0.02, 0.1)]
    feeding = WatchdogFeeding(1.0, lambda: world.request("a", P.WATCHDOG, *costs[-1]))
    world.schedule.set_feeding("a", feeding, 0.0)
    world.run(2.0)
    costs.append((0.05, 0.2))
    world.run(4.0)
    feed = world.schedule.watchdogs.by_drive["a"]
    assert (feed.cost_s, feed.worst_s) == (0.05, 0.2)
    assert feed.misses == 0


def test_an_expired_request_is_no_feed() -> None:
    world = World().drives("a", "b")
    world.feed("b", 1.0)
    others = [world.submit("a", P.CONTROL, expires_at_s=0.5) for _ in range(3 * EXPIRE_BATCH)]
    late = world.submit("b", P.CONTROL, expires_at_s=0.6)
    world.now_s = 0.85
    request = world.step()
    assert request is not None
    assert (request.drive, request.priority) == ("b", P.WATCHDOG)
    world.run(1.1)
    assert {world.outcome(one)[0] for one in (*others, late)} == {Outcome.EXPIRED}


def test_a_watchdog_that_begins_while_its_drive_is_left_alone_is_fed_afterwards() -> None:
    world = World().drives("a")
    world.schedule.hold("a", 0.7, 0.0)
    world.feed("a", 1.0)
    world.run(1.0)
    assert [sent.at_s for sent in world.sent] == [pytest.approx(0.7, abs=1e-3)]


def test_many_withdrawn_requests_leave_the_others_in_their_order() -> None:
    world = World().drives("a")
    requests = [world.submit("a", P.BACKGROUND) for _ in range(4 * EMPTY_LIMIT)]
    kept = requests[::4]
    for request in requests:
        if request not in kept:
            assert world.schedule.withdraw(request, Outcome.REFUSED, "not wanted")
    world.run(100.0)
    assert [sent.request for sent in world.sent] == kept


def test_a_probe_that_no_watchdog_could_survive_is_not_sent() -> None:
    world = World(silent={"away"}).drives("fed", "away")
    world.feed("fed", 0.5)
    world.probe("away", worst_s=5.0)
    world.schedule.park("away", 0.0, "silent")
    world.run(60.0)
    assert {sent.request.drive for sent in world.sent} == {"fed"}
    refused = [one for one in world.ended if one[0].drive == "away"]
    assert refused
    assert {outcome for _, outcome, _, _ in refused} == {Outcome.REFUSED}
    assert world.schedule.stats(60.0).feeds["fed"].misses == 0


def test_an_end_that_is_not_counted_is_told_all_the_same() -> None:
    world = World().drives("a")
    request = world.submit("a")
    before = world.schedule.stats(0.0)
    assert world.schedule.withdraw(request, Outcome.UNKNOWN, "its client was replaced")
    reason = "its client was replaced; it was sent before, and not proven"
    assert world.outcome(request) == (Outcome.UNKNOWN, reason)
    after = world.schedule.stats(0.0)
    assert (before.superseded, before.refused) == (after.superseded, after.refused)


def test_an_end_may_end_another_request_that_is_about_to_end() -> None:
    world = World().drives("a")
    first, second = world.submit("a"), world.submit("a")
    inner = first.settle

    def settle(outcome: Outcome, reason: str) -> None:
        inner(outcome, reason)
        world.schedule.withdraw(second, Outcome.REFUSED, "with the first")

    first.settle = settle
    world.schedule.park("a", 0.0, "silent")
    assert world.outcome(first) == (Outcome.REFUSED, "silent")
    assert world.outcome(second) == (Outcome.REFUSED, "with the first")


# ---- which of two exchanges goes, at a moment made for it ---------------------------------------


def at_a_moment(
    now_s: float, fed: dict[str, tuple[float, float]], faults: FaultHypothesis, **costs: float
) -> World:
    """Two drives with the times of their watchdogs, and when each was fed last."""
    world = World().drives(*fed)
    world.schedule.expect(faults)
    for name, (time_s, fed_at_s) in fed.items():
        world.feed(name, time_s, **costs)
        world.schedule.watchdogs.by_drive[name].reached(fed_at_s)
    world.schedule.watchdogs.changed()
    world.now_s = now_s
    return world


def proof_wanted(world: World, drive: str, **more: float) -> Request:
    """A stop that was sent, and of which only more proof is wanted."""
    return world.submit(drive, P.STOP, yields=True, **more)


def chosen(world: World) -> tuple[str, Priority]:
    request = world.schedule.next(world.now_s)
    assert request is not None
    return request.drive, request.priority


def test_the_feed_of_a_drive_goes_before_more_proof_of_its_own_stop_when_it_is_late() -> None:
    faults = FaultHypothesis(tolerate=1, stop_s=0.2, stop_failed_s=0.5)
    world = at_a_moment(3.85, {"a": (0.6, 3.8), "b": (0.72, 2.44)}, faults)
    world.schedule.park("a", world.now_s, "silent")
    proof_wanted(world, "b")
    assert chosen(world) == ("b", P.WATCHDOG)


def test_a_stop_feeds_its_own_late_drive_where_others_can_wait_for_it() -> None:
    world = at_a_moment(7.88, {"a": (0.6, 7.86), "b": (0.6, 7.36)}, FaultHypothesis())
    world.schedule.hold("b", 8.66, 7.5)
    proof_wanted(world, "b", cost_s=0.5, worst_s=1.0)
    assert chosen(world) == ("b", P.STOP)


@pytest.mark.parametrize("alone", [False, True])
def test_while_a_drive_that_is_stopped_is_left_alone_others_are_fed_in_its_place(
    alone: bool,
) -> None:
    """Its own feed would keep its watchdog, but it is left alone after a write."""
    faults = FaultHypothesis(tolerate=1, stop_s=0.1, stop_failed_s=0.3)
    world = at_a_moment(0.87, {"a": (1.0, 0.0), "b": (1.0, 0.05)}, faults)
    if alone:
        world.schedule.hold("a", 0.92, world.now_s)
    else:
        world.schedule.watchdogs.by_drive["a"].failures = 1
    stop = proof_wanted(world, "a", cost_s=0.3, worst_s=0.5)
    assert chosen(world) == ("b" if alone else "a", P.WATCHDOG)
    assert stop.state == QUEUED


@pytest.mark.parametrize("until_s", [0.7, 0.85])
def test_a_drive_that_is_gone_is_not_tried_while_those_to_feed_before_it_are_left_alone(
    until_s: float,
) -> None:
    """Its vain attempt would make the other late: that is fed first, as soon as it may be."""
    world = World(silent={"gone"}).drives("gone", "other")
    world.feed("gone", 1.0, worst_s=0.4)
    world.feed("other", 1.0)
    for _ in range(SPARE_ATTEMPTS):
        world.schedule.watchdogs.by_drive["gone"].failed(0.5)
    world.schedule.watchdogs.by_drive["gone"].retry_at_s = 0.55
    world.now_s = 0.6
    world.schedule.hold("other", until_s, world.now_s)
    assert world.step() is None
    again_s = world.schedule.watchdogs.by_drive["gone"].retry_at_s
    assert again_s == pytest.approx(min(until_s, 0.6 + 1.0 / 8)), "or an eighth of a watchdog time"
    world.run(2.0)
    first, second = world.sent[:2]
    assert (first.request.drive, second.request.drive) == ("other", "gone")
    assert first.at_s == pytest.approx(until_s, abs=1e-3)
    assert world.schedule.stats(2.0).feeds["other"].lapses == 0


def test_what_fits_by_the_manual_alone_waits_for_the_feeds_that_make_room() -> None:
    world = World().drives("a", "b")
    for name, measured in (("a", True), ("b", False)):
        told = {"documented": (0.02, 0.1)} if measured else {}
        world.feed(name, 1.0, worst_s=0.3 if measured else 0.1, **told)
    world.run(5.0)
    request = world.submit("a", P.CONTROL, worst_s=0.7)
    world.run(8.0)
    assert world.outcome(request)[0] is Outcome.DONE
    assert all(feed.misses == 0 for feed in world.schedule.stats(8.0).feeds.values())
