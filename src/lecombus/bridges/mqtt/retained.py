"""What stands at the broker of a line: states, plain values, and each drive as JSON. Pure.

Strategy: a message carries how long it may stand (`expiry_s`): a value its time until it is stale,
rounded down, so that the broker itself drops what is not refreshed. A value that is not good has no
message: what stood there is removed. Numbers are written as the daemon writes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from math import inf
from typing import Any, Final

import msgspec

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue, LineFollower
from lecombus.bridges.mqtt.topics import Topics

__all__ = [
    "DAEMON_AWAY",
    "EMPTY",
    "JSON_STANDS_S",
    "OFFLINE",
    "ONLINE",
    "STATE_STANDS_S",
    "Message",
    "drive_messages",
    "json_bytes",
    "line_state",
    "line_word",
]

ENCODER: Final = msgspec.json.Encoder(decimal_format="number")

ONLINE: Final = "online"
OFFLINE: Final = "offline"
"""The bridge is not there: what the broker says in its name, and the bridge at its end."""

DAEMON_AWAY: Final = "daemon-away"

STATE_STANDS_S: Final = 60
JSON_STANDS_S: Final = 60
"""A drive's JSON in which no value is good."""

EMPTY: Final = b""
"""Removes a retained message."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message to be sent.

    Args:
        topic: Where.
        payload: What; `EMPTY` with `is_retained` removes what stands there.
        qos: 0 where the next one repairs the loss of this one.
        is_retained: Whether it stands at the broker.
        expiry_s: How long, or how long it may wait there; None: without end.
        properties: What else is said of it, for people and programs.
        content_type: Its MIME type; empty: plain text.
        mark: What makes it worth sending again; a message that only got older has the same.
        until_s: When what it says is no longer known to be so, by `anyio.current_time`.
        response: By what the asker knows an answer: of the answer, and of what asks for it.
        response_topic: Where an answer is wanted; empty: none is.
    """

    topic: str
    payload: bytes
    qos: int = 0
    is_retained: bool = True
    expiry_s: int | None = None
    properties: tuple[tuple[str, str], ...] = ()
    content_type: str = ""
    mark: Any = None
    until_s: float = inf
    response: bytes | None = None
    response_topic: str = ""


def line_state(topics: Topics, follower: LineFollower, now_s: float) -> Message:
    """Return how the line is doing.

    It expires: the broker says `offline` in the bridge's name when the bridge is lost, but not if
    it was itself ended first, and it may have kept this on its disk.
    """
    word, reason = line_word(follower)
    return state_message(topics.line_state, word, reason, STATE_STANDS_S, now_s + STATE_STANDS_S)


def line_word(follower: LineFollower) -> tuple[str, str]:
    """Return `online`, `daemon-away`, `lost` or `closed`, and the reason."""
    if not follower.is_connected or follower.line is None:
        return DAEMON_AWAY, follower.why_away
    word = follower.line.state
    return ONLINE if word == "open" else word, follower.line.reason


def state_message(
    topic: str, word: str, reason: str, expiry_s: int | None = None, until_s: float = inf
) -> Message:
    """Return a message with a state and its reason."""
    said = (("reason", reason),) if reason else ()
    return Message(
        topic, word.encode(), 1, expiry_s=expiry_s, properties=said, mark=(word, reason),
        until_s=until_s,
    )  # fmt: skip


def drive_messages(topics: Topics, drive: FollowedDrive, now_s: float) -> Iterator[Message]:
    """Return all that stands at the broker of a drive."""
    topic, until_s = topics.drive_state(drive.name), now_s + STATE_STANDS_S
    yield state_message(topic, drive.state, drive.reason, STATE_STANDS_S, until_s)
    for code, value in drive.values.items():
        found = value_message(topics.value(drive.name, code), value, now_s)
        if found is not None:
            yield found
    yield json_message(topics.json(drive.name), drive, now_s)


def value_message(topic: str, value: FollowedValue, now_s: float) -> Message | None:
    """Return a plain value; None: it is not good, or empty."""
    left_s = value.left_s(now_s)
    payload = b"" if value.reading.value is None else str(value.reading.value).encode()
    if not payload or left_s < 0.001:
        return None
    reading = value.reading
    said = [("unit", reading.unit), ("quality", "good"), ("text", reading.text)]
    if reading.time is not None:
        said.append(("time", time_text(reading.time)))
    return Message(
        topic, payload, expiry_s=max(1, int(left_s)), mark=(payload, reading.unit),
        until_s=value.good_until_s,
        properties=tuple((key, text) for key, text in said if text),
    )  # fmt: skip


def json_message(topic: str, drive: FollowedDrive, now_s: float) -> Message:
    """Return all that is known of a drive; it stands until its first good value is stale."""
    document: dict[str, Any] = {
        "drive": drive.name, "address": drive.address, "family": drive.family,
        "state": drive.state, "reason": drive.reason or None, "states": drive.states,
        "doing": drive.doing, "fault": drive.fault, "remarks": drive.remarks,
    }  # fmt: skip
    mark = (json_bytes(document), tuple(
        (code, value.reading.value, value.quality(now_s)) for code, value in drive.values.items()
    ))  # fmt: skip
    document["motion"] = drive.motion
    document["values"] = {
        code: value_document(value, now_s) for code, value in drive.values.items()
    }
    good = [one.good_until_s for one in drive.values.values() if one.is_good(now_s)]
    until_s = min(good, default=now_s + JSON_STANDS_S)
    return Message(
        topic, json_bytes(document), content_type="application/json", mark=mark,
        expiry_s=max(1, int(until_s - now_s)), until_s=until_s,
    )  # fmt: skip


def value_document(value: FollowedValue, now_s: float) -> dict[str, Any]:
    """Return a value with its age and quality."""
    reading, age_s = value.reading, value.age_s(now_s)
    return {
        "value": reading.value, "unit": reading.unit or None, "name": reading.name or None,
        "text": reading.text or None, "quality": value.quality(now_s).value,
        "reason": reading.reason or None, "age_s": None if age_s == inf else round(age_s, 3),
        "time": None if reading.time is None else time_text(reading.time),
    }  # fmt: skip


def time_text(time: datetime) -> str:
    """Return a time as the daemon writes it, such as `2026-11-21T10:15:02.113Z`."""
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def json_bytes(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, its decimals exactly as they are."""
    return ENCODER.encode(document)
