"""`lecombus status`: the line and its drives, or one drive with its values."""

from __future__ import annotations

from collections.abc import Sequence

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect, path_of
from lecombus.cli.document_rows import Document, code_of, quality_of, shown_value
from lecombus.cli.exits import Exit
from lecombus.cli.screen import Styled, age, on_terminal, show_rows, table_text

__all__ = ["status_command"]

_TRIPS = ("trip", "fault")


@click.command("status")
@click.argument("drive", required=False)
@daemon_options
def status_command(drive: str | None, socket: str | None, url: str | None, as_json: bool) -> int:
    """Show the line and all its drives, or DRIVE with every value that is known of it.

    Nothing is sent to the line. MOTOR says whether a drive runs or what stops it, by every word
    that shows it; "stopped" means that it does not drive its motor, which may coast. A value
    that is not fresh is shown with its age.

    In a pipe: first the line (the word `line`, name, state, reason), then one line a drive (drive,
    address, family, state, reason, motor, speed, setpoint); or one a value (code, name, value,
    unit, quality, age, reason; quality `once`: not asked for again). With --json: {"line": ..,
    "drives": ..}, the daemon's documents, or with DRIVE the drive's document.
    """
    with connect(socket, url) as daemon:
        if drive:
            answer = daemon.get(path_of("drive", drive))
            if as_json:
                click.echo(answer.text)
            else:
                _show_drive(answer.data)
            return Exit.DONE
        line, drives = daemon.get("/v1/line"), daemon.get("/v1/drives")
    if as_json:
        click.echo(f'{{"line": {line.text}, "drives": {drives.text}}}')
    else:
        _show_line(line.data, _listed(drives.data, "drives"))
    return Exit.DONE


def _listed(data: Sequence[Document] | Document, key: str) -> Sequence[Document]:
    """Return the list in a document that is one, or has one under a key."""
    if isinstance(data, dict):
        found: Sequence[Document] = data.get(key) or []
        return found
    return data  # type: ignore[return-value]


def _show_line(line: Document, drives: Sequence[Document]) -> None:
    name, state, why = table_text(line.get("line")), table_text(line.get("state")), _why(line)
    if on_terminal():
        click.echo(f"line {name}: {state}" + (f", {why}" if why else ""))
    else:
        show_rows((), [("line", name, state, why)])
    rows = []
    for drive in drives:
        who = [table_text(drive.get(key)) for key in ("drive", "address", "family")]
        how = table_text(drive.get("state"))
        why = _why(drive).replace(f"line {state}: {line.get('reason')}", f"line {state}")
        motion: Document = drive.get("motion") or {}
        is_tripped = any(one.get("name") in _TRIPS for one in motion.get("stops") or ())
        style = "red" if is_tripped else "yellow" if motion.get("stale") else ""
        motor = Styled(_motor(motion), style)
        speeds = (_actual(motion), _speed(motion.get("setpoint")))
        if on_terminal():
            how = Styled(how, "") if is_tripped else how
            rows.append((*who, how, motor, *speeds, why))
        else:
            rows.append((*who, how, why, motor, *speeds))
    show_rows(("drive", "address", "family", "state", "motor", "speed", "setpoint", "why"), rows)


def _motor(motion: Document) -> str:
    """Say what a drive does with its motor, and what stops it."""
    doing = table_text(motion.get("doing"))
    stops = [table_text(one.get("text")).partition(": ")[0] for one in motion.get("stops") or ()]
    text = f"{doing}: {', '.join(stops)}" if stops else doing
    return f"{text}, {age(motion.get('age_s'))} ago" if motion.get("stale") else text


def _actual(motion: Document) -> str:
    """Return the speed; without one, whether it is 0, as far as the drive shows that."""
    if motion.get("speed"):
        return _speed(motion["speed"])
    zero = motion.get("zero")
    return "" if zero is None else "0" if zero else "not 0"


def _speed(speed: Document | None) -> str:
    """Return a speed with its unit, and its age where it is not fresh."""
    if not speed or speed.get("value") is None:
        return ""
    text = " ".join(filter(None, (table_text(speed["value"]), table_text(speed.get("unit")))))
    return f"{text}, {age(speed.get('age_s'))} ago" if speed.get("stale") else text


def _show_drive(drive: Document) -> None:
    name = table_text(drive.get("drive") or drive.get("name"))
    if on_terminal():
        why = _why(drive)
        state = table_text(drive.get("state")) + (f", {why}" if why else "")
        click.echo(f"{name} at address {drive.get('address')} ({drive.get('family')}): {state}")
        _show_identity(drive.get("identity") or {})
        _show_motion(drive.get("motion") or {})
        _show_states(drive.get("states"))
        _show_fault(drive.get("fault") or {})
    rows = [
        (
            code_of(value),
            table_text(value.get("name")),
            shown_value(value),
            table_text(value.get("unit")),
            quality,
            age(value.get("age_s")),
            reason,
        )
        for value in _listed(drive, "values")
        for quality, reason in [quality_of(value)]
    ]
    show_rows(("code", "name", "value", "unit", "quality", "age", "why"), rows)


def _show_motion(motion: Document) -> None:
    """Print whether it runs, and by which words that shows; nothing where it is not known."""
    shown = dict.fromkeys(word for one in motion.get("stops") or () for word in one["shown_by"])
    if motion.get("doing"):
        click.echo(f"  motor: {_motor(motion)}" + (f" [{', '.join(shown)}]" if shown else ""))


def _show_states(states: Sequence[str] | None) -> None:
    """Print what the status words show; nothing is printed while that is not known well."""
    if states is not None:
        named = ", ".join(state.replace("_", " ") for state in states)
        click.echo(f"  its status words show: {named or 'nothing of note'}")


def _show_fault(fault: Document) -> None:
    """Print what usually lies behind a fault and what to do; what it is stands in the remarks."""
    for key in ("cause", "remedy"):
        if fault.get(key):
            click.echo(f"  {key}: {fault[key]}")


def _show_identity(identity: Document) -> None:
    """Print the identity that a drive reports."""
    if identity:
        labels = ", ".join(f"{code} {table_text(text)}" for code, text in identity.items())
        click.echo(f"  it says of itself: {labels}")


def _why(one: Document) -> str:
    """Return the reason of a drive's or line's state and what else stands to be said about it."""
    remarks: Document = one.get("remarks") or {}
    parts = [table_text(one.get("reason")), *(table_text(text) for text in remarks.values())]
    return "; ".join(part for part in parts if part)
