"""Where the events of a line come from: the store as it changes, and what users do to drives.

Strategy: while the stream records no events, nothing is done here. A value is published when it
differs from the value published last, when its quality changes, and `HEARTBEAT_S` after it was
published last. Quality also changes with time, without an exchange. So `look` checks all published
values about once a second, in small pieces: a value that became stale is published as stale.

A value that is not read cyclically is followed until it is no longer good. Passwords are not
published.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from lecombus.drive_state.readings import DriveInfo, LineInfo, Quality, Reading, rfc3339
from lecombus.drive_state.store import DriveChanged, Store, ValueChanged
from lecombus.drive_state.store import Event as StoreEvent
from lecombus.errors import OperationError
from lecombus.event_stream import EventStream
from lecombus.operations.actions import ACTOR_FIELDS, LONG_CHARS, Act, Actions, clean
from lecombus.parameters import Code, Json

__all__ = ["HEARTBEAT_S", "EventSources"]

HEARTBEAT_S: Final = 30.0
"""Every cyclic value is published at least so often, changed or not."""

VALUES_AT_ONCE: Final = 16
"""Values looked at before other tasks run: about a tenth of a millisecond."""

WRITES_PER_S: Final = 50
"""More than a line can carry; refused writes take no line time, and a client may send many."""


@dataclass(slots=True)
class Published:
    """What was last published of a value: what it read, how good it was, and when that was."""

    raw: str | None
    quality: Quality
    reason: str | None
    at_s: float


class EventSources:
    """Publishes what happens on a line.

    Args:
        stream: Takes the events.
        store: Where values, states and remarks come from.
        actions: Gives every operation.
        line: The line's name.
        members: The drives of the group of a name; empty: there is none.
        clock: Monotonic time, seconds.
    """

    def __init__(
        self,
        stream: EventStream,
        store: Store,
        actions: Actions,
        line: str,
        members: Callable[[str], Sequence[str]],
        clock: Callable[[], float],
    ) -> None:
        self._stream = stream
        self._store = store
        self._name = line
        self._members = members
        self._clock = clock
        self._values: dict[tuple[str, Code], Published] = {}
        self._drives: dict[str, DriveInfo] = {}
        self._line = store.line()
        self._second = 0
        self._in_second: Counter[bool] = Counter()
        self._kept_back = 0
        stream.follow(self._recording)
        actions.followers += (self,)

    def look(self) -> Iterator[None]:
        """Publish what changed by time alone; everything between two `yield` is short."""
        for name in tuple(self._drives):
            self._look_at_drive(name)
            yield
        for number, (drive, code) in enumerate(tuple(self._values)):
            self._look_at_value(drive, code)
            if number % VALUES_AT_ONCE == 0:
                yield
        if self._kept_back:
            data: dict[str, Json] = {"what": "kept-back", "count": self._kept_back}
            self._kept_back = 0
            self._publish("write", "", data)

    def _publish(
        self, kind: str, drive: str, data: dict[str, Json], members: Sequence[str] = ()
    ) -> None:
        """Publish an event that has the time of day at which it was made."""
        data["time"] = rfc3339(self._store.time_of_day())
        self._stream.publish(kind, drive, data, members)

    # -- what users do (an `ActionFollower`) ------------------------------------------------------

    def begun(self, act: Act) -> Awaitable[None] | None:
        """Nothing waits for this; an operation is published when its outcome is known."""
        return None

    def ended(self, act: Act, outcome: str, fields: Mapping[str, str]) -> None:
        """Publish an operation; of very many in a second only their number."""
        if not self._stream.is_recording:
            return
        second = int(self._clock())
        if second != self._second:
            self._second = second
            self._in_second.clear()
        self._in_second[act.is_stop] += 1
        if self._in_second[act.is_stop] > WRITES_PER_S:
            self._kept_back += 1
            return
        target = clean(act.target)
        by: dict[str, Json] = {**act.actor.fields()}
        data: dict[str, Json] = {"drive": target, "what": act.event, "outcome": outcome}
        data |= {key: text[:LONG_CHARS] for key, text in fields.items() if text}
        if act.old:
            data["old"] = act.old[:LONG_CHARS]
        members = self._members(target)
        drive = "" if members else target
        self._publish("write", drive, data | {"by": by}, members)

    def lease_changed(self, what: str, drives: Sequence[str], fields: Mapping[str, str]) -> None:
        """Publish what became of a lease (`LeaseFollower`)."""
        if self._stream.is_recording:
            data: dict[str, Json] = {"what": what, "drives": list(drives)}
            data |= {key: text for key, text in fields.items() if text and key not in ACTOR_FIELDS}
            if by := {key: text for key, text in fields.items() if key in ACTOR_FIELDS}:
                data["by"] = {**by}
            self._publish("lease", "", data, drives)

    # -- the store ----------------------------------------------------------------------------

    def _recording(self, begins: bool) -> None:
        if begins:
            self._drives = {info.name: info for info in self._store.drives()}
            self._line = self._store.line()
            self._store.subscribe(self._changed)
            return
        self._store.unsubscribe(self._changed)
        self._drives.clear()
        self._values.clear()
        self._kept_back = 0

    def _changed(self, event: StoreEvent) -> None:
        if type(event) is ValueChanged:
            self._look_at_value(event.drive, event.code, is_new=True)
            if event.code in self._store.family(event.drive).words:
                self._look_at_drive(event.drive)
        elif type(event) is DriveChanged:
            self._look_at_drive(event.drive)
        else:
            self._look_at_line()

    def _look_at_value(self, drive: str, code: Code, *, is_new: bool = False) -> None:
        """Publish a value if it changed or is due; forget one that is followed no longer."""
        key = (drive, code)
        try:
            if key not in self._values and self._is_secret(drive, code):
                return
            reading = self._store.reading(drive, code)
        except OperationError:  # the drive was taken out of the roster
            reading = None
        if reading is None:
            self._values.pop(key, None)
            return
        self._publish_value(key, reading)
        is_over = reading.quality is not Quality.GOOD and not is_new
        if is_over and not self._store.is_cyclic(drive, code):
            del self._values[key]

    def _is_secret(self, drive: str, code: Code) -> bool:
        return self._store.family(drive).is_secret(code)

    def _publish_value(self, key: tuple[str, Code], reading: Reading) -> None:
        now_s = self._clock()
        raw = None if reading.value is None else reading.value.raw
        # The reason of a stale value has its age in it, which always changes.
        reason = reading.reason if reading.quality is Quality.BAD else None
        before = self._values.get(key)
        if before is None:
            self._values[key] = Published(raw, reading.quality, reason, now_s)
        elif (
            (before.raw, before.quality, before.reason) == (raw, reading.quality, reason)
            and now_s - before.at_s < HEARTBEAT_S
        ):  # fmt: skip
            return
        else:
            before.raw, before.quality, before.reason = raw, reading.quality, reason
            before.at_s = now_s
        self._stream.publish("value", reading.drive, reading.as_json())

    def _look_at_drive(self, name: str) -> None:
        """Publish what differs of a drive's state, remarks and fault."""
        before = self._drives.get(name)
        try:
            info = self._store.drive(name)
        except OperationError:
            if before is not None:
                self._drive_removed(name)
            return
        self._drives[name] = info
        shown = (info.state, info.reason, info.states)
        if before is None or (before.state, before.reason, before.states) != shown:
            states = None if info.states is None else [state.value for state in info.states]
            self._publish(
                "state",
                name,
                {
                    "drive": name,
                    "state": info.state.value,
                    "reason": info.reason or None,
                    "since": rfc3339(info.since_s),
                    "states": states,  # type: ignore[dict-item]
                },
            )
        self._publish_remarks(name, {} if before is None else before.remarks, info.remarks)
        fault, was = info.fault, None if before is None else before.fault
        if fault != was:
            of = info if fault is not None else before
            assert of is not None
            data: dict[str, Json] = {"drive": name, "active": fault is not None}
            self._publish("trip", name, data | {"fault": of.fault_json()})

    def _drive_removed(self, name: str) -> None:
        del self._drives[name]
        for key in [key for key in self._values if key[0] == name]:
            del self._values[key]
        gone = {"state": None, "reason": "taken out of the roster", "since": None, "states": None}
        self._publish("state", name, {"drive": name, **gone})

    def _look_at_line(self) -> None:
        """Publish what differs of the line's state and remarks, and how the drives look now."""
        before, info = self._line, self._store.line()
        self._line = info
        if (before.state, before.reason) != (info.state, info.reason):
            self._publish_line(info)
            for name in tuple(self._drives):
                self._look_at_drive(name)
        self._publish_remarks("", before.remarks, info.remarks)

    def _publish_line(self, info: LineInfo) -> None:
        self._publish(
            "line",
            "",
            {
                "line": self._name,
                "state": info.state.value,
                "reason": info.reason or None,
                "since": rfc3339(info.since_s),
            },
        )

    def _publish_remarks(
        self, drive: str, before: Mapping[str, str], now: Mapping[str, str]
    ) -> None:
        for key in {**before, **now}:
            if before.get(key) != now.get(key):
                text = now.get(key)
                data: dict[str, Json] = {"drive": drive or None, "subject": key, "text": text}
                self._publish("remark", drive, data)
