"""`lecombus check`: what is wrong with a roster, or what it means."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from lecombus.cli.arguments import json_option, roster_option
from lecombus.cli.exits import Exit
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.config import RosterError, load_roster
from lecombus.config.describing import COLUMNS, Description, describe

__all__ = ["check_command"]


@click.command("check")
@roster_option
@json_option
def check_command(roster: Path, as_json: bool) -> int:
    """List all mistakes of a roster, or show what the roster means.

    Mistakes go to standard error, one a line as FILE:LINE:COLUMN, and the exit status is 2.
    Without mistakes, the line, its drives, and the way in which stops and writes of each group
    are sent are shown, with warnings and with keys that this version does not use yet. No port
    is opened.

    With --json, on standard output: {"ok": false, "mistakes": [{"file", "line", "column", "what",
    "right"}]} or {"ok": true, "file", "line", "cyclic_load", "drives", "groups", "warnings",
    "not_yet_used"}.
    """
    try:
        description = describe(load_roster(roster))
    except RosterError as exc:
        if not as_json:
            raise
        mistakes = [asdict(mistake) for mistake in exc.mistakes]
        click.echo(json.dumps({"ok": False, "mistakes": mistakes}, ensure_ascii=False))
        return Exit.USAGE
    if as_json:
        click.echo(json.dumps({"ok": True, **description.as_json()}, ensure_ascii=False))
    elif on_terminal():
        _show(description)
    else:
        click.echo("\n".join(description.lines()))
    return Exit.DONE


def _show(description: Description) -> None:
    load = f"cyclic reads take {description.cyclic_load:.0%} of it"
    drives = [drive.row for drive in description.drives]
    show_rows(
        COLUMNS,
        drives,
        title=f"{description.line}; {load}",
    )
    click.echo()
    groups = [
        (
            group.name,
            group.stops_words,
            "the same" if group.writes == group.how else group.writes_words,
            ", ".join(group.members),
        )
        for group in description.groups
    ]
    show_rows(("group", "stops go as", "writes go as", "members"), groups)
    for text in description.warnings:
        click.echo(f"warning: {text}")
    for key in description.not_yet_used:
        click.echo(f"not used by this version: {key} (checked, and kept for later)")
