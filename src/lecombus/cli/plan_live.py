"""`lecombus plan --live` and `--from-daemon`: a plan, and what the running line showed."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from lecombus.capacity.facts import roster_of, slow_of
from lecombus.capacity.live import LivePlan, compare
from lecombus.capacity.watchdog_feasibility import InfeasibleWatchdog
from lecombus.cli.client import Answer, connect
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.screen import counted, show_table
from lecombus.config import DriveEntry, Roster, load_roster
from lecombus.durations import format_duration
from lecombus.metrics.rolling_window import WINDOW_S

__all__ = ["live_of", "measured_roster", "show_answers", "show_live", "show_unheld"]

Answers = Mapping[str, Sequence[Mapping[str, Any]]]
"""By drive: what was measured of each code, as `capacity.facts.answers_of` gives it."""


def live_of(answer: Answer) -> LivePlan:
    """Compare what a daemon gives.

    Raises:
        CommandError: It speaks another version.
    """
    with _understood():
        document = json.loads(answer.text)
        roster, measured = roster_of(document["roster"]), document["measured"]
        return compare(roster, measured, document["away"], document["state"])


def measured_roster(
    file: Path | None, socket: str | None, url: str | None
) -> tuple[Roster, Answers]:
    """Give a roster with the answer times that a running daemon has measured.

    Args:
        file: The roster; None: the one that is running.
        socket: What `--socket` says.
        url: What `--url` says.

    Returns:
        The roster, and what was measured of its drives.

    Raises:
        CommandError: There is no daemon, or it speaks another version.
    """
    wanted = None if file is None else load_roster(file)
    with connect(socket, url) as daemon:
        answer = daemon.get("/v1/plan")
    with _understood():
        document = json.loads(answer.text)
        roster, slow = roster_of(document["roster"]), slow_of(document["roster"])
        answers: Answers = document["answers"]
    if wanted is None:
        return roster, answers
    drives = tuple(
        drive.model_copy(update={"slow": slow[drive.name]})
        if _is_same(drive, roster.drive(drive.name))
        else drive
        for drive in wanted.drives
    )
    known = {drive.name for drive in drives if _is_same(drive, roster.drive(drive.name))}
    return (
        wanted.model_copy(update={"drives": drives}),
        {name: rows for name, rows in answers.items() if name in known},
    )


def _is_same(drive: DriveEntry, running: DriveEntry | None) -> bool:
    """Whether what was measured of a running drive was measured of this one."""
    return running is not None and (drive.family, drive.address) == (
        running.family,
        running.address,
    )


@contextmanager
def _understood() -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError) as exc:
        problem = "the daemon describes its line in a way that this lecombus does not know"
        remedy = "use the command of the daemon's own version"
        raise CommandError(Exit.FAILED, Problem(problem, remedy)) from exc


def show_answers(answers: Answers) -> None:
    """Write which drives and codes differ from their manual."""
    rows = [
        (drive, f"{row['code']} written" if row["write"] else row["code"],
         _time(row["manual_s"]), _time(row["measured_s"]))
        for drive, of_drive in answers.items()
        for row in of_drive
        if row["slow"]
    ]  # fmt: skip
    if not answers:
        click.echo("\nno drive of the roster is on the daemon's line: nothing was measured of it")
        return
    if not rows:
        click.echo("\nno drive answers later than its manual says")
        return
    show_table(
        ("drive", "code", "manual", "measured"), rows, title="answered later than the manual says"
    )


def show_unheld(unheld: Sequence[InfeasibleWatchdog]) -> None:
    """Write which watchdogs cannot be held with the answer times that were measured."""
    for one in unheld:
        click.echo(f"\n{one.drive}: {one.what}; {one.right}")


def show_live(live: LivePlan) -> None:
    """Write it for people."""
    slack = "" if live.slack_s is None else f"; least slack {_time(live.slack_s)}"
    click.echo(
        f"line {live.line} at {live.baud} baud, the last {live.window_s:.0f} s: {live.used:.0%} of "
        f"it was taken, {live.load:.0%} is asked for all the time{slack}"
    )
    if live.window_s < WINDOW_S:
        click.echo("that is since its start, when drives are audited: ask again later")
    if live.failed:
        click.echo(
            f"{counted(live.failed, 'exchange')} without an answer; promises hold while drives "
            "answer and at most the exchange under way is lost"
        )
    _show_classes(live)
    _show_drives(live)
    _show_codes(live)
    click.echo()
    if not live.beyond:
        click.echo("nothing is beyond what was promised")
    for text in live.beyond:
        click.echo(f"beyond the promise: {text}")


def _show_classes(live: LivePlan) -> None:
    show_table(
        ("class", "promised", "loaded", "half within", "longest", "waits", "asked", "taken", ""),
        [
            (one.name, _time(one.quiet_s), _time(one.loaded_s), _time(one.median_s),
             _time(one.most_s), str(one.waits), "" if one.load is None else f"{one.load:.1%}",
             f"{one.used:.1%}", one.verdict)
            for one in live.classes
        ],
        title="how long requests waited; others of the same class and above come on top",
    )  # fmt: skip


def _show_drives(live: LivePlan) -> None:
    if not live.drives:
        return
    show_table(
        ("drive", "watchdog", "left, promised", "left, least", ""),
        [
            (one.drive, format_duration(one.time_s), _time(one.promised_s), _time(one.least_s),
             one.verdict)
            for one in live.drives
        ],
        title="watchdogs",
    )  # fmt: skip


def _show_codes(live: LivePlan) -> None:
    show_table(
        ("drive", "code", "asked every", "promised", "loaded", "longest gap", ""),
        [
            (one.drive, one.code, format_duration(one.asked_s), _time(one.promised_s),
             _time(one.loaded_s), _time(one.longest_s), one.verdict)
            for one in live.codes
        ],
        title="cyclic reads",
    )  # fmt: skip


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "none"
    if math.isinf(seconds):
        return "no promise"
    if abs(seconds) < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.2f} s"
