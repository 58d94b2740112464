"""One line for all examples: two drives on a pseudo terminal, their daemon, a broker, the bridge.

The line and its drives are named as the examples name them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd
from support.daemon_host import Daemon, on_a_pty, short_dir, until
from support.mqtt_parts import Bridge, Broker, MqttClient, bridge, broker

DEPLOY = Path(__file__).parents[2] / "deploy"
DRIVES = (("feeder", 11, "8200vector"), ("belt", 12, "smvector"))
ROOT = "lecombus/hall-3"


@dataclass(frozen=True)
class Site:
    """A line with a broker.

    Args:
        broker: The broker.
        daemon: The line's daemon.
        bridge: Its bridge.
        end: The simulated drives.
        client: A client of the broker that hears all.
    """

    broker: Broker
    daemon: Daemon
    bridge: Bridge
    end: PtyEnd
    client: MqttClient

    def heard(self, topic: str, what: str) -> list[tuple[str, str]]:
        """All messages so far whose topics match a filter, with what they say; at least one."""
        levels = topic.split("/")

        def matches(found: str) -> bool:
            parts = found.split("/")
            fits = all(one in ("+", other) for one, other in zip(levels, parts, strict=False))
            return fits and len(parts) == len(levels)

        def found() -> list[tuple[str, str]]:
            return [(one.topic, one.text) for one in list(self.client.heard) if matches(one.topic)]

        return until(found, f"{what}: messages under {topic}")

    def document(self, drive: str) -> dict[str, Any]:
        """The newest document of a drive in which its cyclic values are good and all is known."""

        def found() -> dict[str, Any]:
            said: dict[str, Any] = json.loads(self.client.text(f"{ROOT}/{drive}/json") or "{}")
            values = said.get("values", {}).items()
            good = {code for code, one in values if one["quality"] == "good"}
            doing = (said.get("motion") or {}).get("doing", "unknown")
            return said if doing != "unknown" and {"C0050", "C0150"} <= good else {}

        return until(found, f"the values of {drive}")

    def trip(self, drive: str, number: int) -> None:
        """Trip a drive."""
        with self.end.lock:
            self.end.line[drive].trip(number)

    def reset(self, drive: str) -> None:
        """Reset its fault."""
        assert self.daemon.cli("reset-fault", drive).status == 0


@pytest.fixture(scope="session")
def site() -> Iterator[Site]:
    """The line."""
    with short_dir() as folder, broker(folder) as message_broker:
        mqtt = (
            f"mqtt: {{host: 127.0.0.1, port: {message_broker.port}, tls: no, control: yes, "
            "home_assistant: homeassistant}"
        )
        with (
            on_a_pty(folder, DRIVES, name="hall-3", sections=mqtt) as (daemon, end),
            bridge(folder) as its_bridge,
            message_broker.client("#", "answers/#") as client,
        ):
            daemon.until_online()
            until(lambda: client.text(f"{ROOT}/state") == "online", "the line at the broker")
            yield Site(message_broker, daemon, its_bridge, end, client)
