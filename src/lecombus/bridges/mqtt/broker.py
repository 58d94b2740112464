"""One connection to the broker: TLS, limits, publishing, and what comes in.

Strategy: each attempt has a new client object (ADR 84) and a clean session, so that nothing
of an earlier connection is sent again, and nothing waits at the broker for a bridge that was away.
The limits that the broker names when it accepts the connection are obeyed here.

aiomqtt neither gives the broker's properties nor closes a connection that it gave up; so
`BridgeClient` uses some of its private names (tests/bridges/test_mqtt_broker.py looks for them).
"""

from __future__ import annotations

import asyncio
import logging
import ssl
import stat
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import aiomqtt
import anyio
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from lecombus.bridges.mqtt.retained import Message
from lecombus.roster import MqttEntry

__all__ = ["Broker", "BrokerError", "Incoming", "Limits", "WillLimits", "open_broker"]

KEEP_ALIVE_S: Final = 10
"""After one and a half of this the broker says that the bridge is gone."""

CONNECT_WITHIN_S: Final = 5.0
SENT_WITHIN_S: Final = 10.0
END_WITHIN_S: Final = 2.0

AT_ONCE_MOST: Final = 16
"""Messages under way that the broker acknowledges."""

INCOMING_AT_ONCE: Final = 20
INCOMING_BYTES: Final = 64 * 1024
"""Receive maximum and packet size that the bridge asks of the broker."""

PROPERTY_CHARS: Final = 1000

FAILURES: Final = 128  # and above
RETAIN_NOT_SUPPORTED: Final = 154
QOS_NOT_SUPPORTED: Final = 155
REFUSALS: Final = frozenset((4, 5, 134, 135, 138, 140))
"""Bad user or password, not authorised, banned, bad authentication; of MQTT 3.1.1 and 5."""

logger = logging.getLogger(__name__)

library_logger = logging.getLogger(f"{__name__}.library")
library_logger.setLevel(logging.CRITICAL)  # what it says stands in the errors that it raises


class BrokerError(Exception):
    """The broker cannot be reached, refuses, or is gone.

    Args:
        text: What is wrong.
        is_refused: It was reached, and does not permit it.
    """

    def __init__(self, text: str, *, is_refused: bool = False) -> None:
        super().__init__(text)
        self.is_refused = is_refused


@dataclass(slots=True)
class WillLimits:
    """What the broker takes of a will, as it turned out.

    Args:
        retain: Whether it may be retained.
        qos: Its quality of service.
    """

    retain: bool = True
    qos: int = 1


@dataclass(frozen=True, slots=True)
class Limits:
    """What the broker said when it accepted the connection.

    Args:
        receive_maximum: Messages under way that it acknowledges.
        packet_bytes: The largest packet that it takes; None: any.
        qos: The highest quality of service.
        retain: Whether it keeps retained messages.
        wildcards: Whether subscriptions may have wildcards.
    """

    receive_maximum: int = 65535
    packet_bytes: int | None = None
    qos: int = 2
    retain: bool = True
    wildcards: bool = True

    @classmethod
    def of(cls, properties: Properties | None) -> Limits:
        """Return the limits that a CONNACK has."""

        def found(name: str, default: Any) -> Any:
            return getattr(properties, name, default)

        return cls(
            int(found("ReceiveMaximum", 65535)), found("MaximumPacketSize", None),
            int(found("MaximumQoS", 2)), bool(found("RetainAvailable", 1)),
            bool(found("WildcardSubscriptionAvailable", 1)),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Incoming:
    """A message that came.

    Args:
        topic: Its topic.
        payload: What it says.
        qos: With which quality of service it was delivered.
        is_retained: Whether it was sent to stand at the broker.
        came_s: When it was read, by `anyio.current_time`; in `Commands`: was sent, by its `Pulse`.
        expiry_s: How long it may still wait; None: it does not say.
        response_topic: Where its sender waits for an answer; empty: nowhere.
        correlation: By which the sender knows the answer; None: it gives none.
        reason: Its user property of this name.
    """

    topic: str
    payload: bytes
    qos: int
    is_retained: bool
    came_s: float
    expiry_s: int | None = None
    response_topic: str = ""
    correlation: bytes | None = None
    reason: str = ""


class BridgeClient(aiomqtt.Client):
    """A client that keeps what the broker said of itself and hands messages on as they come."""

    limits = Limits()
    take: Callable[[Incoming], None]

    def __init__(self, *words: Any, **more: Any) -> None:
        super().__init__(*words, **more)
        self._acknowledged: dict[int, asyncio.Future[int]] = {}

    def _on_connect(
        self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None
    ) -> None:
        self.limits = Limits.of(properties)
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_message(self, client: Any, userdata: Any, message: Any) -> None:
        found = message.properties
        waited_s = time.monotonic() - float(message.timestamp)  # for the handshake of QoS 2
        self.take(
            Incoming(
                message.topic,
                bytes(message.payload),
                message.qos,
                bool(message.retain),
                asyncio.get_running_loop().time() - waited_s,
                getattr(found, "MessageExpiryInterval", None),
                getattr(found, "ResponseTopic", ""),
                getattr(found, "CorrelationData", None),
                dict(getattr(found, "UserProperty", ())).get("reason", ""),
            )
        )

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        self._loop.call_soon_threadsafe(self._write_in_turn, sock)

    def _write_in_turn(self, sock: Any) -> None:
        """Wait until a socket can be written; one that is closed by now is left alone.

        aiomqtt registers its number then, which may be another socket's, or none.
        """
        if sock.fileno() >= 0:
            self._loop.add_writer(sock.fileno(), self._write)

    def _write(self) -> None:
        try:
            self._client.loop_write()
        except (OSError, ValueError) as exc:
            if not self._disconnected.done():
                self._disconnected.set_exception(exc)

    def _on_publish(
        self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any
    ) -> None:
        waiting = self._acknowledged.get(mid)
        if waiting is not None and not waiting.done():
            waiting.set_result(int(reason_code.value))
        super()._on_publish(client, userdata, mid, reason_code, properties)

    async def publish_for_reason(
        self, topic: str, payload: bytes, qos: int, retain: bool, properties: Properties
    ) -> int:
        """Send a message with QoS 1 or 2; returns the reason code that acknowledges it.

        Raises:
            MqttError: The connection is lost, or it is not acknowledged in time.
        """
        sent = self._client.publish(topic, payload, qos, retain, properties)
        if sent.rc != 0:
            raise aiomqtt.MqttCodeError(sent.rc, "Could not publish message")
        waiting = self._acknowledged[sent.mid] = asyncio.get_running_loop().create_future()
        try:
            return await self._wait_for(waiting, None)
        finally:
            del self._acknowledged[sent.mid]

    def abandon(self) -> None:
        """Close the connection, if it is still open, without a word to the broker."""
        self._client._sock_close()


class Broker:
    """A connection to the broker.

    Args:
        client: The connected client.
        limits: What the broker takes.
    """

    def __init__(self, client: BridgeClient, limits: Limits) -> None:
        self._client = client
        self.limits = limits
        self._under_way = anyio.CapacityLimiter(min(AT_ONCE_MOST, limits.receive_maximum))
        self._too_big: set[str] = set()
        self._refused: set[int] = set()

    async def publish(self, message: Message) -> bool:
        """Send a message, and wait until the broker has it (at QoS 0: until it is on its way).

        Returns:
            Whether it was sent; False: it is larger than the broker takes, or refused.

        Raises:
            BrokerError: The connection is lost.
        """
        if self._is_too_big(message):
            return False
        if message.qos and self.limits.qos:
            if (code := await self.publish_for_reason(message)) >= FAILURES:
                self._say_refused(message.topic, code)
            return code < FAILURES
        retain = message.is_retained and self.limits.retain
        try:
            await self._client.publish(
                message.topic, message.payload, 0, retain, properties_of(message)
            )
        except (aiomqtt.MqttError, ValueError) as exc:
            raise BrokerError(str(exc)) from exc
        return True

    def _say_refused(self, topic: str, code: int) -> None:
        """Log that the broker took a message and dropped it, once for each reason."""
        if code not in self._refused:
            self._refused.add(code)
            reason = ReasonCode(PacketTypes.PUBACK, identifier=code)
            logger.warning("event=mqtt-refused topic=%s reason=%s", topic, reason)

    async def publish_for_reason(self, message: Message) -> int:
        """Send a message that is acknowledged; returns MQTT's reason code, 0 if there is none.

        Raises:
            BrokerError: The connection is lost, or it is not acknowledged in time.
        """
        if not self.limits.qos:
            await self.publish(message)
            return 0
        qos, retain = min(message.qos, self.limits.qos), message.is_retained and self.limits.retain
        try:
            async with self._under_way:
                return await self._client.publish_for_reason(
                    message.topic, message.payload, qos, retain, properties_of(message)
                )
        except (aiomqtt.MqttError, ValueError) as exc:
            raise BrokerError(str(exc)) from exc

    def _is_too_big(self, message: Message) -> bool:
        """Whether the broker would end the connection because of a message."""
        most = self.limits.packet_bytes
        said = sum(len(key.encode()) + len(text.encode()) + 5 for key, text in message.properties)
        size = len(message.topic) + len(message.payload) + len(message.response or b"") + said + 64
        if most is None or size <= most:
            return False
        if message.topic not in self._too_big:
            self._too_big.add(message.topic)
            logger.warning(
                "event=mqtt-too-big topic=%s bytes=%d broker_takes=%d", message.topic, size, most
            )
        return True

    async def subscribe(
        self,
        filters: tuple[str, ...],
        *,
        retained: bool = False,
        qos: int = 2,
        as_published: bool = True,
        within_s: float = SENT_WITHIN_S,
    ) -> None:
        """Subscribe, and wait for the broker's acknowledgement.

        Args:
            filters: Topics, with wildcards where the broker takes them.
            retained: Whether what stands there is wanted; otherwise only what comes from now on.
            qos: The highest quality of service of what comes.
            as_published: Whether what comes now is marked as retained where its sender did that;
                otherwise only what stood at the broker already.
            within_s: How long to wait for the acknowledgement, seconds.

        Raises:
            BrokerError: The broker refuses, does not answer, or the connection is lost.
        """
        handling = (
            SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE if retained
            else SubscribeOptions.RETAIN_DO_NOT_SEND
        )  # fmt: skip
        options = SubscribeOptions(
            qos=min(qos, self.limits.qos), noLocal=True, retainAsPublished=as_published,
            retainHandling=handling,
        )  # fmt: skip
        wanted: Any = [(one, options) for one in filters]
        try:
            found = await self._client.subscribe(wanted, timeout=within_s)
        except (aiomqtt.MqttError, ValueError) as exc:
            raise BrokerError(str(exc)) from exc
        for topic, code in zip(filters, found, strict=False):
            if getattr(code, "is_failure", False):
                raise BrokerError(
                    f"it does not let this user subscribe to {topic}: {code}", is_refused=True
                )

    async def lost(self) -> None:
        """Wait until the connection is lost, and raise a `BrokerError` then."""
        try:
            async for _ in self._client.messages:
                pass
        except aiomqtt.MqttError as exc:
            raise BrokerError(str(exc.__cause__ or exc)) from exc


def properties_of(message: Message) -> Properties:
    """Return what is said beside a message."""
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    if message.expiry_s is not None:
        properties.MessageExpiryInterval = message.expiry_s
    if message.content_type:
        properties.ContentType = message.content_type
    if message.response is not None:
        properties.CorrelationData = message.response
    if message.response_topic:
        properties.ResponseTopic = message.response_topic
    if message.properties:
        properties.UserProperty = [
            (key, text[:PROPERTY_CHARS].replace("\0", "")) for key, text in message.properties
        ]
    return properties


@asynccontextmanager
async def open_broker(
    entry: MqttEntry,
    identifier: str,
    will: Message | None,
    will_limits: WillLimits,
    take: Callable[[Incoming], None],
    *,
    incoming_bytes: int = INCOMING_BYTES,
) -> AsyncIterator[Broker]:
    """Connect to the broker, and end the connection in good order.

    Args:
        entry: The broker, and how it is spoken to.
        identifier: Who the client is.
        will: What the broker says when the client is lost; None: nothing.
        will_limits: What it takes of that; changed when it turns out to be less.
        take: Called with each message that comes.
        incoming_bytes: The largest packet that the broker may send.

    Raises:
        BrokerError: It cannot be reached, refuses, or a file is missing or wrong.
    """
    client = client_for(entry, identifier, will, will_limits, incoming_bytes)
    client.take = take
    client._client.connect_timeout = CONNECT_WITHIN_S
    try:
        try:
            await client.__aenter__()
        except aiomqtt.MqttError as exc:
            raise refusal(exc, will_limits) from exc
        yield Broker(client, client.limits)
    finally:
        with anyio.move_on_after(END_WITHIN_S, shield=True), suppress(aiomqtt.MqttError):
            if client._connected.done():
                await client.__aexit__(None, None, None)
        client.abandon()


def refusal(exc: aiomqtt.MqttError, will_limits: WillLimits) -> BrokerError:
    """Return why no connection came about, and learn from it."""
    reason = getattr(exc, "rc", None)
    code = getattr(reason, "value", None)
    if code == RETAIN_NOT_SUPPORTED:
        will_limits.retain = False
    elif code == QOS_NOT_SUPPORTED:
        will_limits.qos = 0
    text = str(exc) or "it does not answer in time"
    cause = exc.__context__  # aiomqtt keeps only its text, with the number of the error
    if isinstance(cause, ConnectionRefusedError):
        text = "connection refused; is the broker running, and is that its port?"
    elif isinstance(cause, OSError):
        text = cause.strerror or text
    elif code in REFUSALS:
        text = f"it refuses the connection ({reason}); are user and password right?"
    return BrokerError(text, is_refused=code in REFUSALS)


def client_for(
    entry: MqttEntry,
    identifier: str,
    will: Message | None,
    will_limits: WillLimits,
    incoming_bytes: int = INCOMING_BYTES,
) -> BridgeClient:
    """Return a client that is not connected yet.

    Raises:
        BrokerError: A file is missing or wrong.
    """
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = 0
    properties.ReceiveMaximum = INCOMING_AT_ONCE
    properties.MaximumPacketSize = incoming_bytes
    said = None
    if will is not None:
        said = aiomqtt.Will(
            will.topic, will.payload, min(will.qos, will_limits.qos),
            will.is_retained and will_limits.retain,
        )  # fmt: skip
    return BridgeClient(
        entry.host, entry.port, username=entry.username, password=password_of(entry),
        identifier=identifier, protocol=aiomqtt.ProtocolVersion.V5, will=said, clean_start=True,
        keepalive=KEEP_ALIVE_S, timeout=SENT_WITHIN_S, properties=properties,
        tls_context=tls_of(entry), logger=library_logger,
    )  # fmt: skip


def password_of(entry: MqttEntry) -> str | None:
    """Return the password; read for each attempt, so that a new one counts.

    Raises:
        BrokerError: Its file cannot be read, is empty, or all users may read it.
    """
    if entry.password_file is None:
        return None
    try:
        check_secret(entry.password_file)
        lines = Path(entry.password_file).read_text().splitlines()
    except (OSError, ValueError) as exc:
        raise BrokerError(f"the password cannot be read: {exc}") from exc
    if not lines or not lines[0]:
        raise BrokerError(f"{entry.password_file} holds no password on its first line")
    return lines[0]


def check_secret(path: str) -> None:
    """Refuse a file that all users of this computer may read.

    Raises:
        BrokerError: It is such.
        OSError: There is no such file.
    """
    if Path(path).stat().st_mode & stat.S_IROTH:
        raise BrokerError(f"all users may read {path}: chmod o= {path}")


def tls_of(entry: MqttEntry) -> ssl.SSLContext | None:
    """Return what TLS trusts and shows; None: without TLS.

    Raises:
        BrokerError: A file cannot be read, or holds no certificates or no key, or all users may
            read the key.
    """
    if not entry.tls:
        return None
    file = entry.ca
    try:
        context = ssl.create_default_context(cafile=entry.ca)
        if entry.certificate is not None:
            file = entry.certificate
            if entry.key is not None:
                check_secret(entry.key)
            # A key with a password would ask for it at the terminal, and wait.
            context.load_cert_chain(entry.certificate, entry.key, password=lambda: "")
    except (OSError, ValueError) as exc:
        raise BrokerError(f"TLS: {file}: {exc}") from exc
    return context
