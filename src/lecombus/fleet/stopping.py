"""Stops of whole lines, asked for through the broker.

A stop is one command a line: `all/do/quick-stop`, with a response topic, correlation data of its
own, and an expiry for its way. The bridge of the line has the daemon carry it out, and answers with
the outcome of each drive. All are published before any answer is waited for. Whatever is not
known for certain has the outcome `unknown`: a command without an answer may have been carried out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any, Final
from uuid import uuid4

import anyio

from lecombus.bridges.mqtt.broker import Broker, BrokerError, Incoming, WillLimits, open_broker
from lecombus.bridges.mqtt.retained import Message
from lecombus.roster import MqttEntry

__all__ = ["StopResult", "send_stops"]

EXPIRY_S: Final = 10
"""How long a stop may be on its way to the bridge, which takes one however late it is."""

LISTEN_WITHIN_S: Final = 3.0
"""A broker that does not say in time that answers are heard is sent the stops all the same."""

ANSWERS: Final = "lecombus-fleet"
"""The first level of the topics of answers; not of a line, where no bridge sends any."""

ANSWER_BYTES: Final = 1024 * 1024
"""The outcomes of 99 drives have some 100 kB."""

NO_SUBSCRIBER: Final = 16
NOT_AUTHORISED: Final = 135
FAILURES: Final = 128

EMERGENCY: Final = "use the emergency stop circuit"


@dataclass(frozen=True, slots=True)
class StopResult:
    """How the stop of one line ended.

    Args:
        root: The first levels of its topics.
        outcome: As of `POST /v1/stop`; `unknown`: it is not known whether it was carried out.
        kind: A stable word for programs; empty when it was done.
        reason: Why.
        remedy: What to do.
        answer: The daemon's document; None: none came.
        text: The same as it came.
    """

    root: str
    outcome: str
    kind: str = ""
    reason: str = ""
    remedy: str = ""
    answer: Mapping[str, Any] | None = None
    text: str = ""

    @property
    def is_done(self) -> bool:
        """Whether every drive is known to have taken it."""
        return self.outcome in ("done", "verified")


def not_known(root: str, reason: str, kind: str = "no-answer") -> StopResult:
    """Return that it is not known whether a stop was carried out."""
    text = f"{reason}: it is not known whether it was carried out"
    return StopResult(root, "unknown", kind, text, EMERGENCY)


@dataclass(slots=True)
class Asked:
    """A stop that was asked for.

    Args:
        root: Of the line.
        correlation: By which its answer is known.
        result: How it ended; None: that is not known yet.
        over: Set when it is.
    """

    root: str
    correlation: bytes = field(default_factory=lambda: uuid4().bytes)
    result: StopResult | None = None
    over: anyio.Event = field(default_factory=anyio.Event)

    def end(self, result: StopResult) -> None:
        """Note how it ended, once."""
        if self.result is None:
            self.result = result
            self.over.set()


async def send_stops(
    entry: MqttEntry,
    roots: Iterable[str],
    target: str,
    action: str,
    within_s: float,
    heard: Callable[[StopResult], None] = lambda result: None,
) -> list[StopResult]:
    """Stop lines; return how that ended, one result a line, in their order.

    Args:
        entry: The broker.
        roots: The first levels of the topics of each line.
        target: A drive, a group, or `all`.
        action: `quick-stop` or `inhibit`.
        within_s: How long to wait for answers, seconds.
        heard: Called with each result as it comes.

    Raises:
        BrokerError: There is no connection to the broker: nothing was sent.
    """
    identifier = uuid4().hex[:12]
    stops = [Asked(root) for root in dict.fromkeys(roots)]
    waiting = {one.correlation: one for one in stops}
    base = ANSWERS
    while any(one.root.split("/")[0] == base for one in stops):
        base += "-answers"  # no bridge answers below the first levels of lines
    topic = f"{base}/{identifier}"

    def take(incoming: Incoming) -> None:
        asked = waiting.get(incoming.correlation or b"")
        if asked is not None and incoming.topic == topic and not incoming.is_retained:
            asked.end(result_of(asked.root, incoming.payload))

    async with open_broker(
        entry, f"lecombus-fleet-{identifier}", None, WillLimits(), take, incoming_bytes=ANSWER_BYTES
    ) as broker:  # fmt: skip
        deaf = await listen(broker, topic)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(until_lost, broker, stops)
            async with anyio.create_task_group() as stopping:
                for one in stops:
                    message = Message(
                        f"{one.root}/{target}/do/{action}", b"", 1, is_retained=False,
                        expiry_s=EXPIRY_S, response=one.correlation, response_topic=topic,
                    )  # fmt: skip
                    stopping.start_soon(stop, broker, one, message, within_s, deaf, heard)
            tasks.cancel_scope.cancel()
    return [one.result for one in stops if one.result is not None]


async def listen(broker: Broker, topic: str) -> BrokerError | None:
    """Subscribe to answers; returns why that failed. Stops are sent in any case.

    With QoS 0: of many answers with QoS 1 a broker drops those that its queue does not hold.
    """
    try:
        await broker.subscribe((topic,), qos=0, within_s=LISTEN_WITHIN_S)
    except BrokerError as exc:
        return exc
    return None


async def stop(
    broker: Broker,
    asked: Asked,
    message: Message,
    within_s: float,
    deaf: BrokerError | None,
    heard: Callable[[StopResult], None],
) -> None:
    """Send one stop, then wait for its answer: its time begins when it was sent."""
    code = 0
    try:
        code = await broker.publish_for_reason(message)
    except BrokerError as exc:
        asked.end(not_known(asked.root, f"the broker was lost ({exc})", "broker-lost"))
    if code == NO_SUBSCRIBER:
        asked.end(
            StopResult(asked.root, "refused", "no-bridge", "no bridge takes commands for it at "
                       "this broker: no drive was asked to stop", EMERGENCY)
        )  # fmt: skip
    elif code >= FAILURES:
        is_forbidden = code == NOT_AUTHORISED
        asked.end(
            StopResult(asked.root, "refused", "not-permitted" if is_forbidden else "broker",
                       "the broker does not let this user publish it" if is_forbidden else
                       f"the broker refuses it (MQTT reason code {code})", EMERGENCY)
        )  # fmt: skip
    elif deaf is not None and deaf.is_refused:
        asked.end(not_known(asked.root, f"no answer can be heard ({deaf})"))
    with anyio.move_on_after(within_s):
        await asked.over.wait()
    asked.end(not_known(asked.root, f"no answer came within {within_s:g} s"))
    assert asked.result is not None
    heard(asked.result)


async def until_lost(broker: Broker, stops: list[Asked]) -> None:
    """Wait until the connection is lost; then nothing more is heard."""
    try:
        await broker.lost()
    except BrokerError as exc:
        for one in stops:
            one.end(not_known(one.root, f"the broker was lost ({exc})", "broker-lost"))


def result_of(root: str, payload: bytes) -> StopResult:
    """Return what the answer of a bridge says."""
    try:
        text = payload.decode()
        found: Any = json.loads(text, parse_float=Decimal, parse_constant=refuse)
        outcome = found["outcome"]
        if not isinstance(outcome, str):
            raise TypeError("outcome is not text")
    except (ValueError, TypeError, KeyError, ArithmeticError, RecursionError) as exc:
        return not_known(root, f"the answer cannot be read ({exc})", "bad-answer")
    said = {key: str(found.get(key) or "") for key in ("kind", "reason", "remedy")}
    return StopResult(root, outcome, said["kind"], said["reason"], said["remedy"], found, text)


def refuse(word: str) -> None:
    """Refuse NaN and Infinity, which are no JSON."""
    raise ValueError(f"{word} is not a number")
