"""Which drives Home Assistant knows, as far as this bridge sent them or saw them at the broker."""

from __future__ import annotations

from typing import Final

import anyio

from lecombus.bridges.line_follower import LineFollower
from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.discovery import Discovery
from lecombus.bridges.mqtt.retained import Message

__all__ = ["Devices"]

STANDS: Final = b"stands"
"""In the place of a message of which it is known only that there was one."""

PARTS_MOST: Final = 300
"""Of a device; a drive has some ten."""


class Devices:
    """The drives that Home Assistant knows, and those that it should know.

    Args:
        discovery: Makes the messages.
        follower: Knows the drives.

    Attributes:
        came: Set when there may be something to send.
    """

    def __init__(self, discovery: Discovery, follower: LineFollower) -> None:
        self.discovery = discovery
        self._follower = follower
        self._shown: dict[str, bytes] = {}
        self._parts: dict[str, dict[str, str]] = {}
        self._seen: tuple[object, ...] = ()
        self.came = anyio.Event()

    def looked(self) -> None:
        """Look whether there is something else to make known than before."""
        follower = self._follower
        seen = (follower.stretch, *(
            (drive.name, drive.family, self.discovery.speed_unit(drive),
             tuple((code, follower.period_s(drive.name, code)) for code in drive.values))
            for drive in follower.drives.values()
        ))  # fmt: skip
        if seen != self._seen:
            self._seen = seen
            self.came.set()

    def forget(self) -> None:
        """Send all again, and remove again what may still stand there."""
        self._shown = dict.fromkeys(self._shown, STANDS)
        self.came.set()

    def takes(self, incoming: Incoming) -> bool:
        """Take a message, if it is Home Assistant's birth or a device that stands at the broker."""
        if incoming.topic == self.discovery.birth:
            if incoming.payload == b"online":
                self.forget()
            return True
        found = self.discovery.is_topic(incoming.topic)
        if found and incoming.payload and self.discovery.is_ours(incoming.payload):
            self._shown.setdefault(incoming.topic, STANDS)
            self._add_parts(incoming.topic, incoming.payload)
            self.came.set()
        return found

    def due(self) -> list[Message]:
        """Return what is to be sent; nothing before the daemon has said which drives there are."""
        if not self._follower.is_connected:
            return []
        wanted = {}
        for drive in self._follower.drives.values():
            if drive.family:
                before = self._parts.get(self.discovery.topic(drive.name), {})
                message = self.discovery.message(drive, self._follower, before)
                wanted[message.topic] = message
        gone = [self.discovery.removal(topic) for topic in self._shown if topic not in wanted]
        return gone + [one for one in wanted.values() if self._shown.get(one.topic) != one.payload]

    def sent(self, message: Message) -> None:
        """Note what was sent."""
        if message.payload:
            self._shown[message.topic] = message.payload
            self._add_parts(message.topic, message.payload)
        else:
            self._shown.pop(message.topic, None)
            self._parts.pop(message.topic, None)

    def _add_parts(self, topic: str, payload: bytes) -> None:
        """Note parts that Home Assistant knows; not without end, as others may write them too."""
        parts = self._parts.get(topic, {}) | self.discovery.parts(payload)
        self._parts[topic] = dict(list(parts.items())[-PARTS_MOST:])
