"""`lecombus plan --live`: what was promised beside what the running line showed lately."""

from __future__ import annotations

import json
import math

import click

from lecombus.cli.client import Answer
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.screen import show_rows
from lecombus.durations import format_duration
from lecombus.planning.facts import roster_of
from lecombus.planning.live import LivePlan, compare

__all__ = ["live_of", "show_live"]


def live_of(answer: Answer) -> LivePlan:
    """Compare what a daemon gives.

    Raises:
        CommandError: It speaks another version.
    """
    document = json.loads(answer.text)
    try:
        return compare(roster_of(document["roster"]), document["measured"])
    except (KeyError, TypeError, ValueError) as exc:
        problem = "the daemon describes its line in a way that this lecombus does not know"
        remedy = "use the command of the daemon's own version"
        raise CommandError(Exit.FAILED, Problem(problem, remedy)) from exc


def show_live(live: LivePlan) -> None:
    """Write it for people."""
    slack = "" if live.slack_s is None else f"; least slack {_time(live.slack_s)}"
    click.echo(
        f"line {live.line} at {live.baud} baud, the last {live.window_s:.0f} s: {live.used:.0%} of "
        f"it was taken, {live.load:.0%} is asked for all the time{slack}"
    )
    if live.failed:
        click.echo(
            f"{live.failed} exchanges were not answered; promises hold while drives answer and at "
            "most the exchange under way is lost"
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
    click.echo()
    show_rows(
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
    click.echo()
    show_rows(
        ("drive", "watchdog", "left, promised", "left, least", ""),
        [
            (one.drive, format_duration(one.time_s), _time(one.promised_s), _time(one.least_s),
             one.verdict)
            for one in live.drives
        ],
        title="watchdogs",
    )  # fmt: skip


def _show_codes(live: LivePlan) -> None:
    click.echo()
    show_rows(
        ("drive", "code", "asked every", "promised", "longest gap", ""),
        [
            (one.drive, one.code, format_duration(one.asked_s), _time(one.promised_s),
             _time(one.longest_s), one.verdict)
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
