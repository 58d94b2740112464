"""What is counted while the line works: the instruments behind every exchange.

Strategy: every instrument there can ever be is made when the roster is known and kept in a
dictionary; so the path behind an exchange calls `inc` and `observe` and nothing else, series begin
at 0, and their number is bounded by the roster. A family with many series has several parts (one
per drive, per class), so that rendering it can be cut between them.

An instrument is one series (a counter) or one set of series (a histogram): plain numbers, made into
lines only when a page is rendered; its labels are written out once, when it is made. Counting is an
addition, or a bisection and two. Everything runs on one event loop thread, so there is no lock,
which is most of what prometheus_client's own instruments cost (0.3 and 0.6 µs, seven of them an
exchange).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from lecombus.metrics.exposition import labels_text
from lecombus.schedule.request import Outcome, Priority

__all__ = [
    "EXCHANGE_BUCKETS_S",
    "TELEGRAM_KINDS",
    "TELEGRAM_OUTCOMES",
    "WAIT_BUCKETS_S",
    "Counter",
    "Counters",
    "Histogram",
    "Instrument",
    "MetricFamily",
    "label_of",
]


class Instrument(Protocol):
    """What can be shown on a page."""

    def lines(self, name: str) -> list[str]:
        """Return its sample lines.

        Args:
            name: Its family's.
        """


class Counter:
    """A number that only grows.

    Args:
        labels: Its labels.
    """

    __slots__ = ("_labels", "value")

    def __init__(self, labels: Mapping[str, str]) -> None:
        self._labels = labels_text(labels)
        self.value = 0.0

    def inc(self, by: float = 1.0) -> None:
        """Count one, or as much as is said, 0 or more."""
        self.value += by

    def lines(self, name: str) -> list[str]:
        """Return its sample line."""
        return [f"{name}_total{self._labels} {self.value!r}"]


class Histogram:
    """How many values were no higher than each of some bounds.

    Args:
        labels: Its labels.
        bounds: The bounds, rising; one without end is added.
    """

    __slots__ = ("_bounds", "_buckets", "_counts", "_labels", "_sum")

    def __init__(self, labels: Mapping[str, str], bounds: Sequence[float]) -> None:
        self._labels = labels_text(labels)
        self._bounds = tuple(bounds)
        names = (*map(repr, self._bounds), "+Inf")
        self._buckets = [labels_text({**labels, "le": name}) for name in names]
        self._counts = [0] * len(names)
        self._sum = 0.0

    def observe(self, value: float) -> None:
        """Take a value."""
        self._counts[bisect_left(self._bounds, value)] += 1
        self._sum += value

    def lines(self, name: str) -> list[str]:
        """Return its sample lines: each bucket holds all below it."""
        found, seen = [], 0
        for labels, count in zip(self._buckets, self._counts, strict=True):
            seen += count
            found.append(f"{name}_bucket{labels} {float(seen)!r}")
        found.append(f"{name}_count{self._labels} {float(seen)!r}")
        found.append(f"{name}_sum{self._labels} {self._sum!r}")
        return found


@dataclass(slots=True, eq=False)
class MetricFamily:
    """Series of one name, in parts that are small enough to be rendered in one go.

    Args:
        name: Its name, without `_total`.
        kind: `counter` or `histogram`.
        help: One sentence for people.
        parts: Its instruments, by the label that distinguishes them.
    """

    name: str
    kind: str
    help: str
    parts: dict[str, list[Instrument]] = field(default_factory=dict)


EXCHANGE_BUCKETS_S: Final = (
    *(0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.075),
    *(0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0),
)
"""Dense where reads lie at 9600 and 19200 baud (15 to 75 ms), up to a time-out at 1200 baud."""

WAIT_BUCKETS_S: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)

TELEGRAM_KINDS: Final = ("read", "write")
TELEGRAM_OUTCOMES: Final = (
    *("answered", "refused", "no_reply", "garbled", "unexpected", "echo", "line_lost"),
)
"""How an exchange with one drive can end on the wire."""

MULTICAST: Final = "multicast"
MULTICAST_OUTCOMES: Final = ("sent", "echo", "line_lost")


def label_of(priority: Priority) -> str:
    """Return a class as it stands in a label."""
    return priority.name.lower()


class Counters:
    """The instruments of one line.

    Args:
        line: The line's name: the label `line` of every series.
    """

    def __init__(self, line: str) -> None:
        self.line = line
        self._families: dict[str, MetricFamily] = {}
        self._telegrams = self._family(
            "telegrams",
            "counter",
            "Telegrams sent, by drive (a multicast: by group), kind and how the exchange ended.",
        )
        # A name may go from a group to a drive in one reload: each has its own place.
        self._drives: dict[str, dict[tuple[str, str], Counter]] = {}
        self._groups: dict[str, dict[tuple[str, str], Counter]] = {}
        self._took = {
            kind: self._histogram(
                "exchange_seconds",
                "Time from a telegram's first byte to the end of its answer, or to the time-out.",
                ("kind", kind),
                EXCHANGE_BUCKETS_S,
            )
            for kind in (*TELEGRAM_KINDS, MULTICAST)
        }
        self._waited = {
            priority: self._histogram(
                "queue_wait_seconds",
                "Time that a request waited before its telegram was sent.",
                ("priority", label_of(priority)),
                WAIT_BUCKETS_S,
            )
            for priority in Priority
        }
        self._taken = {
            priority: self._counter(
                "line_seconds",
                "Time the line was in use, by the class of the request; quarantine included.",
                priority=label_of(priority),
            )
            for priority in Priority
        }
        self._ended = {priority: self._outcomes(label_of(priority)) for priority in Priority}
        self._make_plain()

    def _make_plain(self) -> None:
        """Make the counters that have no label but the line."""
        self._busy = self._counter(
            "line_busy_seconds", "Time the line was in use by telegrams, answers and quarantine."
        )
        self._opens = self._counter("line_opens", "How often the port was opened.")
        self.late_answers = self._counter(
            "late_answers", "Whole answers that came after their time-out; none was used."
        )
        self.stray_bytes = self._counter(
            "stray_bytes", "Bytes that came outside an exchange and were discarded."
        )
        self.echo_mismatches = self._counter(
            "echo_mismatches", "Echoes that differ from what was sent: collisions, bad wiring."
        )

    def _outcomes(self, priority: str) -> dict[Outcome, Counter]:
        """Make the counters of how the requests of a class ended."""
        text = "Requests by class and outcome; each has exactly one."
        return {
            outcome: self._counter("requests", text, priority=priority, outcome=outcome.value)
            for outcome in Outcome
        }

    # -- the hot path ---------------------------------------------------------------------------

    def exchange(
        self,
        drive: str,
        kind: str,
        outcome: str,
        *,
        took_s: float,
        busy_s: float,
        priority: Priority,
        waited_s: float,
    ) -> None:
        """Count one exchange.

        Args:
            drive: The drive's name; for a multicast the group's.
            kind: One of `TELEGRAM_KINDS`, or `MULTICAST`.
            outcome: One of `TELEGRAM_OUTCOMES`; `sent` for a multicast.
            took_s: From the first byte to the end of the answer or to giving up, seconds.
            busy_s: The same with the quarantine after it, seconds.
            priority: The class of its request.
            waited_s: How long the request had waited, seconds.
        """
        counters = (self._groups if kind == MULTICAST else self._drives).get(drive)
        if counters is not None:  # it may have left the roster while this was under way
            counters[kind, outcome].inc()
        self._took[kind].observe(took_s)
        self._waited[priority].observe(waited_s)
        self._busy.inc(busy_s)
        self._taken[priority].inc(busy_s)
        if outcome == "echo":
            self.echo_mismatches.inc()

    def request_ended(self, priority: Priority, outcome: Outcome) -> None:
        """Count the end of one request."""
        self._ended[priority][outcome].inc()

    def port_opened(self) -> None:
        """Count one opening of the port."""
        self._opens.inc()

    # -- the roster -----------------------------------------------------------------------------

    def add_drive(self, name: str) -> None:
        """Make the counters of a drive; one that is known keeps counting."""
        self._add(self._drives, name, TELEGRAM_KINDS, TELEGRAM_OUTCOMES)

    def add_group(self, name: str) -> None:
        """Make the counters of a group that is spoken to by multicast."""
        self._add(self._groups, name, (MULTICAST,), MULTICAST_OUTCOMES)

    def remove(self, name: str) -> None:
        """Drop the counters of a group that left the roster, or of a drive.

        A drive that has got the name of the group already keeps its own.
        """
        found = self._groups if name in self._groups else self._drives
        found.pop(name, None)
        self._show(name)

    # -- for the page ---------------------------------------------------------------------------

    def families(self) -> Iterable[MetricFamily]:
        """Give every family; each part of one is small enough for a piece of a page."""
        return self._families.values()

    # -- inside ---------------------------------------------------------------------------------

    def _add(
        self,
        found: dict[str, dict[tuple[str, str], Counter]],
        name: str,
        kinds: tuple[str, ...],
        outcomes: tuple[str, ...],
    ) -> None:
        counters = found.setdefault(name, {})
        for kind in kinds:
            for outcome in outcomes:
                if (kind, outcome) not in counters:
                    labels = {"line": self.line, "drive": name, "kind": kind, "outcome": outcome}
                    counters[kind, outcome] = Counter(labels)
        self._show(name)

    def _show(self, name: str) -> None:
        """Show the counters that there are of a name, as one part of the page."""
        both = (self._drives.get(name, {}), self._groups.get(name, {}))
        part: list[Instrument] = [one for counters in both for one in counters.values()]
        if part:
            self._telegrams.parts[name] = part
        else:
            self._telegrams.parts.pop(name, None)

    def _family(self, name: str, kind: str, text: str) -> MetricFamily:
        return self._families.setdefault(name, MetricFamily(f"lecombus_{name}", kind, text))

    def _counter(self, name: str, text: str, **labels: str) -> Counter:
        counter = Counter({"line": self.line, **labels})
        part = self._family(name, "counter", text).parts
        part.setdefault(labels.get("priority", ""), []).append(counter)
        return counter

    def _histogram(
        self, name: str, text: str, label: tuple[str, str], buckets: tuple[float, ...]
    ) -> Histogram:
        histogram = Histogram({"line": self.line, label[0]: label[1]}, buckets)
        self._family(name, "histogram", text).parts[label[1]] = [histogram]
        return histogram
