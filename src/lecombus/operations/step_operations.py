"""The steps that verbs are made of, taken one by one, and looking at what a drive shows.

Rules held here:

* The control word is taken when it is written, from what was last read or written on this line;
  while a write that moves it is under way it is read again. What another client wrote is not
  undone.
* A stop that is said while a verb is under way ends the verb before its next write; so does a plain
  write that means the same.
* Nothing more is written behind an inhibit once somebody else has written the control word.
* One enable or reset of a drive at a time; a second one is refused, not queued.

What must not live here: which steps a verb takes (`drives.verbs`), what is said of its end
(`verb_operations`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import anyio

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
    UnknownCodeError,
)
from lecombus.line.station import Station
from lecombus.operations.control_words import ControlWords
from lecombus.operations.group_operations import GroupOperations
from lecombus.operations.reports import WriteReport
from lecombus.operations.requests import Requests
from lecombus.operations.verb_reports import (
    GOOD,
    Run,
    lifted,
    may_have_happened,
    superseded,
)
from lecombus.operations.wear import Wear
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import DriveState
from lecombus.schedule import Outcome, Priority
from lecombus.store import Store

__all__ = ["TROUBLE", "StepOperations", "words_of"]

EFFECT_WITHIN_S = 2.0
"""What a drive is given to show that it is enabled or that its fault is gone, seconds."""

LOOK_AGAIN_S = 0.1
"""Between two looks at a status word, seconds."""

BACK_WITHIN_S = 45.0
"""What a drive that starts anew is given until it is audited: a module's own codes take 0.5 s each,
and other drives' audits may come first (EDB2102EN 6.3). Less than a client waits for an answer."""

WORD_TRIES = 5
"""How often a control word is read again that others keep writing."""

TROUBLE = (ExchangeError, LineError, OperationError, ScheduleError)


class StepOperations(GroupOperations):
    """Adds to the operations on one drive and on several the steps of a verb.

    Args:
        restarted: Told of a drive that was made to start anew; it is then audited.
        Others as for `Operations`.
    """

    def __init__(
        self,
        requests: Requests,
        store: Store,
        words: ControlWords,
        wear: Wear,
        clock: Callable[[], float],
        disturbances: Callable[[], int],
        restarted: Callable[[str], None],
    ) -> None:
        super().__init__(requests, store, words, wear, clock, disturbances)
        self._restarted = restarted
        self._busy: dict[str, Verb] = {}

    async def _carry_out(self, run: Run, steps: Sequence[VerbStep]) -> WriteReport | None:
        """Take steps one after the other; give the report of the one that was not done."""
        for step in steps:
            report = await self._take(run, step)
            if report.outcome not in GOOD:
                return report
        return None

    async def _take(self, run: Run, step: VerbStep) -> WriteReport:
        if self._stopped_meanwhile(run):
            return superseded(run)
        if isinstance(step, InhibitStep):
            return await self._inhibit(run)
        if self._lifted_meanwhile(run):
            return lifted(run)
        if isinstance(step, WriteStep):
            return await self._write(run, step.code, step.value.raw)
        report = await self._change_bits(run, step)
        if isinstance(step, RestartStep) and may_have_happened(report):
            return await self._back_again(run, step)
        return report

    async def _inhibit(self, run: Run) -> WriteReport:
        """Inhibit the drive as part of a verb; without proof the verb goes no further."""
        name = run.station.name
        run.stops += 1
        run.lifts = self._lifts_said[name]
        report = (await self.stop(StopAction.INHIBIT, name)).members[0]
        if report.outcome is Outcome.VERIFIED:
            return report
        reason = f"{name} could not be inhibited: {report.reason}"
        return replace(report, outcome=Outcome.REFUSED, kind="not-in-effect", reason=reason)

    async def _change_bits(self, run: Run, step: BitsStep) -> WriteReport:
        """Write the control word as it is now with bits changed; nothing where they are so."""
        name = run.station.name
        for _ in range(WORD_TRIES):
            missing = self._words.missing(name)
            if missing is None:
                break
            await self._requests.read(run.station, missing, Priority.INTERACTIVE)
        word = self._words.get(name)
        if word is None:
            raise OperationError(
                f"the control word {step.code} of {name} cannot be read, or others keep writing "
                "it: its bits are not guessed",
                kind="no-control-word", drive=name, code=str(step.code),
                remedy="ask again when nobody else writes it",
            )  # fmt: skip
        if step.applied(word) == word and not step.always:
            return WriteReport(name, step.code, Outcome.DONE)
        # Nothing is waited for between the look at the word and its place in the queue.
        if self._stopped_meanwhile(run):
            return superseded(run)
        if self._lifted_meanwhile(run):
            return lifted(run)
        return await self._write(run, step.code, Value.hexadecimal(step.applied(word), 4).raw)

    async def _write(self, run: Run, code: Code, raw: str) -> WriteReport:
        name = run.station.name
        wire = self._permissions.permitted(name, run.station, code, raw)
        ending = self.submit_write(
            run.station, code, wire, run.expires_at_s, verify=run.verify,
            goes_on=bool(run.written) or run.lifts is not None,
        )  # fmt: skip
        report = self.report(name, code, ending, *await ending.wait())
        if ending.was_sent and report.kind != "nak":
            run.written.append((code, wire.raw))
        return await self._refusals.explain(report, run.station, wire)

    async def _back_again(self, run: Run, step: RestartStep) -> WriteReport:
        """Wait for a drive that starts anew until it has been audited.

        Its answer is never given, so a missing one says nothing (EDB2102EN 6.4).
        """
        name = run.station.name
        self._restarted(name)
        with anyio.move_on_after(BACK_WITHIN_S):
            while self._store.state(name) is not DriveState.ONLINE:  # noqa: ASYNC110
                await anyio.sleep(LOOK_AGAIN_S)
            return WriteReport(name, step.code, Outcome.DONE)
        state = self._store.drive(name)
        return WriteReport(
            name, step.code, Outcome.UNKNOWN,
            f"{name} was made to restart and is {state.state.value} since: {state.reason}",
            kind="offline",
            remedy="look at the drive and its wires; its quick stop was set before it restarted",
        )  # fmt: skip

    # ---- looking ----------------------------------------------------------------------------

    async def _learn(self, station: Station, codes: Sequence[Code]) -> Known:
        """Read codes now; one that the drive does not have is left out."""
        values: dict[Code, Value] = {}
        for code in codes:
            with contextlib.suppress(UnknownCodeError):
                values[code] = await self._requests.read(station, code, Priority.INTERACTIVE)
        return Known(station.name, station.family, values)

    async def _watch(
        self, run: Run, before: Known, shown: Callable[[Known], bool], codes: Sequence[Code]
    ) -> Known:
        """Look at codes until they show something, or for as long as they may take."""
        until_s = self._clock() + EFFECT_WITHIN_S
        while True:
            seen = await self._learn(run.station, codes)
            known = Known(before.drive, before.family, {**before.values, **seen.values})
            if shown(known) or self._clock() >= until_s or self._stopped_meanwhile(run):
                return known
            await anyio.sleep(LOOK_AGAIN_S)

    async def _states(self, station: Station) -> tuple[OperatingState, ...]:
        """Name what the drive shows now; nothing where it cannot be read."""
        family = station.family
        codes = (*filter(None, (family.configured_by,)), *words_of(station), *family.words)
        with contextlib.suppress(*TROUBLE):
            return states(await self._learn(station, tuple(dict.fromkeys(codes))))
        return ()

    def _stopped_meanwhile(self, run: Run) -> bool:
        return self._stops_said[run.station.name] != run.stops

    def _lifted_meanwhile(self, run: Run) -> bool:
        return run.lifts is not None and self._lifts_said[run.station.name] != run.lifts

    @contextlib.contextmanager
    def _alone(self, drive: str, verb: Verb) -> Iterator[None]:
        """Let one verb at a time change a drive.

        Raises:
            OperationError: `busy`.
        """
        other = self._busy.get(drive)
        if other is not None:
            raise OperationError(
                f"{other} of {drive} is under way: {verb} was not begun",
                kind="busy",
                drive=drive,
                remedy="ask again when it has ended; a stop need not wait",
            )
        self._busy[drive] = verb
        try:
            yield
        finally:
            del self._busy[drive]


def words_of(station: Station) -> tuple[Code, ...]:
    """The control word, and the status word that shows an inhibit and a fault."""
    rules = station.family.verbs
    assert rules is not None
    return (rules.control, *rules.enable.proofs)
