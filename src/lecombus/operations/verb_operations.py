"""Verbs: what a person wants of one drive, carried out step by step and proven.

Read what the verb depends on (a few settings, the words), let `drives.verbs` give the steps or
refuse, take them one by one in the control class, then read the drive's status words for a bounded
time until they show the effect. `inhibit` and `quick-stop` are stops: they wait for nothing and are
refused to no drive.

* An enable that the drive does not show, or that cannot be read, is taken back: otherwise the motor
  would start when a terminal is closed later.
* A reset ends with the drive inhibited, also when another client lifted the inhibit before its end.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import replace
from decimal import Decimal

from lecombus.drives import OperatingState, StopAction, Verb
from lecombus.drives.speeds import speed_step
from lecombus.drives.verb_facts import Known, rules_of
from lecombus.drives.verb_rules import InhibitStep, VerbStep
from lecombus.drives.verbs import (
    enable_objection,
    enable_shown,
    enable_steps,
    further_questions,
    has_fault,
    is_enabled,
    questions,
    reset_steps,
    shown_stops,
    states,
    stop_words,
)
from lecombus.errors import OperationError
from lecombus.leases import Use
from lecombus.operations.awaited_requests import refuse_for_gone_client
from lecombus.operations.context import OperationContext
from lecombus.operations.operation_reports import VerbReport, WriteReport
from lecombus.operations.stop_requests import STOP_REMEDY, Stops
from lecombus.operations.verb_reports import (
    Run,
    cut_off,
    enabled,
    fault_text,
    may_have_happened,
    not_shown,
    still_there,
    superseded,
    verb_report,
    without_fault,
)
from lecombus.operations.verb_steps import TROUBLE, USES, StoppedError, VerbSteps, words_of
from lecombus.operations.writes import Writes
from lecombus.schedule import Outcome

__all__ = ["Verbs"]

STOPS = {Verb.INHIBIT: StopAction.INHIBIT, Verb.QUICK_STOP: StopAction.QUICK_STOP}


class Verbs:
    """Carries out what a person wants of one drive."""

    def __init__(self, context: OperationContext, writes: Writes, stops: Stops) -> None:
        self._context = context
        self._stops = stops
        self._steps = VerbSteps(context, writes, stops)

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
        """Have a drive do something and return how it ended.

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
        station = self._context.station(drive)
        if verb in STOPS:
            return await self._stop_verb(drive, verb)
        rules_of(drive, station.family, verb)
        refuse_for_gone_client(drive)
        # Whether a latched drive takes a speed is looked at when it is written.
        self._context.leases.check(drive, Use.SETTING if verb is Verb.SET_SPEED else USES[verb])
        self._context.permissions.check_ready(drive)
        expires_at_s = None if expires_s is None else self._context.clock() + expires_s
        lasting = self._context.lasting(drive)
        run = Run(station, verb, lasting.stops_and_writes, lasting.stops, expires_at_s, verify)
        if self._context.requests.stopped_since_asked(drive):
            return verb_report(run, superseded(run))
        # A setpoint may follow another that is under way.
        alone = self._context.requests.alone
        with contextlib.nullcontext() if verb is Verb.SET_SPEED else alone(drive, verb):
            try:
                report = await self._whole(run, value, unit)
                report = await self._unless_stopped(run, report)
            except OperationError as exc:
                if verb is Verb.ENABLE:
                    self._context.why.enable_refused(drive, exc)
                raise
            if verb is Verb.ENABLE:
                if report.outcome.is_good:
                    self._context.leases.enabled(drive)
                self._context.why.enable_ended(report, taken_back=run.taken_back)
            return report

    async def _whole(self, run: Run, value: Decimal | None, unit: str) -> VerbReport:
        """Carry out a verb to its end; an enable that fails half way is taken back."""
        name, verb = run.station.name, run.verb
        try:
            if verb is Verb.SET_SPEED:
                assert value is not None
                return await self._set_speed(run, value, unit)
            known = await self._steps.learn(run, questions(name, run.station.family, verb))
            if verb is Verb.ENABLE:
                return await self._enable(run, known)
            return await self._reset_fault(run, known)
        except StoppedError:
            return verb_report(run, superseded(run))
        except TROUBLE as exc:
            if not run.written:
                raise
            report = cut_off(run, exc)
            if verb is Verb.ENABLE and not self._steps.stopped_meanwhile(run):
                with contextlib.suppress(*TROUBLE):
                    return await self._take_back(run, report)
            return verb_report(run, report)

    async def _unless_stopped(self, run: Run, report: VerbReport) -> VerbReport:
        """Take an enable back that a plain write ended, unless that did stop the drive."""
        name = run.station.name
        lasting = self._context.lasting(name)
        by_write = self._steps.stopped_meanwhile(run) and lasting.stops == run.said
        if run.verb is not Verb.ENABLE or not run.written or not by_write:
            return report
        is_done = lasting.stop_write_done
        if is_done is not None and await is_done():
            return report
        remedy = "the write that was to stop it was not done, or that is not known"
        ended = replace(superseded(run), remedy=remedy)
        with contextlib.suppress(*TROUBLE):
            return await self._take_back(run, ended)
        return report

    # ---- the verbs --------------------------------------------------------------------------

    async def _stop_verb(self, drive: str, verb: Verb) -> VerbReport:
        """Stop one drive; the code of its report shows whether it became an inhibit."""
        report = (await self._stops.stop(STOPS[verb], drive)).members[0]
        shown: tuple[OperatingState, ...] = ()
        if report.outcome is Outcome.VERIFIED:
            rules = self._context.requests.station(drive).family.stops
            inhibited = report.code == rules[StopAction.INHIBIT].code
            shown = (OperatingState.INHIBITED if inhibited else OperatingState.QUICK_STOP,)
        return VerbReport(
            drive, verb, report.outcome, report.reason, report.cause, report.kind, report.remedy,
            shown, reading=report.reading, proof=report.proof,
        )  # fmt: skip

    async def _set_speed(self, run: Run, value: Decimal, unit: str) -> VerbReport:
        station = run.station
        known = await self._steps.learn(run, questions(station.name, station.family, run.verb))
        further = await self._steps.learn(run, further_questions(known))
        known = replace(known, values={**known.values, **further.values})
        step = speed_step(known, value, unit)
        self._check_writable(run, (step,))
        report = await self._steps.take(run, step)
        shown = await self._steps.states(run) if report.outcome.is_good else ()
        return verb_report(
            run, report, states=shown, reading=report.reading if run.verify else None
        )

    async def _enable(self, run: Run, known: Known) -> VerbReport:
        steps = enable_steps(known)
        run.was_inhibited = StopAction.INHIBIT in {action for _, action in shown_stops(known)}
        if not steps:
            text, remedy = "it was enabled already", ""
            objection = enable_objection(known)
            if objection is not None:
                text, remedy = f"{text}, and not by the line: {objection}", objection.remedy
            report = replace(enabled(known), reason=text, remedy=remedy)
            return verb_report(run, report, states=states(known))
        self._check_writable(run, steps)
        failed = await self._steps.carry_out(run, steps)
        if failed is not None and not run.written:
            return verb_report(run, failed)
        # Also after a failed step: what was written may have enabled the drive already.
        known = await self._steps.watch(run, known, is_enabled, stop_words(run.station.family))
        if self._steps.stopped_meanwhile(run):
            return verb_report(run, superseded(run))
        if is_enabled(known):
            return verb_report(run, enabled(known), states=states(known))
        return await self._take_back(run, failed or not_shown(known))

    def _check_writable(self, run: Run, steps: Iterable[VerbStep]) -> None:
        """Refuse a verb before its first step where the roster closes any of its writes."""
        codes = [step.code for step in steps if not isinstance(step, InhibitStep)]
        self._context.permissions.check_verb(run.station.name, run.verb, codes)

    async def _take_back(self, run: Run, report: WriteReport) -> VerbReport:
        """Stop a drive that did not show its enable, so that it does not start by itself.

        It is inhibited, but where an inhibit may drop its load (`stop_fallback: none`) and only a
        quick stop held it before, it is put into that again.
        """
        name = run.station.name
        entry = self._context.entries.get(name)  # a reload may have taken it out of the roster
        may_drop = entry is not None and entry.stop_fallback == "none"
        holds = may_drop and not run.was_inhibited
        action = StopAction.QUICK_STOP if holds else StopAction.INHIBIT
        run.stops += 1
        undone = (await self._stops.stop(action, name)).members[0]
        run.taken_back = undone.outcome is Outcome.VERIFIED
        again = "put into quick stop again" if holds else "inhibited again"
        remedy = f"{report.remedy}; it was {again}, so that it does not start by itself"
        if not run.taken_back:
            remedy = f"the enable could not be taken back ({undone.reason}): {STOP_REMEDY}"
        shown = await self._steps.states(run)
        return verb_report(run, replace(report, remedy=remedy), states=shown)

    async def _reset_fault(self, run: Run, known: Known) -> VerbReport:
        steps = reset_steps(known)
        if not steps:
            report = without_fault(known, "no fault is active: nothing was sent")
            return verb_report(run, report, states=await self._steps.states(run))
        self._check_writable(run, steps)
        name = fault_text(known)
        failed = await self._steps.carry_out(run, steps)
        if failed is not None and not may_have_happened(failed):
            return verb_report(run, failed)
        known = await self._steps.watch(
            run, known, lambda now: not has_fault(now), words_of(run.station)
        )
        if has_fault(known):
            return verb_report(
                run,
                still_there(known, fault_text(known)),
                states=await self._steps.states(run),
            )
        if enable_shown(known) and not self._steps.stopped_meanwhile(run):
            # The inhibit was lifted at the keypad or by a plain write.
            again = await self._steps.inhibit(run)
            if not again.outcome.is_good:
                return verb_report(run, again, states=await self._steps.states(run))
        reason = (
            f"{name} was reset; the drive is inhibited: `lecombus enable {known.drive}` lets it run"
        )
        return verb_report(run, without_fault(known, reason), states=await self._steps.states(run))
