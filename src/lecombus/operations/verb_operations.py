"""Verbs: what a person wants of one drive, carried out step by step and proven.

Strategy: read what the verb depends on (a few settings, the words), let `drives` say the steps or
refuse, take them one by one in the control class, and look at the drive's status words until they
show it, for a bounded time. `inhibit` and `quick-stop` are stops and nothing else: they wait for
nothing and are refused to no drive.

Rules held here:

* The control word is taken when it is written, from what was last read or written on this line;
  while a write that moves it is under way it is read again. What another client wrote is not
  undone.
* A stop that is said while a verb is under way ends the verb before its next write; so does a plain
  write that means the same.
* An enable that the drive does not show, or that cannot be seen, is taken back: else the motor
  would start by itself when somebody closes a terminal later.
* A reset goes no further once somebody else has written the control word behind its inhibit, and
  is over when the drive shows that it is inhibited, whoever lifted the inhibit meanwhile.
* One enable or reset of a drive at a time; a second one is refused, not queued.

What must not live here: what the steps are (`drives.verbs`), HTTP, telegrams.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal

import anyio

from lecombus.drives import OperatingState, StopAction, Verb
from lecombus.drives.speeds import speed_step
from lecombus.drives.stops import usable_word
from lecombus.drives.verb_facts import Known, rules_of
from lecombus.drives.verb_steps import (
    BitsStep,
    InhibitStep,
    RestartStep,
    VerbStep,
    WriteStep,
)
from lecombus.drives.verbs import (
    enable_objection,
    enable_shown,
    enable_steps,
    has_fault,
    is_enabled,
    questions,
    reset_steps,
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
from lecombus.operations.reports import VerbReport, WriteReport
from lecombus.operations.requests import Requests
from lecombus.operations.stop_operations import STOP_REMEDY
from lecombus.operations.verb_reports import (
    GOOD,
    Run,
    cut_off,
    fault_text,
    lifted,
    may_have_happened,
    not_shown,
    still_there,
    superseded,
    told,
)
from lecombus.operations.wear import Wear
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import DriveState
from lecombus.schedule import Outcome, Priority
from lecombus.store import Store

__all__ = ["VerbOperations"]

EFFECT_WITHIN_S = 2.0
"""What a drive is given to show that it is enabled or that its fault is gone, seconds."""

LOOK_AGAIN_S = 0.1
"""Between two looks at a status word, seconds."""

BACK_WITHIN_S = 45.0
"""What a drive that starts anew is given until it is audited: a module's own codes take 0.5 s each,
and other drives' audits may come first (EDB2102EN 6.3). Less than a client waits for an answer."""

WORD_TRIES = 5
"""How often a control word is read again that others keep writing."""

STOPS = {Verb.INHIBIT: StopAction.INHIBIT, Verb.QUICK_STOP: StopAction.QUICK_STOP}
TROUBLE = (ExchangeError, LineError, OperationError, ScheduleError)


class VerbOperations(GroupOperations):
    """Adds to the operations on one drive and on several what a person says to one.

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

    async def verb(
        self,
        drive: str,
        verb: Verb,
        *,
        value: Decimal | None = None,
        unit: str = "",
        expires_s: float | None = None,
        verify: bool = False,
    ) -> VerbReport:
        """Have a drive do something and say what came of it.

        Args:
            drive: The drive's name.
            verb: What it shall do.
            value: For `set-speed`: the speed.
            unit: For `set-speed`: `Hz` or `%`.
            expires_s: Not begun after this long, seconds; a stop never expires.
            verify: For `set-speed`: read it back. The others are always proven.

        Raises:
            OperationError: It is refused; nothing was sent.
            ExchangeError: What it depends on could not be read; nothing was written.
            LineError: There is no line.
            QueueFullError: Too many requests wait.
        """
        station = self._requests.station(drive)
        if verb in STOPS:
            return await self._stop_verb(drive, verb)
        rules_of(drive, station.family, verb)
        self.check_ready(drive)
        expires_at_s = None if expires_s is None else self._clock() + expires_s
        run = Run(station, verb, self._stops_said[drive], expires_at_s, verify)
        try:
            if verb is Verb.SET_SPEED:
                assert value is not None
                return await self._set_speed(run, value, unit)
            with self._alone(drive, verb):
                known = await self._learn(station, questions(drive, station.family, verb))
                if verb is Verb.ENABLE:
                    return await self._enable(run, known)
                return await self._reset_fault(run, known)
        except TROUBLE as exc:
            if not run.written:
                raise
            report = cut_off(run, exc)
            if verb is Verb.ENABLE and not self._stopped_meanwhile(run):
                with contextlib.suppress(*TROUBLE):
                    return await self._take_back(run, report)
            return told(run, report)

    # ---- the verbs --------------------------------------------------------------------------

    async def _stop_verb(self, drive: str, verb: Verb) -> VerbReport:
        """Stop one drive; it may have become an inhibit, which its code tells."""
        report = (await self.stop(STOPS[verb], drive)).members[0]
        shown: tuple[OperatingState, ...] = ()
        if report.outcome is Outcome.VERIFIED:
            rules = self._requests.station(drive).family.stops
            inhibited = report.code == rules[StopAction.INHIBIT].code
            shown = (OperatingState.INHIBITED if inhibited else OperatingState.QUICK_STOP,)
        return VerbReport(
            drive, verb, report.outcome, report.reason, report.cause, report.kind, report.remedy,
            shown, reading=report.reading,
        )  # fmt: skip

    async def _set_speed(self, run: Run, value: Decimal, unit: str) -> VerbReport:
        station = run.station
        known = await self._learn(station, questions(station.name, station.family, run.verb))
        step = speed_step(known, value, unit)
        report = await self._take(run, step)
        shown = await self._states(station) if report.outcome in GOOD else ()
        return told(run, report, states=shown, reading=report.reading if run.verify else None)

    async def _enable(self, run: Run, known: Known) -> VerbReport:
        steps = enable_steps(known)
        if not steps:
            text, remedy = "it was enabled already", ""
            objection = enable_objection(known)
            if objection is not None:
                text, remedy = f"{text}, and not by the line: {objection}", objection.remedy
            report = WriteReport(known.drive, None, Outcome.VERIFIED, text, remedy=remedy)
            return told(run, report, states=await self._states(run.station))
        failed = await self._carry_out(run, steps)
        if failed is not None and not run.written:
            return told(run, failed)
        # Whatever became of the last step: what was written may have enabled it already.
        known = await self._watch(run, known, is_enabled)
        if self._stopped_meanwhile(run):
            return told(run, superseded(run), states=await self._states(run.station))
        if is_enabled(known):
            report = WriteReport(known.drive, None, Outcome.VERIFIED)
            return told(run, report, states=await self._states(run.station))
        return await self._take_back(run, failed or not_shown(known))

    async def _take_back(self, run: Run, report: WriteReport) -> VerbReport:
        """Inhibit a drive that did not show its enable, so that it does not start by itself."""
        undone = (await self.stop(StopAction.INHIBIT, run.station.name)).members[0]
        remedy = f"{report.remedy}; it was inhibited again, so that it does not start by itself"
        if undone.outcome is not Outcome.VERIFIED:
            remedy = f"the enable could not be taken back ({undone.reason}): {STOP_REMEDY}"
        shown = await self._states(run.station)
        return told(run, replace(report, remedy=remedy), states=shown)

    async def _reset_fault(self, run: Run, known: Known) -> VerbReport:
        steps = reset_steps(known)
        if not steps:
            report = WriteReport(
                known.drive, None, Outcome.VERIFIED, "no fault is active: nothing was sent"
            )
            return told(run, report, states=await self._states(run.station))
        name = fault_text(known)
        failed = await self._carry_out(run, steps)
        if failed is not None and not may_have_happened(failed):
            return told(run, failed)
        known = await self._watch(run, known, lambda now: not has_fault(now))
        if has_fault(known):
            return told(
                run, still_there(known, fault_text(known)), states=await self._states(run.station)
            )
        if enable_shown(known) and not self._stopped_meanwhile(run):
            # Somebody lifted the inhibit meanwhile, at the keypad or by a plain write.
            again = await self._inhibit(run)
            if again.outcome not in GOOD:
                return told(run, again, states=await self._states(run.station))
        reason = (
            f"{name} was reset; the drive is inhibited: `lecombus enable {known.drive}` lets it run"
        )
        report = WriteReport(known.drive, None, Outcome.VERIFIED, reason)
        return told(run, report, states=await self._states(run.station))

    # ---- steps ------------------------------------------------------------------------------

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
        word = usable_word(self._words.get(name))
        for _ in range(WORD_TRIES):
            if word is not None:
                break
            await self._requests.read(run.station, step.code, Priority.INTERACTIVE)
            word = usable_word(self._words.get(name))
        if word is None:
            raise OperationError(
                f"the control word {step.code} of {name} cannot be read, or others keep writing "
                "it: its bits are not guessed",
                kind="no-control-word", drive=name, code=str(step.code),
                remedy="ask again when nobody else writes it",
            )  # fmt: skip
        if step.applied(word) == word:
            return WriteReport(name, step.code, Outcome.DONE)
        # Nothing is waited for between the look at the word and its place in the queue.
        if self._stopped_meanwhile(run):
            return superseded(run)
        if self._lifted_meanwhile(run):
            return lifted(run)
        return await self._write(run, step.code, Value.hexadecimal(step.applied(word), 4).raw)

    async def _write(self, run: Run, code: Code, raw: str) -> WriteReport:
        name = run.station.name
        wire = self.permitted(name, run.station, code, raw)
        ending = self.submit_write(run.station, code, wire, run.expires_at_s, verify=run.verify)
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
            while self._store.drive(name).state is not DriveState.ONLINE:  # noqa: ASYNC110
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

    async def _watch(self, run: Run, before: Known, shown: Callable[[Known], bool]) -> Known:
        """Look at the words until they show something, or for as long as they may take."""
        until_s = self._clock() + EFFECT_WITHIN_S
        while True:
            seen = await self._learn(run.station, words_of(run.station))
            known = Known(before.drive, before.family, {**before.values, **seen.values})
            if shown(known) or self._clock() >= until_s or self._stopped_meanwhile(run):
                return known
            await anyio.sleep(LOOK_AGAIN_S)

    async def _states(self, station: Station) -> tuple[OperatingState, ...]:
        """Name what the drive shows now; nothing where it cannot be read."""
        with contextlib.suppress(*TROUBLE):
            return states(await self._learn(station, (*words_of(station), *station.family.words)))
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
