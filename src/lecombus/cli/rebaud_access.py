"""How a change of baud rate speaks to the drives: `LineAccess` over a port of its own."""

from __future__ import annotations

import signal
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

import anyio

from lecombus.cli.own_line import OwnPort, own_port
from lecombus.cli.screen import forget_terminal
from lecombus.cli.signals import ending_signals
from lecombus.config import Roster
from lecombus.drives import family
from lecombus.drives.procedures import ReadAttempt, WriteAttempt
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LecombusError,
    NakError,
    UnknownCodeError,
)
from lecombus.fieldbus.lecom.rebaud import LineAccess, Subject
from lecombus.fieldbus.requests import Station
from lecombus.line_runtime import options_of
from lecombus.parameters import Code, Value
from lecombus.schedule import Priority

__all__ = ["Procedure", "carry_out"]

Procedure = Callable[[LineAccess], Awaitable[None]]
"""What is done on the line, such as the check of every drive."""


async def carry_out(
    procedure: Procedure,
    roster: Roster,
    subjects: tuple[Subject, ...],
    interrupt: Callable[[], None],
    watch: Callable[[], None],
) -> None:
    """Carry out a procedure to its end.

    Args:
        procedure: What is done on the line.
        roster: The line and its drives.
        subjects: The drives.
        interrupt: Called at a signal; the procedure then ends by itself.
        watch: Called before every telegram and at the end.

    Raises:
        LecombusError: The port cannot be opened, or was lost.
    """
    stations = {one.name: _station(one, roster) for one in subjects}
    # A line may be silent here: its drives may be at the other rate.
    options = replace(options_of(roster), stall_s=0.0)
    failure: LecombusError | None = None
    async with anyio.create_task_group() as tasks:
        await tasks.start(_listen, interrupt)
        try:
            async with own_port(
                roster.line, retries=roster.line.retries, options=options, drives=stations
            ) as port:
                await procedure(_Line(port, stations, watch))
                watch()
        except LecombusError as exc:  # outside the task group, or it would come out wrapped
            failure = exc
        tasks.cancel_scope.cancel()
    if failure is not None:
        raise failure


async def _listen(
    interrupt: Callable[[], None],
    *,
    task_status: anyio.abc.TaskStatus[None] = anyio.TASK_STATUS_IGNORED,
) -> None:
    with anyio.open_signal_receiver(signal.SIGINT, *ending_signals()) as signals:
        task_status.started()
        async for _ in signals:
            forget_terminal()
            interrupt()


def _station(subject: Subject, roster: Roster) -> Station:
    entry = roster.drive(subject.name)
    assert entry is not None, "subjects are made from the roster"
    kind = family(entry.family)
    return Station(
        entry.name,
        entry.address,
        kind,
        (subject.form,),
        hold_s=kind.hold_after_write_s,
        answer_time_s=entry.answer_time_s,
    )


class _Line:
    """`LineAccess` on a port opened by the command."""

    def __init__(
        self, port: OwnPort, stations: dict[str, Station], watch: Callable[[], None]
    ) -> None:
        self.port = port
        self.stations = stations
        self.watch = watch

    def at(self, baud: int, drive: str, *, retries: int) -> _Drive:
        """Return a drive at a baud rate."""
        return _Drive(self, baud, self.stations[drive], retries)

    async def wait(self, baud: int, for_s: float) -> None:
        """Send nothing for some seconds."""
        self.watch()
        await self.port.at(baud)
        await anyio.sleep(for_s)


@dataclass(frozen=True, slots=True)
class _Drive:
    """`DriveAccess` on a port opened by the command."""

    line: _Line
    baud: int
    station: Station
    retries: int

    async def read(self, code: Code) -> ReadAttempt:
        """Read a code."""
        self.line.watch()
        requests = (await self.line.port.at(self.baud)).requests
        try:
            value = await requests.read(
                self.station, code, Priority.INTERACTIVE, retries=self.retries
            )
        except CutReplyError:
            raise
        except UnknownCodeError as exc:
            return ReadAttempt(code, None, "no-such-code", str(exc))
        except NakError as exc:
            return ReadAttempt(code, None, "nak", str(exc))
        except ExchangeError as exc:
            return ReadAttempt(code, None, "no-answer", str(exc))
        return ReadAttempt(code, value)

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        """Write a code once."""
        self.line.watch()
        requests = (await self.line.port.at(self.baud)).requests
        outcome, reason = await requests.write(self.station, code, value, verify=verify)
        return WriteAttempt(outcome.is_good, outcome.value, reason)
