"""`lecombus reload`: has the running daemon read its roster again, and shows what changed."""

from __future__ import annotations

import click

from lecombus.cli.arguments import DaemonOptions, daemon_options
from lecombus.cli.daemon_access import act, refuse_problem, show
from lecombus.cli.document_rows import Document, is_done
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.screen import on_terminal, show_rows, table_text

__all__ = ["reload_command"]


@click.command("reload")
@daemon_options
def reload_command(daemon: DaemonOptions) -> int:
    """Have the running daemon read its roster again, and show what changed.

    A wrong roster is refused whole, every mistake is listed with its place, and the old roster
    stays in use; so does a remark on the line until a reload is good. `line`, `api`, `journal` and
    `state` cannot change while the daemon runs: they are listed as mistakes, and need a restart.

    In a pipe: one line for each thing that changed (the word `drive`, `group` or `key`, its name,
    `added`, `removed` or `changed`, the keys of a drive that differ). With --json: the daemon's
    document. Exit status 2: the roster was refused.
    """
    answer = act(daemon, "POST", "/v1/reload", {})
    if not is_done(answer.data):
        if not answer.data.get("mistakes"):  # whether it was read is not known
            refuse_problem(answer)
        if daemon.as_json:
            click.echo(answer.text)
            return Exit.USAGE
        raise CommandError.of(Exit.USAGE, *map(_problem_of, answer.data.get("mistakes") or ()))
    show(answer, _show_changes, as_json=daemon.as_json)
    return Exit.DONE


def _problem_of(mistake: Document) -> Problem:
    """Return a mistake as `lecombus check` writes it."""
    place = ":".join(table_text(mistake.get(key)) for key in ("file", "line", "column"))
    return Problem(f"{place}: {mistake.get('what')}, {mistake.get('right')}")


def _show_changes(changes: Document) -> None:
    rows = [
        *(("drive", name, "added", "") for name in changes.get("added") or ()),
        *(("drive", name, "removed", "") for name in changes.get("removed") or ()),
        *(
            ("drive", one.get("drive"), "changed", ", ".join(one.get("keys") or ()))
            for one in changes.get("changed") or ()
        ),
        *(("group", name, "changed", "") for name in changes.get("groups") or ()),
        *(("key", name, "changed", "") for name in changes.get("keys") or ()),
    ]
    if on_terminal():
        count = changes.get("drives")
        what = f"{changes.get('file')}: {count} drive{'' if count == 1 else 's'}"
        click.echo(f"{what}, nothing changed" if not rows else what)
    if rows:
        show_rows(("what", "name", "change", "keys"), rows)
