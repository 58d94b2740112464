"""Samples read when the page is rendered: the store's values and the schedule's state.

Strategy: nothing is copied into gauges while the line works. When a page is wanted, the store is
asked drive by drive and the schedule once, and the lines are written straight. A value that is
not good is left out, not repeated: a monitoring system must never take an old value for a fresh
one, and an absent series is what its own staleness rules understand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from lecombus.drive_state.store import DriveState, LineState, Quality, Reading, Store
from lecombus.drives import Family
from lecombus.errors import OperationError
from lecombus.event_stream import KINDS
from lecombus.journal.journal import JournalFigures
from lecombus.metrics.counters import label_of
from lecombus.metrics.exposition import Block, escape
from lecombus.schedule.request import Priority

__all__ = ["DriveGauges", "JournalGauges", "LeaseFigures", "LineGauges", "LineSnapshot"]


@dataclass(frozen=True, slots=True)
class LeaseFigures:
    """What the metrics show of leases.

    Args:
        held: How many are held.
        lapses: By drive, how often its lease lapsed.
        latched: The drives that have a lease or need one, and whether each is latched.
        holding: Those that run on without a controller, by `on_lapse: hold`.
        silenced: Those that are sent nothing.
    """

    held: int
    lapses: Mapping[str, int]
    latched: Mapping[str, bool]
    holding: frozenset[str]
    silenced: frozenset[str]


@dataclass(frozen=True, slots=True)
class LineSnapshot:
    """What the schedule and the supervisor say about themselves at this moment.

    Args:
        queue_depth: Requests waiting, by class. stretch: How far the cyclic cadence is stretched, 1
        or more. lateness_s: How late the latest cyclic read of late was, seconds.
        watchdog_margin_s: By drive, time left until its watchdog would fire, seconds.
        watchdog_lowest_s: By drive, the least that was left in the last 30 seconds, seconds.
        watchdog_time_s: By drive, the time set in its watchdog, seconds.
        watchdog_misses: By drive, how often a feed came too late. refused: By class, requests the
        schedule refused so far. cyclic_skipped: Cyclic reads passed over so far. writes: By drive
        and code, writes that may have reached the drive's memory, over its whole life.
        slack_s: Time left until the line must be free for feeding; None: nothing is fed.
        woken_late_s: How late the line's task was woken at most of late, seconds.
        answer_ratio: By drive, the slowest answer measured over the manual's longest time.
        leases: Who controls what; None: no drive needs a lease, and none was taken.
        journal: The journal's size and state; None: there is none.
        events: Events published, by kind. event_readers: How many read them now.
        event_readers_dropped: How many were cut because they did not keep up.
    """

    queue_depth: Mapping[Priority, int] = field(default_factory=dict)
    stretch: float = 1.0
    lateness_s: float = 0.0
    watchdog_margin_s: Mapping[str, float] = field(default_factory=dict)
    watchdog_misses: Mapping[str, int] = field(default_factory=dict)
    refused: Mapping[Priority, int] = field(default_factory=dict)
    cyclic_skipped: int = 0
    writes: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    slack_s: float | None = None
    woken_late_s: float = 0.0
    answer_ratio: Mapping[str, float] = field(default_factory=dict)
    leases: LeaseFigures | None = None
    journal: JournalFigures | None = None
    events: Mapping[str, int] = field(default_factory=dict)
    event_readers: int = 0
    event_readers_dropped: int = 0
    watchdog_lowest_s: Mapping[str, float] = field(default_factory=dict)
    watchdog_time_s: Mapping[str, float] = field(default_factory=dict)


class LineGauges:
    """The samples that stand for the line as a whole.

    Args:
        line: The line's name.
    """

    def __init__(self, line: str) -> None:
        self._line = f'line="{escape(line)}"'
        self._leases = LeaseGauges(line)
        self._watchdogs = WatchdogGauges(line)
        self._up = gauge("line_up", "1 while the port is open.")
        self._depth = gauge("queue_depth", "Requests waiting, by class.")
        self._stretch = gauge(
            "cyclic_stretch_ratio", "1 when every cyclic read keeps its period, 2 at half the rate."
        )
        self._late = gauge(
            "cyclic_lateness_seconds",
            "Longest delay of a cyclic read in the last 30 seconds.",
        )
        self._woken = gauge(
            "scheduler_lateness_seconds",
            "Longest delay in waking the line's task in the last 30 seconds.",
        )
        self._slack = gauge(
            "schedule_slack_seconds",
            "Time left until the line must be free to feed a watchdog; absent while none is fed.",
        )
        self._answers = gauge(
            "drive_answer_ratio",
            "Slowest answer time measured / longest in the manual, without the adapter's delay.",
        )
        self._refused = counter(
            "schedule_refusals",
            "Requests that the schedule refused: queue full, drive offline, line lost, no room.",
        )
        self._skipped = counter(
            "cyclic_skipped",
            "Cyclic reads skipped: the drive was held back, or a feed was sent first.",
        )
        self._events = counter("events", "Events recorded for readers of /v1/events, by kind.")
        self._readers = gauge("event_readers", "Clients that read /v1/events now.")
        self._dropped = counter(
            "event_readers_dropped", "Readers of events that were cut: they did not keep up."
        )
        self._writes = counter(
            "parameter_writes",
            "Writes that may have reached a drive's memory, never reset; other: undescribed codes.",
        )

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The families, in the order of the page."""
        return (
            *(self._up, self._depth, self._refused, self._stretch, self._late, self._skipped),
            *(self._woken, self._slack, *self._watchdogs.blocks, self._writes, self._answers),
            *self._leases.blocks,
            *(self._events, self._readers, self._dropped),
        )

    def render(self, store: Store, snapshot: LineSnapshot) -> None:
        """Write the lines of every family."""
        line = self._line
        up = store.line().state is LineState.OPEN
        self._up.add(line, int(up))
        self._stretch.add(line, snapshot.stretch)
        self._late.add(line, snapshot.lateness_s)
        self._woken.add(line, snapshot.woken_late_s)
        if snapshot.slack_s is not None:
            self._slack.add(line, snapshot.slack_s)
        self._skipped.add(line, snapshot.cyclic_skipped)
        self._readers.add(line, snapshot.event_readers)
        self._dropped.add(line, snapshot.event_readers_dropped)
        for kind in KINDS:
            self._events.add(f'{line},kind="{kind}"', snapshot.events.get(kind, 0))
        for priority in Priority:
            label = f'{line},priority="{label_of(priority)}"'
            self._depth.add(label, snapshot.queue_depth.get(priority, 0))
            self._refused.add(label, snapshot.refused.get(priority, 0))
        self._watchdogs.render(snapshot)
        for drive, ratio in snapshot.answer_ratio.items():
            self._answers.add(f'{line},drive="{escape(drive)}"', ratio)
        for drive, writes in snapshot.writes.items():
            label = f'{line},drive="{escape(drive)}",code="'
            for code, count in writes.items():
                self._writes.add(f'{label}{code}"', count)
        if snapshot.leases is not None:
            self._leases.render(snapshot.leases)


class WatchdogGauges:
    """The samples of the drives' watchdogs.

    Args:
        line: The line's name.
    """

    def __init__(self, line: str) -> None:
        self._line = f'line="{escape(line)}"'
        self._margin = gauge(
            "watchdog_margin_seconds", "Time left until the drive's watchdog would fire."
        )
        self._lowest = gauge(
            "watchdog_margin_lowest_seconds",
            "Least time that was left to the drive's watchdog in the last 30 seconds.",
        )
        self._time = gauge(
            "watchdog_time_seconds", "Time after which the drive's watchdog acts, as it is set."
        )
        self._misses = counter("watchdog_misses", "Feeds that were later than the watchdog time.")

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The families, in the order of the page."""
        return (self._margin, self._lowest, self._time, self._misses)

    def render(self, snapshot: LineSnapshot) -> None:
        """Write the lines of every family."""
        for block, figures in (
            (self._margin, snapshot.watchdog_margin_s),
            (self._lowest, snapshot.watchdog_lowest_s),
            (self._time, snapshot.watchdog_time_s),
            (self._misses, snapshot.watchdog_misses),
        ):
            for drive, figure in figures.items():
                block.add(f'{self._line},drive="{escape(drive)}"', figure)


class LeaseGauges:
    """The samples of leases.

    Args:
        line: The line's name.
    """

    def __init__(self, line: str) -> None:
        self._line = f'line="{escape(line)}"'
        self._leases = gauge("leases", "Leases that are held.")
        self._lapses = counter("lease_lapses", "Leases that lapsed while they held the drive.")
        self._latched = gauge(
            "drive_latched",
            "1 while the drive takes no setpoint: it must be enabled under a lease.",
        )
        self._holding = gauge(
            "drive_without_controller", "1 while it runs on after its lease ended (on_lapse: hold)."
        )
        self._silenced = gauge(
            "drive_silenced", "1 while it is sent nothing, so that its own watchdog acts."
        )

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The families, in the order of the page."""
        return (self._leases, self._lapses, self._latched, self._holding, self._silenced)

    def render(self, leases: LeaseFigures) -> None:
        """Write the lines of every family."""
        self._leases.add(self._line, leases.held)
        for drive, latched in leases.latched.items():
            label = f'{self._line},drive="{escape(drive)}"'
            self._lapses.add(label, leases.lapses[drive])
            self._latched.add(label, int(latched))
            self._holding.add(label, int(drive in leases.holding))
            self._silenced.add(label, int(drive in leases.silenced))


class JournalGauges:
    """The samples of the journal; none where the line has none.

    Args:
        line: The line's name.
    """

    def __init__(self, line: str) -> None:
        self._line = f'line="{escape(line)}"'
        self._up = gauge("journal_up", "1 while the journal can be written.")
        self._size = gauge("journal_size_bytes", "Size of the journal's file and its log.")
        self._rows = counter("journal_rows", "Rows written to the journal, since the start.")
        self._failures = counter(
            "journal_failures", "How often the journal began to fail, since the start."
        )
        self._missed = counter(
            "journal_missed_rows", "Rows lost because the journal failed for long, since the start."
        )

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The families, in the order of the page."""
        return (self._up, self._size, self._rows, self._failures, self._missed)

    def render(self, journal: JournalFigures | None) -> None:
        """Write the lines of every family."""
        if journal is None:
            return
        self._up.add(self._line, int(journal.works))
        self._size.add(self._line, journal.size_bytes)
        self._rows.add(self._line, journal.rows)
        self._failures.add(self._line, journal.failures)
        self._missed.add(self._line, journal.missed)


class DriveGauges:
    """The samples that are written drive by drive.

    Args:
        line: The line's name.
    """

    def __init__(self, line: str) -> None:
        self._line = f'line="{escape(line)}"'
        self._up = gauge("drive_up", "1 while the drive answers (online or degraded).")
        self._value = gauge(
            "drive_value",
            "Cyclic values as last read; a value that is stale or bad is left out.",
        )
        self._not_good = gauge(
            "drive_values_not_good", "Cyclic codes whose value is stale or bad and so left out."
        )
        self._bit = gauge(
            "drive_status_bit", "Bits of the status words that the manual names; 1 when set."
        )
        self._fault = gauge("drive_fault", "1 while a status word of the drive reports a fault.")
        self._number = gauge(
            "drive_fault_number",
            "LECOM number of the drive's fault, message or warning, where it is known.",
        )

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The families, in the order of the page."""
        return (self._up, self._value, self._not_good, self._bit, self._fault, self._number)

    def render(self, store: Store, drive: str) -> None:
        """Write the lines of one drive; one that has left the roster has none."""
        try:
            info = store.drive(drive)
            family = store.family(drive)
            readings = store.readings(drive, cyclic_only=True)
        except OperationError:
            return
        label = f'{self._line},drive="{escape(drive)}"'
        up = store.line().state is LineState.OPEN and info.state in (
            DriveState.ONLINE,
            DriveState.DEGRADED,
        )
        good = [one for one in readings if one.quality is Quality.GOOD]
        self._up.add(label, int(up))
        self._not_good.add(label, len(readings) - len(good))
        faults: list[bool] = []
        for reading in good:
            self._value_line(label, reading)
            self._word_lines(label, reading, family, faults)
        if faults:
            self._fault.add(label, int(any(faults)))
        if up and info.fault is not None and info.fault.number is not None:
            self._number.add(f'{label},kind="{info.fault.kind}"', info.fault.number)

    def _value_line(self, label: str, reading: Reading) -> None:
        assert reading.value is not None
        number = reading.value.quantity
        if number is None:
            return
        code = f'code="C{reading.code.number:04d}",subcode="{reading.code.subcode}"'
        named = f'name="{escape(reading.name)}",unit="{escape(reading.unit or "")}"'
        self._value.add(f"{label},{code},{named}", number)

    def _word_lines(self, label: str, reading: Reading, family: Family, faults: list[bool]) -> None:
        assert reading.value is not None
        word = reading.value.word
        if word is None:
            return
        start = f'{label},code="{reading.code}",bit="'
        for name, on in family.status_bits(reading.code, word).items():
            self._bit.add(f'{start}{escape(name)}"', int(on))
        fault = family.active_fault(reading.code, word)
        if fault is not None:
            faults.append(fault)


def gauge(name: str, text: str) -> Block:
    """Return an empty family of gauges."""
    return Block(f"lecombus_{name}", "gauge", text)


def counter(name: str, text: str) -> Block:
    """Return an empty family of counters."""
    return Block(f"lecombus_{name}", "counter", text)
