"""`lecombus journal`: what was done to the drives, what happened to them, and whether all is there.

The daemon is asked, never the file: it is locked while the daemon uses it.
"""

from __future__ import annotations

import csv
import json
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from difflib import get_close_matches
from itertools import chain, islice
from typing import Any, Final

import click

from lecombus.cli.arguments import DaemonOptions, WholeNumber, Word, daemon_options
from lecombus.cli.daemon_access import ask, show
from lecombus.cli.document_rows import Document, shown_code
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import on_terminal, printable, show_rows, table_text
from lecombus.durations import DurationError, parse_duration

__all__ = ["journal_command"]

HEADINGS: Final = ("time", "what", "drive", "outcome", "details")
CSV_FIELDS: Final = (
    "code", "value", "old", "verb", "action", "who", "uid", "pid", "process", "client", "token",
    "reason",
)  # fmt: skip
LAST_FIELDS: Final = ("who", "token", "uid", "process", "client", "reason")
HIDDEN_FIELDS: Final = ("pid",)
FORMULA: Final = re.compile(r"[=@]|[+-](?!\d+(\.\d+)?$)", re.ASCII)
"""A cell that begins so is a formula to a spreadsheet; a client may have chosen the text."""

ASKED: Final = "asked"
PAGE: Final = 500
LOOK_ROWS: Final = 20_000
FOLLOW_S: Final = 1.0


def _time(word: str) -> str:
    """Read a local date and time, or how long ago, as RFC 3339."""
    try:
        when = datetime.now(UTC) - timedelta(seconds=parse_duration(word))
    except OverflowError:
        raise click.BadParameter(f"{word} ago is before the year 1") from None
    except DurationError as exc:
        try:
            when = datetime.fromisoformat(word).astimezone(UTC)
        except (ValueError, OverflowError):  # a day that is none in UTC, or not in Unix time
            if "unknown unit" in exc.what:
                raise click.BadParameter(f"{word} {exc.what}: {exc.right}") from None
            right = 'write a date and time such as "2026-11-23 06:00", or how long ago, such as 8h'
            raise click.BadParameter(f"{word} is no time: {right}") from None
    return when.isoformat(timespec="milliseconds")


@click.group("journal", invoke_without_command=True)
@click.option("--since", type=Word("time", _time), help="From a local time on, or from 8h ago on.")
@click.option(
    "--last", type=WholeNumber(1, PAGE), help="So many of the newest lines; with --json rows."
)
@click.option("--drive", default="", help="Only the rows of a drive and its groups, or of a group.")
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV.")
@click.option("--follow", is_flag=True, help="Print new rows as they come, until Ctrl-C.")
@daemon_options
@click.pass_context
def journal_command(
    context: click.Context,
    daemon: DaemonOptions,
    since: str | None,
    last: int | None,
    drive: str,
    as_csv: bool,
    follow: bool,
) -> int:
    """Show who wrote what to which drive and how that ended, stops, trips, losses and starts.

    Without --since or --last: the newest 100 lines. What is under way is shown as `asked`, and once
    it has ended by its end alone; with --json both rows are printed, one JSON object a line.
    In a pipe: time, what, drive, outcome and details, separated by tabs.
    """
    if context.invoked_subcommand is not None:
        if since is not None or last is not None or drive or as_csv or follow:
            problem = f"{context.invoked_subcommand} has no options for rows"
            raise CommandError(Exit.USAGE, problem, "leave out the options before it")
        context.obj = daemon
        return Exit.DONE
    if since is not None and last is not None:
        raise CommandError(Exit.USAGE, "--since and --last are both given", "give one")
    if as_csv and daemon.as_json:
        raise CommandError(Exit.USAGE, "--csv and --json are both given", "give one")
    rows = _rows(daemon, since, last or 100, drive, follow=follow)
    if drive and not follow:
        first = list(islice(rows, 1))
        if not first:
            _say_if_unknown(daemon, drive)
        rows = chain(first, rows)
    families = _families(daemon) if on_terminal() and not daemon.as_json else {}
    if daemon.as_json:
        for row in rows:
            click.echo(json.dumps(row, ensure_ascii=False))
    elif as_csv:
        _write_csv(_ends(rows))
    elif follow or not on_terminal():
        for row in _ends(rows):
            click.echo("\t".join(_cells(row, families)))
            sys.stdout.flush()
    else:
        show_rows(HEADINGS, [_cells(row, families) for row in _ends(rows)])
    return Exit.DONE


@journal_command.command("verify")
@click.option("--head", default="", metavar="NUMBER:HASH", help="A head from the log.")
@daemon_options
@click.pass_obj
def verify_command(above: DaemonOptions, daemon: DaemonOptions, head: str) -> int:
    """Say whether no row was changed, removed or inserted.

    With --head the journal must also hold a row that was logged as `journal-head`: only that shows
    whether rows were removed at the end. Exit status 1: something is wrong.
    """
    daemon = daemon.behind(above)
    answer = ask(daemon, "/v1/journal/verify", **({"head": head} if head else {}))
    show(answer, _show_verified, as_json=daemon.as_json)
    return Exit.DONE if answer.data.get("whole") is True else Exit.FAILED


def _rows(
    daemon: DaemonOptions, since: str | None, last: int, drive: str, *, follow: bool
) -> Iterator[Document]:
    """Yield rows in their order; with `follow` new ones without end."""
    of = {"drive": drive} if drive else {}
    if since is None:
        page = _newest(daemon, last, of)
    else:
        page = ask(daemon, "/v1/journal", since=since, limit=str(PAGE), **of).data
    while True:
        yield from page["rows"]
        behind = page["next"]
        if behind is None:
            if not follow:
                return
            behind = int(str(page["head"]).partition(":")[0])
            time.sleep(FOLLOW_S)
        more = {"since": since} if since is not None and page["next"] is not None else {}
        page = ask(daemon, "/v1/journal", after=str(behind), limit=str(PAGE), **more, **of).data


def _families(daemon: DaemonOptions) -> Mapping[str, str]:
    """Return the drives' families, by name; a drive may have left the roster since."""
    try:
        drives = ask(daemon, "/v1/drives").data["drives"]
    except CommandError:  # the rows are shown all the same
        return {}
    return {one["drive"]: one["family"] for one in drives}


def _say_if_unknown(daemon: DaemonOptions, drive: str) -> None:
    """Say that the roster has no drive and no group of a name of which there are no rows.

    A name that was in the roster before is right all the same, so this is not an error.
    """
    try:
        groups = ask(daemon, "/v1/groups").data["groups"]
    except CommandError:
        return
    names = {name for one in groups for name in (one["group"], *one["members"])}
    if drive not in names:
        near = get_close_matches(drive, sorted(names), 1)
        hint = f"did you mean {near[0]}?" if near else f"they are: {', '.join(sorted(names))}"
        text = f"no row is about {drive}, and there is no drive and no group of that name; {hint}"
        click.echo(printable(text), err=True)


def _newest(daemon: DaemonOptions, last: int, of: Mapping[str, str]) -> Document:
    """Return a page of the newest rows: as many as are wanted, and are shown.

    Of an operation one of two rows is shown at least, so twice as many are always enough. The
    daemon looks at `LOOK_ROWS` at a time: those of a drive may stand far before these.
    """
    limit = last if daemon.as_json else min(PAGE, 2 * last)
    page: Document = ask(daemon, "/v1/journal", last="true", limit=str(limit), **of).data
    rows, least = list(page["rows"]), 0
    if len(rows) >= limit:
        if daemon.as_json:
            return page
        first = int(rows[0]["number"])
    elif of:  # rows that came while it looked may have moved where it began
        first = max(1, int(str(page["head"]).partition(":")[0]) - LOOK_ROWS + PAGE)
    else:
        first = 1
    if first > 1 and of:
        oldest = ask(daemon, "/v1/journal", after="0", limit="1").data["rows"]
        least = int(oldest[0]["number"]) - 1 if oldest else 0
    while len(shown := rows if daemon.as_json else list(_ends(rows))) < last and first > least + 1:
        behind = max(least, first - 1 - (LOOK_ROWS if of else PAGE))
        before = min(first, rows[0]["number"]) if rows else first
        rows = [*_between(daemon, behind, before, of), *rows]
        first = behind + 1
    return {**page, "rows": shown[-last:]}


def _between(
    daemon: DaemonOptions, behind: int, before: int, of: Mapping[str, str]
) -> Iterator[Document]:
    """Yield the rows behind one and before another."""
    while behind < before - 1:
        page = ask(daemon, "/v1/journal", after=str(behind), limit=str(PAGE), **of).data
        yield from (row for row in page["rows"] if row["number"] < before)
        if page["next"] is None:
            return
        behind = int(page["next"])


def _ends(rows: Iterable[Document]) -> Iterator[Document]:
    """Leave out what was asked where its end is a row too."""
    return (row for row in rows if row["outcome"] != ASKED or not row["ended"])


def _cells(row: Document, families: Mapping[str, str]) -> Sequence[str]:
    """Return the cells of a table's row; a code as the drive's keypad names it, for people."""
    fields: Document = row["fields"]
    if "code" in fields:
        fields = {**fields, "code": shown_code(families.get(row["drive"]), fields["code"])}
    local = datetime.fromisoformat(str(row["time"])).astimezone()
    when = local.replace(tzinfo=None).isoformat(" ", "milliseconds")
    cells = (when, row["what"], row["drive"], row["outcome"], _details(fields))
    return [printable(table_text(cell)) for cell in cells]


def _details(fields: Mapping[str, Any]) -> str:
    """Return fields as `key=value`, who asked and the reason last."""
    first = [key for key in fields if key not in (*LAST_FIELDS, *HIDDEN_FIELDS)]
    keys = (*first, *(key for key in LAST_FIELDS if key in fields))
    return " ".join(f"{key}={_quoted(str(fields[key]))}" for key in keys)


def _quoted(text: str) -> str:
    plain = text and not any(one.isspace() or one in '"=' for one in text)
    return text if plain else json.dumps(text, ensure_ascii=False)


def _write_csv(rows: Iterable[Document]) -> None:
    writer = csv.writer(sys.stdout)
    writer.writerow(("number", "time", "what", "drive", "outcome", *CSV_FIELDS, "more"))
    for row in rows:
        fields = row["fields"]
        more = {key: text for key, text in fields.items() if key not in CSV_FIELDS}
        named = (row[key] for key in ("number", "time", "what", "drive", "outcome"))
        cells = (*named, *(fields.get(key) for key in CSV_FIELDS), _details(more))
        writer.writerow([no_formula(table_text(cell)) for cell in cells])
        sys.stdout.flush()


def no_formula(text: str) -> str:
    """Return a text as a cell that a spreadsheet takes as it is."""
    return f"'{text}" if FORMULA.match(text) else text


def _show_verified(found: Document) -> None:
    rows = f"{found['rows']} rows, {found['first']} to {found['last']}"
    if found["whole"]:
        click.echo(f"whole: {rows}")
    else:
        click.echo(f"not whole: {found['problem']}")
        click.echo(f"right up to there: {rows}")
    click.echo(f"head {found['head']}")
