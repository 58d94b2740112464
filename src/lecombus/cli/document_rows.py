"""Documents of the daemon as rows: readings, writes, stops, drives.

Every function takes a document as `client` reads it and prints it, or returns the exit status it
stands for. A key that a document does not have is an empty cell: an older command line can show
what a newer daemon says.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import click

from lecombus.cli.exits import Exit
from lecombus.cli.screen import age, on_terminal, show_rows, table_text
from lecombus.drive_state.readings import NOT_CYCLIC
from lecombus.errors import LecombusError

__all__ = [
    "Document",
    "cells_of",
    "code_of",
    "is_done",
    "kind_of",
    "members_of",
    "outcome_rows",
    "quality_of",
    "show_outcomes",
    "show_reading",
    "show_verb",
    "shown_code",
    "shown_code_and_name",
    "shown_value",
    "status_of",
    "value_of",
]

Document = Mapping[str, Any]

_DONE = ("done", "verified")


_DETAILS = frozenset(
    ("operation_inhibited", "pulses_inhibited", "ramp_done", "below_threshold", "above_threshold")
)
"""States that add nothing to the result of a verb; `status` shows them."""

_ATTEMPT = re.compile(r" \(attempt \d+\)")

_FORBIDDEN = ("not-writable", "locked", "not-permitted", "read-only")


def is_done(report: Document) -> bool:
    """Return whether an outcome means that it was done."""
    return report.get("outcome") in _DONE


def members_of(report: Document) -> Sequence[Document]:
    """Return a group's reports by drive; a report without members is its own."""
    return report.get("members") or [report]


def status_of(report: Document) -> Exit:
    """Return the exit status of a write's or a group's outcome."""
    if is_done(report):
        return Exit.DONE
    return Exit.FORBIDDEN if kind_of(report) in _FORBIDDEN else Exit.FAILED


def kind_of(problem: Document) -> str:
    """Return the stable word of a problem document, the last part of its type; or nothing."""
    return re.split(r"[:/]", table_text(problem.get("type")))[-1]


def code_of(document: Document) -> str:
    """Return code and subcode as people write them, such as `C0039/1`."""
    code = table_text(document.get("code"))
    subcode = document.get("subcode")
    return f"{code}/{subcode}" if subcode and "/" not in code else code


def shown_code(family_name: object, code: object) -> str:
    """Return a code as the drive's keypad names it where people read it, by its number in a pipe.

    Args:
        family_name: The drive's family, as a document has it.
        code: The code.
    """
    return spoken_code(family_name, code) if on_terminal() else str(code)


def spoken_code(family_name: object, code: object) -> str:
    """Return a code as the drive's keypad names it, for sentences.

    Args:
        family_name: The drive's family, as a document has it.
        code: The code.
    """
    from lecombus.drives import family
    from lecombus.parameters import Code

    try:
        return family(str(family_name)).spoken(Code.parse(str(code)))
    except LecombusError:  # of a daemon that knows more
        return str(code)


def shown_code_and_name(family_name: object, code: object, name: str) -> tuple[str, str]:
    """Return a code as `shown_code` does, and its name without the keypad's where that is said."""
    shown = shown_code(family_name, code)
    return shown, name.removeprefix(f"{shown} ")


def cells_of(document: Document, *keys: str) -> list[str]:
    """Return members of a document as cells."""
    return [table_text(document.get(key)) for key in keys]


def value_of(reading: Document) -> str:
    """Return a value as people know it: a word by its digits on the wire, such as `H8678`."""
    return table_text(reading.get("raw" if reading.get("format") == "VH" else "value"))


def shown_value(reading: Document) -> str:
    """Return a value for a person: with what it means, where that is described."""
    value = value_of(reading)
    return f"{value} ({reading['text']})" if reading.get("text") and on_terminal() else value


def quality_of(reading: Document) -> tuple[str, str]:
    """Return how far a value may be trusted, and why not further.

    A value that is stale only because it was read once, as most parameters are, gets the quality
    `once`: its age is shown.
    """
    quality, reason = cells_of(reading, "quality", "reason")
    if quality == "stale" and reason.endswith(NOT_CYCLIC):
        return "once", ""
    return quality, reason


def show_reading(reading: Document, *, spoken: str = "") -> None:
    """Print one value; on a terminal as a sentence, in a pipe as cells.

    Args:
        reading: The value.
        spoken: What its user calls the code, such as P411, for the sentence; empty: its number.
    """
    code, (quality, reason) = code_of(reading), quality_of(reading)
    value, unit = shown_value(reading), table_text(reading.get("unit"))
    if on_terminal():
        name = f" ({reading['name']})" if reading.get("name") else ""
        shown = " ".join(part for part in (value or "no value", unit) if part)
        line = f"{reading.get('drive', '')} {spoken or code}{name}: {shown}"
        if quality not in ("good", "once"):
            line += f" [{quality}: {reason}]" if reason else f" [{quality}]"
        elif reading.get("age_s") is not None and float(reading["age_s"]) >= 1.0:
            line += f" [{age(reading['age_s'])} old]"
        click.echo(line.strip())
    else:
        cells = (table_text(reading.get("drive")), code, value, unit, quality, reason)
        show_rows(("drive", "code", "value", "unit", "quality", "reason"), [cells])


def show_outcomes(report: Document, *, said_once: Sequence[str] = (), spoken: str = "") -> None:
    """Print how a write, a group write or a stop ended, member by member.

    Args:
        report: The report of the group, or of one write.
        said_once: What is not said of each member but below, once for all it is the same for.
        spoken: What its user calls the code, such as P411, for people; empty: its number.
    """
    members = members_of(report)
    how = {"multicast": "one multicast", "one-by-one": "one write after another"}
    # One drive gets one telegram: how it would be sent to several says nothing.
    sent = how.get(str(report.get("how")), "") if len(members) > 1 else ""
    title = f"as {sent}: {report.get('outcome')}" if sent else ""
    _show_outcomes(members, title=title, without=said_once, spoken=spoken)
    for key in said_once:
        drives: dict[str, list[str]] = {}
        for one in members:
            drives.setdefault(table_text(one.get(key)), []).append(table_text(one.get("drive")))
        for text, names in drives.items():
            if text:
                click.echo(f"{', '.join(names)}: {text}", err=True)


def show_verb(report: Document) -> None:
    """Print how a verb ended."""
    states = [str(state) for state in report.get("states") or () if state not in _DETAILS]
    shown = ", ".join(state.replace("_", " ") for state in states)
    cells = cells_of(report, "drive", "verb", "outcome")
    rows = [(*cells, shown, _reads(report), _why(report))]
    show_rows(("drive", "verb", "outcome", "shows", "reads", "why"), rows)


def _show_outcomes(
    reports: Sequence[Document], title: str, *, without: Sequence[str], spoken: str
) -> None:
    rows = outcome_rows(reports, without=without, spoken=spoken)
    show_rows(("drive", "code", "outcome", "reads", "why"), rows, title=title)


def outcome_rows(
    reports: Sequence[Document], *, without: Sequence[str] = (), spoken: str = ""
) -> list[tuple[str, ...]]:
    """Return reports as rows: drive, code, outcome, value read back, reason.

    Args:
        reports: One a drive.
        without: Keys that are said otherwise.
        spoken: What its user calls the code, such as P411, for people; empty: its number.
    """
    rows: list[tuple[str, ...]] = []
    said: dict[str, str] = {}
    for report in reports:
        drive, outcome = cells_of(report, "drive", "outcome")
        why = _why(report, without)
        if why and not is_done(report) and on_terminal():
            first = said.setdefault(_in_general(why, drive), drive)
            why = why if first == drive else f"like {first}"
        code = spoken if spoken and on_terminal() else code_of(report)
        rows.append((drive, code, outcome, _reads(report), why))
    return rows


def _in_general(why: str, drive: str) -> str:
    """Return a reason without the drive's name, address and number of attempts."""
    return _ATTEMPT.sub("", re.sub(rf"{re.escape(drive)}( \(address \d+\))?", "", why))


def _reads(report: Document) -> str:
    """Return what was read back; what was read before the write is not what it reads now."""
    reading: Document = report.get("reading") or {}
    if reading.get("quality") != "good":
        return ""
    return " ".join(filter(None, (value_of(reading), table_text(reading.get("unit")))))


def _why(report: Document, without: Sequence[str] = ()) -> str:
    keys = [key for key in ("reason", "detail", "cause", "remedy") if key not in without]
    said = [table_text(report.get(key)) for key in keys]
    return "; ".join(dict.fromkeys(part for part in said if part))
