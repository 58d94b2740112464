"""What the last five minutes of a line showed: waits, gaps, margins, by bounded rings.

Strategy: time is cut into slots of ten seconds, and of each slot only what is needed is kept: the
most, sums, and how many waits fell between two marks. Older measurements than the
window are overwritten. So the memory is bounded by the roster, however fast the line is, and
noting something is one comparison or one addition; it is done while the next drive is thinking.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Final

from lecombus.parameters import Code, Json
from lecombus.schedule.request import Priority

__all__ = ["LATELY_S", "WINDOW_S", "Highest", "RollingWindow"]

WINDOW_S: Final = 300.0
LATELY_S: Final = 30.0
"""What a gauge of the worst looks back on: longer than usual between two scrapes."""
SLOT_S: Final = 10.0
SLOTS: Final = int(WINDOW_S / SLOT_S) + 1
NEVER: Final = -1_000_000
"""The number of a slot that was not used yet: a clock may begin at 0."""

STEP: Final = 1.2
MARKS_S: Final = tuple(0.001 * STEP**step for step in range(56))
"""Marks of the waits are a fifth apart, from a millisecond to half a minute."""


class Highest:
    """The highest of what was noted within a time."""

    __slots__ = ("_most", "_number")

    def __init__(self) -> None:
        self._number = [NEVER] * SLOTS
        self._most = [0.0] * SLOTS

    def note(self, value: float, now_s: float) -> None:
        """Take a value."""
        number = int(now_s / SLOT_S)
        at = number % SLOTS
        if self._number[at] != number:
            self._number[at], self._most[at] = number, value
        elif value > self._most[at]:
            self._most[at] = value

    def most(self, now_s: float, within_s: float = WINDOW_S) -> float | None:
        """Give the highest value of so many seconds, rounded up to whole slots; None: none."""
        first = int((now_s - within_s) / SLOT_S)
        found = [
            most for number, most in zip(self._number, self._most, strict=True) if number >= first
        ]
        return max(found, default=None)


@dataclass(slots=True)
class _Slot:
    """Ten seconds of one class."""

    number: int = NEVER
    line_s: float = 0.0
    exchanges: int = 0
    failed: int = 0
    most_s: float = 0.0
    waits: list[int] = field(default_factory=lambda: [0] * (len(MARKS_S) + 1))

    def begin(self, number: int) -> None:
        """Forget what was longer ago than the window."""
        self.number = number
        self.line_s = self.most_s = 0.0
        self.exchanges = self.failed = 0
        self.waits = [0] * (len(MARKS_S) + 1)


class _Gaps:
    """How far apart the good values of one code were."""

    __slots__ = ("last_s", "longest")

    def __init__(self) -> None:
        self.last_s: float | None = None
        self.longest = Highest()


class RollingWindow:
    """The last five minutes of one line.

    Args:
        since_s: When measuring began.
    """

    def __init__(self, since_s: float = 0.0) -> None:
        self._classes = {priority: [_Slot() for _ in range(SLOTS)] for priority in Priority}
        self._gaps: dict[str, dict[Code, _Gaps]] = {}
        self._used: dict[str, Highest] = {}
        self._slack = Highest()  # of what was missing to all the time there is: negative slack
        self.cyclic_late = Highest()
        self.woken_late = Highest()
        self._since_s = since_s

    # -- what is measured -------------------------------------------------------------------------

    def exchange(
        self, priority: Priority, line_s: float, waited_s: float | None, now_s: float, *, good: bool
    ) -> None:
        """Take one exchange.

        Args:
            priority: Its class.
            line_s: Line time it took, quarantine included.
            waited_s: How long its request had waited; None: it was not the request's first.
            now_s: When it ended.
            good: It was answered, or was a multicast that went out.
        """
        number = int(now_s / SLOT_S)
        slot = self._classes[priority][number % SLOTS]
        if slot.number != number:
            slot.begin(number)
        slot.exchanges += 1
        slot.line_s += line_s
        if not good:
            slot.failed += 1
        if waited_s is not None:
            slot.waits[bisect_left(MARKS_S, waited_s)] += 1
            if waited_s > slot.most_s:
                slot.most_s = waited_s

    def value(self, drive: str, code: Code, at_s: float) -> None:
        """Record that a cyclic code was read."""
        gaps = self._gaps[drive].get(code) if drive in self._gaps else None
        if gaps is not None:
            if gaps.last_s is not None:
                gaps.longest.note(at_s - gaps.last_s, at_s)
            gaps.last_s = at_s

    def margin(self, drive: str, margin_s: float, now_s: float) -> None:
        """Take the least time that was left to a drive's watchdog since the last call."""
        if drive not in self._used:
            self._used[drive] = Highest()
        self._used[drive].note(-margin_s, now_s)

    def lowest_margins_s(self, now_s: float, within_s: float) -> dict[str, float]:
        """Give by drive the least time that was left to its watchdog within so many seconds."""
        most = {drive: used.most(now_s, within_s) for drive, used in self._used.items()}
        return {drive: -used_s for drive, used_s in most.items() if used_s is not None}

    def slack(self, slack_s: float, now_s: float) -> None:
        """Take the time that is left until the line must be free for feeding."""
        self._slack.note(-slack_s, now_s)

    def expect(self, drive: str, codes: tuple[Code, ...]) -> None:
        """Say which codes of a drive are asked for all the time."""
        self._gaps[drive] = {code: _Gaps() for code in codes}

    def forget(self, drive: str) -> None:
        """Forget a drive that left the roster."""
        self._gaps.pop(drive, None)
        self._used.pop(drive, None)

    # -- as JSON ----------------------------------------------------------------------------------

    def as_json(self, now_s: float) -> dict[str, Json]:
        """Give all of it; an open gap counts as far as it has come."""
        window_s = min(now_s - self._since_s, WINDOW_S)
        return {
            "window_s": rounded(window_s),
            "classes": {
                priority.name.lower(): self._class_json(slots, window_s, now_s)
                for priority, slots in self._classes.items()
            },
            "slack_s": rounded(self._slack.most(now_s), sign=-1.0),
            "scheduler_lateness_s": rounded(self.woken_late.most(now_s)),
            "margins_s": {
                drive: rounded(used.most(now_s), sign=-1.0) for drive, used in self._used.items()
            },
            "gaps_s": {
                drive: {str(code): _longest_s(one, now_s) for code, one in gaps.items()}
                for drive, gaps in self._gaps.items()
            },
        }

    def _class_json(self, slots: list[_Slot], window_s: float, now_s: float) -> dict[str, Json]:
        first = int((now_s - WINDOW_S) / SLOT_S)
        lately = [slot for slot in slots if slot.number >= first]
        counts = [sum(column) for column in zip(*(slot.waits for slot in lately), strict=True)]
        waits = sum(counts)
        line_s = sum(slot.line_s for slot in lately)
        covered_s = min(window_s, WINDOW_S) if window_s < WINDOW_S else now_s - first * SLOT_S
        most_s = max((slot.most_s for slot in lately), default=0.0)
        return {
            "exchanges": sum(slot.exchanges for slot in lately),
            "failed": sum(slot.failed for slot in lately),
            "utilisation": rounded(line_s / covered_s if covered_s > 0.0 else 0.0),
            "waits": waits,
            "wait_median_s": rounded(min(_median_s(counts), most_s)) if waits else None,
            "wait_most_s": rounded(most_s) if waits else None,
        }


def rounded(value: float | None, *, sign: float = 1.0) -> Decimal | None:
    """Round to microseconds."""
    return None if value is None else Decimal(f"{sign * value:.6f}")


def _median_s(counts: list[int]) -> float:
    """Give the mark below which half of the waits lie."""
    half, seen = sum(counts) / 2, 0
    for mark_s, count in zip(MARKS_S, counts, strict=False):
        seen += count
        if seen >= half:
            return mark_s
    return MARKS_S[-1]


def _longest_s(gaps: _Gaps, now_s: float) -> Decimal | None:
    longest_s = gaps.longest.most(now_s)
    if gaps.last_s is None:
        return rounded(longest_s)
    return rounded(max(longest_s or 0.0, now_s - gaps.last_s))
