"""The roster that a scan proposes: a file to be read through by a person, and then run.

The text is checked by the roster's own reader before anybody is given it. Everything a drive said
of itself stands in comments; nothing it said becomes a setting but its watchdog, if that acts.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from lecombus.capacity.watchdog_feasibility import find_infeasible
from lecombus.config import Roster, WatchdogEntry, parse_roster
from lecombus.drives import family
from lecombus.durations import format_duration

from .identifying import FoundDrive, Unclear

__all__ = ["ProposedLine", "check_place", "entries", "propose"]

LATE_ANSWER_TIME = "300ms"
"""Proposed for a drive that answered only when waited for."""
MOST_WITHOUT_REPEATERS = 31
WIDTH = 94
"""Characters of a comment in a line."""


@dataclass(frozen=True, slots=True)
class ProposedLine:
    """What the roster's other sections say.

    Args:
        name: The line's name.
        port: The port.
        parity: Who makes parity, `line` or `port`.
        direction: Who switches the transceiver.
        socket: Where the daemon makes its socket; empty: where it does by itself.
        state: Where it keeps what must outlive it; empty: where it does by itself.
    """

    name: str
    port: str
    parity: str = "line"
    direction: str = "adapter"
    socket: str = ""
    state: str = ""


def check_place(place: ProposedLine) -> None:
    """See that a roster can be made with this name and port, before anything is searched.

    Raises:
        RosterError: It cannot; says what would be right.
    """
    drive = FoundDrive(1, 9600, "generic", False, "")
    parse_roster("\n".join(_lines(place, 9600, [drive], [], {})), "the roster")


def propose(
    place: ProposedLine, baud: int, found: Sequence[FoundDrive], unclear: Sequence[Unclear] = ()
) -> tuple[str, Roster]:
    """Write a roster for the drives found at a baud rate.

    Args:
        place: The other sections.
        baud: The line's baud rate, bit/s.
        found: Everything found; what answers at another rate stands in a comment.
        unclear: Addresses from which no whole answer came.

    Returns:
        The file's text, and the roster it is read as.
    """
    unheld = _unheld(place, baud, found)
    text = "\n".join(_lines(place, baud, found, unclear, unheld)) + "\n"
    return text, parse_roster(text, "the proposed roster")


def _unheld(place: ProposedLine, baud: int, found: Sequence[FoundDrive]) -> dict[str, str]:
    """Find the watchdogs that this line cannot hold: they are named, and not proposed.

    Returns:
        What is wrong with each, by the drive's name.
    """
    told = {one.name: "" for one in found}
    roster = parse_roster("\n".join(_lines(place, baud, found, (), told)), "the proposed roster")
    watched = {
        one.name: WatchdogEntry(time_s=one.watchdog.time_s, action=one.watchdog.action)
        for one in found
        if one.watchdog is not None and _acts(one)
    }
    unheld: dict[str, str] = {}
    while True:
        drives = tuple(
            drive.model_copy(update={"watchdog": watched.get(drive.name)})
            for drive in roster.drives
        )
        wrong = find_infeasible(roster.model_copy(update={"drives": drives}))
        if not wrong:
            return unheld
        for one in wrong:
            unheld[one.drive] = one.what
            del watched[one.drive]


def _lines(
    place: ProposedLine,
    baud: int,
    found: Sequence[FoundDrive],
    unclear: Sequence[Unclear],
    unheld: Mapping[str, str],
) -> Iterator[str]:
    here = sorted((one for one in found if one.baud == baud), key=lambda one: one.address)
    yield "# What `lecombus scan` found. Nothing was written to any drive."
    yield "# Read it through before it runs: names, watchdogs, what may be written (`writable`)."
    yield "line:"
    yield f"  name: {_quoted(place.name)}"
    yield f"  port: {_quoted(place.port)}"
    yield f"  baud: {baud}"
    if place.parity != "line":
        yield f"  parity: {place.parity}"
    if place.direction != "adapter":
        yield f"  direction: {place.direction}"
    if len(here) > MOST_WITHOUT_REPEATERS:
        yield f"  repeaters: true  # {len(here)} drives: more than an RS-485 line takes without"
    yield "drives:"
    yield from entries(here, unheld)
    yield from _elsewhere(baud, found, unclear)
    if place.socket:
        yield "# Without /run/lecombus, which the systemd unit makes:"
        yield f"api: {{socket: {_quoted(place.socket)}}}"
    if place.state:
        yield "# Who the drives are and how often they were written, without /var/lib/lecombus:"
        yield f"state: {_quoted(place.state)}"


def entries(found: Sequence[FoundDrive], unheld: Mapping[str, str]) -> Iterator[str]:
    """Write drives as they stand under `drives:`.

    Args:
        found: The drives.
        unheld: By name, why a watchdog that acts is named and not proposed.
    """
    for one in found:
        title = "not known" if one.family == "generic" else family(one.family).title
        yield from _comment(f"{title}: {one.why}")
        yield from _comment(", ".join(f"{code} {text}" for code, text in one.labels))
        for remark in one.remarks:
            yield from _comment(f"note: {remark}")
        yield f"  - name: {one.name}"
        yield f"    address: {one.address}"
        yield f"    family: {one.family}"
        if one.late:
            yield f"    answer_time: {LATE_ANSWER_TIME}  # it answered late; measure it"
        yield from _watchdog(one, unheld.get(one.name))


def _acts(one: FoundDrive) -> bool:
    """Whether a drive's watchdog acts, at a time that can be set."""
    traits, found = family(one.family).watchdog, one.watchdog
    if traits is None or found is None or found.action == "none":
        return False
    return bool(found.time_s) and traits.low_s <= found.time_s <= traits.high_s


def _watchdog(one: FoundDrive, unheld: str | None) -> Iterator[str]:
    """Write the watchdog as found: fed if it acts, else as a comment to be thought about."""
    traits, found = family(one.family).watchdog, one.watchdog
    if traits is None:
        return
    if found is None:
        yield "    # watchdog: {time: 3s, action: quick-stop, configure: true}"
        return
    time = format_duration(found.time_s)
    if _acts(one) and unheld is None:
        yield f"    watchdog: {{time: {time}, action: {found.action}}}  # as found"
        return
    if unheld:
        yield from _comment(f"The watchdog acts, and this line cannot hold it: {unheld}.")
    yield f"    # The watchdog as found: {found.action}, {time}. To have one that is fed:"
    yield "    # watchdog: {time: 3s, action: quick-stop, configure: true}"


def _elsewhere(baud: int, found: Sequence[FoundDrive], unclear: Sequence[Unclear]) -> Iterator[str]:
    """Name in comments what is on the line and cannot be in this roster."""
    for one in found:
        if one.baud != baud:
            yield (
                f"# At {one.baud} baud, and so out of this line's reach: address {one.address}, "
                f"{one.family}."
            )
    for odd in unclear:
        yield (
            f"# Address {odd.address} ({odd.baud} baud) never gave a whole answer: two drives "
            "with one address?"
        )


def _comment(text: str) -> Iterator[str]:
    """Write a text as comment lines, with nothing in it that could end a comment."""
    printable = "".join(char if char.isprintable() else "." for char in text)
    for line in textwrap.wrap(printable, WIDTH, break_on_hyphens=False):
        yield f"  # {line}"


def _quoted(text: str) -> str:
    """Write a text as a YAML scalar that cannot be taken for anything else."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
