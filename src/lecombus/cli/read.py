"""`lecombus read`: one code of one drive, through the daemon or through a port that it opens."""

from __future__ import annotations

from collections.abc import Sequence

import click

from lecombus.cli.arguments import CODE, daemon_options
from lecombus.cli.client import connect, path_of
from lecombus.cli.document_rows import show_reading
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.fieldbus.lecom.protocol import BAUDS as ALL_BAUDS
from lecombus.fieldbus.lecom.protocol import is_drive_address
from lecombus.parameters import Code

__all__ = ["read_command"]

BAUDS = [str(baud) for baud in ALL_BAUDS]


@click.command("read")
@click.argument("words", nargs=-1, metavar="[DRIVE] CODE")
@click.option("--stored", is_flag=True, help="What the daemon knows; nothing is sent.")
@click.option("--port", metavar="DEVICE", help="Open this port; no daemon. Needs --address.")
@click.option("--address", type=int, help="The drive's address on that port.")
@click.option("--family", default="generic", show_default=True, help="The drive's family.")
@click.option("--baud", type=click.Choice(BAUDS), default="9600", show_default=True)
@daemon_options
def read_command(
    words: Sequence[str],
    stored: bool,
    port: str | None,
    address: int | None,
    family: str,
    baud: str,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Read CODE of DRIVE now, or with --stored as the daemon last read it.

    With --port no daemon is needed: `read --port /dev/ttyUSB0 --address 1 C0046`. A port that
    another program has open is refused, and so is one that a daemon uses.

    On a terminal: a line of text. In a pipe: drive, code, value, unit, quality, reason, separated
    by tabs. With --json: {"drive", "code", "subcode", "name", "value", "raw", "format", "unit",
    "quality", "reason", "time", "age_s", "text"}. A value of quality bad makes the exit status 1.
    """
    if port:
        code = _only_code(words)
        from lecombus.cli.direct import read_directly

        answer_text, reading = read_directly(port, int(baud), _drive_address(address), family, code)
    else:
        drive, code = _drive_and_code(words)
        with connect(socket, url) as daemon:
            path = f"{path_of('drive', drive)}/codes/{code}"
            answer = daemon.get(path) if stored else daemon.get(path, fresh="true")
        answer_text, reading = answer.text, answer.data
    if as_json:
        click.echo(answer_text)
        return Exit.FAILED if reading.get("quality") == "bad" else Exit.DONE
    return show_reading(reading)


def _drive_address(address: int | None) -> int:
    """Return an address that one drive answers at; groups are never answered."""
    if address is None:
        raise CommandError(Exit.USAGE, Problem("--port needs --address", "give the drive's"))
    if not is_drive_address(address):
        problem = f"no drive has the address {address}"
        remedy = "it is 1 to 99, and not 10, 20 .. 90, which are groups that nobody answers for"
        raise CommandError(Exit.USAGE, Problem(problem, remedy))
    return address


def _only_code(words: Sequence[str]) -> Code:
    if len(words) != 1:
        raise CommandError(
            Exit.USAGE, Problem("with --port only a code is named", "write read --port .. CODE")
        )
    return CODE.convert(words[0], None, None)


def _drive_and_code(words: Sequence[str]) -> tuple[str, Code]:
    if len(words) != 2:
        raise CommandError(
            Exit.USAGE, Problem("a drive and a code are needed", "write read DRIVE CODE")
        )
    return words[0], CODE.convert(words[1], None, None)
