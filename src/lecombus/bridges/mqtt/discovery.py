"""What makes drives known to Home Assistant: one retained message a drive. Pure.

Read-only, with buttons that stop the drive; with `control` also a number for its speed. What is
shown of a drive is available while bridge, daemon, line and drive are there; its state and the
buttons while bridge and daemon are. All that is shown also expires in Home Assistant: it hears
nothing when a message expires at the broker, nor `offline` of a bridge that went with its broker.
Home Assistant keeps a part of a device that is only left out, such as the number after `control`
was taken out of the roster. It removes one of which only the platform is said.

https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from decimal import Decimal
from math import ceil
from typing import Any, Final

from lecombus import __version__
from lecombus.bridges.line_follower import FollowedDrive, LineFollower
from lecombus.bridges.mqtt.retained import (
    EMPTY,
    JSON_STANDS_S,
    STATE_STANDS_S,
    Message,
    json_bytes,
)
from lecombus.bridges.mqtt.topics import Topics
from lecombus.roster import good_for_s

__all__ = ["Discovery"]

KINDS: Final[Mapping[str, str]] = {
    "Hz": "frequency", "V": "voltage", "A": "current", "°C": "temperature", "W": "power",
    "kW": "power", "kWh": "energy", "s": "duration", "h": "duration",
}  # fmt: skip
"""Home Assistant's device class by a unit that it knows."""

BOTH_WAYS: Final[Mapping[str, frozenset[str]]] = {
    "Hz": frozenset(), "%": frozenset(("821x", "822x", "824x", "93xx")),
}  # fmt: skip
"""Families whose setpoint has a sign, by its unit: that of an 821x has one in `%` (C0127 = 1)."""

LINE_IS_THERE: Final = "{{ 'online' if value == 'online' else 'offline' }}"
DAEMON_IS_THERE: Final = "{{ 'online' if value in ('online', 'lost', 'closed') else 'offline' }}"
DRIVE_IS_THERE: Final = "{{ 'online' if value in ('online', 'degraded') else 'offline' }}"

LATE_S: Final = 10
"""How much later than expected a state may be said again until it is not believed any more."""

PLATFORMS: Final = ("sensor", "binary_sensor", "button", "number")
"""Those of the parts of a drive."""

SPEED_MOST: Final[Mapping[str, int]] = {"Hz": 650, "%": 200}
"""What the number takes; the daemon knows the drive's own range, and refuses what is beyond."""


class Discovery:
    """The discovery messages of one line.

    Args:
        prefix: The first levels of Home Assistant's topics.
        topics: The line's topics.
        line: The line's name.
        control: Whether speeds may be written.
    """

    def __init__(self, prefix: str, topics: Topics, line: str, *, control: bool) -> None:
        self._prefix = prefix
        self._topics = topics
        self._line = line
        self._control = control

    @property
    def birth(self) -> str:
        """Where Home Assistant says `online` when it was started."""
        return f"{self._prefix}/status"

    @property
    def filter(self) -> str:
        """Where all devices stand, also those of others."""
        return f"{self._prefix}/device/+/config"

    def is_topic(self, topic: str) -> bool:
        """Whether a device stands there."""
        parts = topic.removeprefix(f"{self._prefix}/").split("/")
        return topic.startswith(f"{self._prefix}/") and len(parts) == 3 and parts[0] == "device"

    def topic(self, drive: str) -> str:
        """Where a drive stands."""
        return f"{self._prefix}/device/{self._topics.device(drive)}/config"

    def is_ours(self, payload: bytes) -> bool:
        """Whether a device that stands at the broker is a drive of this line."""
        with suppress(ValueError, TypeError, AttributeError, KeyError):
            document = json.loads(payload)
            return bool(document["device"]["serial_number"].startswith(f"{self._topics.root}/"))
        return False

    def removal(self, topic: str) -> Message:
        """Return what removes a device."""
        return Message(topic, EMPTY, 1)

    def message(
        self, drive: FollowedDrive, follower: LineFollower, before: Mapping[str, str]
    ) -> Message:
        """Return what makes a drive known.

        Args:
            drive: The drive.
            follower: Knows how often its codes are read.
            before: The parts that were made known of it, and their platforms; those that it has no
                more are removed.
        """
        document = self._document(drive, follower)
        gone = {key: {"platform": platform} for key, platform in before.items()}
        document["components"] = gone | document["components"]
        topic = self.topic(drive.name)
        return Message(topic, json_bytes(document), 1, content_type="application/json")

    def parts(self, payload: bytes) -> dict[str, str]:
        """Return the parts of a device that stands at the broker, with their platforms."""
        with suppress(ValueError, TypeError, AttributeError, KeyError):
            found = json.loads(payload)["components"].items()
            return {key: one["platform"] for key, one in found if one["platform"] in PLATFORMS}
        return {}

    def _document(self, drive: FollowedDrive, follower: LineFollower) -> dict[str, Any]:
        line = {"topic": self._topics.line_state, "value_template": LINE_IS_THERE}
        daemon = {**line, "value_template": DAEMON_IS_THERE}
        there = {"topic": self._topics.drive_state(drive.name), "value_template": DRIVE_IS_THERE}
        return {
            "device": {
                "identifiers": [self._topics.device(drive.name)],
                "name": f"{self._line} {drive.name}",
                "manufacturer": "Lenze",
                "model": drive.family,
                "serial_number": f"{self._topics.root}/{drive.name}",
            },
            "origin": {"name": "lecombus", "sw_version": __version__},
            "availability": [line, there],
            "availability_mode": "all",
            "components": dict(self._components(drive, follower, [daemon])),
        }

    def _components(
        self, drive: FollowedDrive, follower: LineFollower, daemon: list[dict[str, str]]
    ) -> Iterator[tuple[str, dict[str, Any]]]:
        periods = [follower.period_s(drive.name, code) for code in drive.values]
        longest_s = max((good_for_s(one, follower.stretch) for one in periods if one), default=0)
        whole = {
            "state_topic": self._topics.json(drive.name),
            "expire_after": ceil(max(longest_s, JSON_STANDS_S)) + LATE_S,
        }
        yield self._component(
            drive, "state", "sensor", name="State", entity_category="diagnostic",
            state_topic=self._topics.drive_state(drive.name), availability=daemon,
            expire_after=STATE_STANDS_S + LATE_S,
        )  # fmt: skip
        yield self._component(
            drive, "motion", "sensor", name="Motion", **whole,
            value_template="{{ value_json.doing }}",
        )  # fmt: skip
        yield self._component(
            drive, "problem", "binary_sensor", name="Fault", device_class="problem", **whole,
            value_template="{{ 'ON' if value_json.fault else 'OFF' }}",
        )  # fmt: skip
        yield self._component(
            drive, "fault", "sensor", name="Fault meaning", **whole,
            value_template="{{ value_json.fault.meaning if value_json.fault else 'none' }}",
        )  # fmt: skip
        for code in sorted(drive.values):
            period_s = follower.period_s(drive.name, code)
            if period_s is not None:
                yield self._value(drive, code, good_for_s(period_s, follower.stretch))
        for verb, name in (("quick-stop", "Quick stop"), ("inhibit", "Inhibit")):
            yield self._component(
                drive, verb.replace("-", "_"), "button", name=name, availability=daemon,
                command_topic=self._topics.do(drive.name, verb), qos=2, retain=False,
            )  # fmt: skip
        if self._control:
            yield self._speed(drive)

    def speed_unit(self, drive: FollowedDrive) -> str:
        """Return the unit in which a drive's speed is written: `Hz`, or `%` of its highest."""
        unit = ((drive.motion or {}).get("setpoint") or {}).get("unit")
        return str(unit) if unit in SPEED_MOST else "%"

    def _component(
        self, drive: FollowedDrive, key: str, platform: str, **more: Any
    ) -> tuple[str, dict[str, Any]]:
        unique = f"{self._topics.device(drive.name)}_{key}"
        return key, {"platform": platform, "unique_id": unique, **more}

    def _value(self, drive: FollowedDrive, code: str, good_s: float) -> tuple[str, dict[str, Any]]:
        reading = drive.values[code].reading
        name = f"{reading.name[:1].upper()}{reading.name[1:]}" or code
        more: dict[str, Any] = {
            "name": name, "state_topic": self._topics.value(drive.name, code),
            # What is not good is removed from the broker, of which a subscriber hears nothing
            # when it expires.
            "expire_after": ceil(good_s) + 1,
        }  # fmt: skip
        if reading.unit:
            more["unit_of_measurement"] = reading.unit
            if reading.unit in KINDS:
                more["device_class"] = KINDS[reading.unit]
        if isinstance(reading.value, Decimal) or (reading.unit and reading.value is not None):
            more["state_class"] = "measurement"
        else:
            more |= {"entity_category": "diagnostic", "enabled_by_default": False}
        return self._component(drive, code.replace("/", "_"), "sensor", **more)

    def _speed(self, drive: FollowedDrive) -> tuple[str, dict[str, Any]]:
        unit = self.speed_unit(drive)
        most = SPEED_MOST[unit]
        return self._component(
            drive, "speed", "number", name="Speed", mode="box", max=most,
            min=-most if drive.family in BOTH_WAYS[unit] else 0, step=0.01,
            unit_of_measurement=unit, command_topic=self._topics.do(drive.name, "set-speed"),
            command_template=f'{{"value": {{{{ value }}}}, "unit": "{unit}"}}', qos=2,
            retain=False, state_topic=self._topics.json(drive.name),
            value_template="{{ value_json.motion.setpoint.value if value_json.motion "
            "and value_json.motion.setpoint and not value_json.motion.setpoint.stale else none }}",
        )  # fmt: skip
