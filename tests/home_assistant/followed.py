"""A line as the bridge knows it, without a daemon."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from math import inf
from typing import Any, Final

from lecombus.bridges.line_follower import FollowedDrive, FollowedValue, LineFollower
from lecombus.bridges.mqtt.announced_devices import Devices
from lecombus.bridges.mqtt.discovery import Discovery
from lecombus.bridges.mqtt.topics import Topics
from lecombus.client import Quality, Reading
from lecombus.drives import FAMILY_NAMES, family
from lecombus.parameters import Code

__all__ = ["Followed", "devices"]

EACH_FAMILY: Final = {f"drive-{name}": name for name in FAMILY_NAMES}


class Followed(LineFollower):
    """A line whose drives' cyclic codes were read.

    Args:
        drives: The drives' families, by their names.
    """

    def __init__(self, drives: Mapping[str, str] = EACH_FAMILY) -> None:
        super().__init__("/run/x.sock")
        self.is_connected = True
        for number, (drive_name, name) in enumerate(drives.items()):
            drive = FollowedDrive(drive_name, 11 + number, name, "online")
            drive.motion = {"setpoint": {"unit": "%" if name == "93xx" else "Hz", "value": 1}}
            for code, every_s in family(name).status:
                self._periods[drive.name, str(code)] = every_s
                drive.values[str(code)] = self.read(drive.name, code, name)
            self.drives[drive.name] = drive

    def read(self, drive: str, code: Code, name: str) -> FollowedValue:
        info = family(name).info(code)
        unit = "" if info is None else info.unit or ""
        value: Any = Decimal("1.5") if unit else 8
        reading = Reading(
            drive, f"C{code.number:04d}", code.subcode, "" if info is None else info.name, value,
            "1.5", unit, Quality.GOOD, "", None, 0.1, "",
        )  # fmt: skip
        return FollowedValue(reading, 0, inf)


def devices(follower: LineFollower, *, control: bool = False) -> Devices:
    topics = Topics("lecombus", "hall-3")
    return Devices(Discovery("homeassistant", topics, "hall-3", control=control), follower)
