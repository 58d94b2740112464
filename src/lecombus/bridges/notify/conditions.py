"""What messages are sent of: conditions of a line and its drives that begin and end.

Pure: the clocks are arguments. Trips, lost drives and the lost line are read from the follower's
picture after each event: one that lasts a moment is seen, and so is one whose event was missed. The
lapse of a lease is read from its event, and from the picture when the daemon is back. While the
daemon is away, no other condition begins or ends; all are compared when it is back.

A missed watchdog has no event: the daemon counts it in its metrics (`watchdog_missed`). It has no
end either.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from lecombus.bridges.line_follower import FollowedDrive, LineFollower
from lecombus.client import Event

__all__ = ["Conditions", "Happening"]

LAPSES: Final = {
    "lapsed": "its lease {lease} lapsed",
    "none-taken": "it ran after a start, and no lease was taken",
    "came-back": "it came back running after its lease had ended",
}
"""How a lease ends that is a lapse; giving it up is none."""

SILENCED: Final = "silenced on purpose, so that its own watchdog stops it: see that it stands"
"""Of a drive that is sent nothing but stops, whichever end of a lease led to it."""


@dataclass(frozen=True, slots=True)
class Happening:
    """That a condition began, or ended.

    Args:
        event: One of `NotifyEvent`.
        drive: The drive; empty: the line, or its daemon.
        active: Whether it began.
        text: What it is, or what ended it.
        at_s: When, Unix seconds.
        fault: The fault, as in `/v1/drives`; None: it is none.
        is_update: Whether only more is known of what began before.
    """

    event: str
    drive: str
    active: bool
    text: str
    at_s: float
    fault: Mapping[str, Any] | None = None
    is_update: bool = False


class Conditions:
    """Finds what begins and ends on one line.

    Args:
        follower: The picture of the line.
        events: Which events are wanted.
        daemon_gone_s: How long the daemon is away until it counts as lost.
        clock: Monotonic seconds.
        wall: Unix seconds.
        give: Takes each happening.
    """

    def __init__(
        self,
        follower: LineFollower,
        events: Collection[str],
        daemon_gone_s: float,
        *,
        clock: Callable[[], float],
        wall: Callable[[], float],
        give: Callable[[Happening], None],
    ) -> None:
        self._follower = follower
        self._events = frozenset(events)
        self._gone_s = daemon_gone_s
        self._clock = clock
        self._wall = wall
        self._give = give
        self._standing: dict[tuple[str, str], str] = {}
        self._without_line: set[str] = set()
        """Drives that were not spoken to since the line was lost."""
        self._numbers: dict[str, Any] = {}
        self._misses: dict[str, int] | None = None
        self._unfed: set[str] = set()
        """Drives that were silenced since the misses were counted last."""
        self._away_at_s: float | None = clock()

    def take(self, event: Event) -> None:
        """Take an event of the follower."""
        follower = self._follower
        if event.kind == "away":
            self._away_at_s = self._clock()
        if not follower.is_connected or follower.line is None:
            return
        if event.kind == "connected":
            self._away_at_s = None
            self._set("daemon-lost", "", None, "it answers again")
            self._take_leases()
        if event.kind == "lease":
            self._take_lease(event.data)
        elif event.kind in ("state", "trip"):
            drive = follower.drives.get(event.drive)
            if drive is not None:
                self._look_at_drive(drive)
        elif event.kind in ("line", "looked"):
            self._look_at_line()

    def look(self) -> None:
        """See whether the daemon is away for too long."""
        if self._away_at_s is not None and self._clock() - self._away_at_s >= self._gone_s:
            self._set("daemon-lost", "", f"the daemon does not answer: {self._follower.why_away}")

    def watchdog_missed(self, counts: Mapping[str, int]) -> None:
        """Take by drive how often its watchdog was fed too late since the daemon's start.

        None at all: the daemon was started again, and has counted nothing yet.
        """
        before, self._misses = self._misses, dict(counts)
        if not counts:
            return
        unfed = self._unfed | self._follower.silenced
        self._unfed = set(self._follower.silenced)
        if before is None:
            return
        for drive, count in counts.items():
            had = before.get(drive, 0)
            missed = count - had if count >= had else count  # the daemon was started again
            if missed > 0:
                times = "" if missed == 1 else f" {missed} times"
                how = "not fed, on purpose" if drive in unfed else f"fed too late{times}"
                text = f"its watchdog was {how}: it has probably acted"
                self._happen(Happening("watchdog-missed", drive, True, text, self._wall()))

    # -- the line and its drives ------------------------------------------------------------------

    def _look_at_line(self) -> None:
        line = self._follower.line
        assert line is not None
        lost = f"the port is not open: {line.reason}" if line.state == "lost" else None
        if line.state in ("lost", "open"):
            self._set("line-lost", "", lost, "the port is open again")
        for drive in self._follower.drives.values():
            self._look_at_drive(drive)
        for event, name in tuple(self._standing):
            if name and name not in self._follower.drives:
                self._set(event, name, None, "taken out of the roster")

    def _look_at_drive(self, drive: FollowedDrive) -> None:
        fault = drive.fault
        if fault is not None and fault.get("kind") == "trip":
            had, number = self._numbers.get(drive.name), fault.get("number")
            is_other = None not in (had, number) and had != number
            self._numbers[drive.name] = number
            self._set("trip", drive.name, trip_text(fault), fault=fault, is_new=is_other)
        else:
            self._numbers.pop(drive.name, None)
            self._set("trip", drive.name, None, "the fault is gone")
        line = self._follower.line
        if line is None or line.state != "open":
            self._without_line.add(drive.name)
        elif drive.state != "offline":
            self._without_line.discard(drive.name)
        if drive.name in self._without_line:
            return  # no drive answers then, and the line is what was lost
        if drive.state == "offline":
            if drive.name in self._follower.silenced:
                return  # nothing is sent to it, so it is not known whether it answers
            self._set("drive-lost", drive.name, f"it does not answer: {drive.reason}")
        elif drive.state in ("online", "degraded"):
            self._set("drive-lost", drive.name, None, "it answers again")

    def _take_lease(self, data: Mapping[str, Any]) -> None:
        what, lease = data.get("what"), data.get("lease") or "none"
        for name in map(str, data.get("drives") or ()):
            if what == "ended" and data.get("end") in LAPSES:
                text = LAPSES[str(data["end"])].format(lease=lease)
                self._set("lease-lapse", name, f"{text}; on_lapse: {self._on_lapse(name)}")
            elif what == "hold":
                text = "it runs on without a controller (on_lapse: hold)"
                self._set("lease-lapse", name, text, is_new=True)
            elif what == "silenced":
                self._unfed.add(name)
                self._set("lease-lapse", name, SILENCED, is_new=True)
            elif what in ("taken", "unlatched"):
                self._set("lease-lapse", name, None, "it has a controller again")

    def _take_leases(self) -> None:
        """Compare with who controls what, after the daemon was away."""
        for one in self._follower.leases.get("drives") or ():
            name = str(one["drive"])
            if one.get("lease") is not None or not one.get("latched"):
                self._set("lease-lapse", name, None, "it has a controller again")
            elif one.get("silenced"):
                self._set("lease-lapse", name, SILENCED)
            elif one.get("because") == "lapsed":
                text = f"its lease lapsed; on_lapse: {one.get('on_lapse')}"
                self._set("lease-lapse", name, text)

    def _on_lapse(self, name: str) -> str:
        drives = self._follower.leases.get("drives") or ()
        found = (one.get("on_lapse") for one in drives if one.get("drive") == name)
        return str(next(found, "not known"))

    # -- what began and ended ---------------------------------------------------------------------

    def _set(
        self,
        event: str,
        drive: str,
        text: str | None,
        ended: str = "",
        *,
        fault: Mapping[str, Any] | None = None,
        is_new: bool = False,
    ) -> None:
        """Set a condition; text None: it does not hold. A text that changes is an update."""
        key = (event, drive)
        before = self._standing.get(key)
        if text is None:
            if self._standing.pop(key, None) is not None:
                self._happen(Happening(event, drive, False, ended, self._wall()))
        elif text != before:
            self._standing[key] = text
            is_update = before is not None and not is_new
            self._happen(
                Happening(event, drive, True, text, self._wall(), fault, is_update=is_update)
            )

    def _happen(self, happening: Happening) -> None:
        if happening.event in self._events:
            self._give(happening)


def trip_text(fault: Mapping[str, Any]) -> str:
    """Return a fault as it stands in a message: `trip OH (50): heat sink too hot`."""
    number = f"({fault['number']})" if fault.get("number") is not None else ""
    name = " ".join(str(one) for one in ("trip", fault.get("keypad"), number) if one)
    return (
        f"{name}: {fault['meaning']}" if fault.get("meaning") else f"{name} of a number not known"
    )
