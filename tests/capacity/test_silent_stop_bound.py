"""What a stop of a silent drive is promised, and that the daemon reckons with the same figures."""

from __future__ import annotations

from functools import partial

import pytest

from lecombus.capacity.exchange_costs import dearest_feed_times, stop_attempt_s
from lecombus.capacity.plan import make_plan
from lecombus.config import line_timing
from lecombus.drives import StopAction, family
from lecombus.drives.stops import STOP_PATIENCE_S
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker
from lecombus.fieldbus.requests import Station
from lecombus.schedule import ignore_end
from lecombus.schedule.watchdog_deadline import WatchdogDeadline, WatchdogFeeding
from lecombus.schedule.watchdog_set import WatchdogSet

from .rosters import line_of


@pytest.mark.parametrize("kind", ["820x", "8200vector", "93xx", "smvector"])
def test_an_attempt_is_as_long_as_the_request_says(kind: str) -> None:
    roster = line_of(1, only=kind)
    timing = line_timing(roster.line)
    drive, of = roster.drives[0], family(kind)
    maker = LecomRequestMaker(timing, 2, lambda priority, outcome: None)
    made = [
        maker.stop(
            Station("a", 1, of, drive.forms), action, word=lambda: None, said=False,
            settle=ignore_end,
        ).worst_s
        for action in StopAction
    ]  # fmt: skip
    assert max(made) == pytest.approx(stop_attempt_s(drive, timing))


def test_it_waits_for_one_round_of_feeds_and_the_exchange_under_way() -> None:
    few, many = (make_plan(line_of(count, time="4s", baud=19200, only="93xx")) for count in (5, 25))
    roster = line_of(5, time="4s", baud=19200, only="93xx")
    feed_s = dearest_feed_times(roster.drives[0], line_timing(roster.line)).usual_s
    longer_s = many.silent_stop.quiet_s - few.silent_stop.quiet_s
    assert longer_s == pytest.approx(20 * feed_s)
    assert few.silent_stop.quiet_s < few.silent_stop.loaded_s
    assert few.silent_stop.telegrams > many.silent_stop.telegrams > 1


def test_the_round_is_that_of_the_running_schedule() -> None:
    roster = line_of(7, time="4s", baud=19200)
    timing = line_timing(roster.line)
    maker = LecomRequestMaker(timing, 2, lambda priority, outcome: None)
    feeds = WatchdogSet()
    for drive in roster.drives:
        of = family(drive.family)
        station = Station(drive.name, drive.address, of, drive.forms)
        make = partial(maker.feed, station, ())
        feeding = WatchdogFeeding(4.0, make)
        feeds.by_drive[drive.name] = WatchdogDeadline(drive.name, feeding, 0.0)
    planned_s = sum(dearest_feed_times(drive, timing).usual_s for drive in roster.drives)
    assert feeds.round_s() == pytest.approx(planned_s)


def test_on_a_slow_line_at_least_three_telegrams_go_out() -> None:
    plan = make_plan(line_of(60, time="60s", baud=1200))
    assert plan.silent_stop.quiet_s > STOP_PATIENCE_S
    assert plan.silent_stop.telegrams == 3
