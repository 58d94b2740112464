"""`lecombus readdress`: a drive at another address."""

from __future__ import annotations

from urllib.parse import quote

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.reports import Document, show_write, status_of
from lecombus.cli.screen import on_terminal, table_text

__all__ = ["command"]


@click.command("readdress")
@click.argument("drive")
@click.argument("address", type=click.IntRange(1, 99), metavar="NEW")
@click.option("--yes", is_flag=True, help="Do it without asking.")
@daemon_options
def command(
    drive: str, address: int, yes: bool, socket: str | None, url: str | None, as_json: bool
) -> int:
    """Give DRIVE the address NEW, find it there, and use that address from then on.

    The roster must say `allow_address_change: true` for it, the drive must be inhibited or stopped,
    and nothing may answer at NEW. Afterwards write the new address into the roster.

    Exit status 0 only if it was found at NEW. If it is not found at either address, the answer
    says what is known.
    """
    if address % 10 == 0:
        what = f"{address} is no drive's address"
        raise CommandError(Exit.USAGE, Problem(what, "1 to 99 without 10, 20 .. 90 would be right"))
    with connect(socket, url) as daemon:
        path = f"/v1/drives/{quote(drive, safe='')}"
        if not yes:
            known: Document = daemon.get(path).data
            _ask(known, address, may_ask=on_terminal() and not as_json)
        answer = daemon.post(f"{path}/address", {"address": address})
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    return show_write(answer.data)


def _ask(known: Document, address: int, *, may_ask: bool) -> None:
    drive, old = table_text(known.get("drive")), table_text(known.get("address"))
    if not may_ask:
        raise CommandError(
            Exit.USAGE, Problem(f"the address of {drive} is not changed unasked", "add --yes")
        )
    told = ", ".join(f"{code} {text}" for code, text in dict(known.get("identity") or {}).items())
    click.echo(f"{drive} at address {old} ({known.get('family')}), which is {told or 'unknown'}")
    states = known.get("states")
    if states is not None:
        named = ", ".join(state.replace("_", " ") for state in states)
        click.echo(f"its status words show: {named or 'nothing of note'}")
    if "zero_speed" not in (states or ()):
        click.echo("it does not say that its motor has come to rest: look at the machine")
    if not click.confirm(f"Give it address {address}?"):
        raise CommandError(Exit.FAILED, Problem("nothing was changed"))
