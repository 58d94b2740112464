"""Finds what happens on one line, and sends messages of it.

Strategy: a channel has a `Sender` with entries of its own, a limit and a task. It waits a little
for more that belongs into the same message, sends, and goes on; what cannot be sent is put back and
sent later together with what happened since. So nothing piles up, and one channel never waits for
another.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Final, NoReturn

import anyio

from lecombus.bridges.line_follower import LineFollower
from lecombus.bridges.notify.channels import Channel, NotSentError, channels_of
from lecombus.bridges.notify.conditions import Conditions, Happening
from lecombus.bridges.notify.messages import (
    Limiter,
    Notification,
    Pending,
    message_of,
    trial_message,
)
from lecombus.bridges.watchdog_misses import watch_misses
from lecombus.roster import NotifyEntry, Roster

__all__ = ["Sender", "run_bridge", "send_test"]

FIRST_PAUSE_S: Final = 10.0
LONGEST_PAUSE_S: Final = 300.0
"""How long to wait after a message that could not be sent."""

LOOK_EVERY_S: Final = 0.5
MISSES_EVERY_S: Final = 5.0
"""How often the counts of missed watchdogs are read: a page of metrics each time."""

logger = logging.getLogger(__name__)


class Sender:
    """Sends what happens over one channel.

    Args:
        channel: The channel.
        entry: How long to gather, and how often to send.
        line: The line's name.
        wall: Unix seconds.
    """

    def __init__(
        self, channel: Channel, entry: NotifyEntry, line: str, wall: Callable[[], float] = time.time
    ) -> None:
        self._channel = channel
        self._gather_s = entry.gather_s
        self._limiter = Limiter(entry.limit.burst, entry.limit.every_s)
        self._line = line
        self._wall = wall
        self._pending = Pending(ends=entry.ends)
        self._came = anyio.Event()

    def take(self, happening: Happening) -> None:
        """Take what happened; never waits."""
        self._pending.add(happening)
        self._came.set()

    async def run(self) -> NoReturn:
        """Send until cancelled."""
        pause_s = FIRST_PAUSE_S
        while True:
            await self._came.wait()
            await anyio.sleep(self._gather_s)
            await anyio.sleep(self._limiter.wait_s(anyio.current_time()))
            self._came = anyio.Event()
            entries, dropped = self._pending.take()
            if not entries:
                continue
            message = message_of(self._line, entries, dropped, self._wall())
            try:
                await self._channel.send(message)
            except NotSentError as exc:
                self._pending.put_back(entries, dropped)
                self._came.set()
                log_failure(self._channel, exc, pause_s)
                await anyio.sleep(pause_s)
                pause_s = min(2 * pause_s, LONGEST_PAUSE_S)
                continue
            self._limiter.sent()
            pause_s = FIRST_PAUSE_S
            log_sent(self._channel, message)


def log_sent(channel: Channel, message: Notification) -> None:
    """Log a message that was sent, by its subject."""
    logger.info(
        "event=message-sent channel=%s entries=%d subject=%s",
        channel.name, len(message.entries), message.subject,
    )  # fmt: skip


def log_failure(channel: Channel, why: NotSentError, again_s: float) -> None:
    """Log a message that was not sent."""
    logger.warning(
        "event=message-not-sent channel=%s again_s=%g reason=%s", channel.name, again_s, why
    )  # fmt: skip


async def run_bridge(
    roster: Roster, entry: NotifyEntry, wall: Callable[[], float] = time.time
) -> None:
    """Send messages of what happens on a line, until cancelled.

    Args:
        roster: The line's.
        entry: What it says of messages.
        wall: Unix seconds.
    """
    line, socket = roster.line.name, roster.api.socket
    senders = [Sender(channel, entry, line, wall) for channel in channels_of(entry)]

    def give(happening: Happening) -> None:
        for sender in senders:
            sender.take(happening)

    follower = LineFollower(socket)
    conditions = Conditions(
        follower, entry.events, entry.daemon_gone_s,
        clock=anyio.current_time, wall=wall, give=give,
    )  # fmt: skip
    follower.listeners.append(conditions.take)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(follower.run)
        for sender in senders:
            tasks.start_soon(sender.run)
        if "watchdog-missed" in entry.events:
            tasks.start_soon(watch_misses, socket, MISSES_EVERY_S, conditions.watchdog_missed)
        while True:
            conditions.look()
            await anyio.sleep(LOOK_EVERY_S)


async def send_test(roster: Roster, entry: NotifyEntry) -> list[tuple[str, str | None]]:
    """Send a test message over each channel; give its name, and why it was not sent.

    Args:
        roster: The line's.
        entry: What it says of messages.
    """
    found: list[tuple[str, str | None]] = []
    message = trial_message(roster.line.name, time.time())
    for channel in channels_of(entry):
        try:
            await channel.send(message)
        except NotSentError as exc:
            found.append((channel.name, str(exc)))
        else:
            found.append((channel.name, None))
    return found
