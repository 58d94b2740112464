"""What happens on a line, one event after the other, for all who read along.

Pure: no socket, no clock. `publish` appends an event to a bounded buffer; each event is rendered
once, as the bytes of a server-sent event, and these bytes are shared by all readers. A reader is a
position in the buffer; `batch` gives the events behind it that it wants. Who has been away names
the last event it had (`RUN-N`) and gets what came since, or first an event `gap` where the buffer
does not reach back so far.

Events are recorded only while they are read, and for a while after that (`api.event_readers`): a
line without readers renders nothing. What was not recorded counts as a gap. RUN differs for each
start of lecombus, so that an id of an earlier run is known as such.

Memory is bounded by `EVENTS_LIMIT` and `BYTES_LIMIT`; the oldest events go first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from lecombus.parameters import Json

__all__ = ["BYTES_LIMIT", "EVENTS_LIMIT", "GAP", "KINDS", "EventFilter", "EventStream"]

KINDS: Final = ("value", "state", "remark", "trip", "write", "lease", "line")
"""What an event may be: a value, how a drive is doing, a remark, a fault, what a user did to a
drive, a lease, how the line is doing."""

GAP: Final = "gap"
"""What a reader gets in place of events that it missed; no filter leaves it out."""

EVENTS_LIMIT: Final = 4096
"""About a minute of a full line at 19200 bit/s, when every value changes each time it is read."""

BYTES_LIMIT: Final = 2 * 1024 * 1024

NOT_KEPT: Final = "lecombus keeps only the latest events, and these were not among them"
NOT_RECORDED: Final = "events are recorded only while they are read"
ANOTHER_RUN: Final = "the last event was of another run of lecombus"

Render = Callable[[Json], str]
"""Writes a document as JSON text on one line."""


@dataclass(frozen=True, slots=True)
class PublishedEvent:
    """An event as it is sent.

    Args:
        kind: One of `KINDS`.
        drives: The drives it is about; none: the line.
        frame: The whole server-sent event.
    """

    kind: str
    drives: frozenset[str]
    frame: bytes


@dataclass(frozen=True, slots=True)
class EventFilter:
    """Which events a reader wants.

    Args:
        drives: Events about these drives, and those about the line; empty: about any.
        kinds: Events of these kinds; empty: of any.
        visible: The drives that it may see: no event that is also about another; None: all.
    """

    drives: frozenset[str] = frozenset()
    kinds: frozenset[str] = frozenset()
    visible: frozenset[str] | None = None

    def takes(self, event: PublishedEvent) -> bool:
        """Whether an event is wanted."""
        if self.kinds and event.kind not in self.kinds:
            return False
        if self.visible is not None and not self.visible.issuperset(event.drives):
            return False
        return not self.drives or not event.drives or not self.drives.isdisjoint(event.drives)


class EventStream:
    """The events of one line.

    Args:
        run: A word that no other run of lecombus has; letters and digits.
        events_limit: How many events are kept at most.
        bytes_limit: How many bytes they may have together.

    Attributes:
        first: The number of the oldest event kept.
        next: The number that the next event will have.
        published: How many events there were, by kind.
        readers: How many read now.
        dropped: How many readers were cut because they did not keep up.
    """

    def __init__(
        self, run: str, *, events_limit: int = EVENTS_LIMIT, bytes_limit: int = BYTES_LIMIT
    ) -> None:
        self._run = run
        self._events_limit = events_limit
        self._bytes_limit = bytes_limit
        self._events: dict[int, PublishedEvent] = {}
        self._bytes = 0
        self._recorded_from = 1
        self._render: Render | None = None
        self._followers: tuple[Callable[[bool], None], ...] = ()
        self.first = self.next = 1
        self.published: Counter[str] = Counter()
        self.readers = 0
        self.dropped = 0

    @property
    def is_recording(self) -> bool:
        """Whether events are kept; without readers there is no need to publish any."""
        return self._render is not None

    @property
    def kept_bytes(self) -> int:
        """How many bytes the events have that are kept."""
        return self._bytes

    def follow(self, changed: Callable[[bool], None]) -> None:
        """Call `changed` when recording begins (with True) and when it ends."""
        self._followers = (*self._followers, changed)

    def record(self, render: Render) -> None:
        """Begin to keep events.

        Args:
            render: Writes their data.
        """
        if self._render is None:
            self._render = render
            self.first = self.next = self._recorded_from = self.next + 1
            for changed in self._followers:
                changed(True)

    def forget(self) -> None:
        """Keep no more events, and none of those so far."""
        if self._render is not None:
            self._render = None
            self._events.clear()
            self._bytes = 0
            self.first = self.next
            for changed in self._followers:
                changed(False)

    def publish(
        self, kind: str, drive: str, data: Mapping[str, Json], members: Iterable[str] = ()
    ) -> None:
        """Append an event; without readers this does nothing.

        Args:
            kind: One of `KINDS`.
            drive: The drive or group it is about; empty: the line.
            data: What is said, without secrets.
            members: The drives of a group that it is about.
        """
        if self._render is None:
            return
        text = self._render(dict(data))
        number = self.next
        frame = f"id: {self._run}-{number}\nevent: {kind}\ndata: {text}\n\n".encode()
        drives = frozenset((drive, *members)) if drive else frozenset(members)
        self._events[number] = PublishedEvent(kind, drives, frame)
        self._bytes += len(frame)
        self.next = number + 1
        self.published[kind] += 1
        while len(self._events) > self._events_limit or self._bytes > self._bytes_limit:
            self._bytes -= len(self._events.pop(self.first).frame)
            self.first += 1

    # -- for readers ---------------------------------------------------------------------------

    def position_after(self, last_id: str) -> tuple[int, bytes]:
        """Return where to read on, and the event `gap` that goes before if there is one.

        Args:
            last_id: The id of the last event that the reader had; empty: it begins now.
        """
        if not last_id:
            return self.next, b""
        run, _, number = last_id.rpartition("-")
        is_number = number.isascii() and number.isdecimal() and len(number) < 20
        wanted = int(number) + 1 if is_number else 0
        if run != self._run or not 0 < wanted <= self.next:
            return self.first, self._gap(None, ANOTHER_RUN)
        if wanted >= self.first:
            return wanted, b""
        if wanted < self._recorded_from:
            return self.first, self._gap(None, NOT_RECORDED)
        return self.first, self._gap(self.first - wanted, NOT_KEPT)

    def batch(
        self, position: int, wanted: EventFilter, *, until: int, bytes_most: int
    ) -> tuple[bytes, int]:
        """Return events from a position on, and the position behind them.

        Args:
            position: The number of the first event to look at; it must be kept still.
            wanted: Which events to take.
            until: The number of the first event that is not looked at.
            bytes_most: No further event is taken when there are so many bytes.
        """
        frames: list[bytes] = []
        size = 0
        while position < until and size < bytes_most:
            event = self._events[position]
            position += 1
            if wanted.takes(event):
                frames.append(event.frame)
                size += len(event.frame)
        return b"".join(frames), position

    def mark(self, position: int) -> bytes:
        """Return what makes a reader remember a position, without an event."""
        return f": \nid: {self._run}-{position - 1}\n\n".encode()

    def _gap(self, missed: int | None, reason: str) -> bytes:
        assert self._render is not None, "read before anything is recorded"
        text = self._render({"missed": missed, "reason": reason})
        return f"id: {self._run}-{self.first - 1}\nevent: {GAP}\ndata: {text}\n\n".encode()
