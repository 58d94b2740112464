"""`lecombus write` and `lecombus group`: one code of one drive, or of every drive of a group."""

from __future__ import annotations

import click

from lecombus.cli.arguments import CODE, EXPIRY, VALUE, CommandWithNumbers, Given, daemon_options
from lecombus.cli.client import connect, path_of
from lecombus.cli.document_rows import Document, show_group, show_write, status_of
from lecombus.parameters import Code
from lecombus.readings import Json

__all__ = ["group_command", "write_command", "write_document"]

SENT_ONLY = (
    "it was sent as one multicast, which nobody acknowledges, and --no-verify was given: who took "
    "it is unknown, and so this is exit status 1; without --no-verify every member is read back"
)


def write_document(value: Given, expires: float | None, verify: bool | None) -> dict[str, Json]:
    """Return the body of a write request.

    Args:
        value: What to write.
        expires: Seconds after which it shall no longer be sent; None: the daemon's default.
        verify: Whether to read it back; None: as the daemon sees fit.
    """
    document: dict[str, Json] = {"value": value}
    if verify is not None:
        document["verify"] = verify
    if expires is not None:
        document["expires"] = f"{round(expires * 1000)}ms"
    return document


@click.command("write", cls=CommandWithNumbers)
@click.argument("drive")
@click.argument("code", type=CODE)
@click.argument("value", type=VALUE)
@click.option("--verify", is_flag=True, help="Read it back afterwards.")
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
def write_command(
    drive: str,
    code: Code,
    value: Given,
    verify: bool,
    expires: float | None,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Write VALUE to CODE of DRIVE and wait for the outcome.

    VALUE is a number (`write feeder C0046 -5`), a word such as H0008 or 0x0008, or octets such as
    O1A2B. For a word, digits alone are refused: 0208 could be H0208 or decimal 208.

    The outcome is one of done, verified (exit status 0), refused, expired, superseded, unknown
    (1: it may have happened). In a pipe: drive, code, outcome, value read back, reason. With
    --json: the daemon's document, {"drive", "code", "outcome", "reason", "cause", "reading"}.
    """
    with connect(socket, url) as daemon:
        path = f"{path_of('drive', drive)}/codes/{code}"
        answer = daemon.put(path, write_document(value, expires, verify))
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    return show_write(answer.data)


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
def group_command(
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
        path = f"{path_of('group', group)}/codes/{code}"
        answer = daemon.put(path, write_document(value, expires, verify))
    if as_json:
        click.echo(answer.text)
        return status_of(answer.data)
    status = show_group(answer.data)
    if verify is False and was_only_sent(answer.data):
        click.echo(SENT_ONLY, err=True)
    return status
