"""Refusals that one client causes again and again: counted, so that they do not fill the journal.

An operation has two rows in the journal, also when it is refused, because the first one is written
before anything is known of its end. After `FEW` refusals of one kind of request by one client at
one drive within `WINDOW_S`, it is asked first whether this one would be refused as well. Such
refusals are counted, and the journal gets one row a minute for them. It is the question that the
operation itself asks, at the same moment: nothing is refused here that would be carried out.

What is refused only after the drive was read, such as an enable of a drive with a fault, is not
known before. Beyond `MANY` of these within `WINDOW_S` the client is answered 429 for such requests
until the window is over; setpoints and control words never are. Stops do not come here.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Final, TypeVar

from lecombus.api.answers import ProblemDocument, RefusedRequestError
from lecombus.drives import Verb
from lecombus.errors import OperationError
from lecombus.journal.journal import Journal
from lecombus.operations.actions import ACTOR, OTHERS
from lecombus.operations.facade import Operations
from lecombus.operations.verb_steps import USES
from lecombus.parameters import Code

__all__ = ["FEW", "MANY", "WINDOW_S", "AskedWrite", "Refusals"]

WINDOW_S: Final = 60.0
FEW: Final = 5
MANY: Final = 30
LONGEST: Final = 300
WINDOWS_LIMIT: Final = 1000
"""Clients, drives and requests that are told apart; beyond, they share a window."""

PASSING: Final = frozenset({"client-gone", "journal-failing", "line-closed", "queue-full"})
"""Refusals that say nothing of the client."""

Answer = TypeVar("Answer")
Act = Callable[[], Awaitable[Answer]]


@dataclass(slots=True)
class _Window:
    """How often requests of one kind of one client were refused lately at one drive."""

    begun_s: float
    refused: int = 0


@dataclass(frozen=True, slots=True)
class AskedWrite:
    """A write as a client asks for it.

    Args:
        target: The drive or group.
        code: What to write.
        value: The value.
        restoring: It belongs to the restore of a backup.
    """

    target: str
    code: Code
    value: Decimal | int | str
    restoring: bool = False


class Refusals:
    """Carries out requests that are not stops, and counts those that are refused.

    Args:
        clock: Monotonic time, seconds.
        ops: Knows what would be refused.
        journal: Gets what was counted; None: nothing is counted.
    """

    def __init__(
        self, clock: Callable[[], float], ops: Operations, journal: Journal | None
    ) -> None:
        self._clock = clock
        self._ops = ops
        self._journal = journal
        self._windows: dict[tuple[str, str, str], _Window] = {}

    async def write(self, event: str, write: AskedWrite, act: Act[Answer]) -> Answer:
        """Carry out a write to a drive or a group.

        Args:
            event: What it is, as in the journal.
            write: What is asked.
            act: Carries it out.

        Raises:
            OperationError: It is refused.
            ProblemError: It is a setting, and too many were refused lately.
        """
        context = self._ops.context
        if self._journal is None or context.kinds.is_stop(write.target, write.code, write.value):
            return await act()
        window = self._window(event, write.target)
        if window.refused >= FEW:
            try:
                await self._check_write(write)
            except OperationError as exc:
                fields = {"code": str(write.code), "reason": str(exc)}
                if context.kinds.is_secret(write.target, write.code):
                    del fields["reason"]  # it may quote the value
                self._count(event, write.target, fields)
                raise
        limited = context.kinds.is_setting(write.target, write.code, write.value)
        return await self._noted(window, act, MANY if limited else None, write.target)

    async def verb(self, drive: str, verb: Verb, act: Act[Answer]) -> Answer:
        """Carry out a verb that is not a stop.

        Raises:
            OperationError: It is refused.
            ProblemError: Too many were refused lately, and it is not known whether this would be.
        """
        if self._journal is None:
            return await act()
        window = self._window(verb, drive)
        if window.refused >= FEW:
            try:
                await self._check_verb(drive, verb)
            except OperationError as exc:
                self._count("verb", drive, {"verb": verb.value, "reason": str(exc)})
                raise
        return await self._noted(window, act, None if verb is Verb.SET_SPEED else MANY, drive)

    async def other(self, what: str, drive: str, act: Act[Answer]) -> Answer:
        """Carry out what is asked for rarely, such as another address.

        Raises:
            OperationError: It is refused.
            ProblemError: Too many were refused lately.
        """
        if self._journal is None:
            return await act()
        return await self._noted(self._window(what, drive), act, MANY, drive)

    async def _noted(
        self, window: _Window, act: Act[Answer], most: int | None, target: str
    ) -> Answer:
        if most is not None and window.refused >= most:
            raise self._too_many(target, window)
        try:
            return await act()
        except OperationError as exc:
            window.refused += exc.kind not in PASSING
            raise

    async def _check_write(self, write: AskedWrite) -> None:
        """Raise what a write would be refused with now."""
        context = self._ops.context
        await context.shown_stops.see(write.target, write.code, write.value)
        for name in context.drive_names(write.target):
            context.permissions.permitted(
                name, context.station(name), write.code, write.value, restoring=write.restoring
            )

    async def _check_verb(self, drive: str, verb: Verb) -> None:
        """Raise what a verb would be refused with now, as far as that is known without the drive.

        Whether a latched drive takes a speed is known after its stops were read.
        """
        context = self._ops.context
        rules = context.station(drive).family.verbs
        if verb is Verb.SET_SPEED and rules is not None:
            await context.shown_stops.see(drive, rules.setpoints[0].code)
        context.leases.check(drive, USES[verb])
        context.permissions.check_ready(drive)

    def _window(self, what: str, target: str) -> _Window:
        now_s, context = self._clock(), self._ops.context
        for one in [one for one, its in self._windows.items() if now_s - its.begun_s >= WINDOW_S]:
            del self._windows[one]
        is_known = target in context.entries or target in context.groups
        key = ACTOR.get().kind(), what, target if is_known else ""
        if key not in self._windows and len(self._windows) >= WINDOWS_LIMIT:
            key = OTHERS, what, ""
        return self._windows.setdefault(key, _Window(now_s))

    def _count(self, event: str, target: str, fields: Mapping[str, str]) -> None:
        assert self._journal is not None
        self._ops.actions.log(event, target, "refused", fields)
        actor = ACTOR.get()
        said = {key: text[:LONGEST] for key, text in {**fields, **actor.fields()}.items()}
        self._journal.count(event, target[:LONGEST], said, actor.kind())

    def _too_many(self, target: str, window: _Window) -> RefusedRequestError:
        left_s = max(1, round(window.begun_s + WINDOW_S - self._clock()))
        return RefusedRequestError(
            ProblemDocument(
                "too-many-refusals",
                f"{MANY} such requests of this client to {target} were refused within "
                f"{WINDOW_S:.0f} s: nothing was done",
                remedy="remove the reason of the refusals, then ask again; stops are always taken",
                drive=target,
                headers={"Retry-After": str(left_s)},
            )
        )
