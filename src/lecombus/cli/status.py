"""`lecombus status`: the line and its drives, or one drive with its values."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect
from lecombus.cli.exits import Exit
from lecombus.cli.reports import Document, code_of, quality_of, shown_value
from lecombus.cli.screen import age, on_terminal, show_rows, table_text

__all__ = ["command"]


@click.command("status")
@click.argument("drive", required=False)
@daemon_options
def command(drive: str | None, socket: str | None, url: str | None, as_json: bool) -> int:
    """Show the line and all its drives, or DRIVE with every value that is known of it.

    Nothing is sent to the line. In a pipe: first the line (the word `line`, name, state, reason),
    then one line a drive (drive, address, family, state, reason); or one a value (code, name,
    value, unit, quality, age, reason; quality `once`: not asked for again). With --json: {"line":
    .., "drives": ..}, the daemon's documents, or with DRIVE the drive's document.
    """
    with connect(socket, url) as daemon:
        if drive:
            answer = daemon.get(f"/v1/drives/{quote(drive, safe='')}")
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
    rows = [
        (
            table_text(drive.get("drive") or drive.get("name")),
            table_text(drive.get("address")),
            table_text(drive.get("family")),
            table_text(drive.get("state")),
            _why(drive).replace(f"line {state}: {line.get('reason')}", f"line {state}"),
        )
        for drive in drives
    ]
    show_rows(("drive", "address", "family", "state", "why"), rows)


def _show_drive(drive: Document) -> None:
    name = table_text(drive.get("drive") or drive.get("name"))
    if on_terminal():
        why = _why(drive)
        state = table_text(drive.get("state")) + (f", {why}" if why else "")
        click.echo(f"{name} at address {drive.get('address')} ({drive.get('family')}): {state}")
        _show_identity(drive.get("identity") or {})
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
    """Say who a drive is, by its own word."""
    if identity:
        told = ", ".join(f"{code} {table_text(text)}" for code, text in identity.items())
        click.echo(f"  it says of itself: {told}")


def _why(one: Document) -> str:
    """Return the reason of a drive's or line's state and what else stands to be said about it."""
    remarks: Document = one.get("remarks") or {}
    parts = [table_text(one.get("reason")), *(table_text(text) for text in remarks.values())]
    return "; ".join(part for part in parts if part)
