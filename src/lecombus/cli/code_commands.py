"""`lecombus read`, `write` and `group`: one code of a drive, or of every drive of a group.

A read goes through the daemon, or through a port that the command opens.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import click

from lecombus.cli.arguments import (
    EXPIRY,
    GIVEN_CODE,
    VALUE,
    CommandWithNumbers,
    DaemonOptions,
    Given,
    GivenCode,
    check_port_options,
    daemon_options,
    whole_path,
)
from lecombus.cli.daemon_access import act, ask, drive_path, group_path, show
from lecombus.cli.document_rows import Document, show_outcomes, show_reading, status_of
from lecombus.cli.exits import CommandError, Exit
from lecombus.client.documents import Answer
from lecombus.client.requests import write_document
from lecombus.fieldbus.lecom.protocol.addressing import is_drive_address
from lecombus.fieldbus.lecom.protocol.controls import BAUDS as ALL_BAUDS

__all__ = ["group_command", "read_command", "write_command"]

BAUDS = [str(baud) for baud in ALL_BAUDS]

SENT_ONLY = (
    "it was sent as one multicast, which no drive acknowledges, and --no-verify was given: which "
    "drives took it is unknown, and so this is exit status 1; without --no-verify every member is "
    "read back"
)


@click.command("read")
@click.argument("words", nargs=-1, metavar="[DRIVE] CODE")
@click.option("--stored", is_flag=True, help="What the daemon knows; nothing is sent.")
@click.option("--port", metavar="DEVICE", callback=whole_path,
              help="Open this port; no daemon. Needs --address.")  # fmt: skip
@click.option("--address", type=int, help="The drive's address on that port.")
@click.option("--family", default="generic", show_default=True, help="The drive's family.")
@click.option("--baud", type=click.Choice(BAUDS), default="9600", show_default=True)
@daemon_options
@click.pass_context
def read_command(
    ctx: click.Context,
    words: Sequence[str],
    stored: bool,
    port: str | None,
    address: int | None,
    family: str,
    baud: str,
    daemon: DaemonOptions,
) -> int:
    """Read CODE of DRIVE now, or with --stored as the daemon last read it.

    With --port no daemon is needed: `read --port /dev/ttyUSB0 --address 1 C0046`. A port that
    another program has open is refused, and so is one that a daemon uses.

    On a terminal: a line of text. In a pipe: drive, code, value, unit, quality, reason, separated
    by tabs. With --json: {"drive", "code", "subcode", "name", "value", "raw", "format", "unit",
    "quality", "reason", "time", "age_s", "text"}. A value of quality bad makes the exit status 1.
    """
    if port is not None and stored:
        problem = "--stored shows what a daemon knows; with --port no daemon is asked"
        raise CommandError(Exit.USAGE, problem, "leave one of them out")
    check_port_options(
        ctx, port, daemon, only_with=("address", "family", "baud"),
        why="the daemon reads DRIVE as its roster describes it",
    )  # fmt: skip
    if port is not None:
        given = _only_code(words)
        from lecombus.api.decimal_json import encode
        from lecombus.cli.own_line import read_directly

        reading = read_directly(port, int(baud), _drive_address(address), family, given.code)
        document = reading.as_json()
        answer = Answer(encode(document), document)
    else:
        drive, given = _drive_and_code(words)
        path = f"{drive_path(drive)}/codes/{given.code}"
        answer = ask(daemon, path) if stored else ask(daemon, path, fresh="true")
    show(answer, partial(show_reading, spoken=given.spoken), as_json=daemon.as_json)
    return Exit.FAILED if answer.data.get("quality") == "bad" else Exit.DONE


def _drive_address(address: int | None) -> int:
    """Return an address that one drive answers at; groups are never answered."""
    if address is None:
        raise CommandError(Exit.USAGE, "--port needs --address", "give the drive's")
    if not is_drive_address(address):
        problem = f"no drive has the address {address}"
        remedy = "it is 1 to 99, and not 10, 20 .. 90, which are groups: no drive answers for one"
        raise CommandError(Exit.USAGE, problem, remedy)
    return address


def _only_code(words: Sequence[str]) -> GivenCode:
    if len(words) != 1:
        raise CommandError(
            Exit.USAGE, "with --port only a code is named", "write read --port .. CODE"
        )
    return GIVEN_CODE.convert(words[0], None, None)


def _drive_and_code(words: Sequence[str]) -> tuple[str, GivenCode]:
    if len(words) != 2:
        raise CommandError(Exit.USAGE, "a drive and a code are needed", "write read DRIVE CODE")
    return words[0], GIVEN_CODE.convert(words[1], None, None)


@click.command("write", cls=CommandWithNumbers)
@click.argument("drive")
@click.argument("code", type=GIVEN_CODE)
@click.argument("value", type=VALUE)
@click.option("--verify", is_flag=True, help="Read it back afterwards.")
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
def write_command(
    drive: str,
    code: GivenCode,
    value: Given,
    verify: bool,
    expires: float | None,
    daemon: DaemonOptions,
) -> int:
    """Write VALUE to CODE of DRIVE and wait for the outcome.

    VALUE is a number (`write feeder C0046 -5`), a word such as H0008 or 0x0008, or octets such as
    O1A2B. For a word, digits alone are refused: 0208 could be H0208 or decimal 208.

    The outcome is one of done, verified (exit status 0), refused, expired, superseded, unknown
    (1: it may have happened). In a pipe: drive, code, outcome, value read back, reason. With
    --json: the daemon's document, {"drive", "code", "outcome", "reason", "cause", "reading"}.
    """
    path = f"{drive_path(drive)}/codes/{code.code}"
    unsure = f"{code} of {drive} may have been written; `lecombus read {drive} {code}` shows it"
    answer = act(daemon, "PUT", path, write_document(value, verify, expires), unsure=unsure)
    show(answer, partial(show_outcomes, spoken=code.spoken), as_json=daemon.as_json)
    return status_of(answer.data)


def was_only_sent(report: Document) -> bool:
    """Whether a multicast went out and nothing more is known of it."""
    outcomes = {member.get("outcome") for member in report.get("members") or [report]}
    return report.get("how") == "multicast" and outcomes == {"unknown"}


@click.command("group", cls=CommandWithNumbers)
@click.argument("group")
@click.argument("code", type=GIVEN_CODE)
@click.argument("value", type=VALUE)
@click.option(
    "--verify/--no-verify",
    default=None,
    help="Read it back from every member; default: only after a multicast.",
)
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
def group_command(
    group: str,
    code: GivenCode,
    value: Given,
    verify: bool | None,
    expires: float | None,
    daemon: DaemonOptions,
) -> int:
    """Write VALUE to CODE of every drive of GROUP; the group `all` is every drive of the roster.

    Where the group allows that (`lecombus check` shows it), it is sent as one multicast, which
    is not acknowledged, and then read back. Otherwise one write follows the other.

    Exit status 0 only if every member's outcome is done or verified: never for a multicast with
    --no-verify, whose outcome is unknown. In a pipe: one line a member
    with drive, code, outcome, value read back, reason. With --json: the daemon's document,
    {"how", "outcome", "members": [as write]}.
    """
    path = f"{group_path(group)}/codes/{code.code}"
    unsure = f"{code} of some or all drives of {group} may have been written"
    answer = act(daemon, "PUT", path, write_document(value, verify, expires), unsure=unsure)
    show(answer, partial(show_outcomes, spoken=code.spoken), as_json=daemon.as_json)
    if verify is False and was_only_sent(answer.data) and not daemon.as_json:
        click.echo(SENT_ONLY, err=True)
    return status_of(answer.data)
