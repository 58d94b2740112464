"""`lecombus group`: one code of every drive of a group."""

from __future__ import annotations

from urllib.parse import quote

import click

from lecombus.cli.arguments import CODE, EXPIRY, VALUE, CommandWithNumbers, Given, daemon_options
from lecombus.cli.client import connect
from lecombus.cli.reports import Document, show_group, status_of
from lecombus.cli.write import write_document
from lecombus.protocol import Code

__all__ = ["command"]

SENT_ONLY = (
    "it was sent as one multicast, which nobody acknowledges, and --no-verify was given: who took "
    "it is unknown, and so this is exit status 1; without --no-verify every member is read back"
)


def was_only_sent(report: Document) -> bool:
    """Whether a multicast went out and nothing more is known of it."""
    outcomes = {member.get("outcome") for member in report.get("members") or [report]}
    return report.get("how") == "multicast" and outcomes == {"unknown"}


@click.command("group", cls=CommandWithNumbers)
@click.argument("group")
@click.argument("code", type=CODE)
@click.argument("value", type=VALUE)
@click.option(
    "--verify/--no-verify",
    default=None,
    help="Read it back from every member; a multicast is, unless told otherwise.",
)
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
def command(
    group: str,
    code: Code,
    value: Given,
    verify: bool | None,
    expires: float | None,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Write VALUE to CODE of every drive of GROUP; the group `all` is every drive of the roster.

    Where the group allows that (`lecombus check` shows it), it is sent as one multicast, which
    is not acknowledged, and then read back. Otherwise one write follows the other.

    Exit status 0 only if every member's outcome is done or verified: never for a multicast with
    --no-verify, whose outcome is unknown. In a pipe: one line a member
    with drive, code, outcome, value read back, reason. With --json: the daemon's document,
    {"how", "outcome", "members": [as write]}.
    """
    with connect(socket, url) as daemon:
        path = f"/v1/groups/{quote(group, safe='')}/codes/{code}"
        answer = daemon.put(path, write_document(value, expires, verify))
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    status = show_group(answer.data)
    if verify is False and was_only_sent(answer.data):
        click.echo(SENT_ONLY, err=True)
    return status
