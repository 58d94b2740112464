"""`lecombus forget-times`: what was measured of a drive's answer times, dropped."""

from __future__ import annotations

from urllib.parse import quote

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect
from lecombus.cli.exits import Exit
from lecombus.cli.screen import on_terminal, show_rows, table_text

__all__ = ["command"]


@click.command("forget-times")
@click.argument("drive")
@daemon_options
def command(drive: str, socket: str | None, url: str | None, as_json: bool) -> int:
    """Drop the measured answer times of DRIVE.

    Time-outs and plans then use its manual and the roster, until most of its answers are late
    again. Shows what is dropped. In a pipe: code, read or write, the manual's longest time and
    the time measured, in seconds; if there is nothing, a message on standard error says so.
    With --json: the daemon's document.
    """
    with connect(socket, url) as daemon:
        answer = daemon.post(f"/v1/drives/{quote(drive, safe='')}/forget-times", {})
    if as_json:
        click.echo(answer.text)
        return Exit.DONE
    forgotten = answer.data.get("forgotten") or []
    if not forgotten:
        text = f"nothing was measured of {drive} that is later than its manual says"
        click.echo(text, err=not on_terminal())
        return Exit.DONE
    rows = [
        (
            table_text(one.get("code")),
            "write" if one.get("write") else "read",
            f"{float(one.get('manual_s') or 0.0):.3f}",
            f"{float(one.get('measured_s') or 0.0):.3f}",
        )
        for one in forgotten
    ]
    show_rows(("code", "as", "manual, s", "measured, s"), rows, title=f"forgotten of {drive}")
    return Exit.DONE
