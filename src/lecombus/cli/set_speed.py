"""`lecombus set-speed`: a setpoint with its unit."""

from __future__ import annotations

import re

import click

from lecombus.cli.arguments import EXPIRY, NUMBER, CommandWithNumbers, daemon_options
from lecombus.cli.verbs import say
from lecombus.cli.write import write_document

__all__ = ["command"]

_SPEED = re.compile(r"\0?([+-]?[0-9.,]+(?:[eE][+-]?[0-9]+)?)\s*(.*)", re.DOTALL)
"""A number, right or not, and a unit; before a negative one stands what hides it from click."""


@click.command("set-speed", cls=CommandWithNumbers)
@click.argument("drive")
@click.argument("speed", nargs=-1, required=True, metavar="VALUE UNIT")
@click.option("--verify", is_flag=True, help="Read it back afterwards.")
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
@click.pass_context
def command(
    ctx: click.Context,
    drive: str,
    speed: tuple[str, ...],
    verify: bool,
    expires: float | None,
    socket: str | None,
    url: str | None,
    as_json: bool,
) -> int:
    """Give DRIVE its speed: `set-speed belt 35 Hz`, `set-speed belt 70%`.

    % refers to the drive's highest frequency or speed. The setpoint is written to the code that
    the drive's family and settings require. Out of its range, it is refused with the range. It
    does not enable the drive.

    In a pipe and with --json: as for enable.
    """
    match = _SPEED.fullmatch(" ".join(speed))
    if match is None:
        raise click.UsageError(f"`{' '.join(speed)}` is no speed, write it like 35 Hz or 70%", ctx)
    value = NUMBER.convert(match[1], None, ctx)
    if not match[2]:
        raise click.UsageError(f"{match[1]} has no unit, write {match[1]} Hz or {match[1]}%", ctx)
    document = {**write_document(value, expires, verify or None), "unit": match[2]}
    return say(drive, "set-speed", document, socket=socket, url=url, as_json=as_json)
