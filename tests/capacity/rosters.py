"""Lines to plan."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from lecombus.config import Roster
from support.rosters import make_roster

FAMILIES = ("8200vector", "smvector", "93xx", "821x", "820x")


def line_of(
    count: int,
    *,
    time: str = "2s",
    baud: int = 9600,
    cyclic: str = "",
    only: str | None = None,
    times: Mapping[str, str] = MappingProxyType({}),
) -> Roster:
    """A line of some drives, families in turn; `times`: other watchdog times, by drive."""
    addresses = [address for address in range(1, 99) if address % 10][:count]
    drives = [
        (f"d{address}", address, only or FAMILIES[number % len(FAMILIES)])
        for number, address in enumerate(addresses)
    ]
    guard = "watchdog: {time: %s, action: quick-stop, configure: true}"
    own = {name: guard % times.get(name, time) if time else "" for name, _, _ in drives}
    return make_roster(drives, baud=baud, line="repeaters: true", own=own, drive=cyclic)
