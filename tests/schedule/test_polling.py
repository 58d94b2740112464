"""Cycles keep an absolute grid, and are stretched evenly when the line is too slow."""

from __future__ import annotations

import pytest

from lecombus.schedule import Cyclic, Priority
from lecombus.schedule.polling import Polling
from schedule.world import World

P = Priority


def _of(drive: str, world: World) -> list[float]:
    return world.starts(lambda request: request.drive == drive)


def test_slots_stand_on_the_grid_without_drift() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 0.3)
    world.saturate(P.BACKGROUND, ["b"], cost_s=0.033)
    world.run(300.0)
    starts = _of("a", world)
    assert len(starts) == 1000
    late = [start - number * 0.3 for number, start in enumerate(starts)]
    assert min(late) >= -1e-6
    assert max(late) <= 0.033 + 1e-6


def test_entries_of_equal_period_are_spread_evenly() -> None:
    world = World().drives(*"abcd")
    for name in "abcd":
        world.cyclic(name, 1.0)
    world.run(0.99)
    assert [sent.at_s for sent in world.sent] == pytest.approx([0.0, 0.25, 0.5, 0.75])


def test_a_short_burst_is_caught_up_and_the_grid_kept() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 1.0)
    world.at(1.9, lambda: world.submit("b", P.CONTROL, cost_s=0.8))
    world.run(6.0)
    assert _of("a", world) == pytest.approx([0.0, 1.0, 2.7, 3.0, 4.0, 5.0])
    assert world.schedule.stats(6.0).stretch == 1.0


def test_a_pause_longer_than_a_period_is_not_caught_up_twice() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 1.0)
    world.at(1.5, lambda: world.submit("b", P.CONTROL, cost_s=5.0))
    world.run(8.6)
    # Slot 2 runs at 6.5, one period late by the shifted grid; slot 3 at once after it.
    assert _of("a", world) == pytest.approx([0.0, 1.0, 6.5, 6.52, 7.5, 8.5])


def test_overload_stretches_all_cycles_by_the_same_factor() -> None:
    world = World().drives(*"abcdef")
    periods = dict(zip("abcdef", (0.04, 0.05, 0.06, 0.3, 0.5, 1.0), strict=True))
    for name, period_s in periods.items():
        world.cyclic(name, period_s)
    load = sum(0.02 / period_s for period_s in periods.values())
    world.run(200.0)
    ratios = [200.0 / len(_of(name, world)) / period_s for name, period_s in periods.items()]
    assert ratios == pytest.approx([load] * 6, rel=0.05)
    assert world.schedule.stats(200.0).stretch == pytest.approx(load, rel=0.05)


def test_stretch_returns_to_one_after_the_overload() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 0.1)
    entry = world.cyclic("b", 0.02)
    world.run(20.0)
    assert world.schedule.stats(20.0).stretch > 1.1
    world.schedule.remove_cyclic(entry)
    world.run(32.0)
    assert world.schedule.stats(32.0).stretch == 1.0


def test_cycles_that_wait_and_never_run_show_as_stretched() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 0.1)
    world.step()
    world.now_s = 8.0
    assert world.schedule.stats(8.0).stretch > 3.0


def test_a_held_drive_skips_slots_and_does_not_stretch_the_others() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 0.1)
    world.cyclic("b", 0.1)
    world.at(1.0, lambda: world.schedule.hold("a", 3.01, world.now_s))
    world.run(5.0)
    assert world.schedule.stats(5.0).stretch == 1.0
    assert world.schedule.stats(5.0).cyclic_skipped >= 19
    assert len(_of("b", world)) == 50
    again = [start for start in _of("a", world) if start > 3.03]
    off_grid = [round((start - _of("a", world)[0]) / 0.1, 3) % 1 for start in again]
    assert off_grid == [0.0] * len(again)


def test_a_parked_drive_rejoins_at_the_present() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 1.0)
    world.cyclic("b", 1.0)
    world.at(2.2, lambda: world.schedule.park("a", world.now_s, "silent"))
    world.at(7.2, lambda: world.schedule.unpark("a", world.now_s))
    world.run(9.9)
    assert [s for s in _of("a", world) if s > 2.2] == pytest.approx([7.2, 8.2, 9.2])
    assert len(_of("b", world)) == 10
    assert world.schedule.stats(9.9).stretch == 1.0


def test_a_fresh_request_is_made_for_every_slot() -> None:
    world = World().drives("a")
    world.cyclic("a", 0.1)
    world.run(0.95)
    assert len({id(sent.request) for sent in world.sent}) == len(world.sent) == 10


def test_a_removed_entry_is_asked_no_longer() -> None:
    world = World().drives("a")
    entry = world.cyclic("a", 0.1)
    world.run(0.5)
    world.schedule.remove_cyclic(entry)
    count = len(world.sent)
    world.run(2.0)
    assert len(world.sent) == count
    assert world.schedule.wake_at_s(2.0) is None


def test_a_slot_stands_back_for_two_of_its_periods_at_most() -> None:
    polling = Polling()
    entry = polling.add(Cyclic("a", 0.5, World().drives("a").request))
    polling.first()
    polling.take(entry, 0.0)  # its next slot is at 0.5 s
    assert polling.may_wait(entry, 1.49)
    assert not polling.may_wait(entry, 1.51)


def test_an_entry_that_left_while_it_was_set_apart_does_not_come_back() -> None:
    polling, world = Polling(), World()
    entry = polling.add(Cyclic("a", 1.0, lambda: world.request("a", P.CYCLIC)))
    polling.set_apart(entry)
    polling.leave(entry)
    polling.rejoin(entry, 5.0)
    assert (entry.active, polling.skipped, polling.early("a", 9.0)) == (False, 0, None)
