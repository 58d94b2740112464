"""The steps of a change of baud rate, carried out on a port of our own.

The port is opened anew for every rate. SIGINT and SIGTERM let the exchange under way end; the
procedure then begins no further one.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace

import anyio

from lecombus.cli.own_line import OwnLine, own_line
from lecombus.config import LineEntry, Roster, line_timing
from lecombus.drives import family
from lecombus.errors import (
    CutReplyError,
    ExchangeError,
    LecombusError,
    NakError,
    UnknownCodeError,
)
from lecombus.line.port import PortSettings
from lecombus.line.station import Station
from lecombus.line_runtime import options_of
from lecombus.protocol.addressing import Form
from lecombus.rebaud import Came, Read, Said, Step, Steps, Subject, Wait
from lecombus.schedule import Outcome, Priority

__all__ = ["carry_out", "form_of"]

_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
_NO = (NakError, UnknownCodeError)


def form_of(forms: tuple[Form, ...]) -> Form:
    """Choose the addressing form that no code bank redirects, where the drive knows it."""
    return Form.EXTENDED if Form.EXTENDED in forms else forms[0]


async def carry_out(
    steps: Steps[None],
    roster: Roster,
    subjects: tuple[Subject, ...],
    interrupt: Callable[[], None],
    watch: Callable[[], None],
) -> None:
    """Carry out steps to their end.

    Args:
        steps: What is to be said.
        roster: The line, and how its drives are spoken to.
        subjects: The drives.
        interrupt: Called at a signal; the steps then end by themselves.
        watch: Called after every step.

    Raises:
        LecombusError: The port cannot be opened, or was lost.
    """
    stations = {one.name: _station(one, roster) for one in subjects}
    failure: LecombusError | None = None
    async with anyio.create_task_group() as tasks:
        await tasks.start(_listen, interrupt)
        try:
            step: Step | None = next(steps, None)
            while step is not None:
                step = await _at_one_rate(steps, step, roster, stations, watch)
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
    with anyio.open_signal_receiver(*_INTERRUPTS) as signals:
        task_status.started()
        async for _ in signals:
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


async def _at_one_rate(
    steps: Steps[None],
    step: Step,
    roster: Roster,
    stations: dict[str, Station],
    watch: Callable[[], None],
) -> Step | None:
    """Carry out steps as long as they are for one baud rate; returns the first that is not."""
    baud = step.baud
    at: LineEntry = roster.line.model_copy(update={"baud": baud})
    settings = PortSettings(at.port, at.baud, at.direction, at.parity, at.name)
    # A line may be silent for as long as it likes here: its drives may be at the other rate.
    options = replace(options_of(roster), stall_s=0.0)
    async with own_line(settings, line_timing(at), retries=at.retries, options=options) as own:
        for name in stations:
            own.schedule.add_drive(name)
        while step.baud == baud:
            said = await _say(own, step, stations)
            try:
                step = steps.send(said)
            except StopIteration:
                return None
            finally:
                watch()
    return step


async def _say(own: OwnLine, step: Step, stations: dict[str, Station]) -> Said:
    """Carry out one step."""
    if isinstance(step, Wait):
        await anyio.sleep(step.for_s)
        return Said(Came.NOTHING)
    station = stations[step.drive]
    if isinstance(step, Read):
        return await _read(own, step, station)
    outcome, reason = await own.requests.write(station, step.code, step.value, verify=False)
    came = {Outcome.DONE: Came.DONE, Outcome.REFUSED: Came.REFUSED}.get(outcome, Came.NOTHING)
    return Said(came, None, reason)


async def _read(own: OwnLine, step: Read, station: Station) -> Said:
    try:
        value = await own.requests.read(
            station, step.code, Priority.INTERACTIVE, retries=step.retries
        )
    except CutReplyError:
        raise
    except ExchangeError as exc:
        return Said(Came.REFUSED if isinstance(exc, _NO) else Came.NOTHING, None, str(exc))
    return Said(Came.VALUE, value)
