"""The commands of the verbs: enable, set-speed, reset-fault, quick-stop, inhibit and stop.

A stop that is not confirmed begins with one sentence on standard error: how many drives did not
confirm it, that motors may still turn, and what to use then.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from threading import Timer
from typing import Final

import click

from lecombus.cli.arguments import EXPIRY, NUMBER, CommandWithNumbers, DaemonOptions, daemon_options
from lecombus.cli.daemon_access import act, drive_path, show
from lecombus.cli.document_rows import (
    Document,
    is_done,
    members_of,
    show_outcomes,
    show_verb,
    status_of,
)
from lecombus.cli.exits import CommandError, Exit
from lecombus.client.requests import write_document
from lecombus.parameters import Json

__all__ = [
    "alarm",
    "enable_command",
    "inhibit_command",
    "quick_stop_command",
    "reset_fault_command",
    "set_speed_command",
    "spoken",
    "stop_command",
]

WAITED_S: Final = 3.0
"""A stop that takes longer is not kept from the person who waits: its daemon may hang."""

_SPEED = re.compile(r"\0?([+-]?[0-9.,]+(?:[eE][+-]?[0-9]+)?)(?![xX0-9])\s*(.*)", re.DOTALL)
"""A number, right or not, and a unit; before a negative one stands what hides it from click."""


def _run_verb(drive: str, verb: str, document: Mapping[str, Json], daemon: DaemonOptions) -> Exit:
    """Have a drive do something and show how it ended."""
    turns = ", and its motor may turn" if verb == "enable" else ""
    unsure = f"{drive} may have taken the {verb}{turns}; `lecombus status {drive}` shows it"
    answer = act(daemon, "POST", f"{drive_path(drive)}/verbs/{verb}", document, unsure=unsure)
    show(answer, show_verb, as_json=daemon.as_json)
    return status_of(answer.data)


def _send_stop(target: str, action: str, daemon: DaemonOptions) -> Exit:
    """Stop a drive or a group and show how it ended, member by member.

    Raises:
        CommandError: No drive was reached, or none is meant.
    """
    try:
        if not target.strip():
            raise CommandError(
                Exit.USAGE, "TARGET is empty: nothing was stopped", "name a drive, a group or all"
            )
        with _said_while_waiting(action, quiet=daemon.as_json):
            answer = act(daemon, "POST", "/v1/stop", {"action": action, "target": target})
    except (CommandError, KeyboardInterrupt) as exc:
        if not daemon.as_json:
            alarm(_not_answered(target, action, exc))
        raise
    doubtful = _not_confirmed(answer.data, action)
    if doubtful:
        alarm(doubtful)
    show(answer, partial(show_outcomes, said_once=("remedy",)), as_json=daemon.as_json)
    return status_of(answer.data)


def _not_answered(target: str, action: str, error: BaseException) -> str:
    """Say what is known of a stop that was not answered with an outcome."""
    if isinstance(error, CommandError) and error.problems[0].kind == "no-such-drive":
        return (
            f"there is no drive and no group {target}, no {spoken(action)} was sent: motors may "
            "still turn"
        )
    who = f"{target} has not" if target.strip() and target != "all" else "no drive has"
    return f"{who} confirmed the {spoken(action)}: motors may still turn"


@contextmanager
def _said_while_waiting(action: str, *, quiet: bool) -> Iterator[None]:
    """Say when a stop is not answered soon; drives that are silent take long, and so does a hang.

    Args:
        action: How is stopped.
        quiet: Say nothing, as for JSON.
    """
    text = f"the {spoken(action)} is not confirmed after {WAITED_S:.0f} s: motors may still turn"
    timer = Timer(WAITED_S, alarm, [text])
    timer.daemon = True
    if not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _not_confirmed(report: Document, action: str) -> str:
    """Say how many drives did not confirm a stop; nothing where all did."""
    members = members_of(report)
    count = sum(not is_done(one) for one in members)
    if not count:
        return ""
    motors = "its motor" if count == 1 else "their motors"
    who = "the drive" if len(members) == 1 else f"{count} of {len(members)} drives"
    return f"{who} did not confirm the {spoken(action)}: {motors} may still turn"


def alarm(text: str) -> None:
    """Print what is wrong with a stop, red on a terminal, before everything else."""
    click.secho(f"{text}, use the emergency stop circuit", fg="red", bold=True, err=True)


def spoken(action: str) -> str:
    """Return an action in words, such as `quick stop`."""
    return action.replace("-", " ")


@click.command("enable")
@click.argument("drive")
@daemon_options
def enable_command(drive: str, daemon: DaemonOptions) -> int:
    """Release quick stop and inhibit of DRIVE. Its motor turns if it has a setpoint.

    It is refused while a fault is active (`lecombus reset-fault`), and where a setting of the
    drive prevents control over the line; the setting is named. The drive's status words must
    show the enable; if they do not, because its enable terminal is open, it is inhibited again.

    In a pipe: drive, verb, outcome, what the drive shows, value read back, reason. With --json: the
    daemon's document, {"drive", "verb", "outcome", "reason", "states", "written"}.
    """
    return _run_verb(drive, "enable", {}, daemon)


@click.command("set-speed", cls=CommandWithNumbers)
@click.argument("drive")
@click.argument("speed", nargs=-1, required=True, metavar="VALUE UNIT")
@click.option("--verify", is_flag=True, help="Read it back afterwards.")
@click.option("--expires", type=EXPIRY, help="Not sent any more after this time, such as 2s.")
@daemon_options
@click.pass_context
def set_speed_command(
    ctx: click.Context,
    drive: str,
    speed: tuple[str, ...],
    verify: bool,
    expires: float | None,
    daemon: DaemonOptions,
) -> int:
    """Give DRIVE its speed: `set-speed belt 35 Hz`, `set-speed belt 70%`.

    % refers to the drive's highest frequency or speed. The setpoint is written to the code that
    the drive's family and settings require. Out of its range, it is refused with the range. It
    does not enable the drive.

    In a pipe and with --json: as for enable.
    """
    match = _SPEED.fullmatch(" ".join(speed))
    if match is None:
        text = f"`{' '.join(speed)}` is not a speed, write it like 35 Hz or 70%"
        raise click.UsageError(text, ctx)
    value = NUMBER.convert(match[1], None, ctx)
    if not match[2]:
        raise click.UsageError(f"{match[1]} has no unit, write {match[1]} Hz or {match[1]}%", ctx)
    document = {**write_document(value, verify or None, expires), "unit": match[2]}
    return _run_verb(drive, "set-speed", document, daemon)


@click.command("reset-fault")
@click.argument("drive")
@daemon_options
def reset_fault_command(drive: str, daemon: DaemonOptions) -> int:
    """Reset the active fault of DRIVE, by its family's own way. It never starts the motor.

    The drive is inhibited first and stays so: `lecombus enable` lets it run again. Without a
    fault nothing is sent. An 820X and its module restart, which takes about ten seconds: its
    watchdog is set again before it is called online.

    In a pipe and with --json: as for enable.
    """
    return _run_verb(drive, "reset-fault", {}, daemon)


@click.command("quick-stop")
@click.argument("target")
@daemon_options
def quick_stop_command(target: str, daemon: DaemonOptions) -> int:
    """Stop TARGET, a drive or a group, along its ramp by quick stop, before everything else.

    The same as `lecombus stop TARGET --action quick-stop`: it is sent before all other
    requests, and also where writes are refused. It is read back. It is not a safety function.
    """
    return _send_stop(target, "quick-stop", daemon)


@click.command("inhibit")
@click.argument("target")
@daemon_options
def inhibit_command(target: str, daemon: DaemonOptions) -> int:
    """Inhibit TARGET, a drive or a group, before everything else: no torque, the motor coasts.

    The same as `lecombus stop TARGET --action inhibit`: it is sent before all other requests,
    and also where writes are refused. It is read back. It is not a safety function.
    """
    return _send_stop(target, "inhibit", daemon)


@click.command("stop")
@click.argument("target", required=False)
@click.option("--all", "everything", is_flag=True, help="All drives; the same as no TARGET.")
@click.option(
    "--action",
    type=click.Choice(["quick-stop", "inhibit"]),
    default="quick-stop",
    show_default=True,
    help="quick-stop: down its ramp; inhibit: no torque, the motor coasts.",
)
@daemon_options
def stop_command(
    target: str | None,
    everything: bool,
    action: str,
    daemon: DaemonOptions,
) -> int:
    """Stop TARGET, a drive or a group, before everything else that waits.

    Without TARGET all drives of the line are stopped: there is no question, because a stop may
    be urgent. An empty TARGET is refused. It is read back from every drive. It is not a safety
    function.

    Exit status 0 only if every drive is known to have taken the stop. If not, the first line, on
    standard error, says how many drives did not confirm it, that motors may still turn, and to use
    the emergency stop circuit, also with --json. The same is said as soon as it has waited for
    3 s. In a pipe: one line a drive with drive, code, outcome, value read back, reason. With
    --json: the daemon's document, as for group.
    """
    if target is not None and everything:
        raise CommandError(Exit.USAGE, "a target and --all are both given", "leave one of them out")
    return _send_stop("all" if target is None else target, action, daemon)
