"""A real broker, a real bridge and a client for tests of the MQTT bridge."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from support.daemon_host import command, environment, free_port, until
from support.real_parts import require

__all__ = ["Bridge", "Broker", "Heard", "MqttClient", "bridge", "broker"]


@dataclass(frozen=True)
class Heard:
    """A message that a client heard."""

    topic: str
    text: str
    is_retained: bool
    expiry_s: int | None
    said: dict[str, str]
    correlation: bytes | None
    at_s: float


class MqttClient:
    """A client of the broker that keeps all it hears; with a session also across connections."""

    def __init__(self, port: int, *topics: str, session: str = "") -> None:
        self.heard: list[Heard] = []
        self._lock = threading.Lock()
        self._client = paho.Client(
            CallbackAPIVersion.VERSION2, session or None, protocol=paho.MQTTv5,
            reconnect_on_failure=False,
        )  # fmt: skip
        self._acks: set[int] = set()
        self._client.on_message = self._take
        self._client.on_subscribe = lambda client, data, mid, codes, properties: self._acks.add(mid)
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.SessionExpiryInterval = 600 if session else 0
        self._client.connect("127.0.0.1", port, clean_start=not session, properties=properties)
        self._client.loop_start()
        until(self._client.is_connected, "connected to the broker")
        for topic in topics:
            self.subscribe(topic)

    def subscribe(self, topic: str) -> None:
        """Subscribe, and wait until the broker says so."""
        options = SubscribeOptions(qos=2, retainAsPublished=True)
        _, mid = self._client.subscribe(topic, options=options)
        until(lambda: mid in self._acks, f"subscribed to {topic}")

    def _take(self, client: Any, data: Any, message: Any) -> None:
        found = message.properties
        said = dict(getattr(found, "UserProperty", []))
        with self._lock:
            self.heard.append(
                Heard(
                    message.topic, message.payload.decode(), bool(message.retain),
                    getattr(found, "MessageExpiryInterval", None), said,
                    getattr(found, "CorrelationData", None), time.monotonic(),
                )
            )  # fmt: skip

    def last(self, topic: str) -> Heard | None:
        """The last message of a topic; None: there was none."""
        with self._lock:
            return next((one for one in reversed(self.heard) if one.topic == topic), None)

    def text(self, topic: str) -> str | None:
        """What the last message of a topic says."""
        found = self.last(topic)
        return None if found is None else found.text

    def all(self, topic: str) -> list[Heard]:
        """All messages of a topic."""
        with self._lock:
            return [one for one in self.heard if one.topic == topic]

    def publish(
        self,
        topic: str,
        payload: str | bytes = b"",
        *,
        qos: int = 2,
        retain: bool = False,
        correlation: bytes | None = None,
        response: str = "",
        expiry_s: int | None = None,
    ) -> None:
        """Publish, and wait until the broker has it."""
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if correlation is not None:
            properties.CorrelationData = correlation
        if response:
            properties.ResponseTopic = response
        if expiry_s is not None:
            properties.MessageExpiryInterval = expiry_s
        sent = self._client.publish(topic, payload, qos, retain, properties)
        sent.wait_for_publish(10)

    def ask(self, topic: str, payload: str | bytes = b"", **more: Any) -> Heard:
        """Send a command, and wait for its answer."""
        before = len(self.all("answers/test"))
        self.publish(topic, payload, response="answers/test", **more)
        until(lambda: len(self.all("answers/test")) > before, f"an answer to {topic}")
        return self.all("answers/test")[before]

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()
        self._client.loop_stop()


@dataclass
class Broker:
    """A mosquitto that can be ended and started again."""

    folder: Path
    port: int
    more: str = ""
    anonymous: bool = True
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, with what it saved."""
        anonymous = "true" if self.anonymous else "false"
        rows = [
            f"listener {self.port} 127.0.0.1", f"allow_anonymous {anonymous}", "persistence true",
            f"persistence_location {self.folder}/", "autosave_interval 1", "user root", self.more,
        ]  # fmt: skip
        config = self.folder / "mosquitto.conf"
        config.write_text("\n".join(rows) + "\n")
        with (self.folder / "mosquitto.log").open("ab") as log:
            self.process = subprocess.Popen(
                [require("mosquitto"), "-v", "-c", config], stdout=log, stderr=log
            )
        until(self._listens, "the broker listens")

    def _listens(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, (self.folder / "mosquitto.log").read_text()
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def end(self, *, kill: bool = False) -> None:
        """End it."""
        if self.process is not None:
            self.process.kill() if kill else self.process.terminate()
            self.process.wait(10)
            self.process = None

    @contextlib.contextmanager
    def client(self, *topics: str, session: str = "") -> Iterator[MqttClient]:
        """A client for as long as the block runs; with a session nothing is lost in between."""
        client = MqttClient(self.port, *topics, session=session)
        try:
            yield client
        finally:
            client.close()

    def standing(self, topic: str) -> dict[str, Heard]:
        """What stands at the broker under a filter."""
        with self.client() as client:
            client.subscribe(topic)
            client.publish("probe/end", qos=2)
            time.sleep(0.2)
            return {one.topic: one for one in client.heard if one.is_retained}


@contextlib.contextmanager
def broker(folder: Path, *, more: str = "", anonymous: bool = True) -> Iterator[Broker]:
    """A broker of the test's own."""
    require("mosquitto")
    made = Broker(folder, free_port(), more, anonymous)
    try:
        made.start()
        yield made
    finally:
        made.end(kill=True)


@dataclass
class Bridge:
    """A running bridge."""

    process: subprocess.Popen[bytes]
    folder: Path

    def log(self) -> str:
        """All it has logged."""
        return (self.folder / "bridge.log").read_text()


@contextlib.contextmanager
def bridge(folder: Path) -> Iterator[Bridge]:
    """`lecombus bridge mqtt` with the roster of a folder."""
    words = command("bridge", "mqtt", "-c", folder / "roster.yaml", "--state", folder / "mqtt")
    with (folder / "bridge.log").open("wb") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log, env=environment())
    try:
        yield Bridge(process, folder)
        if process.poll() is None:
            assert "Traceback" not in (folder / "bridge.log").read_text()
    except (AssertionError, pytest.fail.Exception) as exc:
        exc.add_note((folder / "bridge.log").read_text()[-3000:])
        raise
    finally:
        process.kill()
        process.wait()
