"""One drive behind a daemon's HTTP API, as backups and restores ask for it.

Strategy: every refusal of the daemon becomes an answer with its stable word, so that `backups`
decides what may be asked again. A daemon that cannot be reached is such an answer too: it may be
restarting. A few reads are requested together, in the background class, so that the line finds the
next one waiting whenever it is idle; writes go one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import anyio

from lecombus.backups import SUPERSEDED, NotUsable, ReadAttempt, WriteAttempt
from lecombus.cli.daemon_access import command_errors, drive_path
from lecombus.cli.document_rows import kind_of
from lecombus.cli.exits import CommandError, Exit
from lecombus.client.documents import Document
from lecombus.client.line import Line
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Json, Value

__all__ = ["DriveOnLine", "HttpDrive", "RestorePermission"]

AT_ONCE: Final = 4
"""Enough that one is always waiting while another is on the line, and no crowd for others."""

WRITE_WITHIN_S: Final = 45
"""A write is not begun after so long, seconds: by then this client has given up."""

UNREACHABLE: Final = "unreachable"
GOOD: Final = ("done", "verified")
USABLE: Final = ("online", "degraded")
OFFLINE: Final = "offline"


@dataclass(frozen=True, slots=True)
class DriveOnLine:
    """Which drive this is.

    Args:
        drive: Its name.
        line: Its line's name.
        address: 1..99.
        family: Its family's name.
    """

    drive: str
    line: str
    address: int
    family: str


@dataclass(frozen=True, slots=True)
class RestorePermission:
    """Whether the daemon lets it be restored.

    Args:
        reason: Why not; empty when it does.
        remedy: What to do about it.
        owned: Codes that lecombus sets from the roster.
        stops: Changes with every stop of the drive.
    """

    reason: str
    remedy: str
    owned: tuple[Code, ...]
    stops: str = ""


class HttpDrive:
    """A drive behind a daemon.

    Args:
        line: The line, behind its daemon.
        drive: The drive's name.
        clock: Monotonic time, seconds.
        stops: As the restore rights have it: what is written ends with the next stop of the drive.

    Attributes:
        waited_s: How long the drive or its line was waited for, seconds.
    """

    def __init__(
        self,
        line: Line,
        drive: str,
        clock: Callable[[], float] = time.monotonic,
        *,
        stops: str = "",
    ) -> None:
        self._line = line
        self._name = drive
        self._clock = clock
        self.stops = stops
        self.waited_s = 0.0
        self._path = drive_path(drive)

    # ---- who it is --------------------------------------------------------------------------

    async def ask_which(self) -> DriveOnLine:
        """Ask which drive this is.

        Raises:
            CommandError: There is no such drive, or no daemon.
        """
        line = await self._ask("/v1/line")
        drive = await self._ask(self._path)
        return DriveOnLine(
            self._name, str(line["line"]), int(drive["address"]), str(drive["family"])
        )

    async def restore_rights(self) -> RestorePermission:
        """Ask whether it may be restored.

        Raises:
            CommandError: There is no such drive, or no daemon.
        """
        said = await self._ask(f"{self._path}/restore")
        reason = "" if said["permitted"] else str(said["reason"])
        owned = tuple(Code.parse(code) for code in said["owned"])
        return RestorePermission(
            reason, str(said["remedy"] or ""), owned, str(said.get("stops") or "")
        )

    # ---- what backups ask -------------------------------------------------------------------

    async def read(self, code: Code) -> ReadAttempt:
        """Read a code when the line is idle."""
        try:
            path = f"{self._path}/codes/{code}"
            said = await self._ask(path, fresh="true", priority="background")
            return ReadAttempt(code, Value.parse(str(said["raw"])))
        except CommandError as exc:
            kind, text = why(exc)
            return ReadAttempt(code, None, kind, text)
        except CodeValueError as exc:
            return ReadAttempt(code, None, "garbled", str(exc))

    async def read_many(self, codes: Sequence[Code], heard: Callable[[ReadAttempt], None]) -> None:
        """Read codes, a few at a time."""
        rest = iter(codes)

        async def one_after_the_other() -> None:
            for code in rest:
                heard(await self.read(code))

        async with anyio.create_task_group() as tasks:
            for _ in range(AT_ONCE):
                tasks.start_soon(one_after_the_other)

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        """Write a code as part of a restore."""
        document: dict[str, Json] = {
            "value": value.raw, "verify": verify, "priority": "background", "restore": True,
            "expires": f"{WRITE_WITHIN_S}s",
        }  # fmt: skip
        return await self._act("PUT", f"{self._path}/codes/{code}", document | self._ended_by())

    async def inhibit(self) -> WriteAttempt:
        """Inhibit it by a stop, which goes first and does not end what is written later.

        If another client stopped the drive since the mark was taken, this counts as stopped too.
        """
        said = await self._act("POST", "/v1/stop", {"action": "inhibit", "target": self._name})
        try:
            before, self.stops = self.stops, (await self.restore_rights()).stops
        except CommandError as exc:
            kind, text = why(exc)
            return WriteAttempt(False, kind, text)
        if stops_between(before, self.stops) > 1:
            return WriteAttempt(
                False, SUPERSEDED, f"{self._name} was also stopped by another client"
            )
        return said

    async def enable(self) -> WriteAttempt:
        """Lift the inhibit, unless it was stopped since; C0040 must be writable by the roster."""
        document: dict[str, Json] = {"value": 1, "verify": True}
        return await self._act("PUT", f"{self._path}/codes/C0040", document | self._ended_by())

    def _ended_by(self) -> dict[str, Json]:
        return {"stops": self.stops} if self.stops else {}

    async def why_not_usable(self) -> NotUsable | None:
        """Say why it cannot be asked just now; None when it can."""
        try:
            line = await self._ask("/v1/line")
            drive = await self._ask(self._path)
        except CommandError as exc:
            if exc.status is not Exit.UNREACHABLE:
                raise
            return NotUsable(why(exc)[1])
        if line["state"] != "open":
            reason = line["reason"] or "no reason given"
            return NotUsable(f"line {line['line']} is {line['state']}: {reason}")
        if drive["state"] not in USABLE:
            reason = f": {drive['reason']}" if drive["reason"] else ""
            text = f"{self._name} is {drive['state']}{reason}"
            return NotUsable(text, is_offline=drive["state"] == OFFLINE)
        return None

    async def pause(self, for_s: float) -> None:
        """Let time pass, seconds."""
        await anyio.sleep(for_s)
        self.waited_s += for_s

    def now_s(self) -> float:
        """Give monotonic time, seconds."""
        return self._clock()

    # ---- HTTP -------------------------------------------------------------------------------

    async def _act(self, method: str, path: str, document: Mapping[str, Json]) -> WriteAttempt:
        try:
            with command_errors():
                said = self._object((await self._line.act(method, path, document)).data)
        except CommandError as exc:
            kind, text = why(exc)
            return WriteAttempt(False, kind, text)
        if said.get("outcome") in GOOD:
            return WriteAttempt(True)
        parts = [said.get(key) for key in ("reason", "detail", "cause", "remedy")]
        text = "; ".join(dict.fromkeys(str(part) for part in parts if part))
        return WriteAttempt(False, kind_of(said) or str(said.get("outcome")), text)

    async def _ask(self, path: str, **params: str) -> Document:
        with command_errors():
            return self._object((await self._line.ask(path, **params)).data)

    def _object(self, data: Any) -> Document:
        if isinstance(data, dict):
            return data
        problem = f"what answers at {self._line.where} is not lecombus"
        raise CommandError(Exit.UNREACHABLE, problem, "look at the path")


def stops_between(before: str, after: str) -> int:
    """Return how many stops lie between two marks, which end in their number; 0: not known."""
    run, _, first = before.rpartition("-")
    other, _, last = after.rpartition("-")
    is_known = run == other and first.isdecimal() and last.isdecimal()
    return int(last) - int(first) if is_known else 0


def why(exc: CommandError) -> tuple[str, str]:
    """Give the stable word and the text of an error."""
    problem = exc.problems[0]
    kind = UNREACHABLE if exc.status is Exit.UNREACHABLE else problem.kind
    return kind or "refused", str(problem)
