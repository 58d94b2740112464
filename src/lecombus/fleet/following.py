"""The connection through which the lines of a broker are followed.

Strategy: messages are asked for with QoS 0. With QoS 1 a broker queues what stands there for each
subscriber, and drops what is too much for that queue (mosquitto: 1000); with QoS 0 all of it comes,
and the next renewal repairs what is lost. The topic `state` is not renewed, so it is asked for
again each minute.

What comes is as old as it was on its way, which no message shows. So every few seconds the same
is subscribed to again, without what stands there: its acknowledgement comes behind all that the
broker sent before. Without it in time the connection counts as lost. A process that stood, or a
computer that slept, finds old messages in its socket: then they are not taken, and it connects
again.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any, Final, NoReturn
from uuid import uuid4

import anyio

from lecombus.bridges.mqtt.broker import Broker, BrokerError, Incoming, WillLimits, open_broker
from lecombus.fleet.lines import FleetLines, filters_of
from lecombus.roster import MqttEntry

__all__ = ["FleetFollower", "follow_once", "now_s"]

PULSE_EVERY_S: Final = 5.0
PULSE_WITHIN_S: Final = 8.0

FIRST_WITHIN_S: Final = 60.0
"""What stands there of thousands of lines comes before this is acknowledged."""

AS_NEWS: Final[Any] = {"qos": 0, "as_published": False}

STATES_EVERY_S: Final = 60.0

TICK_S: Final = 0.5
STOOD_S: Final = 5.0
"""A tick that is so late means that this process or this computer stood."""

FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 10.0


def now_s() -> float:
    """Return the time, which goes on while the computer sleeps; seconds."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class FleetFollower:
    """Follows the lines of a broker.

    Args:
        entry: The broker.
        lines: Takes what it shows.
        clock: Seconds; it goes on while the computer sleeps.

    Attributes:
        failure: Why the last attempt to connect failed; None: it did not.
        settled: Set when all that stood at the broker has come for the first time.
    """

    def __init__(
        self, entry: MqttEntry, lines: FleetLines, clock: Callable[[], float] = now_s
    ) -> None:
        self._entry = entry
        self._lines = lines
        self._clock = clock
        self._ticked_s = clock()
        self.failure: BrokerError | None = None
        self.settled = anyio.Event()

    async def run(self) -> NoReturn:
        """Follow until cancelled, also across losses of the broker."""
        pause_s = FIRST_PAUSE_S
        while True:
            begun_s = self._clock()
            try:
                await self.run_once()
            except BrokerError as exc:
                self.failure = exc
                self._lines.lost(str(exc), self._clock())
            has_held = self._clock() - begun_s > LONGEST_PAUSE_S
            pause_s = FIRST_PAUSE_S if has_held else min(2 * pause_s, LONGEST_PAUSE_S)
            await anyio.sleep(pause_s)

    async def run_once(self) -> NoReturn:
        """Follow until the connection is lost.

        Raises:
            BrokerError: It is, or there is none.
        """
        identifier = f"lecombus-fleet-{uuid4().hex[:12]}"
        async with open_broker(
            self._entry, identifier, None, WillLimits(), self._take
        ) as broker:  # fmt: skip
            if not broker.limits.wildcards:
                raise BrokerError("it takes no subscriptions with wildcards")
            why: list[BrokerError] = []
            async with anyio.create_task_group() as tasks:

                async def until_lost(work: Callable[[Broker], Awaitable[None]]) -> None:
                    try:
                        await work(broker)
                    except BrokerError as exc:
                        why.append(exc)
                        tasks.cancel_scope.cancel()

                self._ticked_s = self._clock()
                for work in (Broker.lost, self._pulse, self._tick):
                    tasks.start_soon(until_lost, work)
            raise BrokerError(f"the connection ended: {why[0]}", is_refused=why[0].is_refused)

    async def _pulse(self, broker: Broker) -> NoReturn:
        """Ask for what stands there, then show again and again that nothing is late."""
        prefixes = self._lines.prefixes
        everything = tuple(filters_of(prefixes))
        states = tuple(filters_of(prefixes, ["state"]))
        self._lines.began()
        await broker.subscribe(everything, retained=True, **AS_NEWS)
        await broker.subscribe(everything, within_s=FIRST_WITHIN_S, **AS_NEWS)
        self.failure = None
        self._lines.settled()
        self.settled.set()
        states_s = self._clock()
        while True:
            await anyio.sleep(PULSE_EVERY_S)
            if self._clock() - states_s >= STATES_EVERY_S:
                states_s = self._clock()
                await broker.subscribe(states, retained=True, **AS_NEWS)
            await broker.subscribe(everything, within_s=PULSE_WITHIN_S, **AS_NEWS)

    async def _tick(self, broker: Broker) -> NoReturn:
        """Notice that this process stood."""
        while True:
            await anyio.sleep(TICK_S)
            if self._has_stood():
                raise BrokerError("this program stood for some time; connecting again")
            self._ticked_s = self._clock()

    def _has_stood(self) -> bool:
        return self._clock() - self._ticked_s > STOOD_S

    def _take(self, incoming: Incoming) -> None:
        if self._has_stood():
            return
        self._lines.take(
            incoming.topic, incoming.payload, self._clock(), is_retained=incoming.is_retained,
            expiry_s=incoming.expiry_s, reason=incoming.reason,
        )  # fmt: skip


async def until_settled(lines: FleetLines, *, quiet_s: float, within_s: float) -> None:
    """Wait until no more lines come, at the most `within_s`.

    A broker of several computers may send what stands there behind its acknowledgement.
    """
    with anyio.move_on_after(within_s):
        while True:
            before = len(lines)
            await anyio.sleep(quiet_s)
            waits = lines.expected and len(lines) < len(lines.expected)
            if len(lines) == before and not waits:
                return


async def follow_once(
    entry: MqttEntry, lines: FleetLines, *, connect_within_s: float, quiet_s: float
) -> None:
    """Read what stands at the broker now.

    Raises:
        BrokerError: It cannot be reached, or refuses.
    """
    follower = FleetFollower(entry, lines)
    failed: list[BrokerError] = []
    async with anyio.create_task_group() as tasks:

        async def follow() -> None:
            try:
                await follower.run_once()
            except BrokerError as exc:
                failed.append(exc)
                tasks.cancel_scope.cancel()

        tasks.start_soon(follow)
        with anyio.move_on_after(connect_within_s):
            await follower.settled.wait()
        if follower.settled.is_set():
            await until_settled(lines, quiet_s=quiet_s, within_s=connect_within_s)
        tasks.cancel_scope.cancel()
    if failed:
        raise failed[0]
    if not follower.settled.is_set():
        raise BrokerError(f"it does not answer within {connect_within_s:g} s")
