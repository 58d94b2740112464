"""Whether the line may be left idle, and until when: cyclic and background work do not count."""

from __future__ import annotations

import pytest

from lecombus.schedule import Priority, Request
from schedule.world import World

P = Priority


def submitted(world: World, priority: Priority) -> Request:
    request = world.request(priority=priority)
    world.schedule.submit(request, world.now_s)
    return request


@pytest.mark.parametrize("priority", [P.STOP, P.CONTROL, P.INTERACTIVE])
def test_what_somebody_waits_for_presses(priority: Priority) -> None:
    world = World().drives("a")
    assert world.schedule.wanted_at_s(0.0) > 0.0
    submitted(world, priority)
    assert world.schedule.wanted_at_s(0.0) == 0.0
    assert not world.schedule.may_idle(0.0, 0.1)


def test_cyclic_and_background_work_does_not() -> None:
    world = World().drives("a")
    world.cyclic("a", 0.1)
    submitted(world, P.BACKGROUND)
    assert world.schedule.may_idle(50.0, 1.0)


def test_a_held_drive_s_request_presses_when_the_hold_ends() -> None:
    world = World().drives("a")
    world.schedule.hold("a", 0.5, 0.0)
    submitted(world, P.INTERACTIVE)
    assert world.schedule.wanted_at_s(0.0) == pytest.approx(0.5)
    assert world.schedule.wanted_at_s(0.5) == 0.5


def test_a_line_is_not_idle_for_longer_than_its_watchdogs_allow() -> None:
    world = World().drives("a", "b")
    world.feed("a", 2.0)
    # A feed takes 0.02 s and must be over at 1.8 s.
    assert world.schedule.may_idle(0.5, 1.2)
    assert not world.schedule.may_idle(0.5, 1.3)


def test_a_feed_that_is_due_presses() -> None:
    world = World().drives("a")
    world.feed("a", 2.0)
    wanted_s = world.schedule.wanted_at_s(0.0)
    assert 1.0 < wanted_s < 1.8
    assert world.schedule.wanted_at_s(wanted_s + 0.001) == pytest.approx(wanted_s + 0.001)
