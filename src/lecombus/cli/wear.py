"""`lecombus wear`: how often a drive's memory was written."""

from __future__ import annotations

from urllib.parse import quote

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect
from lecombus.cli.exits import Exit
from lecombus.cli.screen import age, on_terminal, show_rows, table_text

__all__ = ["command"]


@click.command("wear")
@click.argument("drive")
@daemon_options
def command(drive: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Show how often each code that wears DRIVE's memory was written, the highest count first.

    Every write that may have reached the memory counts, since counting began; "this device":
    since this device was accepted. In a pipe: code, name, writes, to this device, and how long
    until it may be written again. With --json: the daemon's document.
    """
    with connect(socket, url) as daemon:
        answer = daemon.get(f"/v1/drives/{quote(drive, safe='')}/wear")
    if as_json:
        click.echo(answer.text)
        return Exit.DONE
    codes = answer.data.get("codes") or []
    if not codes and on_terminal():
        click.echo(f"nothing that wears its memory was written to {drive} yet")
        return Exit.DONE
    rows = [
        (
            table_text(one.get("code")),
            table_text(one.get("name")),
            table_text(one.get("writes")),
            table_text(one.get("to_this_device")),
            age(one["wait_s"]) if one.get("wait_s") else "",
        )
        for one in codes
    ]
    show_rows(("code", "name", "writes", "this device", "again in"), rows)
    return Exit.DONE
