"""The report of a change: where every drive is, and what to do then.

A drive is reported at a rate only if it was seen there. The remedies are whole command lines, in
the order in which they are to be done.

Source: EDB2102EN 6.1.3 (93XX: what was not saved is lost at power-off), 8.2; CMVLC401A 4.2.
"""

from __future__ import annotations

from enum import StrEnum

from lecombus.drives import saving_rule

from .drives import DrivePlace, RebaudDrive
from .moving import Rebaud

__all__ = ["RebaudEnd", "ending_of", "situation", "what_to_do"]


class RebaudEnd(StrEnum):
    """How it ended."""

    MOVED = "moved"
    """Every drive is at the new rate."""
    UNCHANGED = "unchanged"
    """Every drive is at the old rate."""
    MIXED = "mixed"
    """The line is at two rates, or it is not known at which."""


def ending_of(work: Rebaud) -> RebaudEnd:
    """Return how it ended."""
    places = {drive.place for drive in work.drives}
    if places == {DrivePlace.NEW}:
        return RebaudEnd.MOVED
    return RebaudEnd.UNCHANGED if places <= {DrivePlace.OLD, DrivePlace.UNSEEN} else RebaudEnd.MIXED


def situation(drive: RebaudDrive, work: Rebaud) -> str:
    """Return where a drive is."""
    old, new = work.old, work.new
    match drive.place:
        case DrivePlace.UNSEEN:
            return "not asked to the end; nothing was written to it"
        case DrivePlace.OLD | DrivePlace.NEW:
            if not _needs_saving(drive, work):
                return f"at {drive.rate} baud"
            is_known = drive.saved is False or drive.writes > 0  # not by an attempt before
            return f"at {drive.rate} baud, {'' if is_known else 'perhaps '}not saved"
        case DrivePlace.WRITTEN:
            return f"at {old} or {new} baud: a write ended, and it was not looked for since"
        case DrivePlace.PENDING:
            return f"at {drive.rate} baud, until it is switched off and on"
        case DrivePlace.LOST:
            return "not found"


def what_to_do(work: Rebaud, roster: str, present: int) -> list[str]:
    """Return what is to be done now.

    Args:
        work: What came out.
        roster: The roster's file, as the user calls it.
        present: The baud rate that it says, bit/s.
    """
    ending = ending_of(work)
    if ending is RebaudEnd.MOVED:
        return _after_success(work, roster, present)
    told = _one_by_one(work)
    if ending is RebaudEnd.UNCHANGED:
        line = _roster_line(roster, work.old, present)
        kept = f"every drive is at {work.old} baud as before: {roster} stays as it is"
        return [*told, line if line else kept]
    origin = "" if present == work.old else f" --from {work.old}"
    return [
        *told,
        f"to go on: lecombus rebaud {work.new}{origin} -c {roster}",
        f"to go back: lecombus rebaud {work.old} --from {work.new} -c {roster}",
        "start no daemon before that: it would reach only those at the roster's rate",
    ]


def _after_success(work: Rebaud, roster: str, present: int) -> list[str]:
    unsaved = [drive for drive in work.drives if _needs_saving(drive, work)]
    told = [
        f"{drive.name} falls back to {work.old} baud when it is switched off, if it has not saved: "
        f"start the daemon and `lecombus write {drive.name} {_saving_code(drive)} 1`"
        for drive in unsaved
    ]
    line = _roster_line(roster, work.new, present)
    return [line or f"{roster} says so already: start the daemon", *told]


def _roster_line(roster: str, baud: int, present: int) -> str:
    """Say what is to be written into the roster; empty where it stands there."""
    if baud == present:
        return ""
    return f"in {roster}, under `line:`, write `baud: {baud}`, then start the daemon"


def _one_by_one(work: Rebaud) -> list[str]:
    told = []
    for drive in work.drives:
        code, name = drive.subject.spoken, drive.name
        if drive.place is DrivePlace.LOST:
            numbers = f"{drive.subject.number(work.old)} is {work.old}"
            numbers += f", {drive.subject.number(work.new)} is {work.new} baud"
            told.append(f"{name}: switch it off and on; look at {code} at its keypad ({numbers})")
        elif drive.place is DrivePlace.PENDING:
            told.append(f"{name}: switch it off and on, so that it takes the rate in {code}")
        elif drive.place is DrivePlace.NEW and _needs_saving(drive, work):
            told.append(
                f"{name}: if it has not saved, it is at {work.old} baud when switched off and on"
            )
    return told


def _needs_saving(drive: RebaudDrive, work: Rebaud) -> bool:
    """Whether a drive forgets at power-off what rate it was given here."""
    if saving_rule(drive.subject.family) is None or drive.saved:
        return False
    return drive.place is DrivePlace.NEW  # also one that an attempt before has moved


def _saving_code(drive: RebaudDrive) -> str:
    rule = saving_rule(drive.subject.family)
    return str(rule.codes[0]) if rule is not None else ""
