"""A line of drives behind a running daemon: what a program asks and what it has done.

Strategy: `connect` gives a `Line`; `Line.drive` and `Line.group` give objects that hold no more
than a name. Reads raise an error when there is no value to give. Writes, verbs and stops give a
result with an outcome, also when lecombus or the drive refuses; they raise an error only when
nothing can have been sent because the daemon is not there, or the request itself is wrong.

What must not live here: HTTP (`connection`), what documents mean (`documents`, `results`).
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final, Literal, TypeVar

from lecombus.client.connection import (
    ANSWER_WITHIN_S,
    REPEAT_FOR_S,
    AnswerLostError,
    Connection,
    Json,
    open_connection,
    problem_error,
)
from lecombus.client.documents import (
    Answer,
    Document,
    DriveStatus,
    GroupInfo,
    LineStatus,
    Reading,
    Why,
)
from lecombus.client.finding import find_daemon
from lecombus.client.requests import (
    ValueToWrite,
    code_text,
    expires_document,
    path_of,
    write_document,
)
from lecombus.client.results import GroupResult, Outcome, Result, VerbResult, WriteResult

__all__ = ["Drive", "Group", "Line", "StopAction", "connect"]

StopAction = Literal["quick-stop", "inhibit"]
"""Along the drive's ramp, or without torque: the motor coasts."""

WRONG_REQUESTS: Final = frozenset((400, 401, 404, 405, 413, 414, 421, 422, 431))
"""HTTP statuses that say that the request is wrong, however often it is sent."""

R = TypeVar("R", bound=Result)


@asynccontextmanager
async def connect(
    socket: str | None = None,
    url: str | None = None,
    *,
    token_file: str | Path | None = None,
    ca: str | Path | None = None,
    certificate: str | Path | None = None,
    answer_within_s: float = ANSWER_WITHIN_S,
    repeat_for_s: float = REPEAT_FOR_S,
) -> AsyncIterator[Line]:
    """Connect to the daemon of a line.

    Args:
        socket: The path of its Unix socket.
        url: Its HTTP address, such as `https://hall-3.example:9740`. None for both: what
            LECOMBUS_SOCKET or LECOMBUS_URL says, else the only socket in /run/lecombus.
        token_file: The file that holds the bearer token, for a URL.
        ca: The file with the certificates that sign the daemon's; None: the system's.
        certificate: The file with the client's certificate and key, where the daemon asks for one.
        answer_within_s: How long to wait for an answer, seconds.
        repeat_for_s: How long a write whose connection broke is repeated, seconds; 0: never.

    Raises:
        AmbiguousDaemonError: Both are given, or it is not clear which daemon is meant.
        NotPermittedError: The socket or a file may not be opened.
        UnreachableError: No daemon listens at the socket.
    """
    path, base = find_daemon(socket, url)
    async with open_connection(
        path, base, token_file=token_file, ca=ca, certificate=certificate,
        answer_within_s=answer_within_s, repeat_for_s=repeat_for_s,
    ) as connection:  # fmt: skip
        yield Line(connection)


class Line:
    """A line of drives.

    Args:
        connection: Speaks with its daemon.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    @property
    def where(self) -> str:
        """The socket's path or the URL of its daemon."""
        return self.connection.where

    def drive(self, name: str) -> Drive:
        """Return a drive by its name in the roster; nothing is asked yet.

        Raises:
            ProblemError: No drive can have this name.
        """
        return Drive(self, name)

    def group(self, name: str) -> Group:
        """Return a group by its name in the roster; `all` is every drive.

        Raises:
            ProblemError: No group can have this name.
        """
        return Group(self, name)

    async def status(self) -> LineStatus:
        """Return how the line is doing; nothing is sent to it.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return LineStatus.of((await self.ask("/v1/line")).data)

    async def drives(self) -> list[DriveStatus]:
        """Return every drive with all that is known of it; nothing is sent to the line.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return [DriveStatus.of(one) for one in (await self.ask("/v1/drives")).data["drives"]]

    async def groups(self) -> list[GroupInfo]:
        """Return the groups of the roster.

        Raises:
            UnreachableError: The daemon cannot be reached.
        """
        return [GroupInfo.of(one) for one in (await self.ask("/v1/groups")).data["groups"]]

    async def stop(self, target: str = "all", action: StopAction = "quick-stop") -> GroupResult:
        """Stop drives, before everything else; needs no lease.

        Check the result: a stop that is not `verified` leaves motors that may turn. This is no
        safety function.

        Args:
            target: A drive, a group, or `all`.
            action: `quick-stop`: along the drive's ramp. `inhibit`: no torque, the motor coasts.

        Raises:
            ProblemError: There is no such drive or group.
            UnreachableError: The daemon cannot be reached: nothing was stopped.
        """
        document: dict[str, Json] = {"action": action, "target": target}
        what = {"target": target, "drive": target}
        return await self.result("POST", "/v1/stop", document, GroupResult.of, what)

    async def ask(self, path: str, **params: str) -> Answer:
        """Ask for any document of docs/api.md.

        Raises:
            ProblemError: The daemon refuses.
            UnreachableError: It cannot be reached.
        """
        return await self.connection.ask(path, params)

    async def act(
        self, method: str, path: str, document: Mapping[str, Json] | None = None
    ) -> Answer:
        """Ask for any action of docs/api.md, with an `Idempotency-Key`.

        Returns:
            What the daemon answers, also if it is a problem document with an outcome.

        Raises:
            ProblemError: The daemon refuses, and nothing was sent to a drive.
            UnreachableError: It cannot be reached, or its answer was lost.
        """
        answer = await self.connection.act(method, path, document)
        done = 200 <= answer.status < 300
        found: Document = answer.data if isinstance(answer.data, dict) else {}
        if done or (found.get("outcome") and found.get("sent") is not False):
            return answer
        raise problem_error(answer)

    async def result(
        self,
        method: str,
        path: str,
        document: Mapping[str, Json] | None,
        read: Callable[[Document, Answer | None], R],
        what: Mapping[str, Json],
    ) -> R:
        """Have something done, and return how it ended, whatever happened to the answer.

        Args:
            method: The HTTP method.
            path: The path.
            document: The body.
            read: Makes the result of the answer.
            what: What the result says of the request, where the daemon said nothing.

        Raises:
            ProblemError: The request is wrong: it was not carried out.
            UnreachableError: Nothing was sent.
        """
        try:
            answer = await self.connection.act(method, path, document)
        except AnswerLostError as exc:
            remedy = "it may have happened: read back, or look at the drive, before it is repeated"
            lost = {"reason": exc.problem, "remedy": remedy, "type": "answer-lost"}
            return read({**what, **lost, "outcome": Outcome.UNKNOWN.value}, None)
        found: Document = answer.data if isinstance(answer.data, dict) else {}
        if found.get("outcome"):
            return read({**what, **known_of(found)}, answer)
        if answer.status in WRONG_REQUESTS:
            raise problem_error(answer)
        refused = answer.status < 500 or answer.status == 503
        outcome = Outcome.REFUSED if refused else Outcome.UNKNOWN
        return read({**what, **known_of(found), "outcome": outcome.value}, answer)


class Drive:
    """One drive of a line.

    Args:
        line: Its line.
        name: Its name in the roster.
    """

    def __init__(self, line: Line, name: str) -> None:
        self.line = line
        self.name = name
        self.path = path_of("drive", name)

    async def status(self) -> DriveStatus:
        """Return all that is known of it; nothing is sent to the line.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached.
        """
        return DriveStatus.of((await self.line.ask(self.path)).data)

    async def read(self, code: str | int) -> Reading:
        """Read a code from the drive now; takes as long as an exchange, behind what waits.

        Args:
            code: `C0050`, `50`, `C0039/1` (with a subcode), or `P425` of an SMVector.

        Raises:
            ProblemError: It gave no value: `no-answer`, `offline`, `no-such-code`, `line-lost` ..
            UnreachableError: The daemon cannot be reached.
            ValueError: This is no code.
        """
        answer = await self.line.ask(f"{self.path}/codes/{code_text(code)}", fresh="true")
        return Reading.of(answer.data, answer)

    async def value(self, code: str | int) -> Reading:
        """Return a code as last read, with its age and quality; nothing is sent to the line.

        Args:
            code: As for `read`.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached.
            ValueError: This is no code.
        """
        answer = await self.line.ask(f"{self.path}/codes/{code_text(code)}")
        return Reading.of(answer.data, answer)

    async def write(
        self,
        code: str | int,
        value: ValueToWrite,
        *,
        verify: bool | None = None,
        expires_s: float | None = None,
    ) -> WriteResult:
        """Write a value and wait for its outcome. A setpoint or a control word can start a motor.

        If the caller is cancelled before the write was sent, it is not sent any more.

        Args:
            code: As for `read`; the roster's `writable` must allow it.
            value: A number, in the code's own unit and decimals, or text as on the wire.
            verify: Read it back afterwards; None: do not.
            expires_s: It is not sent any more after so long, 0.001 to 3600 seconds; None: the
                daemon's own limit.

        Raises:
            ProblemError: The request is wrong: no such drive or code, a value out of range ..
            UnreachableError: The daemon cannot be reached: nothing was sent.
            ValueError: This is no code, no value or no duration.
        """
        document = write_document(value, verify, expires_s)
        path = f"{self.path}/codes/{code_text(code)}"
        what: dict[str, Json] = {"drive": self.name, "code": code_text(code)}
        return await self.line.result("PUT", path, document, WriteResult.of, what)

    async def enable(self, *, expires_s: float | None = None) -> VerbResult:
        """Release quick stop and inhibit: the motor turns if it has a setpoint.

        `verified`: the drive's status words show it. It is refused while a fault is active.

        Args:
            expires_s: It is not begun any more after so long, 0.001 to 3600 seconds.

        Raises:
            ProblemError: There is no such drive, or its family has no such command.
            UnreachableError: The daemon cannot be reached: nothing was sent.
        """
        return await self._verb("enable", expires_document(expires_s))

    async def set_speed(
        self,
        value: ValueToWrite,
        unit: Literal["Hz", "%"],
        *,
        verify: bool | None = None,
        expires_s: float | None = None,
    ) -> VerbResult:
        """Give the drive its speed; an enabled drive follows. It does not enable the drive.

        Args:
            value: The speed, within the drive's range.
            unit: `Hz`, or `%` of its highest frequency or speed.
            verify: Read the setpoint back; None: do not.
            expires_s: It is not sent any more after so long, 0.001 to 3600 seconds.

        Raises:
            ProblemError: There is no such drive, or the speed is out of its range.
            UnreachableError: The daemon cannot be reached: nothing was sent.
        """
        return await self._verb(
            "set-speed", {**write_document(value, verify, expires_s), "unit": unit}
        )

    async def reset_fault(self, *, expires_s: float | None = None) -> VerbResult:
        """Reset the drive's fault; it stays inhibited.

        Args:
            expires_s: It is not begun any more after so long, 0.001 to 3600 seconds.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached: nothing was sent.
        """
        return await self._verb("reset-fault", expires_document(expires_s))

    async def quick_stop(self) -> VerbResult:
        """Stop the drive along its ramp, before everything else; needs no lease.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached: nothing was stopped.
        """
        return await self._verb("quick-stop", None)

    async def inhibit(self) -> VerbResult:
        """Take the drive's torque away, before everything else: its motor coasts.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached: nothing was stopped.
        """
        return await self._verb("inhibit", None)

    async def why(self, *, fresh: bool = True, language: Literal["en", "de"] = "en") -> Why:
        """Say why it does not turn.

        Args:
            fresh: Read the few codes that matter first.
            language: Of the texts.

        Raises:
            ProblemError: There is no such drive.
            UnreachableError: The daemon cannot be reached.
        """
        params = {"fresh": "true"} if fresh else {}
        return Why.of((await self.line.ask(f"{self.path}/why", lang=language, **params)).data)

    async def _verb(self, verb: str, document: Mapping[str, Json] | None) -> VerbResult:
        path, what = f"{self.path}/verbs/{verb}", {"drive": self.name, "verb": verb}
        return await self.line.result("POST", path, document, VerbResult.of, what)


class Group:
    """Drives that are written to together.

    Args:
        line: Their line.
        name: The group's name in the roster.
    """

    def __init__(self, line: Line, name: str) -> None:
        self.line = line
        self.name = name
        self.path = path_of("group", name)

    async def write(
        self,
        code: str | int,
        value: ValueToWrite,
        *,
        verify: bool | None = None,
        expires_s: float | None = None,
    ) -> GroupResult:
        """Write a value to every member and wait for all outcomes.

        Its `outcome` is that of its worst member.

        Args:
            code: As for `Drive.read`.
            value: As for `Drive.write`.
            verify: Read back from every member; None: only where it goes out as one multicast,
                which no drive acknowledges.
            expires_s: It is not sent any more after so long, 0.001 to 3600 seconds.

        Raises:
            ProblemError: There is no such group, or the value cannot be sent.
            UnreachableError: The daemon cannot be reached: nothing was sent.
            ValueError: This is no code, no value or no duration.
        """
        document = write_document(value, verify, expires_s)
        path = f"{self.path}/codes/{code_text(code)}"
        return await self.line.result("PUT", path, document, GroupResult.of, {"target": self.name})

    async def stop(self, action: StopAction = "quick-stop") -> GroupResult:
        """Stop every member, before everything else; as `Line.stop`."""
        return await self.line.stop(self.name, action)


def known_of(document: Document) -> Document:
    """Return what a document says, without its keys of null."""
    return {key: found for key, found in document.items() if found is not None}
