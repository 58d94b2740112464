"""From the words on the command line to an exit status.

The table of commands names modules, which are imported only when their command is called. Every
error made on purpose becomes one line per problem on standard error (one JSON document per line
with `--json`) and the exit status that `exits` defines; only a bug shows a traceback.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Final

import click

from lecombus import __version__
from lecombus.cli.exits import CommandError, Exit, Problem, status_of_cause
from lecombus.errors import (
    CodeValueError,
    ConfigError,
    LecombusError,
    OperationError,
    meant,
)

__all__ = ["COMMANDS", "lecombus", "main"]

COMMANDS: Final[Mapping[str, tuple[str, str]]] = {
    "demo": ("run", "Watch simulated drives of five families, without any hardware."),
    "run": ("run", "Run the line that a roster describes."),
    "check": ("check", "List the mistakes of a roster, or show what it means."),
    "plan": ("line_plan", "Say what a line can hold and how long requests wait, before it runs."),
    "reload": ("reload", "Have the running daemon read its roster again."),
    "simulate": ("simulate", "Simulate a roster's drives, on a pty or a TCP port."),
    "read": ("code_commands", "Read one code of one drive."),
    "write": ("code_commands", "Write one code of one drive."),
    "group": ("code_commands", "Write one code of every drive of a group."),
    "enable": ("verb_commands", "Release quick stop and inhibit of one drive: its motor may turn."),
    "set-speed": ("verb_commands", "Give one drive its speed, in Hz or %."),
    "reset-fault": ("verb_commands", "Reset the fault of one drive, which stays inhibited."),
    "quick-stop": ("verb_commands", "Stop drives along their ramp, before everything else."),
    "inhibit": ("verb_commands", "Inhibit drives, before everything else: no torque."),
    "stop": ("verb_commands", "Stop drives, before everything else; all of them if none is named."),
    "readdress": ("drive_commands", "Give a drive another address, and use it from then on."),
    "rebaud": ("rebaud", "Give all drives of a line another baud rate, with the daemon stopped."),
    "wear": ("drive_commands", "Show how often a drive's memory was written."),
    "accept": ("drive_commands", "Accept another drive in the place of the one that was there."),
    "forget-times": ("drive_commands", "Drop the measured answer times of a drive."),
    "describe": ("describe", "Say what is known of the codes of a family of drives."),
    "backup": ("backup", "Read all parameters of a drive, or of all drives, into files."),
    "diff": ("diff", "Show the differences of two backups or drives."),
    "restore": ("restore", "Write a backup back into a drive, after showing what that changes."),
    "status": ("status", "Show the line and its drives, or one drive with its values."),
    "lease": ("leases", "Run a command with a lease of drives, for service."),
    "leases": ("leases", "Show who controls which drives, and what is latched."),
    "events": ("events", "Print what happens on the line, as it happens."),
    "journal": ("journal", "Show who did what to which drive, and what happened to them."),
    "token": ("token", "Make, list and revoke the tokens that requests over TCP carry."),
    "support-bundle": ("support_bundle", "Collect what a maintainer needs, without secrets."),
    "scan": ("scan", "Find the drives on a line, and propose a roster."),
    "bridge": ("bridge_commands", "Run a bridge: MQTT, Modbus TCP, or notify (mail, a command)."),
    "fleet": ("fleet", "Follow many lines on a broker: what needs attention; stop lines."),
    "notify": ("notify", "Try the messages that are sent when something happens."),
    "why": ("status", "Say why a drive does not turn, and what to do next."),
}
"""By name, in the order of the help: the module in `cli/` with its `NAME_command`, and the help."""


COMPLETION = "_LECOMBUS_COMPLETE"
"""Set by a shell that completes a word; `_LECOMBUS_COMPLETE=bash_source lecombus` sets that up."""


class _Commands(click.Group):
    """Finds a command in its module, which is imported then."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            remedy = meant(cmd_name, COMMANDS, "the commands")
            raise CommandError(Exit.USAGE, f"there is no command `{cmd_name}`", remedy)
        module = import_module(f"lecombus.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, f"{cmd_name.replace('-', '_')}_command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List them without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=(
        "Exit status: 0 done; 1 the drive or the line refused or failed; 2 usage or roster wrong; "
        "3 daemon not reachable; 4 not permitted."
    ),
)
@click.version_option(__version__, prog_name="lecombus", message="%(prog)s %(version)s")
def lecombus() -> None:
    """Speak LECOM-A/B with a line of Lenze drives.

    demo, run, check, plan, simulate and rebaud work on a roster, bridge and notify on a roster and
    its daemon, describe on nothing, token on its file; fleet talks to an MQTT broker, all others to
    a running daemon; read and scan can open a port themselves. lecombus is not a safety function:
    have an emergency stop without software.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line.

    Args:
        argv: The words after the program's name; None: those the program was called with.

    Returns:
        The exit status.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    # Only `run` shows logs; elsewhere warnings would stand between a command's own lines.
    logging.getLogger("lecombus").addHandler(logging.NullHandler())
    if COMPLETION in os.environ:
        lecombus.main(words, prog_name="lecombus", complete_var=COMPLETION)
    try:
        status = _invoke(words)
        sys.stdout.flush()
    except (click.Abort, KeyboardInterrupt):
        return Exit.INTERRUPTED
    except BrokenPipeError:
        _forget_stdout()
        return Exit.PIPE_CLOSED
    except click.exceptions.NoArgsIsHelpError as exc:
        click.echo(exc.format_message(), err=True)
        return Exit.USAGE
    except (click.ClickException, CommandError, LecombusError, OSError) as exc:
        error = _as_command_error(exc)
        _complain(error, as_json="--json" in words)
        return error.status
    return status


def _invoke(words: list[str]) -> int:
    """Run a command; click's own `main` would hide closed pipes and exit by itself."""
    try:
        with lecombus.make_context("lecombus", words) as ctx:
            return int(lecombus.invoke(ctx) or Exit.DONE)
    except click.exceptions.Exit as exc:
        return exc.exit_code


def _as_command_error(exc: Exception) -> CommandError:
    if isinstance(exc, CommandError):
        return exc
    if isinstance(exc, click.ClickException):
        return CommandError(Exit.USAGE, exc.format_message(), _how_to_call(exc))
    if isinstance(exc, OSError):
        return _as_system_error(exc)
    status = status_of_cause(exc)
    if status is Exit.FAILED and isinstance(exc, ConfigError | CodeValueError):
        status = Exit.USAGE
    lines = str(exc).splitlines() or [type(exc).__name__]
    if isinstance(exc, OperationError):
        return CommandError(status, " ".join(lines), exc.remedy, exc.kind, exc.drive, exc.code)
    return CommandError.of(status, *(Problem(line) for line in lines))


def _as_system_error(exc: OSError) -> CommandError:
    status = Exit.FAILED
    if isinstance(exc, PermissionError):
        status = Exit.FORBIDDEN
    elif isinstance(exc, FileNotFoundError | IsADirectoryError):
        status = Exit.USAGE
    what = (exc.strerror or type(exc).__name__).lower()
    names = " -> ".join(str(name) for name in (exc.filename, exc.filename2) if name)  # of a link
    return CommandError(status, f"{names}: {what}" if names else what)


def _how_to_call(exc: click.ClickException) -> str:
    ctx = exc.ctx if isinstance(exc, click.UsageError) else None
    if ctx is None:
        return ""
    return f"see {ctx.command_path} --help"


def _complain(error: CommandError, *, as_json: bool) -> None:
    for problem in error.problems:
        if as_json:
            document = {"status": int(error.status), **problem.as_json()}
            click.echo(json.dumps(document, ensure_ascii=False), err=True)
        else:
            click.echo(str(problem), err=True)


def _forget_stdout() -> None:
    """Let the interpreter's own last flush go nowhere instead of failing loudly."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
