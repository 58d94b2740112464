"""`lecombus token`: makes, lists and revokes the tokens that requests over TCP carry.

It works on the file of tokens, not through a daemon; daemons read the file again when it changed.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

import click

from lecombus.cli.arguments import Word, json_option
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.durations import DurationError, parse_duration
from lecombus.tokens.grants import ALL_DRIVES, Scope
from lecombus.tokens.secret import digest_of, new_secret
from lecombus.tokens.token_file import (
    MOST_TOKENS,
    NAME,
    TokenEntry,
    Tokens,
    document_of,
    now_rounded,
    owners_for_root,
    read_tokens,
    write_tokens,
)

__all__ = ["token_command"]

DEFAULT_FILE: Final = "/etc/lecombus/tokens"
LONGEST: Final = timedelta(days=20 * 365)
SECRET_MODE: Final = 0o600
LOCK_S: Final = 5.0
"""Longer than any other command needs. Every user who may read the folder may lock it, and that
must not keep a token from being revoked."""
LOCK_LOOK_S: Final = 0.05


def _expiry(word: str) -> datetime:
    """Read when a token expires: after a time, or on a day."""
    now = now_rounded()
    try:
        if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", word, re.ASCII):
            at = datetime.strptime(word, "%Y-%m-%d").replace(tzinfo=UTC)
        elif re.fullmatch(r"[0-9]{1,5}d", word, re.ASCII):
            at = now + timedelta(days=int(word[:-1]))
        else:
            at = now + timedelta(seconds=parse_duration(word))
    except (DurationError, ValueError, OverflowError):
        right = "write a time such as 90d or 12h, or a day such as 2027-06-30"
        raise click.BadParameter(f"`{word}` is not a time, {right}") from None
    if not now < at <= now + LONGEST:
        raise click.BadParameter(f"{word} is in the past, or more than 20 years away")
    return at


EXPIRY: Final = Word("when", _expiry)


def _file_option(function: click.decorators.FC) -> click.decorators.FC:
    """Give a command `--file` and `-c`."""
    function = click.option(
        "--file",
        "file",
        type=click.Path(dir_okay=False, path_type=Path),
        envvar="LECOMBUS_TOKENS",
        help=f"The file of tokens; default: that of the roster, else {DEFAULT_FILE}.",
    )(function)
    return click.option(
        "-c",
        "--config",
        "roster",
        metavar="ROSTER",
        type=click.Path(dir_okay=False, path_type=Path),
        help="A roster whose `api.tokens` names the file; drives are looked up there too.",
    )(function)


@click.group("token")
def token_command() -> None:
    """Make, list and revoke the tokens that requests over TCP carry.

    Run it as root, or as who owns the file. A daemon reads the file again within two seconds after
    it changed; nothing needs a restart.
    """


@token_command.command("new")
@click.argument("name")
@click.option(
    "--scope",
    "scopes",
    type=click.Choice([scope.value for scope in Scope]),
    multiple=True,
    required=True,
    help="What it is for: metrics (the metrics page), read (with it), write (settings; also reads) "
    "or control (setpoints, enables, stops; also reads). May stand more than once.",
)
@click.option(
    "--for",
    "targets",
    metavar="TARGET",
    multiple=True,
    help="A drive or a group that it is for; may stand more than once. Default: all drives.",
)
@click.option("--expires", type=EXPIRY, help="When it ends: 90d, 12h, 2027-06-30. Default: never.")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the token into a new file that only you may read, instead of printing it.",
)
@_file_option
@json_option
def new_command(
    name: str,
    scopes: tuple[str, ...],
    targets: tuple[str, ...],
    expires: datetime | None,
    output: Path | None,
    file: Path | None,
    roster: Path | None,
    as_json: bool,
) -> int:
    """Make a token and print it once: it is stored nowhere.

    NAME stands in logs and in `token list`. In a pipe: the token alone.
    """
    path = _path(file, roster, targets)
    if re.fullmatch(NAME, name, re.ASCII) is None:
        raise CommandError(
            Exit.USAGE, f"`{name}` is not a name", "write 1 to 40 letters, digits or any of . _ - @"
        )
    if targets and ALL_DRIVES not in targets and set(scopes) == {Scope.METRICS}:
        problem = "the metrics page shows all drives, so a token for it alone is for all of them"
        raise CommandError(Exit.USAGE, problem, "leave out --for, or use --scope read")
    secret = new_secret()
    entry = TokenEntry(
        name=name,
        sha256=digest_of(secret),
        scopes=tuple(Scope(scope) for scope in dict.fromkeys(scopes)),
        targets=() if ALL_DRIVES in targets else tuple(dict.fromkeys(targets)),
        created=now_rounded(),
        expires=expires,
    )
    with _changing(path) as tokens:
        if tokens.named(name) is not None:
            problem = f"there is a token {name} already"
            raise CommandError(Exit.USAGE, problem, "revoke it first, or take another name")
        if len(tokens.entries) >= MOST_TOKENS:
            problem = f"{path} holds {MOST_TOKENS} tokens, which is the most"
            raise CommandError(Exit.FAILED, problem, "revoke some: `lecombus token list`")
        if output is not None:
            _write_secret(output, secret)
        try:
            write_tokens(path, [*tokens, entry])
        except BaseException:  # an interrupt too: the secret was never valid
            if output is not None:
                output.unlink(missing_ok=True)
            raise
    _show_secret(entry, secret, output, as_json=as_json)
    return Exit.DONE


@token_command.command("list")
@_file_option
@json_option
def list_command(file: Path | None, roster: Path | None, as_json: bool) -> int:
    """Show the tokens: who they are for, what they allow, until when. Never the tokens themselves.

    In a pipe: name, scopes, targets, created, expires, valid or expired.
    """
    path = _path(file, roster)
    tokens = read_tokens(path, owners=owners_for_root())
    if as_json:
        click.echo(json.dumps({"file": str(path), "tokens": [document_of(one) for one in tokens]}))
        return Exit.DONE
    rows = [_row(one) for one in tokens]
    if rows:
        show_rows(("name", "scopes", "for", "created", "expires", "state"), rows)
    elif on_terminal():
        click.echo(f"there is no token in {path}")
    return Exit.DONE


@token_command.command("revoke")
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@_file_option
@json_option
def revoke_command(
    names: tuple[str, ...], file: Path | None, roster: Path | None, as_json: bool
) -> int:
    """Revoke tokens by their names: requests with them are refused within two seconds."""
    path = _path(file, roster)
    with _changing(path) as tokens:
        missing = [name for name in names if tokens.named(name) is None]
        if missing:
            problem = f"there is no token {', '.join(missing)} in {path}; none was revoked"
            raise CommandError(Exit.USAGE, problem, "`lecombus token list` shows them")
        write_tokens(path, [one for one in tokens if one.name not in names])
    if as_json:
        click.echo(json.dumps({"file": str(path), "revoked": list(names)}))
    elif on_terminal():
        click.echo(f"revoked: {', '.join(names)}; daemons refuse it within two seconds")
    return Exit.DONE


def _path(file: Path | None, roster: Path | None, targets: tuple[str, ...] = ()) -> Path:
    """Return the file of tokens; drives and groups are looked up in the roster, if one is given."""
    if roster is None:
        return file or Path(DEFAULT_FILE)
    from lecombus.config import load_roster  # which takes a tenth of a second

    loaded = load_roster(roster)
    known = {*loaded.groups, *(drive.name for drive in loaded.drives)}
    unknown = [name for name in targets if name not in known]
    if unknown:
        problem = f"{roster} has no drive or group {', '.join(unknown)}"
        raise CommandError(Exit.USAGE, problem, f"they are {', '.join(sorted(known)[:20])}")
    if file is None and loaded.api.tokens is None:
        problem = f"{roster} has no `api.tokens`"
        raise CommandError(Exit.USAGE, problem, f"write `tokens: {DEFAULT_FILE}` under `api`")
    return file or Path(loaded.api.tokens or DEFAULT_FILE)


@contextmanager
def _changing(path: Path) -> Iterator[Tokens]:
    """Give the tokens of a file that no other command changes at the same time."""
    place = path.resolve().parent  # that of the file itself, whichever link names it
    folder = os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _lock(folder, place)
        yield read_tokens(path, owners=owners_for_root())
    finally:
        os.close(folder)


def _lock(folder: int, name: Path) -> None:
    """Wait for other commands that change a file in a folder; says so if that takes too long."""
    until_s = time.monotonic() + LOCK_S
    while True:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                click.echo(f"another process keeps {name} locked: changed all the same", err=True)
                return
            time.sleep(LOCK_LOOK_S)
        else:
            return


def _write_secret(path: Path, secret: str) -> None:
    """Write a token into a new file that only its owner may read."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    try:
        descriptor = os.open(path, flags, SECRET_MODE)
    except FileExistsError:
        problem = f"{path} exists already"
        raise CommandError(Exit.USAGE, problem, "name a new file, or delete this one") from None
    with os.fdopen(descriptor, "w") as file:
        file.write(f"{secret}\n")


def _show_secret(entry: TokenEntry, secret: str, output: Path | None, *, as_json: bool) -> None:
    if as_json:
        shown = {} if output is not None else {"token": secret}
        click.echo(json.dumps({**document_of(entry), **shown}))
        return
    if output is None:
        click.echo(secret)
    if on_terminal():
        where = "above; it is not shown again" if output is None else f"in {output}"
        click.echo(f"the token of {entry.name} is {where}", err=True)


def _row(entry: TokenEntry) -> tuple[str, ...]:
    state = "expired" if entry.is_expired(datetime.now(UTC).timestamp()) else "valid"
    scopes, targets = ", ".join(entry.scopes), ", ".join(entry.targets) or ALL_DRIVES
    expires = "never" if entry.expires is None else written(entry.expires)
    return entry.name, scopes, targets, written(entry.created), expires, state


def written(at: datetime) -> str:
    """Write a time of the file for people."""
    return at.astimezone(UTC).strftime("%Y-%m-%d %H:%MZ")
