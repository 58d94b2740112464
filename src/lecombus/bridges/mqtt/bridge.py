"""The MQTT bridge of one line, put together: what is shown, what is taken, and how it ends.

Strategy: a `LineFollower` knows the line, whether or not there is a broker. For each connection to
the broker a group of tasks runs until it is lost: one shows states and values, one sends events,
one sends the pulse, one makes drives known to Home Assistant. Values are never kept for later:
after an outage the newest are sent. Events are kept, bounded, on the disk. Commands outlive a
connection: what was begun is carried out. At the end the bridge itself says that it is `offline`;
if it cannot, the broker does.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Final

import anyio
import anyio.to_thread

from lecombus.bridges.line_follower import LineFollower
from lecombus.bridges.mqtt.announced_devices import Devices
from lecombus.bridges.mqtt.board import Board
from lecombus.bridges.mqtt.broker import Broker, BrokerError, Incoming, WillLimits, open_broker
from lecombus.bridges.mqtt.commands import PULSE_EVERY_S, VERBS, Commands, Pulse
from lecombus.bridges.mqtt.discovery import Discovery
from lecombus.bridges.mqtt.event_queue import EventQueue
from lecombus.bridges.mqtt.retained import (
    EMPTY,
    OFFLINE,
    Message,
    drive_messages,
    json_bytes,
    line_state,
    state_message,
)
from lecombus.bridges.mqtt.seen_commands import SeenCommands
from lecombus.bridges.mqtt.summary import LineSummarizer
from lecombus.bridges.mqtt.topics import Topics
from lecombus.bridges.watchdog_misses import watch_misses
from lecombus.client import Event
from lecombus.roster import MqttEntry, Roster

__all__ = ["MqttBridge"]

LOOK_EVERY_S: Final = 0.5
"""How often it is looked what expires soon."""

MISSES_EVERY_S: Final = 10.0
"""How often the counts of missed watchdogs are read: a page of metrics each time."""

CHANGES_WAIT_S: Final = 0.05
"""Changes that come within this are sent together."""

NEWEST_S: Final = 0.5
"""What was made so long before it is sent is made again."""

FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 30.0
STEADY_S: Final = 10.0
"""After a connection that held for so long the next attempt is soon."""

END_WITHIN_S: Final = 3.0

ID: Final = re.compile(r"[!-~]{1,100}")
"""Of an event."""

SENT_EVENTS: Final = frozenset(("state", "remark", "trip", "write", "lease", "line", "gap"))

logger = logging.getLogger(__name__)


class MqttBridge:
    """The bridge.

    Args:
        roster: The roster, with `mqtt`.
        directory: What must outlive the bridge is kept there; None: nowhere.
    """

    def __init__(self, roster: Roster, directory: Path | None) -> None:
        assert roster.mqtt is not None
        self._roster = roster
        self._entry: MqttEntry = roster.mqtt
        self._topics = Topics(self._entry.topics, roster.line.name)
        self._events = EventQueue(directory)
        self._position = SentPosition(None if directory is None else directory / "last-event")
        self._heard_id = self._position.read()
        self.follower = LineFollower(roster.api.socket, after=self._heard_id)
        self.follower.listeners.append(self._heard)
        self._pulse = Pulse()
        self._will_limits = WillLimits()
        self._broker: Broker | None = None
        self._board = Board()
        self._summary = LineSummarizer(self._topics, roster.line.name)
        self._shown: set[str] = set()
        self._changed: set[str] = set()
        self._is_all_changed = True
        self._came = anyio.Event()
        self._event_came = anyio.Event()
        self._is_ending = False
        self._commands = Commands(
            self._topics, roster.api.socket, control=self._entry.control,
            home_assistant=self._entry.home_assistant,
            seen=SeenCommands(None if directory is None else directory / "commands"),
            pulse=self._pulse, answer=self._answer,
            is_drive=lambda name: name in self.follower.drives,
        )  # fmt: skip
        self._devices = None
        if self._entry.home_assistant is not None:
            self._devices = Devices(
                Discovery(self._entry.home_assistant, self._topics, roster.line.name,
                          control=self._entry.control),
                self.follower,
            )  # fmt: skip

    async def run(self) -> None:
        """Run until cancelled, then end in good order."""
        stopping = anyio.Event()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(self._run_until, stopping)
            try:
                await anyio.sleep_forever()
            finally:
                stopping.set()

    async def _run_until(self, stopping: anyio.Event) -> None:
        with anyio.CancelScope(shield=True):
            await self.run_until(stopping)

    async def run_until(self, stopping: anyio.Event) -> None:
        """Run until `stopping` is set, then end in good order."""
        async with anyio.create_task_group() as tasks:
            for work in (self.follower.run, self._commands.run, self._stay_connected,
                         self._position.keep, self._watch_misses):  # fmt: skip
                tasks.start_soon(work)
            await stopping.wait()
            with anyio.move_on_after(END_WITHIN_S), suppress(BrokerError):
                await self._publish_end()
            tasks.cancel_scope.cancel()
        self._keep_events(at_end=True)
        self._position.write()

    # -- the connection --------------------------------------------------------------------------

    async def _stay_connected(self) -> None:
        """Connect to the broker, again and again."""
        pause_s, why_before = FIRST_PAUSE_S, ""
        while True:
            begun_s = anyio.current_time()
            why = await self._serve_until_lost()
            has_held = anyio.current_time() - begun_s >= STEADY_S
            if has_held or why != why_before:
                logger.warning("event=mqtt-lost broker=%s reason=%s", self._where, why)
            why_before = why
            pause_s = FIRST_PAUSE_S if has_held else min(2 * pause_s, LONGEST_PAUSE_S)
            await anyio.sleep(pause_s)

    @property
    def _where(self) -> str:
        return f"{self._entry.host}:{self._entry.port}"

    async def _serve_until_lost(self) -> str:
        """Serve one connection; returns why it ended."""
        why: list[str] = []
        try:
            async with open_broker(
                self._entry, self._topics.client, self._offline("the bridge was lost"),
                self._will_limits, self._take,
            ) as broker:  # fmt: skip
                await self._begin(broker)
                async with anyio.create_task_group() as tasks:
                    for work in (broker.lost, partial(self._show, broker),
                                 partial(self._send_events, broker),
                                 partial(self._beat, broker),
                                 partial(self._make_known, broker)):  # fmt: skip
                        tasks.start_soon(until_lost, work, why, tasks.cancel_scope)
        except BrokerError as exc:
            why.append(str(exc))
        finally:
            self._broker = None
            self._pulse.lost()
            self._keep_events()
        return why[0]

    async def _begin(self, broker: Broker) -> None:
        """Begin with a connection: what is known is shown, then commands are taken."""
        self._board.connected(anyio.current_time())
        self._is_all_changed = True
        await self._beat_once(broker)
        if not broker.limits.qos and self._entry.control:
            reason = "it acknowledges nothing, so only stops are carried out"
            logger.warning("event=mqtt-limited broker=%s reason=%s", self._where, reason)
        if not broker.limits.retain:
            logger.warning("event=mqtt-limited broker=%s reason=it keeps no retained messages",
                           self._where)  # fmt: skip
        if not broker.limits.wildcards:
            reason = "it takes no wildcards, so what a reload adds takes no commands"
            logger.warning("event=mqtt-limited broker=%s reason=%s", self._where, reason)
        self._broker = broker
        await broker.subscribe(self._filters(broker))
        if self._devices is not None:
            self._devices.forget()
            await broker.subscribe((self._devices.discovery.birth,))
            if broker.limits.wildcards and broker.limits.retain:
                await broker.subscribe((self._devices.discovery.filter,), retained=True)
        logger.info("event=mqtt-connected broker=%s", self._where)

    def _filters(self, broker: Broker) -> tuple[str, ...]:
        """Return what to subscribe to; without wildcards what the roster has."""
        if broker.limits.wildcards:
            return self._topics.command_filters
        writable = {drive.name: set(drive.writable) for drive in self._roster.drives}
        for name, group in self._roster.groups.items():
            writable[name] = set().union(*(writable[member] for member in group.members))
        return (
            *(self._topics.do(name, verb) for name in writable for verb in VERBS),
            *(self._topics.set(name, str(code)) for name, codes in writable.items()
              for code in sorted(codes)),
        )  # fmt: skip

    def _take(self, incoming: Incoming) -> None:
        """Take a message that came."""
        if self._devices is not None and self._devices.takes(incoming):
            return
        self._commands.take(incoming)

    async def _answer(self, message: Message) -> None:
        """Send an answer, if there is a connection; without one the asker hears nothing."""
        if self._broker is not None:
            with suppress(BrokerError):
                if not await self._broker.publish(message):
                    outcome = json_bytes(dict(message.properties))
                    await self._broker.publish(replace(message, payload=outcome))

    async def _publish_end(self) -> None:
        """Say that nothing more comes."""
        broker = self._broker
        self._is_ending = True
        if broker is None:
            return
        for name in self.follower.drives:
            topic = self._topics.drive_state(name)
            await broker.publish(state_message(topic, "unknown", "the bridge has ended", 60))
        await broker.publish(Message(self._topics.summary, EMPTY))
        await broker.publish(self._offline("the bridge has ended"))

    def _offline(self, reason: str) -> Message:
        return state_message(self._topics.line_state, OFFLINE, reason)

    # -- what is shown ---------------------------------------------------------------------------

    async def _show(self, broker: Broker) -> None:
        """Show states and values, whenever they change or would expire."""
        next_all_s = -inf
        while not self._is_ending:
            self._came = anyio.Event()
            names, self._changed = self._changed, set()
            now_s = anyio.current_time()
            if self._is_all_changed or now_s >= next_all_s:
                self._is_all_changed = False
                next_all_s = now_s + LOOK_EVERY_S
                names = self._shown | set(self.follower.drives)
                whole = [line_state(self._topics, self.follower, now_s),
                         self._summary.message(self.follower, now_s)]  # fmt: skip
                await self._publish(broker, whole, "\0", now_s)
            for name in names:
                self._shown.add(name)
                await self._show_drive(broker, name)
            self._shown = {
                one
                for one in self._shown
                if one in self.follower.drives or self._board.holds(self._under(one))
            }
            with anyio.move_on_after(max(0.0, next_all_s - anyio.current_time())):
                await self._came.wait()
                await anyio.sleep(CHANGES_WAIT_S)

    async def _show_drive(self, broker: Broker, name: str) -> None:
        drive, now_s = self.follower.drives.get(name), anyio.current_time()
        messages = [] if drive is None else list(drive_messages(self._topics, drive, now_s))
        await self._publish(broker, messages, self._under(name), now_s)

    def _under(self, name: str) -> str:
        """Return the beginning of the topics of a drive."""
        return f"{self._topics.root}/{name}/"

    async def _publish(
        self, broker: Broker, messages: list[Message], under: str, now_s: float
    ) -> None:
        """Send what is due; what gets old while others are sent is left for the next time."""
        for message in list(self._board.due(messages, under, now_s)):
            if self._is_ending or anyio.current_time() > now_s + NEWEST_S:
                return
            await broker.publish(message)
            self._board.sent(message, now_s)

    def _heard(self, event: Event) -> None:
        """Take an event of the line."""
        if event.kind in ("away", "connected", "line"):
            self._is_all_changed = True
            self._came.set()
        elif event.drive:
            self._changed.add(event.drive)
            self._came.set()
        elif event.kind == "looked" and self._devices is not None:
            self._devices.looked()
        if event.kind not in SENT_EVENTS:
            return
        text = json_bytes({"id": event.id or None, "kind": event.kind, **event.data}).decode()
        self._heard_id = event.id or self._heard_id
        try:
            self._events.put(event.drive, text)
            if self._events.is_on_disk:
                self._position.last_id = self._heard_id
        except OSError as exc:
            logger.error("event=mqtt-events-not-kept reason=%s", exc)
        self._event_came.set()

    async def _watch_misses(self) -> None:
        def take(counts: Mapping[str, int]) -> None:
            self._summary.watchdog_missed(counts, anyio.current_time())

        await watch_misses(self.follower.socket, MISSES_EVERY_S, take)

    # -- events, pulse, devices ------------------------------------------------------------------

    async def _send_events(self, broker: Broker) -> None:
        """Send events in their order."""
        while True:
            self._event_came = anyio.Event()
            if lost := self._events.lost:
                gap = {"kind": "gap", "missed": lost, "reason": "the broker was away for too long"}
                await self._send_event(broker, "", json_bytes(gap).decode())
                self._events.told_lost(lost)
            while (entry := self._events.first()) is not None:
                await self._send_event(broker, *entry)
                self._events.done(entry)
            self._position.last_id = self._heard_id
            await self._event_came.wait()

    async def _send_event(self, broker: Broker, drive: str, text: str) -> None:
        await broker.publish(
            Message(self._topics.event(drive), text.encode(), 1, is_retained=False,
                    content_type="application/json")
        )  # fmt: skip

    def _keep_events(self, *, at_end: bool = False) -> None:
        try:
            self._events.save(at_end=at_end)
            self._position.last_id = self._heard_id
        except OSError as exc:
            logger.error("event=mqtt-events-not-kept reason=%s", exc)

    async def _beat(self, broker: Broker) -> None:
        """Send the pulse, where commands need it."""
        while self._entry.control:
            await anyio.sleep(PULSE_EVERY_S)
            await self._beat_once(broker)

    async def _beat_once(self, broker: Broker) -> None:
        sent_s = self._pulse.now_s()
        await broker.publish(Message(self._topics.pulse, b"", 1, is_retained=False, expiry_s=1))
        if broker.limits.qos > 0:
            self._pulse.proven(sent_s, anyio.current_time())

    async def _make_known(self, broker: Broker) -> None:
        """Make drives known to Home Assistant."""
        while self._devices is not None:
            self._devices.came = anyio.Event()
            for message in self._devices.due():
                await broker.publish(message)
                self._devices.sent(message)
            await self._devices.came.wait()
            await anyio.sleep(CHANGES_WAIT_S)


class SentPosition:
    """Up to which event the daemon's events were sent or are on the disk, kept in a file.

    Args:
        file: The file; None: it is not kept.

    Attributes:
        last_id: The id of the last event.
    """

    def __init__(self, file: Path | None) -> None:
        self._file = file
        self.last_id = self._written = ""

    def read(self) -> str:
        """Return the id of the last event of an earlier run; empty: there is none."""
        if self._file is not None:
            with suppress(OSError, ValueError):
                found = self._file.read_text().strip()
                if ID.fullmatch(found):  # zeros after a power cut would go into a header
                    self.last_id = self._written = found
        return self.last_id

    def write(self) -> None:
        """Keep it, if it is another."""
        if self._file is not None and self.last_id != self._written:
            with suppress(OSError):  # then some events come twice after the next start
                beside = self._file.with_suffix(".new")
                beside.write_text(f"{self.last_id}\n")
                beside.replace(self._file)
                self._written = self.last_id

    async def keep(self) -> None:
        """Keep it until cancelled; not more often than once a second."""
        while True:
            await anyio.sleep(1)
            await anyio.to_thread.run_sync(self.write)  # a disk that stalls delays no stop


async def until_lost(
    work: Callable[[], Awaitable[None]], why: list[str], scope: anyio.CancelScope
) -> None:
    """Run a part of a connection; when that is lost, end the others."""
    try:
        await work()
    except BrokerError as exc:
        why.append(str(exc))
        scope.cancel()
