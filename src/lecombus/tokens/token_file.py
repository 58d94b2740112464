"""The file of tokens: names, digests, scopes, targets, times; never a token itself.

One JSON document, written again as a whole: a reader finds the old one or the new one. Only its
owner may write it, and its owner is root or the user that reads it: another user who may write it
could make a token for everything. A file that breaks one of these rules, or is no such document, is
refused as a whole.

Times are those of the computer's clock (Unix seconds in the program, RFC 3339 in the file).
"""

from __future__ import annotations

import grp
import hmac
import json
import os
import pwd
import stat
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from lecombus.errors import OperationError
from lecombus.tokens.grants import Grant, Scope, granted
from lecombus.tokens.secret import digest_of, is_well_formed

__all__ = [
    "MOST_TOKENS",
    "NAME",
    "TokenEntry",
    "Tokens",
    "document_of",
    "now_rounded",
    "owners_for_root",
    "read_tokens",
    "write_tokens",
]

VERSION: Final = 1
LARGEST: Final = 256 * 1024
"""Bytes of a file that is read."""

MOST_TOKENS: Final = 100
"""Each request is compared with all of them."""

NAME: Final = r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,39}"
"""A token's name: it stands in logs and in the journal."""

MODE: Final = 0o640
DAEMON: Final = "lecombus"
"""The daemon's user, and its group, where root writes the file."""


class TokenEntry(BaseModel):
    """One token, without its secret.

    Args:
        name: Who or what uses it.
        sha256: Digest of the secret, in hexadecimal.
        scopes: What it is for.
        targets: Drives and groups; none: all.
        created: When it was made.
        expires: From when it is not valid; None: it does not expire.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=f"^{NAME}$")]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    scopes: Annotated[tuple[Scope, ...], Field(min_length=1)]
    targets: tuple[Annotated[str, Field(min_length=1, max_length=64)], ...] = ()
    created: datetime
    expires: datetime | None = None

    @field_validator("created", "expires")
    @classmethod
    def _zoned(cls, value: datetime | None) -> datetime | None:
        if value is not None and value.tzinfo is None:
            raise ValueError("a time needs its zone, such as Z")
        return value

    @property
    def grant(self) -> Grant:
        """What it allows."""
        return granted(self.scopes, self.targets)

    def is_expired(self, now_s: float) -> bool:
        """Return whether its time is over at a time of the wall clock, Unix seconds."""
        return self.expires is not None and now_s >= self.expires.timestamp()


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    version: Annotated[int, Field(ge=1, le=VERSION)]
    tokens: Annotated[tuple[TokenEntry, ...], Field(max_length=MOST_TOKENS)]

    @field_validator("tokens")
    @classmethod
    def _differ(cls, value: tuple[TokenEntry, ...]) -> tuple[TokenEntry, ...]:
        for kind in ("name", "sha256"):
            if len({getattr(one, kind) for one in value}) < len(value):
                raise ValueError(f"two tokens have the same {kind}")
        return value


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a file.

    Args:
        entries: The tokens, in the order of the file.
    """

    entries: tuple[TokenEntry, ...] = ()

    def __iter__(self) -> Iterator[TokenEntry]:
        """Give the tokens in order."""
        return iter(self.entries)

    def find(self, secret: str, now_s: float) -> TokenEntry | None:
        """Return the valid token with a secret; the time that takes says nothing about secrets.

        Args:
            secret: What a client sent.
            now_s: The wall clock, Unix seconds.
        """
        if not is_well_formed(secret):
            return None
        digest, found = digest_of(secret), None
        for entry in self.entries:
            if hmac.compare_digest(entry.sha256, digest):
                found = entry
        return None if found is None or found.is_expired(now_s) else found

    def holds(self, entry: TokenEntry, now_s: float) -> bool:
        """Return whether a token that was valid still is, with the same rights."""
        return entry in self.entries and not entry.is_expired(now_s)

    def named(self, name: str) -> TokenEntry | None:
        """Return the token of a name."""
        return next((one for one in self.entries if one.name == name), None)


def read_tokens(path: Path, *, of_any_user: bool = False, owners: Collection[int] = ()) -> Tokens:
    """Return the tokens of a file; none if there is no file.

    Args:
        path: The file.
        of_any_user: It may belong to another user than root and that of this process: the
            daemon's is not known here.
        owners: Users that it may belong to besides.

    Raises:
        OperationError: `tokens`: it cannot be read, others may write it, or it is not such a file.
    """
    try:
        data = _read(path, None if of_any_user else {0, os.geteuid(), *owners})
    except FileNotFoundError:
        return Tokens()
    except OSError as exc:
        remedy = "let the daemon's user read it: owner root, group lecombus, mode 0640"
        raise refused(path, f"it cannot be read ({exc.strerror})", remedy) from exc
    try:
        found = json.loads(data)
        version = found.get("version") if isinstance(found, dict) else None
        if type(version) is int and version > VERSION:  # its keys are not known here
            what = f"it has version {version}, and this lecombus knows {VERSION}"
            raise refused(path, what, "install the lecombus that wrote it, or a later one")
        return Tokens(_Document.model_validate(found).tokens)
    except ValidationError as exc:
        first = exc.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the document"
        raise refused(path, f"{where}: {first['msg']}", "make tokens by `lecombus token`") from None
    except (ValueError, RecursionError) as exc:
        raise refused(path, f"it is no JSON ({exc})", "make tokens by `lecombus token`") from None


def owners_for_root() -> set[int]:
    """Return the daemon's user if root asks: root may change the file that the daemon reads."""
    if os.geteuid() != 0:
        return set()
    try:
        return {pwd.getpwnam(DAEMON).pw_uid}
    except KeyError:
        return set()


def _read(path: Path, owners: Collection[int] | None) -> bytes:
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise refused(path, "it is not a regular file", "name the file of tokens")
        if found.st_mode & 0o022:
            mode = f"its mode is {stat.S_IMODE(found.st_mode):04o}"
            raise refused(path, f"others may write it: {mode}", f"chmod 0640 {path}")
        if owners is not None and found.st_uid not in owners:
            what = f"it belongs to user {found.st_uid}"
            raise refused(path, what, f"give it to root or to the daemon's user: chown root {path}")
        data = file.read(LARGEST + 1)
    if len(data) > LARGEST:
        raise refused(path, f"it is longer than {LARGEST} bytes", "make tokens by `lecombus token`")
    return data


def refused(path: Path, what: str, remedy: str) -> OperationError:
    """Return the error for a file that is not used."""
    return OperationError(f"{path}: the tokens are not used: {what}", kind="tokens", remedy=remedy)


def write_tokens(path: Path, tokens: Sequence[TokenEntry]) -> None:
    """Write a file of tokens again, as a whole; owner, group and mode stay as they were.

    A link to a file stays one: what it leads to is written, for a daemon may name that. A new file
    has mode 0640, and where root makes it the group `lecombus` if there is one.

    Raises:
        OSError: It cannot be written; the old file is there as before.
    """
    document = _Document(version=VERSION, tokens=tuple(tokens))
    text = json.dumps(document.model_dump(mode="json"), indent=1) + "\n"
    place = path.resolve() if path.exists() else path
    mode, owner, group = _kept(place)
    descriptor, name = tempfile.mkstemp(prefix=f".{place.name}.", dir=place.parent)
    try:
        with os.fdopen(descriptor, "w") as file:
            if os.geteuid() == 0 or group in os.getgroups():
                os.fchown(descriptor, owner, group)
            os.fchmod(descriptor, mode)
            file.write(text)
            file.flush()
            os.fsync(descriptor)
        Path(name).replace(place)
    except BaseException as exc:  # an interrupt too: the file beside it holds digests
        Path(name).unlink(missing_ok=True)
        if isinstance(exc, OSError) and not exc.filename:
            exc.filename = str(path)  # a full disk does not name it
        raise
    _sync_folder(place.parent)


def _kept(path: Path) -> tuple[int, int, int]:
    """Return mode, owner and group for the file; -1: as they come."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return MODE, -1, _group()
    return stat.S_IMODE(found.st_mode) & ~0o022 & 0o777, found.st_uid, found.st_gid


def _group() -> int:
    if os.geteuid() != 0:
        return -1
    try:
        return grp.getgrnam(DAEMON).gr_gid
    except KeyError:
        return -1


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def now_rounded() -> datetime:
    """Return the time now in whole seconds, as it stands in the file."""
    return datetime.now(UTC).replace(microsecond=0)


def document_of(entry: TokenEntry) -> dict[str, Any]:
    """Return what is shown of a token: all but its digest."""
    document = entry.model_dump(mode="json")
    del document["sha256"]
    return document
