"""Verbs: what a person wants of one drive, carried out step by step and proven.

Strategy: read what the verb depends on (a few settings, the words), let `drives` say the steps or
refuse, take them one by one in the control class, and look at the drive's status words until they
show it, for a bounded time. `inhibit` and `quick-stop` are stops and nothing else: they wait for
nothing and are refused to no drive.

Rules held here:

* The control word is taken when it is written, from what was last read or written on this line;
  while a write that moves it is under way it is read again. What another client wrote is not
  undone.
* A stop that is said while a verb is under way ends the verb before its next write.
* An enable that the drive does not show is taken back: else the motor would start by itself when
  somebody closes a terminal later.
* One enable or reset of a drive at a time; a second one is refused, not queued.

What must not live here: what the steps are (`drives.verbs`), HTTP, telegrams.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
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
    enable_steps,
    fault_number,
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
from lecombus.operations.group_operations import STOP_REMEDY, GroupOperations
from lecombus.operations.reports import VerbReport, WriteReport
from lecombus.operations.requests import Requests
from lecombus.operations.wear import Wear
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.readings import DriveState, Reading
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
GOOD = (Outcome.DONE, Outcome.VERIFIED)
TROUBLE = (ExchangeError, LineError, OperationError, ScheduleError)


@dataclass(slots=True)
class _Run:
    """One verb under way.

    Args:
        station: The drive.
        verb: What it is told to do.
        stops: How many stops of the drive had been said when it began, its own included.
        expires_at_s: No write of it is begun after this.
        verify: Read back what is written.
        written: What went out.
    """

    station: Station
    verb: Verb
    stops: int
    expires_at_s: float | None = None
    verify: bool = False
    written: list[tuple[Code, str]] = field(default_factory=list)


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
        run = _Run(station, verb, self._stops_said[drive], expires_at_s, verify)
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
            return told(run, cut_off(run, exc))

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

    async def _set_speed(self, run: _Run, value: Decimal, unit: str) -> VerbReport:
        station = run.station
        known = await self._learn(station, questions(station.name, station.family, run.verb))
        step = speed_step(known, value, unit)
        report = await self._take(run, step)
        shown = await self._states(station) if report.outcome in GOOD else ()
        return told(run, report, states=shown, reading=report.reading if run.verify else None)

    async def _enable(self, run: _Run, known: Known) -> VerbReport:
        steps = enable_steps(known)
        if not steps:
            report = WriteReport(known.drive, None, Outcome.VERIFIED, "it was enabled already")
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
        return await self._take_back(run, known, failed or not_shown(known))

    async def _take_back(self, run: _Run, known: Known, report: WriteReport) -> VerbReport:
        """Inhibit a drive that did not show its enable, so that it does not start by itself."""
        undone = (await self.stop(StopAction.INHIBIT, known.drive)).members[0]
        remedy = f"{report.remedy}; it was inhibited again, so that it does not start by itself"
        if undone.outcome is not Outcome.VERIFIED:
            remedy = f"the enable could not be taken back ({undone.reason}): {STOP_REMEDY}"
        shown = await self._states(run.station)
        return told(run, replace(report, remedy=remedy), states=shown)

    async def _reset_fault(self, run: _Run, known: Known) -> VerbReport:
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
        reason = (
            f"{name} was reset; the drive is inhibited: `lecombus enable {known.drive}` lets it run"
        )
        report = WriteReport(known.drive, None, Outcome.VERIFIED, reason)
        return told(run, report, states=await self._states(run.station))

    # ---- steps ------------------------------------------------------------------------------

    async def _carry_out(self, run: _Run, steps: Sequence[VerbStep]) -> WriteReport | None:
        """Take steps one after the other; give the report of the one that was not done."""
        for step in steps:
            report = await self._take(run, step)
            if report.outcome not in GOOD:
                return report
        return None

    async def _take(self, run: _Run, step: VerbStep) -> WriteReport:
        if self._stopped_meanwhile(run):
            return superseded(run)
        if isinstance(step, InhibitStep):
            return await self._inhibit(run)
        if isinstance(step, WriteStep):
            return await self._write(run, step.code, step.value.raw)
        report = await self._change_bits(run, step)
        if isinstance(step, RestartStep) and may_have_happened(report):
            return await self._back_again(run, step)
        return report

    async def _inhibit(self, run: _Run) -> WriteReport:
        """Inhibit the drive as part of a verb; without proof the verb goes no further."""
        name = run.station.name
        run.stops += 1
        report = (await self.stop(StopAction.INHIBIT, name)).members[0]
        if report.outcome is Outcome.VERIFIED:
            return report
        reason = f"{name} could not be inhibited: {report.reason}"
        return replace(report, outcome=Outcome.REFUSED, kind="not-in-effect", reason=reason)

    async def _change_bits(self, run: _Run, step: BitsStep) -> WriteReport:
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
        return await self._write(run, step.code, Value.hexadecimal(step.applied(word), 4).raw)

    async def _write(self, run: _Run, code: Code, raw: str) -> WriteReport:
        name = run.station.name
        wire = self.permitted(name, run.station, code, raw)
        ending = self.submit_write(run.station, code, wire, run.expires_at_s, verify=run.verify)
        report = self.report(name, code, ending, *await ending.wait())
        if ending.was_sent and report.kind != "nak":
            run.written.append((code, wire.raw))
        return await self._refusals.explain(report, run.station, wire)

    async def _back_again(self, run: _Run, step: RestartStep) -> WriteReport:
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

    async def _watch(self, run: _Run, before: Known, shown: Callable[[Known], bool]) -> Known:
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

    def _stopped_meanwhile(self, run: _Run) -> bool:
        return self._stops_said[run.station.name] != run.stops

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


def may_have_happened(report: WriteReport) -> bool:
    """Whether a step was done as far as anybody can tell: its acknowledgement may be lost."""
    unheard = report.outcome is Outcome.UNKNOWN and report.kind == "no-answer"
    return report.outcome in GOOD or unheard


def cut_off(run: _Run, exc: Exception) -> WriteReport:
    """What is told of a verb that had begun to write when something went wrong."""
    name = run.station.name
    return WriteReport(
        name, None, Outcome.UNKNOWN,
        f"{run.verb} was begun and not brought to its end: {exc}",
        kind="line-lost" if isinstance(exc, LineError) else "no-answer",
        remedy=f"what was written stands; `lecombus status {name}` says what the drive shows. Take "
        "it for one that may start",
    )  # fmt: skip


def superseded(run: _Run) -> WriteReport:
    """What is told of a verb in whose way a stop came."""
    return WriteReport(
        run.station.name, None, Outcome.SUPERSEDED,
        f"a stop came while {run.verb} was under way: nothing more was written",
        kind="superseded",
    )  # fmt: skip


def not_shown(known: Known) -> WriteReport:
    """What is told of a drive that was enabled and does not show it."""
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    proof = next(iter(rules.enable.proofs))
    reads = known.values[proof].raw if proof in known.values else "nothing"
    cause, remedy = f"probably {rules.enable.otherwise}", "put that in order, then enable it again"
    if has_fault(known):
        cause, remedy = "it has a fault now", f"`lecombus why {known.drive}` says which"
    return WriteReport(
        known.drive,
        rules.enable.code,
        Outcome.REFUSED,
        f"{known.drive} took the enable and does not show it: {proof} reads {reads}",
        cause=cause,
        kind="not-in-effect",
        remedy=remedy,
    )


def fault_text(known: Known) -> str:
    """Name a fault by its number, what the keypad shows and what it means."""
    number = fault_number(known)
    if number is None:
        return "the fault"
    fault = known.family.fault(number)
    if fault is None:
        return f"fault {number}"
    return f"fault {number} ({', '.join(filter(None, (fault.keypad, str(fault.meaning))))})"


def still_there(known: Known, fault: str) -> WriteReport:
    """What is told of a fault that a reset did not end."""
    return WriteReport(
        known.drive, None, Outcome.REFUSED,
        f"the reset was taken, but {fault} is still there or has come again",
        cause="its cause lasts",
        kind="not-in-effect",
        remedy=f"`lecombus why {known.drive}` says what to do about it; the drive is inhibited",
    )  # fmt: skip


def told(
    run: _Run,
    report: WriteReport,
    *,
    states: tuple[OperatingState, ...] = (),
    reading: Reading | None = None,
) -> VerbReport:
    """Tell of a verb what is known of its last step."""
    return VerbReport(
        run.station.name, run.verb, report.outcome, report.reason, report.cause, report.kind,
        report.remedy, states, tuple(run.written), reading,
    )  # fmt: skip
