"""A drive and a group of a line: reads, writes with an outcome, verbs, why it does not turn.

Each holds no more than its line and its name. What is said of results and errors in `line` holds
here too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from lecombus.client.connection import Json
from lecombus.client.documents import DriveStatus, Reading, Why
from lecombus.client.requests import (
    ValueToWrite,
    code_text,
    expires_document,
    path_of,
    write_document,
)
from lecombus.client.results import GroupResult, VerbResult, WriteResult

if TYPE_CHECKING:
    from lecombus.client.line import Line

__all__ = ["Drive", "Group", "StopAction"]

StopAction = Literal["quick-stop", "inhibit"]
"""Along the drive's ramp, or without torque: the motor coasts."""


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
            ValueError: This is not a code.
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
            ValueError: This is not a code.
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
            ValueError: The code, value or duration is wrong.
        """
        document = write_document(value, verify, expires_s)
        path = f"{self.path}/codes/{code_text(code)}"
        what: dict[str, Json] = {"drive": self.name, "code": code_text(code)}
        return await self.line.result("PUT", path, document, WriteResult.of, what)

    async def enable(
        self, *, expires_s: float | None = None, asked_ago_s: float = 0.0
    ) -> VerbResult:
        """Release quick stop and inhibit: the motor turns if it has a setpoint.

        `verified`: the drive's status words show it. It is refused while a fault is active.

        Args:
            expires_s: It is not begun any more after so long, 0.001 to 3600 seconds.
            asked_ago_s: How long ago it was asked for by one for whom this program asks, seconds;
                a stop since then ends it.

        Raises:
            ProblemError: There is no such drive, or its family has no such command.
            UnreachableError: The daemon cannot be reached: nothing was sent.
        """
        return await self._verb("enable", expires_document(expires_s), asked_ago_s)

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

    async def _verb(
        self, verb: str, document: Mapping[str, Json] | None, asked_ago_s: float = 0.0
    ) -> VerbResult:
        path, what = f"{self.path}/verbs/{verb}", {"drive": self.name, "verb": verb}
        return await self.line.result(
            "POST", path, document, VerbResult.of, what, asked_ago_s=asked_ago_s
        )


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
            ValueError: The code, value or duration is wrong.
        """
        document = write_document(value, verify, expires_s)
        path = f"{self.path}/codes/{code_text(code)}"
        return await self.line.result("PUT", path, document, GroupResult.of, {"target": self.name})

    async def stop(self, action: StopAction = "quick-stop") -> GroupResult:
        """Stop every member, before everything else; as `Line.stop`."""
        return await self.line.stop(self.name, action)
