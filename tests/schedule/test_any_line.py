"""Lines drawn at random, with all that can happen to them in a few seconds.

Each seed is one line. Those named here between them take every way through the schedule that needs
several things together: a drive that falls silent while it is stopped, is left alone and late,
measured times for which there is never room, requests that no watchdog leaves room for, more lost
answers tolerated than ever fit.
"""

from __future__ import annotations

import random

import pytest

from lecombus.capacity.watchdog_demand import demand_of, least_time_s
from lecombus.schedule import Priority, Request
from lecombus.schedule.watchdog_deadline import FaultHypothesis
from schedule.world import COST_S, World
from support.rosters import make_roster

P = Priority
LASTS_S = 12.0
CALM_S = 60.0
MORE_LOST = 1000  # from this seed on two or three lost answers are tolerated


class Line:
    """One line and its clients."""

    def __init__(self, seed: int) -> None:
        self.draw = draw = random.Random(seed)
        self.world = world = World()
        self.names = [f"d{number}" for number in range(draw.choice([2, 3, 5, 8, 12, 20]))]
        self.asked: list[Request] = []
        self.repeats: dict[Request, int] = {}
        world.drives(*self.names)
        world.after = self._after
        if draw.random() < 0.7:
            tolerates = [0, 1, 1] if seed < MORE_LOST else [2, 2, 3]
            faults = FaultHypothesis(
                draw.choice(tolerates), draw.choice([0.0, 0.05, 0.2, 0.4]),
                draw.choice([0.0, 0.1, 0.3, 0.5]),
            )  # fmt: skip
            world.schedule.expect(faults)
        feeds = [self._costs() for _ in self.names]
        round_s = sum(float(str(more.get("cost_s", COST_S))) for more in feeds)
        base_s = max(draw.choice([0.4, 0.6, 1.0, 1.5, 2.0]), 4 * round_s)  # a roster is refused
        for name, more in zip(self.names, feeds, strict=True):
            world.feed(name, base_s * draw.choice([1, 1, 1, 1.2, 2, 3]), **more)
        for _ in range(draw.randint(2, 6)):
            world.at(draw.uniform(1.0, 6.0), self._stop)
            world.at(draw.uniform(1.0, 8.0), self._write)
            world.at(draw.uniform(1.0, 8.0), self._leave_alone)

    def _costs(self) -> dict[str, object]:
        draw = self.draw
        if draw.random() >= 0.3:
            return {}
        measured = {"cost_s": draw.choice([0.03, 0.08, 0.15]), "worst_s": draw.choice([0.2, 0.3])}
        return measured | ({"documented": (0.02, 0.1)} if draw.random() < 0.5 else {})

    def _stop(self) -> None:
        draw, world, name = self.draw, self.world, self.draw.choice(self.names)
        if draw.random() < 0.7:
            world.silent.add(name)
        if draw.random() < 0.2:
            world.schedule.park(name, world.now_s, "silent")
        stop = world.submit(
            name, P.STOP, yields=draw.random() < 0.4, cost_s=draw.choice([0.02, 0.1, 0.25, 0.5]),
            worst_s=draw.choice([0.1, 0.3, 0.6, 1.0]),
        )  # fmt: skip
        self.asked.append(stop)
        self.repeats[stop] = draw.randint(1, 12)

    def _after(self, request: Request, reached: bool) -> bool:
        draw, world = self.draw, self.world
        if self.repeats.get(request, 0) <= request.attempts:
            return False
        if draw.random() < 0.3:
            world.schedule.hold(request.drive, world.now_s + draw.choice([0.05, 0.3, 0.8]), 0.0)
        if draw.random() < 0.1:
            world.silent.discard(request.drive)
        world.schedule.again(request, world.now_s, world.now_s + draw.choice([0.0, 0.05, 0.2]))
        return True

    def _write(self) -> None:
        draw = self.draw
        documented = draw.choice([None, (0.02, 0.1), (0.02, 0.6)])
        self.asked.append(
            self.world.submit(
                draw.choice(self.names),
                P.CONTROL,
                worst_s=draw.choice([0.1, 0.5, 0.9]),
                documented=documented,
            )
        )

    def _leave_alone(self) -> None:
        draw, world = self.draw, self.world
        until_s = world.now_s + draw.choice([0.1, 0.5])
        world.schedule.hold(draw.choice(self.names), until_s, world.now_s)

    def run(self) -> None:
        world = self.world
        world.run(LASTS_S)
        world.silent.clear()
        for name in self.names:
            world.schedule.unpark(name, world.now_s)
        world.run(LASTS_S + CALM_S)


@pytest.mark.parametrize(
    "seed", [*range(24), 80, 93, 361, 1431, 1611, 1641, 2240, 2477, 2712, 5469]
)
def test_every_request_ends_and_every_stop_is_sent_as_often_as_it_is_repeated(seed: int) -> None:
    line = Line(seed)
    line.run()
    world = line.world
    assert all(request.settled for request in line.asked)
    assert all(stop.attempts == times for stop, times in line.repeats.items())
    stats = world.schedule.stats(world.now_s)
    assert not any(stats.depth.values())
    late = [name for name, feed in stats.feeds.items() if feed.age_s > 0.95 * feed.time_s]
    assert late == [], "all are fed again when all answer again"


def test_a_line_says_the_same_whenever_it_is_run() -> None:
    runs = []
    for _ in range(2):
        line = Line(7)
        line.run()
        runs.append([(sent.at_s, sent.request.drive, sent.reached) for sent in line.world.sent])
    assert runs[0] == runs[1]


SETPOINT, STOP = (0.044, 0.214), (0.237, 0.492)
"""What writes of an 820X take at 19200 baud: one that it acknowledges soon, and its inhibit."""
HOLD_S = 0.23


def of_820x(*names: str, tolerate: int, longer: float = 1.0) -> tuple[World, FaultHypothesis]:
    """Feed drives with the shortest watchdogs that their roster may have, or longer, at 19200."""
    roster = make_roster(
        [(name, at, "820x") for at, name in enumerate(names, 1)], baud=19200,
        line=f"tolerate: {tolerate}", drive="",
        watchdog="{time: 60000ms, action: quick-stop, configure: true}",
    )  # fmt: skip
    demand = demand_of(roster)
    time_s = least_time_s(demand, all_alike=True)
    assert time_s is not None
    world = World().drives(*names)
    world.schedule.expect(demand.faults)
    for name, stream in zip(names, demand.streams, strict=True):
        world.feed(name, longer * time_s, cost_s=stream.cost_s, worst_s=demand.lost_s)
    world.run(2.0)
    return world, demand.faults


def write_and_hold(world: World, priority: Priority, times_s: tuple[float, float]) -> None:
    """Write to `a`, and leave it alone after that, as its module may acknowledge early."""
    cost_s, worst_s = times_s
    write = world.submit("a", priority, cost_s=cost_s, worst_s=worst_s, hold_s=HOLD_S)
    while not write.attempts:
        world.run(world.now_s + 0.01)
    world.schedule.hold("a", world.now_s + HOLD_S, world.now_s)


def lapsed(world: World) -> list[str]:
    """Name the drives whose watchdogs acted."""
    feeds = world.schedule.stats(world.now_s).feeds
    return [name for name, feed in feeds.items() if feed.lapses]


WRITES = [(P.CONTROL, SETPOINT), (P.STOP, STOP)]


@pytest.mark.parametrize("tolerate", [0, 1])
@pytest.mark.parametrize("write", WRITES)
def test_the_watchdog_of_a_lone_drive_outlasts_that_it_is_left_alone_after_a_write(
    write: tuple[Priority, tuple[float, float]], tolerate: int
) -> None:
    """With 0 a lone 820X might have 270 ms, and is not fed for 230 ms after a write (130627)."""
    world, _ = of_820x("a", tolerate=tolerate)
    for _ in range(5):
        write_and_hold(world, *write)
        world.run(world.now_s + 1.0)
    assert lapsed(world) == []


@pytest.mark.parametrize("tolerate", [0, 1])
@pytest.mark.parametrize("write", WRITES)
@pytest.mark.parametrize("other", ["a", "b"])
@pytest.mark.parametrize("after_ms", range(0, 300, 20))
def test_a_stop_while_a_drive_is_left_alone_after_a_write_makes_no_watchdog_act(
    *, other: str, after_ms: int, write: tuple[Priority, tuple[float, float]], tolerate: int
) -> None:
    """If an answer may be lost, it is that of the stop."""
    world, faults = of_820x("a", "b", tolerate=tolerate)
    write_and_hold(world, *write)
    world.run(world.now_s + after_ms / 1000)
    world.silent = {other} if tolerate else set()
    stop = world.submit(other, P.STOP, cost_s=STOP[0], worst_s=faults.stop_failed_s)

    def again(request: Request, reached: bool) -> bool:
        if request is stop and not reached:
            world.schedule.again(stop, world.now_s, world.now_s)
        return request is stop and not reached

    world.after = again
    while not stop.attempts:
        world.step()
    world.silent = set()
    world.run(world.now_s + 3.0)
    assert lapsed(world) == []


@pytest.mark.parametrize("tolerate", range(4))
@pytest.mark.parametrize(("takes_s", "longer"), [(0.083, 1.0), (0.26, 1.0), (0.26, 1.2)])
@pytest.mark.parametrize("seed", range(10))
def test_members_of_a_multicast_that_are_left_alone_after_it_are_fed_in_time(
    *, seed: int, takes_s: float, longer: float, tolerate: int
) -> None:
    """It feeds none of them, each is left alone for 230 ms after it, and what is tolerated comes.

    That is a stop of one of them, and then the lost answers, right behind the time for which they
    are left alone.
    """
    world, faults = of_820x("a", "b", tolerate=tolerate, longer=longer)
    feeds = world.schedule.watchdogs
    random_ = random.Random(seed)
    world.run(world.now_s + random_.random())
    sent = 0
    for _ in range(6):
        for name in "ab":
            for _ in range(random_.randrange(12)):
                world.submit(name, P.INTERACTIVE, cost_s=0.045, worst_s=0.15)
        write = world.submit(
            "g", P.CONTROL, cost_s=takes_s, worst_s=takes_s, members=("a", "b"), writes=True,
            hold_s=HOLD_S,
        )  # fmt: skip
        while not write.attempts and not write.settled:
            world.run(world.now_s + 0.005)
        if write.attempts:
            sent += 1
            for name in "ab":
                world.schedule.hold(name, world.now_s + HOLD_S, world.now_s)
            world.run(world.now_s + random_.choice([0.0, 0.1, HOLD_S]))
            world.submit(random_.choice("ab"), P.STOP, cost_s=faults.stop_s, worst_s=0.6)
            lose(world, tolerate, random_)
        world.run(world.now_s + 2.0 * feeds.shortest_s())
    assert lapsed(world) == []
    assert sent == (0 if feeds.never(write) else 6), "it is sent, or never fits"


def lose(world: World, count: int, random_: random.Random) -> None:
    """Lose so many answers, of what goes next, but for stops."""
    lost = 0
    while lost < count:
        world.silent = {"a", "b"} if random_.random() < 0.7 else set()
        if world.schedule.stops():
            world.silent = set()
        before = len(world.sent)
        world.run(world.now_s + 0.001)
        lost += sum(not one.reached for one in world.sent[before:])
    world.silent = set()
