"""What a plan is made from, as a document that a running daemon gives and a client plans from.

A plan takes tens of milliseconds to calculate, longer than a telegram may be held up; so the daemon
gives the facts and the client calculates. Only what a plan depends on is in them: not what may be
written, nor the identity of a drive, nor where the daemon listens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any

from lecombus.drives import family
from lecombus.drives.measured import AnswerRow, SlowAnswers
from lecombus.parameters import Code, rules_of
from lecombus.roster import (
    ApiEntry,
    CyclicEntry,
    DriveEntry,
    LeaseEntry,
    LineEntry,
    Roster,
    WatchdogEntry,
)

__all__ = ["answers_of", "facts_of", "roster_of", "slow_of"]


def facts_of(roster: Roster, slow: Mapping[str, SlowAnswers] | None = None) -> dict[str, Any]:
    """Give what a plan of a roster is made from.

    Args:
        roster: The roster.
        slow: What was measured of its drives, by name; None: what stands in the roster.
    """
    found = {drive.name: drive.slow for drive in roster.drives} if slow is None else slow
    return {
        "line": _exact(roster.line.model_dump()),
        "drives": [
            _facts_of_drive(drive) | {"slow": _facts_of_slow(found[drive.name])}
            for drive in roster.drives
        ],
    }


def answers_of(rows: Mapping[str, Sequence[AnswerRow]]) -> dict[str, Any]:
    """Give the answer times that were measured, by drive and the slowest first."""
    return {
        drive: [
            {
                "code": str(row.code),
                "write": row.write,
                "manual_s": _decimal(row.manual_s),
                "measured_s": _decimal(round(row.measured_s, 6)),
                "slow": row.slow,
            }
            for row in of_drive
        ]
        for drive, of_drive in rows.items()
    }


def slow_of(facts: Mapping[str, Any]) -> dict[str, SlowAnswers]:
    """Give what was measured of each drive, from the facts that a daemon gave."""
    return {one["name"]: _slow_of(one["slow"]) for one in facts["drives"]}


def _facts_of_slow(slow: SlowAnswers) -> dict[str, Any]:
    return {
        "reads": {str(code): _decimal(time_s) for code, time_s in slow.reads.items()},
        "writes": {str(code): _decimal(time_s) for code, time_s in slow.writes.items()},
        "ratio": _decimal(round(slow.ratio, 6)),
    }


def _slow_of(facts: Mapping[str, Any]) -> SlowAnswers:
    reads, writes = (
        {Code.parse(code): float(time_s) for code, time_s in facts[kind].items()}
        for kind in ("reads", "writes")
    )
    return SlowAnswers(reads, writes, float(facts["ratio"]))


def roster_of(facts: Mapping[str, Any]) -> Roster:
    """Give a roster that is planned as the one whose facts they are.

    Args:
        facts: As `facts_of` gave them and JSON carried them, numbers as floats.
    """
    return Roster(
        file="the running daemon's roster",
        line=LineEntry.model_validate(facts["line"]),
        drives=tuple(_drive_of(one) for one in facts["drives"]),
        groups={},
        api=ApiEntry(socket=""),
    )


def _facts_of_drive(drive: DriveEntry) -> dict[str, Any]:
    return {
        "name": drive.name,
        "address": drive.address,
        "family": drive.family,
        "forms": [form.value for form in drive.forms],
        "watchdog": None if drive.watchdog is None else _exact(drive.watchdog.model_dump()),
        "cyclic": [
            {"code": str(one.code), "every_s": _decimal(one.every_s)} for one in drive.cyclic
        ],
        "answer_time_s": None if drive.answer_time_s is None else _decimal(drive.answer_time_s),
        "lease": _exact(drive.lease.model_dump()),
        "stop_fallback": drive.stop_fallback,
    }


def _drive_of(facts: Mapping[str, Any]) -> DriveEntry:
    guard, own_s = facts["watchdog"], facts["answer_time_s"]
    known = rules_of(family(facts["family"]).protocol).forms
    return DriveEntry(
        name=facts["name"],
        address=facts["address"],
        family=facts["family"],
        forms=tuple(known[form] for form in facts["forms"]),
        watchdog=None if guard is None else WatchdogEntry.model_validate(guard),
        cyclic=tuple(
            CyclicEntry(code=Code.parse(one["code"]), every_s=float(one["every_s"]))
            for one in facts["cyclic"]
        ),
        writable=frozenset(),
        answer_time_s=None if own_s is None else float(own_s),
        lease=LeaseEntry.model_validate(facts["lease"]),
        stop_fallback=facts["stop_fallback"],
        slow=_slow_of(facts["slow"]),
    )


def _exact(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _decimal(value) if isinstance(value, float) else value for key, value in fields.items()
    }


def _decimal(seconds: float) -> Decimal:
    return Decimal(str(seconds))
