"""How a scan asks the line: `AddressAccess` over a port of its own, and through a daemon."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import anyio

from lecombus.cli.own_line import OwnPort, own_port
from lecombus.cli.second_answers import SECOND_WITHIN_S, SecondAnswers
from lecombus.client import Line, ProblemError
from lecombus.config import LineEntry
from lecombus.fieldbus.lecom.scanning import Heard, HeardKind, Question, Scan
from lecombus.operations.address_reads import read_address
from lecombus.parameters import Value
from lecombus.schedule import Priority

__all__ = ["ThroughDaemon", "scan_own_port"]

Watch = Callable[[], None]

REOPENED_WITHIN_S = 10.0
"""A daemon opens its port again where no drive answers for a time; a scan waits so long for it."""

LOOK_EVERY_S = 0.2
"""How often it looks meanwhile whether the port is open."""


async def scan_own_port(scan: Scan, line: LineEntry, watch: Watch, second: SecondAnswers) -> int:
    """Scan on a port opened by the command, reopened for every baud rate.

    Args:
        scan: The search.
        line: Port, parity and direction; its baud rate is not used.
        watch: Called before every question and at the end.
        second: Gets the second answers.

    Returns:
        How many bytes were received, echoes included.

    Raises:
        LineError: The port cannot be used, or another master speaks on the line.
    """
    async with own_port(line, retries=0) as port:
        try:
            await scan.run(_OnOwnPort(port, watch, second))
            if second.most:  # that of the last answer may be under way
                await anyio.sleep(SECOND_WITHIN_S)
                second.look(await port.at(scan.baud), scan.baud)
        finally:
            watch()
        return port.bytes_heard


@dataclass(frozen=True, slots=True)
class _OnOwnPort:
    """`AddressAccess` on a port opened by the command."""

    port: OwnPort
    watch: Watch
    second: SecondAnswers

    async def ask(self, ask: Question) -> Heard:
        """Read a code at an address, once."""
        self.watch()
        own = await self.port.at(ask.baud)
        heard = await read_address(
            own.requests,
            ask.address,
            ask.code,
            form=ask.form,
            family_name=ask.family,
            patient=ask.patient,
            priority=Priority.INTERACTIVE,
            disturbances=lambda: own.disturbances,
        )
        self.second.answers[ask.address, ask.baud] += heard.is_answer
        self.second.look(own, ask.baud)
        return replace(heard, received=own.take_strays() + heard.received)

    async def listen(self, baud: int, for_s: float) -> Heard:
        """Send nothing for some seconds; return what was heard."""
        own = await self.port.at(baud)
        await anyio.sleep(for_s)
        return Heard(HeardKind.SILENCE, received=own.take_strays(), disturbances=own.disturbances)


@dataclass(frozen=True, slots=True)
class ThroughDaemon:
    """`AddressAccess` through a running daemon."""

    line: Line
    watch: Watch

    async def ask(self, ask: Question) -> Heard:
        """Read a code at an address, once."""
        self.watch()
        try:
            answer = await self._answer(ask)
        except ProblemError as exc:
            if exc.kind != "line-lost" or not await self._is_open_again():
                raise
            answer = await self._answer(ask)
        raw = answer.get("raw")
        return Heard(
            HeardKind(answer["heard"]),
            None if raw is None else Value.parse(str(raw)),
            bytes.fromhex(answer.get("received") or ""),
            int(answer.get("disturbances") or 0),
        )

    async def _answer(self, ask: Question) -> dict[str, Any]:
        path = f"/v1/line/addresses/{ask.address}/codes/{ask.code}"
        said = await self.line.ask(
            path, addressing=ask.form.value, family=ask.family,
            patient="true" if ask.patient else "false",
        )  # fmt: skip
        answer: dict[str, Any] = said.data
        return answer

    async def _is_open_again(self) -> bool:
        """Wait for a port that the daemon opens again; its requests block, so this does too."""
        until_s = time.monotonic() + REOPENED_WITHIN_S
        while (await self.line.ask("/v1/line")).data.get("state") != "open":
            if time.monotonic() > until_s:
                return False
            time.sleep(LOOK_EVERY_S)  # noqa: ASYNC251 - its requests block too
        return True

    async def listen(self, baud: int, for_s: float) -> Heard:
        """A daemon has listened to its line already."""
        return Heard(HeardKind.SILENCE)
