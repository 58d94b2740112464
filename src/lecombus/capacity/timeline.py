"""The running schedule over a roster, on a simulated clock, and its picture.

`preview` gives the same `Schedule` that a daemon runs the roster's feeds and cyclic reads; every
exchange takes its usual time. So the picture shows what the line really does.

`picture` draws that as an SVG: one row for the line and one for each drive, one box an exchange,
one tick a deadline, one dashed line an end of the hyperperiod. No scripts; names are escaped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html import escape
from typing import Final

from lecombus.capacity.exchange_costs import Times, feed_times, read_times, watched_s
from lecombus.capacity.load import Load, load_on
from lecombus.capacity.watchdog_demand import faults_of
from lecombus.fieldbus.costs import LineTiming
from lecombus.roster import Roster
from lecombus.schedule import Cyclic, Outcome, Priority, Request, Schedule, WatchdogFeeding
from lecombus.schedule.watchdog_deadline import HARD_PART

__all__ = ["Preview", "Span", "hyperperiod_s", "picture", "preview"]

LONGEST_S: Final = 10.0
"""More than this is not seen in a picture."""
SHORTEST_S: Final = 1.0
LOOKED_AT_S: Final = 20.0
"""Run this long to measure shares of the line: a picture may be too short for a feed."""
SETTLED_S: Final = 5.0
"""After this the staggering of a start is over."""
FULL_PART: Final = 0.99
"""So much of the line is all of it: a line that has more time than that catches up."""
SHORT_PART: Final = 1.02
"""Reads that are short of what is asked by less than this are so by where the run was cut off."""


@dataclass(frozen=True, slots=True)
class Span:
    """One exchange.

    Args:
        drive: With whom.
        kind: `cyclic` or `watchdog`.
        what: The code that is read; for a feed beside the cyclic reads, `feed`.
        start_s: When it begins, seconds from the picture's left.
        end_s: When the line is free again.
    """

    drive: str
    kind: str
    what: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Preview:
    """A stretch of a line's time.

    Args:
        length_s: How long it is: the hyperperiod of the cyclic reads, within bounds.
        whole_s: That hyperperiod itself, stretched as the reads are; 0: nothing is read cyclically.
        stretch: By how much the schedule stretches the cyclic periods; 1: not.
        spans: The exchanges, in order.
        deadlines: For each watched drive, when its feed has to be over.
        cyclic: The share of the line that cyclic reads take, also beyond the picture.
        feeding: The share that feeds beside them take.
    """

    length_s: float
    whole_s: float
    stretch: float
    spans: tuple[Span, ...]
    deadlines: dict[str, tuple[float, ...]]
    cyclic: float
    feeding: float

    @property
    def total(self) -> float:
        """The share of the line that is taken."""
        return self.cyclic + self.feeding

    def as_json(self) -> dict[str, float]:
        """Give what the exchanges take, for `--json`."""
        found = {"cyclic": self.cyclic, "feeding": self.feeding, "total": self.total}
        found |= {"hyperperiod_s": self.whole_s}
        return {name: round(value, 6) for name, value in found.items()}


def preview(roster: Roster, timing: LineTiming) -> Preview:
    """Run the schedule over a roster and write down one hyperperiod."""
    schedule = Schedule(absent_share=roster.line.absent_share)
    schedule.expect(faults_of(roster, timing))
    for drive in roster.drives:
        schedule.add_drive(drive.name)
        for entry in drive.cyclic:
            times = read_times(drive, entry.code, timing)
            make = _maker(drive.name, Priority.CYCLIC, times, str(entry.code))
            schedule.add_cyclic(Cyclic(drive.name, entry.every_s, make), 0.0)
        time_s = watched_s(drive)
        if time_s is not None:
            make = _maker(drive.name, Priority.WATCHDOG, feed_times(drive, timing), "feed")
            schedule.set_feeding(drive.name, WatchdogFeeding(time_s, make), 0.0)
    spans = _run(schedule, SETTLED_S + LOOKED_AT_S)
    run = [_moved(one) for one in spans if one.end_s > SETTLED_S]
    cyclic, feeding = _share(run, "cyclic"), _share(run, "watchdog")
    stretch = _reached(load_on(roster.drives, timing), cyclic, feeding)
    whole_s = hyperperiod_s(roster) * stretch
    length_s = min(max(whole_s, SHORTEST_S), LONGEST_S)
    return Preview(
        length_s, whole_s, stretch, tuple(one for one in run if one.start_s < length_s),
        _due(spans, roster, length_s), cyclic, feeding,
    )  # fmt: skip


def _reached(load: Load, cyclic: float, feeding: float) -> float:
    """Give the factor by which cyclic periods grow, from the shares of the line that were taken.

    Feeds that keep room for lost answers and stops take turns with reads. Where short watchdogs
    never leave that much room, these feeds go all the time, and take more than must be.
    """
    if cyclic + feeding < FULL_PART or load.cyclic < SHORT_PART * cyclic * load.stretch:
        return load.stretch
    return load.cyclic / cyclic


def _share(spans: list[Span], kind: str) -> float:
    taken_s = sum(min(one.end_s, LOOKED_AT_S) - one.start_s for one in spans if one.kind == kind)
    return taken_s / LOOKED_AT_S


def _maker(drive: str, priority: Priority, times: Times, what: str) -> Callable[[], Request]:
    return lambda: Request(drive, priority, times.usual_s, times.worst_s, _ended, work=what)


def _ended(outcome: Outcome, reason: str) -> None:
    """Ignore it: no client waits for these requests."""


def _run(schedule: Schedule, until_s: float) -> list[Span]:
    spans: list[Span] = []
    now_s = 0.0
    while now_s < until_s:
        request = schedule.next(now_s)
        if request is None:
            wake_s = schedule.wake_at_s(now_s)
            if wake_s is None:
                break
            now_s = max(wake_s, now_s + 1e-6)
            continue
        end_s = now_s + request.cost_s
        kind = "watchdog" if request.priority is Priority.WATCHDOG else "cyclic"
        spans.append(Span(request.drive, kind, str(request.work), now_s, end_s))
        schedule.finished(request, now_s, end_s, reached=True)
        request.end(Outcome.DONE)
        now_s = end_s
    return spans


def _moved(span: Span) -> Span:
    """Count from the picture's left edge; an exchange under way then is shown from there on."""
    return replace(span, start_s=max(span.start_s - SETTLED_S, 0.0), end_s=span.end_s - SETTLED_S)


def _due(spans: list[Span], roster: Roster, length_s: float) -> dict[str, tuple[float, ...]]:
    """Find the deadlines that fall into the picture, also those that were set before it."""
    hard_s = {
        drive.name: HARD_PART * time_s for drive in roster.drives if (time_s := watched_s(drive))
    }
    due: dict[str, list[float]] = {}
    for span in spans:
        if span.drive in hard_s:
            at_s = span.start_s + hard_s[span.drive] - SETTLED_S
            if 0.0 <= at_s <= length_s:
                due.setdefault(span.drive, []).append(at_s)
    return {name: tuple(times) for name, times in due.items()}


def hyperperiod_s(roster: Roster) -> float:
    """Give the time after which the cyclic reads come again in the same order; 0: none."""
    periods = {round(entry.every_s * 1000) for drive in roster.drives for entry in drive.cyclic}
    return math.lcm(*periods) / 1000 if periods else 0.0


WIDTH: Final = 1000
NAMES: Final = 150
ROW: Final = 18
TOP: Final = 86
BOX: Final = 12
ROOM: Final = NAMES - 18
SIZE: Final = 11
USUAL, WIDE = 6.2, 9.5  # of a character at that size, about
COLOURS: Final = {"cyclic": "#3b6ea5", "watchdog": "#c2662d"}
STYLE: Final = (
    "text{font:11px sans-serif;fill:#222}.head{font-size:14px}.grid{stroke:#ddd}"
    ".due{stroke:#b00020;stroke-width:1.5}.round{stroke:#222;stroke-dasharray:4 3}"
)
MOST_ROUNDS: Final = 50
"""More ends of a hyperperiod than these would hide the picture, and are not drawn."""


def picture(title: str, drives: tuple[str, ...], shown: Preview) -> str:
    """Draw a stretch of a line's time.

    Args:
        title: What stands above it.
        drives: The rows, from the top.
        shown: What happens.

    Returns:
        An SVG document.
    """
    height = TOP + ROW * (len(drives) + 1) + 30
    rows = {name: TOP + ROW * number for number, name in enumerate(drives, 1)}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" role="img">',
        f"<title>{escape(title)}</title><style>{STYLE}</style>",
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        f'<text class="head" x="10" y="22">{escape(title)}</text>',
        f'<text x="10" y="40">{escape(_about(shown))}</text>',
        *_legend(),
        *_grid(shown.length_s, height),
        *_rounds(shown, height),
        _name("the line", TOP),
        *(_box(span, TOP, shown.length_s, "") for span in shown.spans),
        *(_name(name, y) for name, y in rows.items()),
        *(_box(span, rows[span.drive], shown.length_s, _told(span)) for span in shown.spans),
        *_deadlines(shown, rows),
        "</svg>",
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def _about(shown: Preview) -> str:
    """Say how much of the hyperperiod is shown, and how full it is."""
    taken = (
        f"{shown.total:.0%} of the time is taken: reads {shown.cyclic:.0%}, feeds "
        f"{shown.feeding:.0%}"
    )
    if not shown.whole_s:
        return f"no cyclic reads; {shown.length_s:g} s are shown; {taken}"
    whole = f"{shown.whole_s:g} s"
    if shown.stretch > 1.0:
        whole = f"{shown.whole_s:.2f} s, stretched by {shown.stretch:.2f}"
    if shown.whole_s > shown.length_s:
        part = f"its first {shown.length_s:g} s are shown"
    elif shown.whole_s < shown.length_s:
        part = f"{shown.length_s:g} s are shown"
    else:
        part = "all of it is shown"
    return f"hyperperiod of the cyclic reads: {whole}, {part}; {taken}"


def _x(at_s: float, length_s: float) -> float:
    return NAMES + (WIDTH - NAMES - 20) * min(at_s, length_s) / length_s


def _legend() -> Iterator[str]:
    x = NAMES
    for word, colour in (("cyclic read", COLOURS["cyclic"]), ("feed", COLOURS["watchdog"])):
        yield f'<rect x="{x}" y="52" width="12" height="{BOX}" fill="{colour}"/>'
        yield f'<text x="{x + 17}" y="62">{word}</text>'
        x += 110
    for kind, word in (
        ("due", "by then it must have been fed again"), ("round", "end of a hyperperiod"),
    ):  # fmt: skip
        yield f'<line class="{kind}" x1="{x}" y1="52" x2="{x}" y2="64"/>'
        yield f'<text x="{x + 6}" y="62">{word}</text>'
        x += 230


def _grid(length_s: float, height: int) -> Iterator[str]:
    for tenth in range(11):
        at_s = length_s * tenth / 10
        x = _x(at_s, length_s)
        yield f'<line class="grid" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 24}"/>'
        yield f'<text x="{x - 10:.1f}" y="{height - 10}">{at_s:g} s</text>'


def _rounds(shown: Preview, height: int) -> Iterator[str]:
    """Mark where the cyclic reads begin again."""
    count = int(shown.length_s / shown.whole_s + 1e-9) if shown.whole_s else 0
    for number in range(1, count + 1) if count <= MOST_ROUNDS else ():
        x = _x(shown.whole_s * number, shown.length_s)
        yield f'<line class="round" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 24}"/>'


def _name(name: str, y: float) -> str:
    """Write a row's name, smaller where it would reach into the picture."""
    wide = sum(WIDE if one in "mwMW" else USUAL for one in name)
    fitted = "" if wide <= ROOM else f' style="font-size:{SIZE * ROOM / wide:.1f}px"'
    return f'<text x="10" y="{y + BOX - 2}"{fitted}>{escape(name)}</text>'


def _told(span: Span) -> str:
    return f"{span.drive}, {span.what}: {span.start_s:.3f} s to {span.end_s:.3f} s"


def _box(span: Span, y: float, length_s: float, about: str) -> str:
    left, right = _x(span.start_s, length_s), _x(span.end_s, length_s)
    shape = (
        f'<rect x="{left:.2f}" y="{y}" width="{max(right - left, 0.4):.2f}" height="{BOX}" '
        f'fill="{COLOURS[span.kind]}"'
    )
    return f"{shape}><title>{escape(about)}</title></rect>" if about else f"{shape}/>"


def _deadlines(shown: Preview, rows: dict[str, int]) -> Iterator[str]:
    for name, times in shown.deadlines.items():
        for at_s in times:
            x = _x(at_s, shown.length_s)
            y = rows[name]
            yield f'<line class="due" x1="{x:.2f}" y1="{y}" x2="{x:.2f}" y2="{y + BOX}"/>'
