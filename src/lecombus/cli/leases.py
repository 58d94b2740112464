"""`lecombus leases`: who controls which drives, and what must be enabled again."""

from __future__ import annotations

import click

from lecombus.cli.arguments import DaemonOptions, daemon_options
from lecombus.cli.daemon_access import ask, show
from lecombus.cli.document_rows import Document, cells_of
from lecombus.cli.exits import Exit
from lecombus.cli.screen import on_terminal, show_rows

__all__ = ["leases_command"]


@click.command("leases")
@daemon_options
def leases_command(daemon: DaemonOptions) -> int:
    """Show who holds leases, and which drives need one or are latched.

    A latched drive takes no setpoint until a lease is held for it and it was enabled with the
    lease's token. Tokens are never shown.

    In a pipe: one line a drive (drive, `required` or `free`, its lease, number, seconds until that
    lapses, `latched` and why, `on_lapse`, who holds it). With --json: the daemon's document.
    """
    show(ask(daemon, "/v1/leases"), _show, as_json=daemon.as_json)
    return Exit.DONE


def _show(document: Document) -> None:
    held: dict[str, Document] = {one["name"]: one for one in document.get("leases") or ()}
    rows = []
    for drive in document.get("drives") or ():
        lease: Document = held.get(drive.get("lease") or "", {})
        holder: Document = lease.get("holder") or {}
        rows.append(
            (
                *cells_of(drive, "drive"),
                "required" if drive.get("required") else "free",
                *cells_of(lease, "name", "number", "expires_in_s"),
                f"latched: {drive.get('because')}" if drive.get("latched") else "",
                *cells_of(drive, "on_lapse"),
                " ".join(f"{key}={text}" for key, text in holder.items()),
            )
        )
    if not rows and on_terminal():
        click.echo("no drive needs a lease, and none is held")
    if rows:
        head = ("drive", "lease", "held as", "number", "ends in s", "latch", "on lapse", "holder")
        show_rows(head, rows)
