"""What a roster means, in words and as data, for `lecombus check`.

Gives what cannot be seen in the file: whether a group is one telegram or one write after another,
what was filled in from a drive's family, how much of the line the cyclic reads take, the warnings,
and the keys that do nothing yet.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lecombus.config.warnings import counted, cyclic_load, find_warnings
from lecombus.durations import format_duration
from lecombus.protocol.addressing import group_reach
from lecombus.roster import DriveEntry, GroupEntry, Roster

__all__ = ["DescribedDrive", "DescribedGroup", "Description", "describe"]


COLUMNS = ("drive", "address", "family", "watchdog", "stop fallback", "cyclic reads")
"""The heads of the drives table."""


@dataclass(frozen=True, slots=True)
class DescribedDrive:
    """One row of the drives table; texts are ready to be shown.

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

    @property
    def row(self) -> tuple[str, ...]:
        """What stands in the table, in the order of `COLUMNS`."""
        return (
            self.name, str(self.address), self.family, self.watchdog, self.stop_fallback,
            self.cyclic,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class DescribedGroup:
    """One row of the groups table.

    Args:
        name: The group's name.
        members: Its members' names.
        how: How a stop goes out: `multicast` or `one-by-one`.
        multicast_address: The address of the one telegram; None one by one.
        writes: How a write goes out that is no stop: `multicast` or `one-by-one`.
    """

    name: str
    members: tuple[str, ...]
    how: str
    multicast_address: int | None
    writes: str

    @property
    def stops_words(self) -> str:
        """How a stop goes out, in words."""
        return way_words(self.how, self.multicast_address)

    @property
    def writes_words(self) -> str:
        """How other writes go out, in words."""
        return way_words(self.writes, self.multicast_address)


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
        not_yet_used: Keys that this version checks but does not use.
    """

    file: str
    line: str
    cyclic_load: float
    drives: tuple[DescribedDrive, ...]
    groups: tuple[DescribedGroup, ...]
    warnings: tuple[str, ...]
    not_yet_used: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the description as plain text for a terminal, without colours."""
        rows = [drive.row for drive in self.drives]
        found = [self.line, f"cyclic reads take {self.cyclic_load:.0%} of the line", ""]
        found.extend(_columns([COLUMNS, *rows]))
        found.append("")
        found.extend(f"group {group.name}: {_how(group)}" for group in self.groups)
        found.extend(f"warning: {text}" for text in self.warnings)
        found.extend(
            f"not used by this version: {text} (checked, and kept for later)"
            for text in _gathered(self.not_yet_used)
        )
        return found

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
        not_yet_used=roster.not_yet_used,
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


def _how(group: DescribedGroup) -> str:
    count = len(group.members)
    drives = f"{count} drive{'s' if count != 1 else ''}"
    if group.how == group.writes:
        return f"{drives}, stops and writes as {group.stops_words}"
    return f"{drives}, stops as {group.stops_words}, writes as {group.writes_words}"


def way_words(how: str, address: int | None) -> str:
    """Say how something goes to a group, and which drives one multicast telegram reaches."""
    if how == "one-by-one" or address is None:
        return "one after another"
    reach = group_reach(address)
    return f"one multicast to {address:02d} (reaches every drive at {reach[0]} to {reach[-1]})"


def _gathered(keys: tuple[str, ...]) -> list[str]:
    """Put the keys of single drives into one text: 31 lines would hide the others."""
    of_drives = [key for key in keys if key.startswith("drives.")]
    if len(of_drives) < 2:
        return list(keys)
    others = [key for key in keys if key not in of_drives]
    more = len(of_drives) - 1
    of_more = "1 more drive's" if more == 1 else f"{more} more drives'"
    return [*others, f"{of_drives[0]} and {of_more}"]


def _columns(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
