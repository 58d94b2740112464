"""What `lecombus rebaud` shows: its plan, and where every drive is at the end."""

from __future__ import annotations

import json

import click

from lecombus.cli.screen import on_terminal, show_rows
from lecombus.config import Roster
from lecombus.drives import saving_rule
from lecombus.rebaud import Drive, DrivePlace, Rebaud, ending_of, situation, what_to_do

__all__ = ["show_end", "show_plan"]


def show_plan(work: Rebaud, roster: Roster, *, as_json: bool) -> None:
    """Say what would be written to whom, and what happens besides."""
    if as_json:
        click.echo(json.dumps({**_head(work, roster), "ending": "planned", "remedies": []}))
        return
    rows = [
        (one.name, str(one.subject.address), one.subject.family.name, _now(one), _step(one, work),
         one.motion, one.note)
        for one in work.drives
    ]  # fmt: skip
    show_rows(("drive", "address", "family", "now", "write", "motion", "watchdog"), rows)
    if on_terminal():
        click.echo(
            "A drive that is on this line and not in the roster stays where it is, out of reach."
        )


def _now(drive: Drive) -> str:
    return f"{drive.rate} baud" if drive.rate is not None else "silent"


def _step(drive: Drive, work: Rebaud) -> str:
    if drive.place is DrivePlace.NEW or drive.rate is None:
        return ""
    subject = drive.subject
    rule = saving_rule(subject.family)
    saving = f", then {rule.codes[0]} = {rule.value}" if rule is not None else ""
    return f"{subject.spoken} = {subject.number(work.new)}{saving}"


def show_end(work: Rebaud, roster: Roster, trouble: str, *, as_json: bool) -> None:
    """Say where every drive is, and what to do.

    Args:
        work: What came out.
        roster: The roster.
        trouble: What ended it early; empty where nothing did.
        as_json: Print one JSON document.
    """
    remedies = what_to_do(work, roster.file, roster.line.baud)
    if as_json:
        document = {**_head(work, roster), "ending": ending_of(work).value, "remedies": remedies}
        click.echo(json.dumps({**document, "trouble": trouble or None}))
        return
    if trouble:
        click.echo(f"ended early: {trouble}", err=True)
    if work.line.interrupted:
        click.echo("interrupted: nothing further was sent", err=True)
    rows = [
        (one.name, str(one.subject.address), situation(one, work), one.why) for one in work.drives
    ]
    show_rows(("drive", "address", "where", "why"), rows)
    for remedy in remedies:
        click.echo(remedy)


def _head(work: Rebaud, roster: Roster) -> dict[str, object]:
    return {
        "line": roster.line.name,
        "from": work.old,
        "to": work.new,
        "interrupted": work.line.interrupted,
        "trouble": None,
        "drives": [_as_json(one, work) for one in work.drives],
    }


def _as_json(drive: Drive, work: Rebaud) -> dict[str, object]:
    return {
        "drive": drive.name,
        "address": drive.subject.address,
        "family": drive.subject.family.name,
        "place": drive.place.value,
        "baud": drive.rate,
        "shows": situation(drive, work),
        "why": drive.why or None,
        "motion": drive.motion or None,
        "watchdog": drive.note or None,
    }
