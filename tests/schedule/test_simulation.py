"""Random loads in virtual time: what holds for every schedule, whatever comes."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from lecombus.errors import QueueFullError
from lecombus.schedule import Outcome, Priority, Request, Schedule
from lecombus.schedule.watchdog_deadline import HARD_PART
from schedule.world import World

P = Priority
NAMES = ["a", "b", "c", "d"]
LIMITS = {P.CONTROL: 8, P.INTERACTIVE: 12, P.BACKGROUND: 20}


class Chaos:
    """Everything that can happen to a schedule, drawn from one seed."""

    def __init__(self, seed: int, until_s: float = 20.0) -> None:
        self.random = Random(seed)
        self.world = World(Schedule(limits=LIMITS)).drives(*NAMES)
        self.submitted: list[Request] = []
        self.holds: list[tuple[str, float, float]] = []
        self.until_s = until_s
        self.world.after = self.after
        for name in NAMES:
            if self.random.random() < 0.7:
                self.world.feed(name, self.random.uniform(0.4, 3.0))
            for _ in range(self.random.randrange(3)):
                self.world.cyclic(name, self.random.uniform(0.05, 2.0))
            self.world.probe(name)
        deeds = [self.ask] * 12 + [self.stop, self.silence, self.hold, self.park, self.lose]
        for _ in range(300):
            at_s = self.random.uniform(0.0, until_s)
            self.world.at(at_s, self.random.choice(deeds))

    def after(self, request: Request, reached: bool) -> bool:
        if request.attempts < 3 and self.random.random() < (0.1 if reached else 0.6):
            pause_s = self.random.choice([0.0, 0.0, 0.05, 0.5])
            self.world.schedule.again(request, self.world.now_s, self.world.now_s + pause_s)
            return True
        return False

    def ask(self) -> None:
        random, world = self.random, self.world
        drive = random.choice([*NAMES, "group"])
        request = world.request(
            drive,
            random.choice([P.CONTROL, P.CONTROL, P.INTERACTIVE, P.BACKGROUND]),
            worst_s=random.choice([0.03, 0.1, 0.6]),
            writes=random.random() < 0.4,
            supersedes=(drive, random.randrange(2)) if random.random() < 0.4 else None,
            expires_at_s=world.now_s + random.uniform(0, 1) if random.random() < 0.3 else None,
            members=("a", "b") if drive == "group" else (),
        )
        try:
            world.schedule.submit(request, world.now_s)
        except QueueFullError:
            return
        self.submitted.append(request)

    def stop(self) -> None:
        stops = tuple(self.random.sample(NAMES, self.random.randint(1, 3)))
        self.submitted.append(self.world.submit(stops[0], P.STOP, stops=stops))

    def silence(self) -> None:
        self.world.silent.symmetric_difference_update({self.random.choice(NAMES)})

    def hold(self) -> None:
        name, until_s = self.random.choice(NAMES), self.world.now_s + self.random.uniform(0, 0.5)
        self.world.schedule.hold(name, until_s, self.world.now_s)
        self.holds.append((name, self.world.now_s, until_s))

    def park(self) -> None:
        name = self.random.choice(NAMES)
        self.world.schedule.park(name, self.world.now_s, "silent")
        back_s = self.world.now_s + self.random.uniform(0, 3)
        self.world.at(back_s, lambda: self.world.schedule.unpark(name, self.world.now_s))

    def lose(self) -> None:
        if self.random.random() < 0.1:
            self.holds = [(n, f, min(u, self.world.now_s)) for n, f, u in self.holds]
            self.world.schedule.fail_all(self.world.now_s, "lost")

    def run(self) -> World:
        self.world.run(self.until_s)
        self.world.schedule.fail_all(self.world.now_s, "the end")
        return self.world


@settings(max_examples=40, deadline=None, phases=[Phase.generate])  # a seed cannot be shrunk
@given(st.integers(min_value=0, max_value=2**32))
def test_what_always_holds(seed: int) -> None:
    always_holds(seed)


@pytest.mark.parametrize("seed", range(20))
def test_what_held_before_holds(seed: int) -> None:
    always_holds(seed)


def always_holds(seed: int) -> None:
    chaos = Chaos(seed)
    world = chaos.run()
    _each_ends_once(chaos, world)
    _ends_tell_the_truth(world)
    _nothing_overtakes_a_stop(chaos, world)
    _held_drives_are_left_alone(chaos, world)
    depth = world.schedule.stats(world.now_s).depth
    assert sum(depth.values()) == 0


def _each_ends_once(chaos: Chaos, world: World) -> None:
    ended = [request for request, _, _, _ in world.ended]
    assert len({id(request) for request in ended}) == len(ended)
    missing = {id(request) for request in chaos.submitted} - {id(request) for request in ended}
    assert not missing


def _ends_tell_the_truth(world: World) -> None:
    sent = {id(s.request): s.at_s for s in reversed(world.sent)}  # the first time of each
    for request, outcome, _, _ in world.ended:
        if outcome in (Outcome.EXPIRED, Outcome.SUPERSEDED) and (
            request.writes or request.supersedes is not None
        ):
            assert id(request) not in sent
        if outcome is Outcome.EXPIRED:
            assert id(request) not in sent
        if outcome is Outcome.DONE:
            assert id(request) in sent
        if id(request) in sent and request.expires_at_s is not None:
            assert sent[id(request)] < request.expires_at_s


def _nothing_overtakes_a_stop(chaos: Chaos, world: World) -> None:
    stops = [r for r in chaos.submitted if r.priority is P.STOP]
    first = {id(s.request): s.at_s for s in reversed(world.sent)}
    for stop in stops:
        waits_till = first.get(id(stop), stop.submitted_at_s)  # a lost line may have ended it
        for sent in world.sent:
            if stop.submitted_at_s <= sent.at_s < waits_till:
                feeds = sent.request.priority is P.WATCHDOG and stop.drive in sent.silent
                assert sent.request.priority is P.STOP or feeds
            moves = set(sent.request.members or (sent.request.drive,)) & set(stop.stops)
            if sent.request.writes and moves and sent.request.serial < stop.serial:
                assert sent.at_s < stop.submitted_at_s or sent.at_s == stop.submitted_at_s


def _held_drives_are_left_alone(chaos: Chaos, world: World) -> None:
    for name, from_s, until_s in chaos.holds:
        for sent in world.sent:
            if from_s <= sent.at_s < until_s and sent.request.priority is not P.STOP:
                assert name not in (sent.request.members or (sent.request.drive,))


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_no_feed_is_late_on_a_feasible_line(data: st.DataObject) -> None:
    number = data.draw(st.integers(1, 12))
    costs = data.draw(st.lists(st.floats(0.005, 0.05), min_size=number, max_size=number))
    least_s = (2 * sum(costs) + max(costs)) / HARD_PART
    world = World().drives("other")
    for index, cost_s in enumerate(costs):
        world.drives(f"d{index}")
        time_s = least_s * data.draw(st.sampled_from([1.0, 1.1, 2.0, 10.0]))
        world.feed(f"d{index}", time_s, cost_s=cost_s, worst_s=cost_s * 3)
        if data.draw(st.booleans()):
            world.cyclic(f"d{index}", data.draw(st.floats(0.02, 3.0)), cost_s=cost_s)
    for priority in (P.CONTROL, P.INTERACTIVE, P.BACKGROUND):
        worst_s = data.draw(st.floats(0.01, 1.0))
        part = data.draw(st.floats(0.1, 1.0))
        if worst_s < least_s / 8:
            drives = data.draw(st.sampled_from([["other"], ["d0", "other"]]))
            world.saturate(priority, drives, cost_s=worst_s * part, worst_s=worst_s)
    world.run(15.0)
    for feed in world.schedule.stats(world.now_s).feeds.values():
        assert feed.misses == 0
        assert feed.margin_least_s >= feed.time_s * (1 - HARD_PART) - 1e-9


def test_the_own_feed_that_goes_before_an_exchange_makes_no_other_late() -> None:
    costs = [0.03125, 0.03125, 0.03125, 0.015625, 0.0234375, 0.005859375]
    time_s = (2 * sum(costs) + max(costs)) / HARD_PART
    world = World().drives("other")
    for index, cost_s in enumerate(costs):
        world.drives(f"d{index}")
        world.feed(f"d{index}", time_s, cost_s=cost_s, worst_s=cost_s * 3)
    world.cyclic("d2", 1.0, cost_s=costs[2])  # it may take longer than its drive's feed
    world.saturate(P.CONTROL, ["other"], cost_s=0.015625, worst_s=0.015625)
    world.run(15.0)
    assert {feed.misses for feed in world.schedule.stats(world.now_s).feeds.values()} == {0}


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.4, 3.0), min_size=1, max_size=12), st.sampled_from([0.0, 0.01, 0.05]))
def test_without_overload_every_slot_stands_on_its_grid(
    periods: list[float], other_s: float
) -> None:
    world = World().drives("other")
    if other_s > 0.0:
        world.saturate(P.BACKGROUND, ["other"], cost_s=other_s)
    for index, period_s in enumerate(periods):
        world.drives(f"d{index}")
        world.cyclic(f"d{index}", period_s)
    world.run(30.0)
    late_most_s = other_s + 0.02 * len(periods)  # all others may be due at the same moment
    for index, period_s in enumerate(periods):
        starts = [sent.at_s for sent in world.sent if sent.request.drive == f"d{index}"]
        phase_s = starts[0] - (starts[0] % period_s if starts[0] < period_s else 0.0)
        late = [start - phase_s - number * period_s for number, start in enumerate(starts)]
        assert max(late) - min(late) <= late_most_s + 1e-9
        assert len(starts) == pytest.approx(30.0 / period_s, abs=2)
    assert world.schedule.stats(30.0).stretch == 1.0


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(0.1, 1.0), min_size=5, max_size=12), st.floats(1.2, 4.0))
def test_overload_stretches_evenly(periods: list[float], load: float) -> None:
    scale = load / sum(1 / period_s for period_s in periods)  # the cost that makes this load
    world = World()
    for index, period_s in enumerate(periods):
        world.drives(f"d{index}")
        world.cyclic(f"d{index}", period_s, cost_s=scale, worst_s=scale)
    until_s = 60 * max(periods)
    world.run(until_s)
    half_s = until_s / 2
    for index, period_s in enumerate(periods):
        runs = [s.at_s for s in world.sent if s.request.drive == f"d{index}" and s.at_s > half_s]
        achieved_s = (runs[-1] - runs[0]) / (len(runs) - 1)
        assert achieved_s / period_s == pytest.approx(load, rel=0.05)
