"""Commands on one drive of a running daemon: wear, forget-times, accept and readdress."""

from __future__ import annotations

from functools import partial

import click

from lecombus.cli.arguments import CODE, DaemonOptions, WholeNumber, Word, daemon_options
from lecombus.cli.daemon_access import act, ask, drive_path, refuse_problem, show
from lecombus.cli.document_rows import (
    Document,
    cells_of,
    show_outcomes,
    shown_code,
    status_of,
)
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import age, on_terminal, show_rows, table_text

__all__ = ["accept_command", "forget_times_command", "readdress_command", "wear_command"]


def _seen(word: str) -> tuple[str, str]:
    code, equals, text = word.partition("=")
    if not equals or not text:
        raise click.BadParameter(f"`{word}` is no CODE=VALUE, such as C1810=33S2102I_10000")
    return str(CODE.convert(code, None, None)), text


@click.command("accept")
@click.argument("drive")
@click.option(
    "--seen", type=Word("seen", _seen), multiple=True, metavar="CODE=VALUE",
    help="What differs, as you have seen it; instead of being asked. Once for each code.",
)  # fmt: skip
@daemon_options
def accept_command(
    drive: str,
    seen: tuple[tuple[str, str], ...],
    daemon: DaemonOptions,
) -> int:
    """Accept the device that answers at DRIVE's address as DRIVE, after a replacement.

    Shows the old and the new identity, and asks. Until then only stops are sent to it. In a
    pipe, or with --json, there is no question: repeat every value that differs with --seen.
    """
    path = drive_path(drive)
    known: Document = ask(daemon, f"{path}/identity").data
    found, accepted = dict(known.get("found") or {}), dict(known.get("accepted") or {})
    differing = {code: text for code, text in found.items() if accepted.get(code) != text}
    if not seen and not daemon.as_json:
        kind = _family_of(daemon, drive)
        rows = [
            (shown_code(kind, code), accepted.get(code, ""), found.get(code, ""))
            for code in dict.fromkeys((*accepted, *found))
        ]
        show_rows(("code", "was", "is"), rows, title=drive)
    if not differing and found:
        if not known.get("problem"):
            _ask_again(daemon, drive, found)
        if daemon.as_json:
            click.echo(ask(daemon, f"{path}/identity").text)
        else:
            click.echo(table_text(known.get("problem")) or f"{drive} is the same drive as before")
        return Exit.FAILED if known.get("problem") else Exit.DONE
    _confirm_identity(drive, differing, dict(seen), may_ask=on_terminal() and not daemon.as_json)
    answer = act(daemon, "POST", f"{path}/accept", {"identity": found})
    refuse_problem(answer)
    accepted_text = f"{drive} is accepted; it is audited now, then it may be written to"
    show(answer, lambda _: click.echo(accepted_text), as_json=daemon.as_json)
    return Exit.DONE


def _ask_again(daemon: DaemonOptions, drive: str, found: dict[str, str]) -> None:
    """Read the identity from the drive again: its audit may be long ago."""
    path = drive_path(drive)
    for code in found:
        ask(daemon, f"{path}/codes/{code}", fresh="true")
    known = dict(ask(daemon, f"{path}/identity").data.get("found") or {})
    state: Document = ask(daemon, path).data
    if known != found or state.get("state") != "online":
        what = f"{drive} is {': '.join(cells_of(state, 'state', 'reason'))}"
        raise CommandError(Exit.FAILED, what, "repeat this when it is online")


def _confirm_identity(
    drive: str, differing: dict[str, str], seen: dict[str, str], *, may_ask: bool
) -> None:
    """Check that the user has seen the identity that is accepted.

    Raises:
        CommandError: The user has not, or does not accept it.
    """
    if not differing:
        return  # nothing was read of it: the daemon says why
    if seen:
        wrong = [code for code in {**differing, **seen} if differing.get(code) != seen.get(code)]
        if wrong:
            right = " ".join(f"--seen {code}={text}" for code, text in differing.items())
            what = f"what was seen of {', '.join(sorted(wrong))} is not what differs"
            raise CommandError(Exit.USAGE, what, f"look again: it is {right}")
        return
    if not may_ask:
        right = " ".join(f"--seen {code}={text}" for code, text in differing.items())
        what = f"another drive as {drive} is accepted only after its identity was compared"
        raise CommandError(Exit.USAGE, what, f"if it is the right drive, add {right}")
    if not click.confirm(f"Accept this drive as {drive}?"):
        raise CommandError(Exit.FAILED, "nothing was accepted")


@click.command("readdress")
@click.argument("drive")
@click.argument("address", type=WholeNumber(1, 99), metavar="NEW")
@click.option("--yes", is_flag=True, help="Do it without asking.")
@daemon_options
def readdress_command(drive: str, address: int, yes: bool, daemon: DaemonOptions) -> int:
    """Give DRIVE the address NEW, find it there, and use that address from then on.

    The roster must say `allow_address_change: true` for it, the drive must be inhibited or stopped,
    and nothing may answer at NEW. Afterwards write the new address into the roster.

    Exit status 0 only if it was found at NEW. If it is not found at either address, the answer
    says what is known.
    """
    if address % 10 == 0:
        what = f"{address} is not a drive's address"
        raise CommandError(Exit.USAGE, what, "1 to 99 without 10, 20 .. 90 would be right")
    path = drive_path(drive)
    if not yes:
        known: Document = ask(daemon, path).data
        _confirm_address(known, address, may_ask=on_terminal() and not daemon.as_json)
    unsure = f"{drive} may have address {address} now; `lecombus status {drive}` shows it"
    answer = act(daemon, "POST", f"{path}/address", {"address": address}, unsure=unsure)
    show(answer, show_outcomes, as_json=daemon.as_json)
    return status_of(answer.data)


def _confirm_address(known: Document, address: int, *, may_ask: bool) -> None:
    drive, old = cells_of(known, "drive", "address")
    if not may_ask:
        raise CommandError(
            Exit.USAGE, f"the address of {drive} is changed only after a confirmation", "add --yes"
        )
    kind, identity = known.get("family"), dict(known.get("identity") or {})
    labels = ", ".join(f"{shown_code(kind, code)} {text}" for code, text in identity.items())
    click.echo(f"{drive} at address {old} ({kind}), which is {labels or 'unknown'}")
    states = known.get("states")
    if states is not None:
        named = ", ".join(state.replace("_", " ") for state in states)
        click.echo(f"its status words show: {named or 'nothing of note'}")
    if "zero_speed" not in (states or ()):
        click.echo("it does not say that its motor has come to rest: look at the machine")
    if not click.confirm(f"Give it address {address}?"):
        raise CommandError(Exit.FAILED, "nothing was changed")


@click.command("wear")
@click.argument("drive")
@daemon_options
def wear_command(drive: str, daemon: DaemonOptions) -> int:
    """Show how often each code that wears DRIVE's memory was written, the highest count first.

    Every write that may have reached the memory counts, since counting began; "this device":
    since this device was accepted. In a pipe: code, name, writes, to this device, and how long
    until it may be written again. With --json: the daemon's document.
    """
    answer = ask(daemon, f"{drive_path(drive)}/wear")
    kind = _family_of(daemon, drive)
    show(answer, partial(_show_wear, drive, kind), as_json=daemon.as_json)
    return Exit.DONE


def _family_of(daemon: DaemonOptions, drive: str) -> str:
    """Ask for a drive's family where its codes are shown to people; empty elsewhere."""
    if daemon.as_json or not on_terminal():
        return ""
    try:
        return table_text(ask(daemon, drive_path(drive)).data.get("family"))
    except CommandError:  # the codes are shown by their numbers then
        return ""


def _show_wear(drive: str, kind: str, report: Document) -> None:
    codes = report.get("codes") or []
    if not codes and on_terminal():
        click.echo(f"nothing that wears its memory was written to {drive} yet")
        return
    rows = [
        (
            shown_code(kind, table_text(one.get("code"))),
            *cells_of(one, "name", "writes", "to_this_device"),
            age(one["wait_s"]) if one.get("wait_s") else "",
        )
        for one in codes
    ]
    show_rows(("code", "name", "writes", "this device", "again in"), rows)


@click.command("forget-times")
@click.argument("drive")
@daemon_options
def forget_times_command(drive: str, daemon: DaemonOptions) -> int:
    """Drop the measured answer times of DRIVE.

    Time-outs and plans then use its manual and the roster, until most of its answers are late
    again. Shows what is dropped. In a pipe: code, read or write, the manual's longest time and
    the time measured, in seconds; if there is nothing, a message on standard error says so.
    With --json: the daemon's document.
    """
    kind = _family_of(daemon, drive)
    answer = act(daemon, "POST", f"{drive_path(drive)}/forget-times", {})
    refuse_problem(answer)
    show(answer, partial(_show_forgotten, drive, kind), as_json=daemon.as_json)
    return Exit.DONE


def _show_forgotten(drive: str, kind: str, report: Document) -> None:
    forgotten = report.get("forgotten") or []
    if not forgotten:
        text = f"nothing was measured of {drive} that is later than its manual says"
        click.echo(text, err=not on_terminal())
        return
    rows = [
        (
            shown_code(kind, table_text(one.get("code"))),
            "write" if one.get("write") else "read",
            f"{float(one.get('manual_s') or 0.0):.3f}",
            f"{float(one.get('measured_s') or 0.0):.3f}",
        )
        for one in forgotten
    ]
    show_rows(("code", "as", "manual, s", "measured, s"), rows, title=f"forgotten of {drive}")
