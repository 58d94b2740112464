"""When what stands at the broker is sent again. Pure: time is an argument.

A message *stands* at the broker while the broker keeps it as a retained message.

Strategy: a message is sent when it differs from the one that stands there, and before that one
expires; not each time a value is read. What should not stand there any more is removed. There is no
queue: what is due is determined again before each sending, so that only the newest is sent, however
long the broker was away.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import inf
from typing import Any, Final

from lecombus.bridges.mqtt.retained import EMPTY, Message

__all__ = ["Board"]

RENEW_LEFT_S: Final = 1.3
"""At the latest so long before a message expires, it is sent again."""

RENEW_PART: Final = 1 / 3
"""Of its time; the greater of both counts."""

GAIN_S: Final = 0.2
"""A message that is good for less than this beyond the one that stands is not sent."""

LOSS_S: Final = 1.0
"""A message that stands for longer than this after its value is good is sent again."""

JSON_EVERY_S: Final = 1.0

EXPIRED_AFTER_S: Final = 2.0
"""So long after its time the broker has dropped a message: it counts in whole seconds."""

NOT_KNOWN: Final = object()
"""The mark of a message that may or may not stand."""


@dataclass(slots=True)
class Standing:
    """A message that stands at the broker."""

    mark: Any
    sent_s: float
    until_s: float
    renew_s: float


class Board:
    """What stands at the broker, as far as this bridge sent it."""

    def __init__(self) -> None:
        self._standing: dict[str, Standing] = {}

    def connected(self, now_s: float) -> None:
        """A new connection: what was sent before may stand at the broker, or be lost with it.

        So all is sent again, and removed what should not stand there any more.
        """
        self._standing = {
            topic: Standing(NOT_KNOWN, -inf, one.until_s, -inf)
            for topic, one in self._standing.items() if now_s < one.until_s + EXPIRED_AFTER_S
        }  # fmt: skip

    def holds(self, under: str) -> bool:
        """Whether something stands whose topic has this beginning."""
        return any(one.startswith(under) for one in self._standing)

    def due(self, messages: Iterable[Message], under: str, now_s: float) -> Iterator[Message]:
        """Return what is to be sent now.

        Args:
            messages: All that should stand under some topic.
            under: The beginning of these topics; what else stands there is removed.
            now_s: By a monotonic clock.
        """
        wanted = set()
        for message in messages:
            wanted.add(message.topic)
            standing = self._standing.get(message.topic)
            if standing is None or is_due(standing, message, now_s):
                yield message
        for topic in [one for one in self._standing if one.startswith(under)]:
            if topic not in wanted:
                yield Message(topic, EMPTY)

    def sent(self, message: Message, now_s: float) -> None:
        """Note what was sent, with the time of its making."""
        if message.payload == EMPTY:
            self._standing.pop(message.topic, None)
            return
        left_s = message.until_s - now_s
        before_s = max(RENEW_LEFT_S, left_s * RENEW_PART)
        renew_s = inf if left_s == inf else message.until_s - before_s
        self._standing[message.topic] = Standing(message.mark, now_s, message.until_s, renew_s)


def is_due(standing: Standing, message: Message, now_s: float) -> bool:
    """Whether a message is worth sending over one that stands."""
    if standing.mark != message.mark:
        return not message.content_type or now_s >= standing.sent_s + JSON_EVERY_S
    if message.until_s < standing.until_s - LOSS_S:
        return True
    return now_s >= standing.renew_s and message.until_s > standing.until_s + GAIN_S
