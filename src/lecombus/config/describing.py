"""What a roster means, as data for `lecombus check`.

Gives what cannot be seen in the file: whether a group is one telegram or one write after another,
what was filled in from a drive's family, how much of the line the cyclic reads take, the warnings,
and the keys that do nothing yet.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lecombus.config.warnings import counted, cyclic_load, find_warnings
from lecombus.durations import format_duration
from lecombus.roster import DriveEntry, GroupEntry, Roster

__all__ = ["DescribedDrive", "DescribedGroup", "Description", "describe"]


@dataclass(frozen=True, slots=True)
class DescribedDrive:
    """What is shown of a drive; texts are ready to be shown.

    Args:
        name: The drive's name.
        address: Its address.
        family: Its family's name.
        watchdog: Such as `2s quick-stop, written` or `not looked after`.
        cyclic: What is read how often, such as `C0150 500ms, C0050 2s`.
        writable: What may be written, in order.
        stop_fallback: What replaces a quick stop that is not possible: `inhibit` or `none`.
    """

    name: str
    address: int
    family: str
    watchdog: str
    cyclic: str
    writable: str
    stop_fallback: str


@dataclass(frozen=True, slots=True)
class DescribedGroup:
    """What is shown of a group.

    Args:
        name: The group's name.
        members: Its members' names.
        how: How a stop goes out: `multicast` or `one-by-one`.
        multicast_address: The address of the one telegram; None one by one.
        writes: How a write goes out that is not a stop: `multicast` or `one-by-one`.
    """

    name: str
    members: tuple[str, ...]
    how: str
    multicast_address: int | None
    writes: str


@dataclass(frozen=True, slots=True)
class Description:
    """What a roster means.

    Args:
        file: The roster.
        line: The line in one sentence.
        cyclic_load: Share of line time the cyclic reads ask for; above 1 they are stretched.
        drives: The drives in the order of the file.
        groups: The groups, `all` first.
        warnings: What is valid but suspicious.
    """

    file: str
    line: str
    cyclic_load: float
    drives: tuple[DescribedDrive, ...]
    groups: tuple[DescribedGroup, ...]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the description for `check --json`."""
        return asdict(self)


def describe(roster: Roster) -> Description:
    """Describe a roster."""
    line = roster.line
    return Description(
        file=roster.file,
        line=f"line {line.name}: {line.medium} on {line.port}, {line.baud} baud, "
        f"{counted(roster.drives)}",
        cyclic_load=round(cyclic_load(roster), 4),
        drives=tuple(map(_drive, roster.drives)),
        groups=tuple(_group(name, group) for name, group in roster.groups.items()),
        warnings=tuple(find_warnings(roster)),
    )


def _drive(drive: DriveEntry) -> DescribedDrive:
    watchdog = drive.watchdog
    cyclic = [f"{entry.code} {format_duration(entry.every_s)}" for entry in drive.cyclic]
    watched = "not looked after"
    if watchdog is not None:
        doing = "written" if watchdog.configure else "compared only"
        watched = f"{format_duration(watchdog.time_s)} {watchdog.action}, {doing}"
    return DescribedDrive(
        name=drive.name,
        address=drive.address,
        family=drive.family,
        watchdog=watched,
        cyclic=", ".join(cyclic) or "nothing",
        writable=", ".join(map(str, sorted(drive.writable))) or "nothing",
        stop_fallback=drive.stop_fallback,
    )


def _group(name: str, group: GroupEntry) -> DescribedGroup:
    address = group.multicast_address
    return DescribedGroup(
        name, group.members, _way(address), address, writes=_way(group.write_address)
    )


def _way(address: int | None) -> str:
    return "one-by-one" if address is None else "multicast"
