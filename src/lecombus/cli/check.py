"""`lecombus check`: what is wrong with a roster, or what it means."""

from __future__ import annotations

import contextlib
import grp
import json
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import click

from lecombus.cli.arguments import json_option, roster_option
from lecombus.cli.document_rows import shown_code
from lecombus.cli.exits import Exit
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.client.finding import RUNTIME_DIR
from lecombus.config import RosterError, load_roster
from lecombus.config.building import STATE_DIR
from lecombus.config.describing import DescribedDrive, DescribedGroup, Description, describe
from lecombus.errors import OperationError
from lecombus.fieldbus.protocols import find
from lecombus.roster import ApiEntry, Roster, TlsEntry
from lecombus.tokens.token_file import read_tokens

__all__ = ["check_command", "pipe_rows"]

Reach = Callable[[int], Sequence[int]]
"""Gives the addresses that a multicast to an address reaches."""

COLUMNS = ("drive", "address", "family", "watchdog", "stop fallback", "cyclic reads")


@click.command("check")
@roster_option
@json_option
def check_command(roster: Path, as_json: bool) -> int:
    """List all mistakes of a roster, or show what the roster means.

    Mistakes go to standard error, one a line as FILE:LINE:COLUMN, and the exit status is 2.
    Without mistakes, the line, its drives, and the way in which stops and writes of each group
    are sent are shown, with warnings. No port is opened.

    In a pipe each line begins with what it is: line (text, share of it that cyclic reads take),
    drive (name, address, family, watchdog, stop fallback, cyclic reads), group (name, how stops
    go, how writes go, members), warning (text).

    With --json, on standard output: {"ok": false, "mistakes": [{"file", "line", "column", "what",
    "right"}]} or {"ok": true, "file", "line", "cyclic_load", "drives", "groups", "warnings"}.
    """
    try:
        loaded = load_roster(roster)
        description, reach = describe(loaded), find(loaded.line.protocol).group_reach
        warnings = (*description.warnings, *file_warnings(loaded))
        description = replace(description, warnings=warnings)
    except RosterError as exc:
        if not as_json:
            raise
        mistakes = [asdict(mistake) for mistake in exc.mistakes]
        click.echo(json.dumps({"ok": False, "mistakes": mistakes}, ensure_ascii=False))
        return Exit.USAGE
    if as_json:
        click.echo(json.dumps({"ok": True, **description.as_json()}, ensure_ascii=False))
    elif on_terminal():
        _show(description, reach)
    else:
        show_rows((), pipe_rows(description, reach))
    return Exit.DONE


def file_warnings(roster: Roster) -> Iterator[str]:
    """Warn of files that the daemon could not use if it were this user on this machine.

    They are not mistakes: the roster may be for another machine, and what this user may not read
    the daemon's may.
    """
    api, journal, state = roster.api, roster.journal, roster.state
    with contextlib.suppress(PermissionError):
        if text := socket_mistake(api):
            yield f"api.socket {api.socket}: {text}; `lecombus run` does not start with it"
    with contextlib.suppress(PermissionError):
        if api.tls is not None and (text := tls_mistake(api.tls)):
            yield f"api.tls: {text}; `lecombus run` does not start with it"
    with contextlib.suppress(PermissionError):
        if api.tokens is not None and (text := tokens_mistake(Path(api.tokens))):
            yield f"api.tokens {text}; until then TCP has no valid token"
    with contextlib.suppress(PermissionError):
        if journal is not None and (text := kept_mistake(Path(journal.file))):
            yield f"journal {journal.file}: {text}, so that it cannot be written"
    with contextlib.suppress(PermissionError):
        if state is not None and (text := kept_mistake(Path(state))):
            yield f"state {state}: {text}, so that nothing is kept"


def socket_mistake(api: ApiEntry) -> str:
    """Say why there can be no socket; empty: nothing that can be seen here."""
    path = Path(api.socket)
    found, folder = stat_of(path), stat_of(path.parent)
    if found is not None and not stat.S_ISSOCK(found.st_mode):
        return "something else has its place"
    if folder is None and path.parent != RUNTIME_DIR:  # that one is made when the service starts
        return f"there is no directory {path.parent}"
    if folder is not None and not stat.S_ISDIR(folder.st_mode):
        return f"{path.parent} is not a directory"
    if api.socket_group is not None:
        try:
            grp.getgrnam(api.socket_group)
        except KeyError:
            return f"there is no group {api.socket_group} (api.socket_group)"
    return ""


def tls_mistake(entry: TlsEntry) -> str:
    """Say what is wrong with certificate and key; empty: nothing that can be seen here."""
    from lecombus.api.tls import TlsFileError, context_of

    try:
        context_of(entry)
    except TlsFileError as exc:
        return "" if isinstance(exc.__cause__, PermissionError) else f"{exc} ({exc.remedy})"
    return ""


def tokens_mistake(path: Path) -> str:
    """Say what is wrong with the file of tokens; empty: nothing that can be seen here."""
    try:
        read_tokens(path, of_any_user=True)
    except OperationError as exc:
        return "" if isinstance(exc.__cause__, PermissionError) else f"{exc} ({exc.remedy})"
    if stat_of(path) is None:
        return f"{path}: there is no such file (make tokens by `lecombus token new`)"
    return ""


def kept_mistake(path: Path) -> str:
    """Say why there can be no such file; empty: nothing that can be seen here."""
    found, folder = stat_of(path), stat_of(path.parent)
    if found is not None and not stat.S_ISREG(found.st_mode):
        is_directory = stat.S_ISDIR(found.st_mode)
        return "this is a directory" if is_directory else "this is not a regular file"
    if folder is None and path.parent != STATE_DIR:  # that one is made when the service starts
        return f"there is no directory {path.parent}"
    if folder is not None and not stat.S_ISDIR(folder.st_mode):
        return f"{path.parent} is not a directory"
    return ""


def stat_of(path: Path) -> os.stat_result | None:
    """Return what the system knows of a file; None: there is none.

    Raises:
        PermissionError: This user may not know.
    """
    try:
        return path.stat()
    except PermissionError:
        raise
    except OSError:
        return None


def pipe_rows(description: Description, reach: Reach) -> list[tuple[str, ...]]:
    """Return the report for a pipe: rows whose first cell says what they are."""
    line = description.line.removeprefix("line ")
    return [
        ("line", line, f"{description.cyclic_load:.0%}"),
        *(("drive", *_row(one)) for one in description.drives),
        *(
            ("group", one.name, *_ways(one, reach), ", ".join(one.members))
            for one in description.groups
        ),
        *(("warning", text) for text in description.warnings),
    ]


def _show(description: Description, reach: Reach) -> None:
    """Print the report on a terminal."""
    title = f"{description.line}; cyclic reads take {description.cyclic_load:.0%} of it"
    show_rows(COLUMNS, map(_shown_row, description.drives), title=title)
    click.echo()
    rows = []
    for group in description.groups:
        stops, writes = _ways(group, reach)
        how = "the same" if group.how == group.writes else writes
        rows.append((group.name, stops, how, ", ".join(group.members)))
    show_rows(("group", "stops go as", "writes go as", "members"), rows)
    for text in map(_warning, description.warnings):
        click.echo(text)


def _row(drive: DescribedDrive) -> tuple[str, ...]:
    """Return the cells of `COLUMNS`."""
    return (
        drive.name, str(drive.address), drive.family, drive.watchdog, drive.stop_fallback,
        drive.cyclic,
    )  # fmt: skip


def _shown_row(drive: DescribedDrive) -> tuple[str, ...]:
    """Return the cells for people: cyclic reads by the codes that the keypad shows."""
    reads = (one.partition(" ") for one in drive.cyclic.split(", "))
    cyclic = (f"{shown_code(drive.family, code)}{space}{every}" for code, space, every in reads)
    return *_row(drive)[:-1], ", ".join(cyclic)


def _ways(group: DescribedGroup, reach: Reach) -> tuple[str, str]:
    """Say how stops and how other writes go to a group."""
    address = group.multicast_address
    return _way(group.how, address, reach), _way(group.writes, address, reach)


def _way(how: str, address: int | None, reach: Reach) -> str:
    """Say how a telegram goes to a group, and which drives a multicast reaches."""
    if how == "one-by-one" or address is None:
        return "one after another"
    reached = reach(address)
    return f"one multicast to {address:02d} (reaches every drive at {reached[0]} to {reached[-1]})"


def _warning(text: str) -> str:
    return f"warning: {text}"
