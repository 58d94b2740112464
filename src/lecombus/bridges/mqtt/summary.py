"""A line in one message: its drives by state, and what needs attention. Pure.

For those who follow many lines (`lecombus fleet`): one message a line instead of some for each
drive, sent when it says something else and before it expires. It carries how long each thing has
lasted as a duration, so that the clocks of two computers are never compared.
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final
from uuid import uuid4

from lecombus import __version__
from lecombus.bridges.line_follower import FollowedDrive, LineFollower
from lecombus.bridges.mqtt.retained import Message, json_bytes, line_word
from lecombus.bridges.mqtt.topics import Topics
from lecombus.client import Quality

__all__ = ["KINDS", "STANDS_S", "Attention", "LineSummarizer"]

STANDS_S: Final = 30
"""How long a summary stands; it is renewed when a third of that is left."""

MISS_STANDS_S: Final = 300.0
"""So long after its watchdog was missed a drive needs attention, as for the alert."""

VALUES_WAIT_S: Final = 20.0
"""How long a value may be stale or bad until it needs attention: one lost answer is read again."""

ITEMS_MOST: Final = 60
TEXT_CHARS: Final = 160

KINDS: Final = (
    "trip", "watchdog-missed", "drive-offline", "no-controller", "lease-lapsed", "stale-value",
    "bad-value", "degraded", "starting", "fault", "remark",
)  # fmt: skip
"""What a drive or a line may need attention for, worst first."""

RANKS: Final = {kind: rank for rank, kind in enumerate(KINDS)}

OF_VALUES: Final = frozenset(("stale-value", "bad-value"))

SAID_OTHERWISE: Final = frozenset(("fault", "lease"))
"""Subjects of remarks that are kinds of their own, or need no attention."""

HOLDS: Final = "without a controller"
"""Stands in the remark on a drive that runs on after its lease has ended."""


@dataclass(frozen=True, slots=True)
class Attention:
    """Something that needs attention.

    Args:
        kind: One of `KINDS`, or of a line as a whole.
        drive: Which drive; empty: the line.
        text: What it is, in words.
        for_s: For how long, seconds; None: that is not known.
    """

    kind: str
    drive: str
    text: str
    for_s: float | None = None


class LineSummarizer:
    """The summary of one line.

    Args:
        topics: Of the line.
        line: Its name.

    Attributes:
        bridge: Tells this run of the bridge from others, as two that have the same name.
    """

    def __init__(self, topics: Topics, line: str) -> None:
        self._topics = topics
        self._line = line
        self.bridge = uuid4().hex[:12]
        self._host = platform.node()
        self._since_s: dict[tuple[str, str], float] = {}
        self._counts: dict[str, int] | None = None
        self._missed_s: dict[str, float] = {}

    def watchdog_missed(self, counts: Mapping[str, int], now_s: float) -> None:
        """Take by drive how often its watchdog was fed too late since the daemon's start.

        None at all: the daemon was started again, and has counted nothing yet.
        """
        before, self._counts = self._counts, dict(counts)
        if before is None:
            return
        for drive, count in counts.items():
            had = before.get(drive, 0)
            if count > (had if count >= had else 0):  # fewer: the daemon was started again
                self._missed_s[drive] = now_s

    def message(self, follower: LineFollower, now_s: float) -> Message:
        """Return the summary of what the follower knows now."""
        items = sorted(self._items(follower, now_s), key=lambda one: RANKS[one.kind])
        keys = [(one.kind, one.drive) for one in items]
        self._since_s = {key: self._since_s.get(key, now_s) for key in keys}
        items = [
            one for one in items
            if one.kind not in OF_VALUES
            or now_s - self._since_s[one.kind, one.drive] >= VALUES_WAIT_S
        ]  # fmt: skip
        drives = follower.drives.values()
        word, reason = line_word(follower)
        document: dict[str, Any] = {
            "line": self._line, "bridge": self.bridge, "host": self._host, "version": __version__,
            "state": word, "reason": reason[:TEXT_CHARS] or None, "stands_s": STANDS_S,
            "drives": Counter(one.state for one in drives),
            "doing": Counter(one.doing for one in drives),
            "more": max(0, len(items) - ITEMS_MOST),
        }  # fmt: skip
        shown = items[:ITEMS_MOST]
        document["attention"] = [
            {"kind": one.kind, "drive": one.drive or None, "text": one.text,
             "for_s": round(now_s - self._since_s[one.kind, one.drive], 1)}
            for one in shown
        ]  # fmt: skip
        mark = (word, reason, document["drives"], document["doing"], document["more"], shown)
        return Message(
            self._topics.summary, json_bytes(document), content_type="application/json",
            expiry_s=STANDS_S, until_s=now_s + STANDS_S, mark=mark,
        )  # fmt: skip

    def _items(self, follower: LineFollower, now_s: float) -> Iterator[Attention]:
        """Find what needs attention; nothing but that the daemon is away while it is."""
        line = follower.line
        if not follower.is_connected or line is None:
            return
        for text in (line.document.get("remarks") or {}).values():
            yield item("remark", "", str(text))
        lapsed = {
            str(one["drive"])
            for one in follower.leases.get("drives") or ()
            if one.get("latched") and one.get("because") == "lapsed"
        }
        for drive in follower.drives.values():
            yield from drive_items(drive, is_lapsed=drive.name in lapsed)
            if line.state == "open":
                yield from answer_items(drive, follower, now_s)
            missed_s = self._missed_s.get(drive.name)
            if missed_s is not None and now_s < missed_s + MISS_STANDS_S:
                text = "its watchdog was not fed in time: it has probably acted"
                yield item("watchdog-missed", drive.name, text)


def drive_items(drive: FollowedDrive, *, is_lapsed: bool) -> Iterator[Attention]:
    """Find what needs attention of a drive, whether it answers now or not."""
    fault = drive.fault
    if fault is not None:
        kind = "trip" if fault.get("kind") == "trip" else "fault"
        yield item(kind, drive.name, fault_text(fault))
    lease = drive.remarks.get("lease", "")
    if HOLDS in lease:
        yield item("no-controller", drive.name, lease)
    elif is_lapsed:
        yield item("lease-lapsed", drive.name, lease or "its lease lapsed")
    for subject, text in drive.remarks.items():
        if subject not in SAID_OTHERWISE:
            yield item("remark", drive.name, text)


def answer_items(drive: FollowedDrive, follower: LineFollower, now_s: float) -> Iterator[Attention]:
    """Find what needs attention because of how a drive answers, on a line that is open."""
    if drive.state in ("offline", "degraded", "starting"):
        kind = "drive-offline" if drive.state == "offline" else drive.state
        yield item(kind, drive.name, drive.reason or drive.state)
    if drive.state not in ("online", "degraded"):
        return
    found: dict[str, list[str]] = {}
    why = ""
    for code, value in drive.values.items():
        if follower.period_s(drive.name, code) is None or value.reading.time is None:
            continue  # not read cyclically, or not yet
        quality = value.quality(now_s)
        if quality is not Quality.GOOD:
            found.setdefault("stale-value" if quality is Quality.STALE else "bad-value", []).append(
                code
            )
            why = why or value.reading.reason
    for kind, codes in found.items():
        because = f": {why}" if kind == "bad-value" and why else ""
        yield item(kind, drive.name, f"{', '.join(codes[:6])}{because}")


def fault_text(fault: Mapping[str, Any]) -> str:
    """Return a fault in words, such as `trip OH (50): heat sink too hot`."""
    number = f"({fault['number']})" if fault.get("number") is not None else ""
    parts = (fault.get("kind"), fault.get("keypad"), number)
    name = " ".join(str(one) for one in parts if one)
    meaning = fault.get("meaning")
    return f"{name}: {meaning}" if meaning else f"{name} of a number not known"


def item(kind: str, drive: str, text: str) -> Attention:
    """Return something that needs attention, its text of bounded length."""
    text = " ".join(text.split())
    return Attention(
        kind, drive, text if len(text) <= TEXT_CHARS else f"{text[: TEXT_CHARS - 2]}.."
    )
