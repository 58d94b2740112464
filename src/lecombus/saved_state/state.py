"""What is kept of each drive, its form in the file, and the file: there is always a good one.

`State` is plain mutable facts that their owner changes in place and reports by `touch`. The form on
disk is made and read here alone, and is checked as strictly as a roster, because the file is a
border: a person or a failing disk may have changed it.

`StateFile` is read once and written whole: the new content goes to a neighbour of the file, is
brought to the disk (fsync), takes the file's name, and the folder is brought to the disk as well. A
file of an older version is read as one of this version, and kept beside it. A damaged file is never
overwritten: it is set aside under its own name with `.damaged` and a number, and said. A file of a
later version is left alone, and nothing is kept then; so is what is not a regular file. Where the
path is a link, all this is done where it leads, also when there is nothing yet, and the link stays
a link; it is checked again each time.

Only regular files are opened, never a pipe, a device or a folder. Opening never waits: a pipe
without a reader would block open() without end, and a device that is given another name
(`/dev/full`, as root) is gone for all other programs.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import stat
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from lecombus.parameters import Json

__all__ = [
    "VERSION",
    "DriveFacts",
    "LastEnable",
    "Moved",
    "NewerStateError",
    "State",
    "StateFile",
    "StateFormatError",
    "open_regular",
]

VERSION: Final = 1

STEPS: Final[Mapping[int, Callable[[dict[str, Any]], dict[str, Any]]]] = {}
"""By version: what makes a document of it one of the next version. Version 1 is the first."""

FORMER_MOST: Final = 100
"""Drives remembered that are not in the roster now: a typing error must not cost their counts."""

Count = Annotated[int, Field(ge=0)]


def _plain(text: str) -> str:
    """Refuse what no drive says and what would steer a terminal."""
    if not text.isprintable():
        raise ValueError("a control character")
    return text


PlainText = Annotated[str, AfterValidator(_plain)]


class StateFormatError(ValueError):
    """The text is not a state file."""


class NewerStateError(ValueError):
    """A later lecombus wrote it: nothing of it is touched."""


@dataclass(slots=True)
class Moved:
    """A drive was given another address than the roster says.

    Args:
        address: The address it was given.
        at: When, RFC 3339.
        confirmed: It was found there; else it was found nowhere.
    """

    address: Annotated[int, Field(ge=1, le=99)]
    at: PlainText
    confirmed: bool


@dataclass(frozen=True, slots=True)
class LastEnable:
    """The last enable of a drive, where it was refused or taken back.

    Args:
        at: When it ended, RFC 3339.
        address: The address that the drive had then.
        family: The family that it had then.
        outcome: `refused` or `unknown`.
        taken_back: The drive took it, did not show it, and was stopped again.
        reason: What happened.
        cause: Why, probably.
        remedy: What to do.
        by_drive: The drive refused or ignored it; else a setting kept it from being sent.
        stopped_since: The drive was stopped on purpose after it.
    """

    at: PlainText
    address: Count
    family: PlainText
    outcome: PlainText
    taken_back: bool
    reason: PlainText
    cause: PlainText
    remedy: PlainText
    by_drive: bool
    stopped_since: bool = False

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "time": self.at,
            "outcome": self.outcome,
            "taken_back": self.taken_back,
            "reason": self.reason or None,
            "cause": self.cause or None,
            "remedy": self.remedy or None,
        }


@dataclass(slots=True)
class DriveFacts:
    """What is kept of one drive.

    Args:
        identity: What it said of itself when it was accepted, by code.
        accepted_at: When that was, RFC 3339; empty before.
        writes: Writes that may have reached its memory, by code, never reset.
        writes_before: The same when the present device was accepted in place of another.
        moved: Where it was moved to, as long as the roster says otherwise.
        last_enable: The last enable, where it failed and none succeeded since.
    """

    identity: dict[PlainText, PlainText] = field(default_factory=dict)
    accepted_at: PlainText = ""
    writes: dict[PlainText, Count] = field(default_factory=dict)
    writes_before: dict[PlainText, Count] = field(default_factory=dict)
    moved: Moved | None = None
    last_enable: LastEnable | None = None


@dataclass(slots=True)
class _Document:
    version: int
    drives: dict[str, DriveFacts]
    lease_number: Count = 0


_ADAPTER: Final = TypeAdapter(_Document)


class State:
    """Everything kept of one line's drives.

    Args:
        drives: The facts by the drives' names.
        lease_number: The largest number of a lease so far; none is used twice.
        version: Of the file that it was read from.

    Attributes:
        counted: Called for each write that was counted: drive, code and the count now.
        saver: Puts what changed on disk; None where nothing is kept.
    """

    def __init__(
        self,
        drives: dict[str, DriveFacts] | None = None,
        lease_number: int = 0,
        version: int = VERSION,
    ) -> None:
        self.lease_number = lease_number
        self.version = version
        self._drives = drives if drives is not None else {}
        self.changes = 0
        self.counted: Callable[[str, str, int], None] | None = None
        self.saver: Callable[[], Awaitable[None]] | None = None

    def drive(self, name: str) -> DriveFacts:
        """Return what is kept of a drive; empty facts for one that is new."""
        return self._drives.setdefault(name, DriveFacts())

    def count(self, drive: str, code: str) -> None:
        """Count a write that may have reached a drive's memory."""
        writes = self.drive(drive).writes
        writes[code] = writes.get(code, 0) + 1
        self.touch()
        if self.counted is not None:
            self.counted(drive, code, writes[code])

    def touch(self) -> None:
        """Say that something was changed, so that it is written."""
        self.changes += 1

    async def save_now(self) -> None:
        """Put what changed on disk before what follows is done, unless the disk hangs or fails."""
        if self.saver is not None:
            await self.saver()

    def bound(self, names: Iterable[str]) -> None:
        """Drop the facts of the drives that left the roster longest ago, beyond a hundred.

        Args:
            names: The drives of the roster.
        """
        present = set(names)
        for name in present & self._drives.keys():
            self._drives[name] = self._drives.pop(name)  # to the end: the latest in the roster
        former = [name for name in self._drives if name not in present]
        for name in former[: max(0, len(former) - FORMER_MOST)]:
            del self._drives[name]
            self.touch()

    def text(self) -> str:
        """Return the file's content."""
        drives = {name: asdict(facts) for name, facts in self._drives.items()}
        document: dict[str, object] = {"version": VERSION, "drives": drives}
        if self.lease_number:
            document["lease_number"] = self.lease_number
        return json.dumps(document, indent=1, ensure_ascii=False)

    @classmethod
    def parse(cls, text: bytes) -> State:
        """Read a file's content.

        Raises:
            NewerStateError: A later version wrote it.
            StateFormatError: It is not a state file.
        """
        version, text = _as_of_now(text)
        try:
            document = _ADAPTER.validate_json(text, strict=True)
        except ValidationError as exc:
            _refuse_newer(text)
            first = exc.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "the whole"
            raise StateFormatError(f"{place}: {first['msg']}") from exc
        if document.version != VERSION:
            _refuse_newer(text)
            raise StateFormatError(f"version: {document.version} was never written")
        return cls(document.drives, document.lease_number, version)


def _as_of_now(text: bytes) -> tuple[int, bytes]:
    """Return the version of a file's content, and the content in the form of this version."""
    try:
        document = json.loads(text)
        version = document["version"]
    except (ValueError, TypeError, LookupError, RecursionError):
        return VERSION, text
    if type(version) is not int or version not in STEPS:
        return VERSION, text
    for number in range(version, VERSION):
        try:
            document = STEPS[number](document) | {"version": number + 1}
        except (TypeError, ValueError, LookupError, AttributeError):
            return VERSION, text  # it is damaged, and is refused as such
    return version, json.dumps(document).encode()


def _refuse_newer(text: bytes) -> None:
    """Return whether it is a file of a later version, not a damaged one."""
    try:
        version = json.loads(text)["version"]
    except (ValueError, TypeError, KeyError, LookupError, RecursionError):
        return
    if isinstance(version, int) and version > VERSION:
        raise NewerStateError(
            f"it is of version {version}, this lecombus knows {VERSION}; install the lecombus that "
            "wrote it, or name another file by `state:`"
        )


MODE: Final = 0o640

NO_FILE: Final = "Not a regular file"

LARGEST: Final = 8 * 1024 * 1024
"""Bytes; 90 drives with a hundred codes each take under one."""

SET_ASIDE_MOST: Final = 9
"""Damaged files kept; then the last one is replaced."""


class StateFile:
    """One state file.

    Args:
        path: Where it is; None: nothing is kept.

    Attributes:
        trouble: What was wrong with it when it was read; empty when all was well.
        is_usable: False where it must not be written at all.
        kept: The copy of the file of an older version that was read; empty: it was not.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.trouble = ""
        self.is_usable = path is not None
        self.kept = ""

    def load(self) -> State:
        """Read it; every error ends in `trouble`, never in an exception."""
        if self.path is None:
            return State()
        try:
            return self._read(self.path)
        except NewerStateError as exc:
            self.is_usable = False
            self.trouble = f"{self.name} is not used and not changed: {exc}"
        except StateFormatError as exc:
            self._set_aside(self.target, str(exc))
        except FileNotFoundError:
            self._look_at_folder(self.target.parent)
        except OSError as exc:
            self.is_usable = False
            self.trouble = f"{self.name} cannot be read: {exc.strerror}"
        return State()

    @property
    def target(self) -> Path:
        """The file itself, where the path leads now."""
        assert self.path is not None
        return Path(os.path.realpath(self.path))

    @property
    def name(self) -> str:
        """The file as messages name it: with where a link leads."""
        if self.path is None or not self.path.is_symlink():
            return str(self.path)
        return f"{self.path}, a link to {self.target},"

    def save(self, text: str) -> None:
        """Put new content in the place of the old; blocks for as long as the disk takes.

        Raises:
            OSError: It could not be written; the old file is as it was.
        """
        target = self.target
        neighbour = target.with_name(f".{target.name}.new")
        check_regular(target)
        descriptor = open_regular(neighbour, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        check_regular(target)
        neighbour.replace(target)
        folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _look_at_folder(self, folder: Path) -> None:
        """Report now what the first attempt to write would report later."""
        if not folder.is_dir():
            self.is_usable = False
            self.trouble = (
                f"{folder}{self._led_by_link} does not exist, nothing is kept: make it and "
                "restart, or name another file by `state:` in the roster"
            )
        elif not os.access(folder, os.W_OK | os.X_OK):
            self.is_usable = False
            self.trouble = (
                f"{folder}{self._led_by_link} may not be written to, nothing is kept: give it to "
                "the user that lecombus runs as (a service also needs it in `ReadWritePaths=`) and "
                "restart, or name another file by `state:` in the roster"
            )

    @property
    def _led_by_link(self) -> str:
        """Why a folder is meant that the roster does not name."""
        assert self.path is not None
        return f", where {self.path} leads," if self.path.is_symlink() else ""

    def _read(self, path: Path) -> State:
        with os.fdopen(open_regular(path, os.O_RDONLY), "rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise StateFormatError("it is far too large")
        state = State.parse(data)
        if state.version != VERSION:
            self._keep(data, state.version)
            state.touch()
        return state

    def _keep(self, data: bytes, version: int) -> None:
        """Keep the file of an older version beside the one that will take its place.

        Raises:
            OSError: It cannot be written.
        """
        kept = self.target.with_name(f"{self.target.name}.version-{version}")
        if not kept.exists():
            neighbour = kept.with_name(f".{kept.name}.new")
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
            with os.fdopen(open_regular(neighbour, flags), "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            neighbour.replace(kept)
        self.kept = str(kept)

    def _set_aside(self, path: Path, why: str) -> None:
        names = [path.with_name(f"{path.name}.damaged-{n}") for n in range(1, SET_ASIDE_MOST + 1)]
        aside = next((name for name in names if not name.exists()), names[-1])
        try:
            path.replace(aside)
        except OSError as exc:
            self.is_usable = False
            self.trouble = (
                f"{self.name} is damaged ({why}) and cannot be set aside: {exc.strerror}; it is "
                "not used and not changed"
            )
            return
        self.trouble = (
            f"{self.name} was damaged ({why}) and is {aside.name} now: the drives' "
            "identities are recorded again and write counts start at 0; delete it when it is of no "
            "use"
        )


def open_regular(path: Path, flags: int) -> int:
    """Open a file and give its descriptor.

    Raises:
        OSError: It cannot be opened, or is not a regular file.
    """
    with contextlib.suppress(FileNotFoundError):
        _refuse(path, path.stat().st_mode)  # opening alone does something to some devices
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, MODE)
    try:
        _refuse(path, os.fstat(descriptor).st_mode)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def check_regular(path: Path) -> None:
    """See that a place is free or holds a regular file, before its name is given to another.

    Raises:
        OSError: Something else stands there.
    """
    with contextlib.suppress(FileNotFoundError):
        _refuse(path, path.lstat().st_mode)


def _refuse(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, NO_FILE, str(path))
