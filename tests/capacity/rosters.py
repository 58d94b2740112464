"""Lines to plan."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from lecombus.config import Roster, parse_roster

FAMILIES = ("8200vector", "smvector", "93xx", "821x", "820x")


def roster_of(
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
    drives = []
    for number, address in enumerate(addresses):
        family = only or FAMILIES[number % len(FAMILIES)]
        own = times.get(f"d{address}", time)
        watchdog = f", watchdog: {{time: {own}, action: quick-stop, configure: true}}"
        drives.append(
            f"  - {{name: d{address}, address: {address}, family: {family}"
            f"{watchdog if time else ''}{cyclic}}}\n"
        )
    head = f"line: {{name: l, port: 'sim:', baud: {baud}, medium: rs485, repeaters: true}}\n"
    return parse_roster(f"{head}drives:\n{''.join(drives)}", "r.yaml")
