"""`lecombus leases`: who controls which drives; `lecombus lease`: a command under a lease.

`lease` holds the lease in this process for as long as its command runs, and gives the command the
token in `LECOMBUS_LEASE`, which all commands of lecombus send with what they write. They ask the
daemon that gave the lease, in every folder, also where the environment named another.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from lecombus.cli.arguments import EXPIRY, DaemonOptions, daemon_options
from lecombus.cli.daemon_access import LEASE_VARIABLE, ask, command_errors, connected, show
from lecombus.cli.document_rows import Document, cells_of
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.cli.signals import ended_as_by_ctrl_c
from lecombus.client.finding import find_daemon

if TYPE_CHECKING:
    from anyio.abc import Process

__all__ = ["lease_command", "leases_command"]

ENDS: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
"""What a command is ended with, one after the other: an interactive shell ignores the first."""

END_WITHIN_S: Final = 2.0

SIGNALLED: Final = 128
"""A shell adds to this the number of the signal that ended a command."""


@click.command("leases")
@daemon_options
def leases_command(daemon: DaemonOptions) -> int:
    """Show who holds leases, and which drives need one or are latched.

    A latched drive takes no setpoint until a lease is held for it and it was enabled with the
    lease's token. Tokens are never shown.

    In a pipe: one line a drive (drive, `required` or `free`, its lease, number, seconds until that
    lapses, `latched` and why and whether it is silenced, `on_lapse`, who holds it). With --json:
    the daemon's document.
    """
    show(ask(daemon, "/v1/leases"), _show, as_json=daemon.as_json)
    return Exit.DONE


def _show(document: Document) -> None:
    held: dict[str, Document] = {one["name"]: one for one in document.get("leases") or ()}
    rows = []
    for drive in document.get("drives") or ():
        lease: Document = held.get(drive.get("lease") or "", {})
        holder: Document = lease.get("holder") or {}
        silenced = ", silenced" if drive.get("silenced") else ""
        rows.append(
            (
                *cells_of(drive, "drive"),
                "required" if drive.get("required") else "free",
                *cells_of(lease, "name", "number", "expires_in_s"),
                f"latched: {drive.get('because')}{silenced}" if drive.get("latched") else "",
                *cells_of(drive, "on_lapse"),
                " ".join(f"{key}={text}" for key, text in holder.items()),
            )
        )
    if not rows and on_terminal():
        click.echo("no drive needs a lease, and none is held")
    if rows:
        head = ("drive", "lease", "held as", "number", "ends in s", "latch", "on lapse", "holder")
        show_rows(head, rows)


@click.command("lease", context_settings={"ignore_unknown_options": True})
@click.argument("name")
@click.option(
    "--on", "targets", metavar="TARGET", multiple=True, required=True,
    help="A drive or a group; may be given several times.",
)  # fmt: skip
@click.option("--time", "time_s", type=EXPIRY, default="2s", show_default=True,
              help="How long it lasts if this process dies.")  # fmt: skip
@click.option("--take-over", metavar="LEASE", default="", help="Take the drives of this lease.")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
@daemon_options
@ended_as_by_ctrl_c()
def lease_command(
    name: str,
    targets: tuple[str, ...],
    time_s: float,
    take_over: str,
    command: tuple[str, ...],
    daemon: DaemonOptions,
) -> int:
    """Run COMMAND with a lease of drives, called NAME, and give that up when COMMAND ends.

    For service and for trying things out: `lecombus lease service --on feeder -- bash`, and in that
    shell `lecombus enable feeder`. Drives whose roster requires a lease are stopped at the end. If
    this process is killed or hangs, the lease lapses after its time. If the lease is lost, or this
    process is ended by SIGTERM, SIGHUP or Ctrl-C, COMMAND is ended.

    The exit status is that of COMMAND.
    """
    import anyio  # no other command that asks needs it

    if shutil.which(command[0]) is None:
        raise CommandError(Exit.USAGE, f"there is no command `{command[0]}`", "name one to run")
    return anyio.run(hold, daemon, (name, targets, time_s, take_over), command)


async def hold(
    daemon: DaemonOptions, lease: tuple[str, Sequence[str], float, str], command: Sequence[str]
) -> int:
    """Run a command under a lease; gives its exit status.

    Raises:
        OSError: It cannot be run; the lease was given up.
    """
    name, targets, time_s, take_over = lease
    failure: OSError | None = None
    async with connected(daemon) as line:
        with command_errors():
            async with line.lease(name, targets, time_s, take_over=take_over) as held:
                try:
                    return await run(command, variables_of(daemon, held.token))
                except OSError as exc:  # raised below: an error here would let the lease lapse
                    failure = exc
    assert failure is not None
    raise failure


async def run(command: Sequence[str], variables: dict[str, str]) -> int:
    """Run a command to its end; gives its exit status as a shell does.

    Raises:
        OSError: It cannot be run.
    """
    import anyio

    program = await anyio.open_process(command, env=variables, stdin=None, stdout=None, stderr=None)
    try:
        status = await program.wait()
        return status if status >= 0 else SIGNALLED - status
    finally:
        await end(program)


def variables_of(daemon: DaemonOptions, token: str) -> dict[str, str]:
    """Return the environment in which commands ask the same daemon, with a lease's token."""
    found = {**os.environ, LEASE_VARIABLE: token}
    for name in ("LECOMBUS_SOCKET", "LECOMBUS_URL"):
        found.pop(name, None)
    path, url = find_daemon(daemon.socket, daemon.url)
    if url:
        found["LECOMBUS_URL"] = url
    files = {
        "LECOMBUS_SOCKET": path, "LECOMBUS_TOKEN_FILE": daemon.token_file,
        "LECOMBUS_CA": daemon.ca, "LECOMBUS_CERTIFICATE": daemon.certificate,
    }  # fmt: skip
    return found | {name: str(Path(file).absolute()) for name, file in files.items() if file}


async def end(program: Process) -> None:
    """End a command that has not ended, also one that ignores signals."""
    import anyio

    for number in ENDS:
        if program.returncode is None:
            with suppress(ProcessLookupError):
                program.send_signal(number)
            with anyio.move_on_after(END_WITHIN_S, shield=True):
                await program.wait()
