"""Loses answers at the worst moments, exactly as many within a watchdog time as it is told.

One loss follows the other: the first when the watchdogs have least time left for it, or when a stop
is under way (on a line whose clients ask seldom, only then); the others hit what goes out directly
after it, which by then is mostly feeds. Then
none for as long as the longest watchdog time. An exchange that leaves no room for that many at any
time, such as a read of a module's own slow codes, is hit alone, or not at all; where only a stop
besides is too much, the burst that it begins leaves room for one and ends with it, and a stop
directly behind it is hit alone. Half of the answers are lost on the way back; else the drive has
not heard the question, and is not fed by it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random

from lecombus.capacity.exchange_costs import watched_s
from lecombus.capacity.watchdog_demand import demand_of, least_time_s
from lecombus.config import Roster
from lecombus.fieldbus.lecom.simulator.faults import Faults
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.line_runtime import LineRuntime
from lecombus.schedule import Priority
from proof.lines import ADDRESSES, FAMILIES, RandomLine, groups_of
from support.lecom_loop import lecom_loop
from support.rosters import make_roster

__all__ = ["MOST_TOLERATED", "Losses", "TolerantLine", "tolerant_line"]

MOST_TOLERATED = 3
"""The most that `line.tolerate` takes."""
NEAR = 1.2
"""An exchange that leaves the watchdogs no more than this part of the least seen is hit."""
LAST_PART = 0.1
"""Of a watchdog time: an exchange that only this part of it holds is not an exception."""
LONGER, LONGEST = 1.6, 4.0
"""Times the least watchdog time: then there is room for a write to an 820X, or for a module's own
codes, which take half a second."""
STOP_LOST, STOP_LOST_IDLE = 0.3, 0.7
"""Part of the stops whose answer is lost, where other answers are lost too and where none are."""
GROUPS_FROM = 150_000
"""The first line on which clients write to groups."""
LEARNT_IN = 3.0
"""Watchdog times after which the least seen is forgotten: the load has changed."""


@dataclass(frozen=True)
class TolerantLine(RandomLine):
    """A line whose watchdogs are as short as the roster's hypothesis allows.

    Args:
        losses: So many answers are lost within any watchdog time.
        idle: One client asks for one thing after the other: mostly feeds go, and stops are lost.
    """

    losses: int = 0
    idle: bool = False

    @property
    def is_loaded(self) -> bool:
        """Whether clients ask for more than the line can do."""
        return not self.idle

    @property
    def is_idle(self) -> bool:
        """Whether one client asks for one thing after the other, and mostly feeds go."""
        return self.idle

    @property
    def writes_groups(self) -> bool:
        """Whether clients also write to groups by multicast: often, but on idle lines."""
        return has_groups(self.seed)

    @property
    def is_saturated(self) -> bool:
        """Whether clients also write setpoints as fast as they are done."""
        return self.seed % 2 == 0


def has_groups(seed: int) -> bool:
    """Whether a line has groups: half have, from a seed on. Earlier ones stay what they were."""
    return seed >= GROUPS_FROM and seed // 64 % 2 == 1


def tolerant_line(seed: int, *, tolerate: int, losses: int, length_s: float) -> TolerantLine:
    """Draw a line whose watchdogs just outlast so many lost answers.

    On a sixth they are longer: there is room for exchanges, not for each with all that may follow.
    On as many clients ask seldom, mostly to write and then to stop, and the stop is what is lost:
    feeds then keep as little room as they ever do.
    """
    random = Random(seed)
    count = random.choice((2, 3, 5, 8, 12, 20, 31))
    drives = sorted(
        {random.choice(ADDRESSES): random.choice(FAMILIES) for _ in range(count)}.items()
    )
    baud = random.choice((1200, 4800, 9600, 19200, 19200))
    few = random.choice(("cyclic: []", "", "cyclic: [{code: C0150, every: 1s}]"))

    def roster(time_ms: int) -> Roster:
        return make_roster(
            [(f"d{address}", address, kind) for address, kind in drives],
            baud=baud, line=f"tolerate: {tolerate}", drive=few,
            watchdog=f"{{time: {time_ms}ms, action: quick-stop, configure: true}}",
            sections=groups_of(drives, multicast=True) if has_groups(seed) else "",
        )  # fmt: skip

    while (least_s := least_time_s(demand_of(roster(60000)), all_alike=True)) is None:
        drives = drives[: len(drives) // 2]  # no time of so many outlasts so much
    of, turn = divmod(seed // 16, 4)
    special = turn == 3  # a quarter of the lines, a third of these for each
    if special and of % 3:
        least_s *= random.uniform(1.0, LONGER if of % 3 == 2 else LONGEST)
    return TolerantLine(
        seed, "tolerant", roster(math.ceil(round(least_s * 1000, 3))), "", length_s,
        losses=losses, idle=special and of % 3 < 2,
    )  # fmt: skip


class Losses:
    """Loses the answers of one line.

    Args:
        line: The line.
        sim: Its drives.
        site: What runs it.
    """

    def __init__(self, line: TolerantLine, sim: SimLine, site: LineRuntime) -> None:
        self._count = line.losses
        self._idle = line.idle
        self._sim = sim
        self._site = site
        self._random = Random(line.seed + 2)
        self._time_s = max(watched_s(drive) or 0.0 for drive in line.roster.drives)
        self._left = 0  # of this burst
        self._ends_by_stop = False  # this burst
        self._took_room = False  # the last exchange but stops left none for a stop and all losses
        self._next_s = 0.0
        self._least_s = float("inf")
        self._least_at_s = 0.0
        self.lost = 0

    def said(self, address: int, now_s: float) -> None:
        """A telegram goes out; decide whether its answer is lost."""
        self._sim.drive_faults.clear()
        is_stop = self._is_stop()
        took_room = self._took_room
        if not is_stop:
            self._took_room = self._leaves_no_room(stops=1)
        if now_s < self._next_s:
            return
        too_long = not self._left and (took_room if is_stop else self._leaves_no_room())
        if self._left and self._ends_by_stop and is_stop:
            self._end_burst(now_s)
        elif not self._left and self._is_worst(now_s):
            self._left = 1 if too_long else self._count
            self._ends_by_stop = not is_stop and self._took_room
            while self._ends_by_stop and self._left > 1 and self._leaves_no_room(
                stops=1, lost=self._left
            ):  # fmt: skip
                self._left -= 1
        elif too_long and not is_stop:
            self._next_s = now_s + self._time_s
        if self._left and address % 10:
            self._left -= 1
            self.lost += 1
            heard = self._random.random() < 0.5
            self._sim.drive_faults[address] = Faults(lost=1.0) if heard else Faults(unheard=1.0)
            if not self._left:
                self._end_burst(now_s)

    def _end_burst(self, now_s: float) -> None:
        self._left = 0
        self._next_s = now_s + self._time_s
        self._least_s = float("inf")

    def _is_stop(self) -> bool:
        under_way = lecom_loop(self._site.worker).under_way
        return under_way is not None and under_way[0].priority is Priority.STOP

    def _leaves_no_room(self, *, stops: int = 0, lost: int | None = None) -> bool:
        """Whether what is sent leaves no room for what is tolerated, whenever it begins.

        Args:
            stops: That are answered besides, and wait for nothing.
            lost: So many answers; None: as many as are tolerated.
        """
        tolerate = self._site.schedule.watchdogs.faults.tolerate
        under_way = lecom_loop(self._site.worker).under_way
        feeds = self._site.schedule.watchdogs
        if under_way is None or under_way[0].priority is Priority.STOP or tolerate < 2:
            return False
        cost_s, worst_s = under_way[0].cost_s, under_way[0].worst_s
        lost_s = max(feed.worst_s for feed in feeds.by_drive.values())
        lost = tolerate if lost is None else lost
        needed_s = (lost - 1) * lost_s + max(worst_s, cost_s + lost_s)
        needed_s += stops * feeds.faults.stop_s
        return needed_s > feeds.most_s(under_way[0].drive)[0] + LAST_PART * feeds.shortest_s()

    def _is_worst(self, now_s: float) -> bool:
        under_way = lecom_loop(self._site.worker).under_way
        if under_way is None or not self._count:
            return False
        request = under_way[0]
        if request.priority is Priority.STOP or self._idle:
            hit = STOP_LOST_IDLE if self._idle else STOP_LOST
            return request.priority is Priority.STOP and self._random.random() < hit
        alone_s = request.hold_s if request.members else 0.0  # it feeds none of them
        left_s = self._site.schedule.watchdogs.slack_s(now_s) - request.worst_s - alone_s
        if now_s > self._least_at_s + LEARNT_IN * self._time_s:
            self._least_s = float("inf")
        if left_s < self._least_s:
            self._least_s, self._least_at_s = left_s, now_s
            return False
        return left_s <= max(NEAR * self._least_s, self._least_s + 0.005)
