"""How `lecombus scan` asks through a running daemon."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lecombus.client import Line, ProblemError
from lecombus.fieldbus.lecom.scanning import Heard, HeardKind, Question
from lecombus.parameters import Value

__all__ = ["ByDaemon"]

REOPENED_WITHIN_S = 10.0
"""A daemon opens its port again where no drive answers for a time; a scan waits so long for it."""

LOOK_EVERY_S = 0.2
"""How often it looks meanwhile whether the port is open."""


def _pause(for_s: float) -> None:
    time.sleep(for_s)


@dataclass(frozen=True, slots=True)
class ByDaemon:
    """`AddressAccess` through a running daemon."""

    line: Line
    watch: Callable[[], None]

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
            _pause(LOOK_EVERY_S)
        return True

    async def listen(self, baud: int, for_s: float) -> Heard:
        """A daemon has listened to its line already."""
        return Heard(HeardKind.SILENCE)
