"""Lower classes get their share and no more; absent drives get theirs and no more."""

from __future__ import annotations

from itertools import pairwise

import pytest

from lecombus.schedule import Priority, Schedule
from lecombus.schedule.request import DispatchReason
from lecombus.schedule.shares import Shares
from schedule.world import COST_S, World

P = Priority


def _loaded(*classes: Priority) -> World:
    world = World().drives("a", "b", "c")
    for priority in classes:
        world.saturate(priority, ["a", "b", "c"])
    return world


def test_every_class_gets_its_share_behind_saturating_control() -> None:
    world = _loaded(P.CONTROL, P.INTERACTIVE, P.BACKGROUND)
    for name in "abc":
        world.cyclic(name, 0.03)
    world.run(60.0)
    assert world.busy_s(P.INTERACTIVE) / 60 == pytest.approx(0.15, abs=0.01)
    assert world.busy_s(P.CYCLIC) / 60 == pytest.approx(0.20, abs=0.01)
    assert world.busy_s(P.BACKGROUND) / 60 == pytest.approx(0.05, abs=0.01)
    assert world.busy_s(P.CONTROL) / 60 == pytest.approx(0.60, abs=0.02)


def test_shares_hold_when_watchdogs_must_be_kept_too() -> None:
    world = _loaded(P.CONTROL, P.INTERACTIVE, P.BACKGROUND)
    for name in "abc":
        world.feed(name, 1.0)
        world.cyclic(name, 0.03)
    world.run(60.0)
    assert world.busy_s(P.INTERACTIVE) / 60 == pytest.approx(0.15, abs=0.01)
    assert world.busy_s(P.BACKGROUND) / 60 == pytest.approx(0.05, abs=0.01)
    assert sum(feed.misses for feed in world.schedule.stats(60.0).feeds.values()) == 0


def test_cyclic_keeps_its_share_behind_saturating_interactive() -> None:
    world = _loaded(P.INTERACTIVE)
    for name in "abc":
        world.cyclic(name, 0.03)
    world.run(60.0)
    assert world.busy_s(P.CYCLIC) / 60 == pytest.approx(0.20, abs=0.01)


def test_a_cycle_that_needs_less_than_its_share_is_held_behind_saturating_interactive() -> None:
    world = _loaded(P.INTERACTIVE)
    world.cyclic("a", 0.5)
    world.run(60.0)
    assert len(world.starts(lambda r: r.priority is P.CYCLIC)) == 120
    assert world.schedule.stats(60.0).stretch == 1.0


def test_background_never_delays_a_higher_class_by_more_than_one_exchange() -> None:
    world = _loaded(P.BACKGROUND)
    for number in range(200):
        world.at(0.013 + number * 0.1, lambda: world.submit("a", P.INTERACTIVE))
    world.run(25.0)
    waits = [
        s.at_s - s.request.submitted_at_s for s in world.sent if s.request.priority is P.INTERACTIVE
    ]
    assert len(waits) == 200
    assert max(waits) <= 0.02 + 1e-9


def test_background_by_its_share_never_goes_twice_in_a_row_before_others() -> None:
    world = _loaded(P.CONTROL, P.BACKGROUND)
    world.run(60.0)
    kinds = [sent.request.priority for sent in world.sent]
    assert kinds.count(P.BACKGROUND) > 100
    assert (P.BACKGROUND, P.BACKGROUND) not in set(pairwise(kinds))


def test_a_lone_control_request_lets_nobody_go_first_whatever_others_have_saved_up() -> None:
    world = _loaded(P.INTERACTIVE, P.BACKGROUND)
    for name in "abc":
        world.cyclic(name, 0.03)
    for number in range(100):
        world.at(5.0 + number * 0.1, lambda: world.submit("a", P.CONTROL))
    world.run(20.0)
    waits = [
        s.at_s - s.request.submitted_at_s for s in world.sent if s.request.priority is P.CONTROL
    ]
    assert len(waits) == 100
    assert max(waits) <= 0.02 + 1e-9


def test_a_control_request_among_many_lets_one_exchange_go_after_each_of_its_own() -> None:
    world = _loaded(P.CONTROL, P.INTERACTIVE, P.BACKGROUND)
    for name in "abc":
        world.cyclic(name, 0.03)
    world.run(60.0)
    kinds = [sent.request.priority for sent in world.sent]
    others = [pair for pair in pairwise(kinds) if P.CONTROL not in pair]
    assert others == []


def test_long_control_exchanges_leave_each_class_its_turn() -> None:
    world = World().drives("a", "b", "c")
    world.saturate(P.CONTROL, ["a", "b"], cost_s=0.3)
    for priority in (P.INTERACTIVE, P.BACKGROUND):
        world.saturate(priority, ["c"])
    world.cyclic("c", 0.03)
    world.run(60.0)
    kinds = [sent.request.priority for sent in world.sent]
    for priority in (P.INTERACTIVE, P.CYCLIC, P.BACKGROUND):
        assert kinds.count(priority) >= len(kinds) / 2 / 3 - 2, priority


def test_idle_classes_save_nothing_up() -> None:
    world = _loaded(P.CONTROL)
    world.run(30.0)
    for _ in range(50):
        world.submit("b", P.INTERACTIVE)
    since = len(world.sent)
    world.run(31.0)
    first = [sent.request.priority for sent in world.sent[since : since + 5]]
    assert P.INTERACTIVE not in first


def _most_in_window(world: World, window_s: float) -> float:
    sent = [s for s in world.sent if s.request.drive.startswith("x")]
    return max(
        sum(
            min(s.end_s, at.at_s + window_s) - s.at_s
            for s in sent
            if 0 <= s.at_s - at.at_s < window_s
        )
        for at in sent
    )


def _absent(number: int, share: float = 0.10, worst_s: float = 0.1) -> World:
    world = World(Schedule(absent_share=share)).drives("here")
    for index in range(number):
        name = f"x{index}"
        world.drives(name)
        world.silent.add(name)
        world.probe(name, worst_s=worst_s)
        world.schedule.park(name, 0.0, "silent")
    return world


@pytest.mark.parametrize("worst_s", [0.05, 0.3, 0.7])
def test_thirty_absent_drives_take_no_more_than_their_share_in_any_window(worst_s: float) -> None:
    world = _absent(30, worst_s=worst_s)
    world.run(300.0)
    assert _most_in_window(world, 30.0) <= 3.0 + 1e-6
    probed = {sent.request.drive for sent in world.sent}
    assert len(probed) == 30


def test_a_single_absent_drive_is_probed_at_once_and_then_with_backoff() -> None:
    world = _absent(1)
    world.run(130.0)
    starts = [sent.at_s for sent in world.sent]
    assert starts == pytest.approx([0, 1, 3, 7, 15, 31, 61, 91, 121], abs=0.2)


def test_backoff_starts_again_when_a_drive_was_back_in_between() -> None:
    world = _absent(1)
    world.run(40.0)
    world.schedule.unpark("x0", world.now_s)
    world.run(100.0)
    since = len(world.sent)
    world.schedule.park("x0", world.now_s, "silent")
    world.run(104.0)
    assert [sent.at_s for sent in world.sent[since:]] == pytest.approx([100, 101, 103], abs=0.2)


def test_probes_leave_the_others_their_cycle() -> None:
    world = _absent(30)
    world.cyclic("here", 0.2)
    world.run(60.0)
    assert len(world.starts(lambda request: request.drive == "here")) == 300


def test_a_probe_and_its_next_steps_go_out_though_the_drive_is_parked() -> None:
    world = _absent(1)
    steps: list[bool] = []

    def after(request: object, reached: bool) -> bool:
        steps.append(reached)
        if len(steps) < 3:
            world.schedule.again(world.sent[-1].request, world.now_s)
            return True
        return False

    world.after = after
    world.run(0.5)
    assert len(steps) == 3


def test_no_share_means_no_probe() -> None:
    world = _absent(3, share=0.0)
    world.run(60.0)
    assert world.sent == []


def test_credit_of_the_class_that_goes_by_right_keeps_no_other_from_its_turn() -> None:
    """Seed 32840 of the proof: feeds took most of the line, and background waited for 9 s."""
    shares, waiting = Shares(), {P.CYCLIC: COST_S, P.BACKGROUND: COST_S}
    assert shares.entitled(waiting, P.CYCLIC) is None
    for _ in range(100):
        shares.book(P.WATCHDOG, DispatchReason.FEED, COST_S)
    shares.book(P.CYCLIC, DispatchReason.RIGHT, COST_S)
    assert shares.foresee(waiting, P.CYCLIC, None, 0.0) is P.BACKGROUND
    assert shares.entitled(waiting, P.CYCLIC) is P.BACKGROUND
    shares.book(P.BACKGROUND, DispatchReason.CREDIT, COST_S)
    assert shares.entitled(waiting, P.CYCLIC) is None, "no class goes first twice in a row"
