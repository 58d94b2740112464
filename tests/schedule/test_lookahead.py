"""Choices made beforehand: they are those that would have been made in haste, or none."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from lecombus.schedule import Outcome, Priority, Request
from schedule.test_simulation import Chaos
from schedule.world import COST_S, World

P = Priority
Line = list[tuple[float, str, Priority, bool]]


def line_of(world: World) -> Line:
    """What went out when; a probe's bucket is filled in other steps, which rounds differently."""
    return [(round(s.at_s, 9), s.request.drive, s.request.priority, s.reached) for s in world.sent]


@settings(max_examples=40, deadline=None, phases=[Phase.generate])  # a seed cannot be shrunk
@given(st.integers(min_value=0, max_value=2**32))
def test_whatever_happens_the_line_is_the_same_with_rehearsals(seed: int) -> None:
    same_with_rehearsals(seed)


@pytest.mark.parametrize("seed", range(8))
def test_what_happened_before_leaves_the_line_the_same_with_rehearsals(seed: int) -> None:
    same_with_rehearsals(seed)


def same_with_rehearsals(seed: int) -> None:
    plain, rehearsed = Chaos(seed), Chaos(seed)
    rehearsed.world.rehearses = True
    worlds = plain.run(), rehearsed.run()
    assert line_of(worlds[1]) == line_of(worlds[0])
    ends = [
        sorted((round(at_s, 9), o, reason) for _, o, reason, at_s in world.ended)
        for world in worlds
    ]
    assert ends[1] == ends[0]


def loaded(seed: int, *, follows: bool) -> World:
    """A full line of all classes, most of it known from the beginning."""
    random, world = Random(seed), World(rehearses=follows, follows=follows)
    for name in "abcdef":
        world.drives(name)
        world.cyclic(name, random.choice([0.1, 0.2, 1.0]))
        if random.random() < 0.5:
            world.feed(name, random.uniform(1.5, 4.0))
    for _ in range(150):
        world.submit(random.choice("abcdef"), random.choice([P.BACKGROUND, P.INTERACTIVE]))
    for _ in range(20):
        drive, motion = random.choice("abcdef"), random.random() < 0.5

        def control(drive: str = drive, motion: bool = motion) -> None:
            world.submit(drive, P.CONTROL, writes=motion, supersedes=(drive,))

        world.at(random.uniform(0.0, 10.0), control)
        world.at(random.uniform(0.0, 10.0), lambda d=drive: world.submit(d, P.STOP, stops=(d,)))  # type: ignore[misc]
    return world.run(12.0)


@settings(max_examples=30, deadline=None, phases=[Phase.generate])
@given(st.integers(min_value=0, max_value=2**32))
def test_what_is_begun_before_the_exchange_is_booked_is_what_would_have_been_begun_after_it(
    seed: int,
) -> None:
    same_when_followed(seed)


@pytest.mark.parametrize("seed", range(4))
def test_what_was_begun_before_the_exchange_was_booked_is_what_would_have_been_begun_after_it(
    seed: int,
) -> None:
    same_when_followed(seed)


def same_when_followed(seed: int) -> None:
    plain, followed = loaded(seed, follows=False), loaded(seed, follows=True)
    assert line_of(followed) == line_of(plain)
    assert followed.followed > len(followed.sent) / 4, "the plain case is the usual one"
    margins = [
        {name: feed.margin_least_s for name, feed in w.schedule.stats(w.now_s).feeds.items()}
        for w in (plain, followed)
    ]
    assert margins[1] == margins[0]


def full_line() -> tuple[World, Request]:
    """A line with more to say than it can; the first exchange is under way."""
    world = World().drives("a", "b", "c")
    for name in "abc":
        world.cyclic(name, 0.01)
    first = world.schedule.next(0.0)
    assert first is not None
    assert world.schedule.look_ahead(first, 0.0, COST_S) is not None
    assert world.schedule.planned(COST_S) is not None
    return world, first


def _feed(world: World) -> None:
    world.feed("b", 1.0)


SPOILERS: dict[str, Callable[[World], object]] = {
    "a setpoint": lambda w: w.submit("c", P.CONTROL),
    "a stop": lambda w: w.submit("c", P.STOP, stops=("c",)),
    "a hold": lambda w: w.schedule.hold("b", 1.0, 0.0),
    "parking": lambda w: w.schedule.park("b", 0.0, "silent"),
    "removal": lambda w: w.schedule.remove_drive("b", 0.0, "gone"),
    "a watchdog": _feed,
    "a cyclic read": lambda w: w.cyclic("c", 0.5),
    "a lost line": lambda w: w.schedule.fail_all(0.0, "lost"),
}


@pytest.mark.parametrize("change", SPOILERS.values(), ids=SPOILERS)
def test_a_change_spoils_what_was_foreseen(change: Callable[[World], object]) -> None:
    world, _ = full_line()
    change(world)
    assert world.schedule.planned(COST_S) is None


def test_a_failed_exchange_spoils_what_was_foreseen() -> None:
    world, first = full_line()
    world.schedule.finished(first, 0.0, COST_S, reached=False)
    assert world.schedule.planned(COST_S) is None


def test_a_slot_is_not_run_before_it_is_due_because_it_was_foreseen() -> None:
    world = World().drives("a", "b")
    world.cyclic("a", 1.0)
    world.cyclic("b", 1.0)  # half a period after the other
    first = world.schedule.next(0.0)
    assert first is not None
    slot = world.schedule.look_ahead(first, 0.0, 0.6)
    assert slot is not None
    assert slot.drive == "b"
    assert world.schedule.planned(0.49) is None
    assert world.schedule.planned(0.51) is slot
    world.schedule.finished(first, 0.0, 0.49, reached=True)
    assert world.schedule.next(0.49) is None


def test_a_request_is_not_begun_after_its_expiry_because_it_was_foreseen() -> None:
    world, first = full_line()
    ask = world.submit("c", P.INTERACTIVE, expires_at_s=0.03)
    assert world.schedule.look_ahead(first, 0.0, COST_S) is ask
    assert world.schedule.planned(0.031) is None
    world.schedule.finished(first, 0.0, 0.031, reached=True)
    assert world.schedule.next(0.031) is not ask
    assert world.outcome(ask)[0] is Outcome.EXPIRED


def test_a_watchdog_goes_before_what_was_foreseen_if_the_answer_takes_its_time() -> None:
    world = World().drives("a", "b")
    world.feed("a", 1.0)
    world.schedule.next(0.0)  # computes the bounds
    for _ in range(100):
        world.submit("b", P.BACKGROUND, worst_s=0.1)
    under_way = world.schedule.next(0.0)
    assert under_way is not None
    chosen = world.schedule.look_ahead(under_way, 0.0, COST_S)
    assert chosen is not None
    assert chosen.drive == "b"
    assert world.schedule.planned(0.85) is None
    world.schedule.finished(under_way, 0.0, 0.85, reached=True)
    fed = world.schedule.next(0.85)
    assert fed is not None
    assert fed.drive == "a"


@pytest.mark.parametrize("hold_s", [0.0, 0.5])
def test_a_write_behind_which_its_drive_may_not_be_fed_in_time_is_not_foreseen(
    hold_s: float,
) -> None:
    """Its feed goes first: that is seen when the line is free."""
    world = World().drives("a")
    world.feed("a", 1.0)
    world.schedule.next(0.0)  # computes the bounds
    write = world.submit("a", P.CONTROL, writes=True, hold_s=hold_s)
    foreseen = world.schedule.look_ahead(None, 0.5, 0.5)
    assert (foreseen is write) is (hold_s == 0.0)
    chosen = world.schedule.next(0.5)
    assert chosen is not None
    assert (chosen is write) is (hold_s == 0.0)


def test_a_stop_is_foreseen_whatever_else_waits() -> None:
    world, first = full_line()
    world.feed("b", 0.05)
    halt = world.submit("c", P.STOP, stops=("c",))
    assert world.schedule.look_ahead(first, 0.0, COST_S) is halt
    assert world.schedule.planned(0.0) is halt
    assert world.schedule.planned(10.0) is halt
