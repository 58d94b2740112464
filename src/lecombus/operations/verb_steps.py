"""The steps of verbs, taken one by one, and reading what a drive shows.

* The control word is built just before it is written, from its last value on this line; while a
  write that changes it is under way it is read again. Bits that another client wrote stay.
* A stop, or a plain write that means one, ends a verb before its next write, and what the verb
  waits to read: its end is known then, however much the line has to do.
* After its inhibit a verb writes nothing more once another client has written the control word.
* One enable or reset of a drive at a time; a second one is refused, not queued.
"""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, TypeVar

import anyio

from lecombus.drive_state.readings import DriveState
from lecombus.drives import OperatingState, StopAction, Verb
from lecombus.drives.verb_facts import Known
from lecombus.drives.verb_rules import (
    BitsStep,
    InhibitStep,
    RestartStep,
    VerbStep,
    WriteStep,
)
from lecombus.drives.verbs import (
    states,
)
from lecombus.errors import (
    ExchangeError,
    LineError,
    OperationError,
    ScheduleError,
)
from lecombus.fieldbus.requests import Station
from lecombus.leases import Use
from lecombus.operations.context import OperationContext
from lecombus.operations.operation_reports import WriteReport
from lecombus.operations.stop_requests import Stops
from lecombus.operations.verb_reports import (
    Run,
    lifted,
    may_have_happened,
    superseded,
)
from lecombus.operations.writes import Writes
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority

__all__ = ["TROUBLE", "USES", "StoppedError", "VerbSteps", "words_of"]

EFFECT_WITHIN_S = 2.0
"""How long a drive may take to show that it is enabled or that its fault is gone, seconds."""

LOOK_AGAIN_S = 0.1
"""Between two reads of a status word, seconds."""

BACK_WITHIN_S = 45.0
"""How long a drive that restarts may take until it is audited: a module's own codes take 0.5 s
each, and other audits may come first (EDB2102EN 6.3). Less than a client waits for an answer."""

WORD_TRIES = 5
"""How often a control word is read again that other clients keep writing."""

USES: Final[Mapping[Verb, Use]] = {
    Verb.ENABLE: Use.ENABLE, Verb.RESET_FAULT: Use.ENABLE, Verb.SET_SPEED: Use.SETPOINT,
}  # fmt: skip
"""What the writes of a verb are for: a drive that is latched can be reset, and enabled, and given a
speed while it shows that it is stopped."""


Read = TypeVar("Read")


class StoppedError(Exception):
    """The drive was stopped while a verb waited for a reading."""


TROUBLE = (ExchangeError, LineError, OperationError, ScheduleError)


class VerbSteps:
    """Takes the steps of verbs, and reads what a drive shows.

    Args:
        context: What all operations share.
        writes: Writes codes.
        stops: Stops drives.
    """

    def __init__(self, context: OperationContext, writes: Writes, stops: Stops) -> None:
        self._context = context
        self._writes = writes
        self._stops = stops

    async def carry_out(self, run: Run, steps: Sequence[VerbStep]) -> WriteReport | None:
        """Take steps one after the other; return the report of the one that was not done."""
        for step in steps:
            report = await self.take(run, step)
            if not report.outcome.is_good:
                return report
        return None

    async def take(self, run: Run, step: VerbStep) -> WriteReport:
        """Take one step, unless a stop or another client's write has ended the verb."""
        if self.stopped_meanwhile(run):
            return superseded(run)
        if isinstance(step, InhibitStep):
            return await self.inhibit(run)
        if self.lifted_meanwhile(run):
            return lifted(run)
        if isinstance(step, WriteStep):
            return await self._write(run, step.code, step.value.raw)
        report = await self._change_bits(run, step)
        if isinstance(step, RestartStep) and may_have_happened(report):
            return await self._back_again(run, step)
        return report

    async def inhibit(self, run: Run) -> WriteReport:
        """Inhibit the drive as part of a verb; without proof the verb goes no further."""
        name = run.station.name
        run.stops += 1
        run.lifts = self._context.lasting(name).lifts
        report = (await self._stops.stop(StopAction.INHIBIT, name)).members[0]
        if report.outcome is Outcome.VERIFIED:
            return report
        reason = f"{name} could not be inhibited: {report.reason}"
        return replace(report, outcome=Outcome.REFUSED, kind="not-in-effect", reason=reason)

    async def _change_bits(self, run: Run, step: BitsStep) -> WriteReport:
        """Write the control word with bits changed; nothing where they are set so already."""
        name = run.station.name
        for _ in range(WORD_TRIES):
            missing = self._context.control_word(name).missing()
            if missing is None:
                break
            read = partial(self._context.requests.read, run.station, missing, Priority.INTERACTIVE)
            await self._until_stopped(run, read)
        word = self._context.control_word(name).get()
        if word is None:
            raise OperationError(
                f"the control word {step.code} of {name} cannot be read, others keep writing it, "
                "or answers come twice on this line: its bits are not guessed",
                kind="no-control-word", drive=name, code=str(step.code),
                remedy="ask again when nobody else writes it; see the remarks of the line",
            )  # fmt: skip
        if step.applied(word) == word and not step.always:
            return WriteReport(name, step.code, Outcome.DONE)
        # No await between reading the word and submitting its write.
        if self.stopped_meanwhile(run):
            return superseded(run)
        if self.lifted_meanwhile(run):
            return lifted(run)
        return await self._write(run, step.code, Value.hexadecimal(step.applied(word), 4).raw)

    async def _write(self, run: Run, code: Code, raw: str) -> WriteReport:
        name = run.station.name
        if USES[run.verb] is Use.SETPOINT:
            await self._context.shown_stops.see(name, code)
            if self.stopped_meanwhile(run):
                return superseded(run)
        wire = self._context.permissions.permitted(name, run.station, code, raw, use=USES[run.verb])
        ending = self._writes.submit_write(
            run.station, code, wire, run.expires_at_s, verify=run.verify,
            goes_on=bool(run.written) or run.lifts is not None, use=USES[run.verb],
        )  # fmt: skip
        report = self._writes.report(name, code, ending, *await ending.wait())
        if ending.was_sent and report.kind != "nak":
            run.written.append((code, wire.raw))
        return await self._context.diagnosis.explain(report, run.station, wire)

    async def _back_again(self, run: Run, step: RestartStep) -> WriteReport:
        """Wait for a drive that restarts until it has been audited: what it lost is set then.

        Its answer is never given, so a missing one says nothing (EDB2102EN 6.4: a TRIP reset of
        820X initialises drive and fieldbus module).
        """
        name = run.station.name
        drive = self._context.requests.drives.find(name)
        if drive is not None:
            self._context.line.doubt(drive, "it was made to restart: to be audited")
        with anyio.move_on_after(BACK_WITHIN_S):
            while self._context.store.state(name) is not DriveState.ONLINE:
                if self.stopped_meanwhile(run):
                    return superseded(run)
                await anyio.sleep(LOOK_AGAIN_S)
            return WriteReport(name, step.code, Outcome.DONE)
        state = self._context.store.drive(name)
        return WriteReport(
            name, step.code, Outcome.UNKNOWN,
            f"{name} was made to restart and is {state.state.value} since: {state.reason}",
            kind="offline",
            remedy="look at the drive and its wires; its quick stop was set before it restarted",
        )  # fmt: skip

    # ---- reading ----------------------------------------------------------------------------

    async def learn(self, run: Run, codes: Sequence[Code]) -> Known:
        """Read codes now; a code that the drive does not have is left out.

        Raises:
            StoppedError: The drive was stopped since the verb began.
        """
        read = self._context.requests.read_known
        values = await self._until_stopped(run, lambda: read(run.station, codes))
        return Known(run.station.name, run.station.family, values)

    async def _until_stopped(self, run: Run, read: Callable[[], Awaitable[Read]]) -> Read:
        """Read, but wait no longer for it than until the drive is stopped."""
        if self.stopped_meanwhile(run):
            raise StoppedError
        awaited = self._context.lasting(run.station.name).awaited
        with anyio.CancelScope() as scope:
            awaited.add(scope)
            try:
                return await read()
            finally:
                awaited.discard(scope)
        raise StoppedError

    async def watch(
        self, run: Run, before: Known, shown: Callable[[Known], bool], codes: Sequence[Code]
    ) -> Known:
        """Read codes until they show something, or until its time is over."""
        until_s = self._context.clock() + EFFECT_WITHIN_S
        while True:
            seen = await self.learn(run, codes)
            known = Known(before.drive, before.family, {**before.values, **seen.values})
            if shown(known) or self._context.clock() >= until_s:
                return known
            await anyio.sleep(LOOK_AGAIN_S)

    async def states(self, run: Run) -> tuple[OperatingState, ...]:
        """Return what the drive shows now; nothing where it cannot be read, or is stopped first."""
        family = run.station.family
        codes = (*filter(None, (family.configured_by,)), *words_of(run.station), *family.words)
        with contextlib.suppress(*TROUBLE, StoppedError):
            return states(await self.learn(run, tuple(dict.fromkeys(codes))))
        return ()

    def stopped_meanwhile(self, run: Run) -> bool:
        """Whether the drive was stopped since the verb began."""
        return self._context.lasting(run.station.name).stops_and_writes != run.stops

    def lifted_meanwhile(self, run: Run) -> bool:
        """Whether another client may have lifted the inhibit of the verb."""
        return run.lifts not in (None, self._context.lasting(run.station.name).lifts)


def words_of(station: Station) -> tuple[Code, ...]:
    """The control word, and the status word that shows an inhibit and a fault."""
    rules = station.family.verbs
    assert rules is not None
    return (rules.control, *rules.enable.proofs)
