"""The steps that a verb takes on one drive, or its refusal with the setting to change.

Everything here is a function of what is known (`Known`: the family's rules and the values just read
from the drive). A verb that the drive's settings would leave without effect is refused before
anything is sent, with the setting and its right value.

Safety: a drive with a fault is not enabled; a fault is reset only on a drive that is inhibited, so
that no reset starts a motor. Setpoints are in `speeds`.

Source: EDB2102EN 5, 6.2 to 6.5, 8.2; CMVLC401A 4.2, 7.2, table 9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

from .family import Family
from .stops import StopAction, usable_word
from .verb_facts import (
    Known,
    active_set_word,
    codes_in_force,
    control_bits,
    control_word,
    demand_met,
    objected,
    objections,
    rules_of,
)
from .verb_rules import (
    Access,
    BitsStep,
    Demand,
    InhibitStep,
    RestartStep,
    Verb,
    VerbRules,
    VerbStep,
    WriteStep,
)
from .words import OperatingState, join_states

__all__ = [
    "acts_on_setpoints",
    "enable_objection",
    "enable_shown",
    "enable_steps",
    "fault_number",
    "further_questions",
    "has_fault",
    "held_stop_codes",
    "held_stops",
    "is_enabled",
    "may_move",
    "questions",
    "reset_steps",
    "shown_stops",
    "states",
    "status_shows_quick_stop",
    "stop_words",
    "takes_control",
]

NOT_ENABLED = frozenset(
    {
        OperatingState.INHIBITED,
        OperatingState.OPERATION_INHIBITED,
        OperatingState.START_LOCK,
        OperatingState.INITIALISING,
        OperatingState.POWER_OFF,
    }
)
"""What a status word may show of a drive that does not follow an enable."""


def questions(drive: str, family: Family, verb: Verb) -> tuple[Code, ...]:
    """Return the codes whose values must be known before a verb is carried out.

    Raises:
        OperationError: `no-verb`.
    """
    rules = rules_of(drive, family, verb)
    return tuple(dict.fromkeys(_questions(family, rules, verb)))


def _questions(family: Family, rules: VerbRules, verb: Verb) -> Iterator[Code]:
    yield rules.control
    if family.configured_by is not None:
        yield family.configured_by
    wanted = {Verb.ENABLE: {Access.ENABLE, Access.CONTROL_WORD}, Verb.SET_SPEED: {Access.SETPOINT}}
    for demand in rules.demands:
        if demand.access & wanted.get(verb, {Access.RESET, Access.CONTROL_WORD}):
            yield demand.condition.code
    if verb is not Verb.SET_SPEED:
        yield from rules.enable.proofs
    if verb is Verb.ENABLE:
        yield from stop_words(family)
    if verb is Verb.RESET_FAULT:
        yield from (code for code in (rules.reset.code, rules.reset.number) if code is not None)
    if verb is Verb.SET_SPEED:
        yield from _speed_settings(rules)
        yield from (rule.least for rule in rules.setpoints if rule.least is not None)
        word = active_set_word(family)
        if word is not None:
            yield word  # last, so that it is the latest


def _speed_settings(rules: VerbRules) -> Iterator[Code]:
    """Return what a speed depends on that may differ between parameter sets."""
    for rule in rules.setpoints:
        if rule.when is not None:
            yield rule.when.code
        if rule.full_scale is not None:
            yield rule.full_scale


def further_questions(known: Known) -> tuple[Code, ...]:
    """Return what of a speed's settings must be known of further parameter sets.

    Args:
        known: The answers to `questions`.
    """
    rules = rules_of(known.drive, known.family, Verb.SET_SPEED)
    wanted = (
        one for code in _speed_settings(rules) for one in codes_in_force(known, code) if one != code
    )
    return tuple(dict.fromkeys(wanted))


# ---- enable ---------------------------------------------------------------------------------


def enable_steps(known: Known) -> tuple[VerbStep, ...]:
    """Return how a drive is enabled: quick stop released first, then the inhibit lifted.

    Returns:
        The steps; none where every word shows that neither inhibit nor quick stop is there. Where
        no status word shows a quick stop, the control word is written in any case: the drive's
        watchdog may have set one that a control word read back as written does not show. Unless
        the motor turns, its quick stop is set first then, as only a change may lift it.

    Raises:
        OperationError: `fault-active`, `setting`, `no-control-word`, `no-verb`.
    """
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    if has_fault(known):
        raise OperationError(
            f"{known.drive} has an active fault: it is not enabled, nothing was sent",
            kind="fault-active",
            drive=known.drive,
            remedy=f"reset it first (lecombus reset-fault {known.drive}); "
            f"`lecombus why {known.drive}` says what it is",
        )
    steps: list[VerbStep] = []
    bits = control_bits(known, rules)
    word = control_word(known, rules)
    shown = shown_stops(known)
    inhibited = not enable_shown(known) or any(one is StopAction.INHIBIT for _, one in shown)
    quick_stopped = any(one is StopAction.QUICK_STOP for _, one in shown)
    objection = next(objections(known, rules, Access.CONTROL_WORD), None)
    if (quick_stopped or word & bits.quick_stop) and objection is not None:
        raise objected(known, objection)
    if objection is None:
        unseen = not status_shows_quick_stop(known.configured)
        may_be_stopped = quick_stopped or (unseen and (inhibited or _is_at_zero(known)))
        if may_be_stopped and not word & bits.quick_stop:
            # Only a change may lift what did not come by this word: the watchdog's, for one. A
            # motor that turns is not stopped for that.
            steps.append(BitsStep(bits.code, set_mask=bits.quick_stop))
        if quick_stopped or word & (bits.quick_stop | bits.inhibit) or unseen:
            mask = bits.quick_stop | bits.inhibit
            steps.append(BitsStep(bits.code, clear_mask=mask, always=unseen))
    if inhibited:
        steps.append(WriteStep(rules.enable.code, rules.enable.value))
    if steps:
        demand_met(known, rules, Access.ENABLE)
    return tuple(steps)


def _is_at_zero(known: Known) -> bool:
    """Return whether a status word reports that the motor does not turn, or output frequency 0."""
    shown = {
        state
        for code, info in known.configured.words.items()
        if (word := known.word(code)) is not None
        for state in info.shown_states(word)
    }
    return bool(shown & {OperatingState.ZERO_SPEED, OperatingState.OUTPUT_FREQUENCY_0})


def enable_objection(known: Known) -> OperationError | None:
    """Say which setting keeps the line from enabling a drive, as of one that runs without it."""
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    demand = next(objections(known, rules, Access.ENABLE), None)
    return None if demand is None else objected(known, demand)


def enable_shown(known: Known) -> bool:
    """Return whether the drive's status words show that nothing inhibits it."""
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    return all(
        code in known.values and proof.holds(known.values[code])
        for code, proof in rules.enable.proofs.items()
    )


def is_enabled(known: Known) -> bool:
    """Return whether the drive shows that it is enabled: no inhibit, no fault, no quick stop.

    Its control word counts only where its settings let the line write it; then it must be known.
    """
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    word_known = usable_word(known.word(rules.control)) is not None
    word_known = word_known or not _line_controls(known, rules)
    return enable_shown(known) and word_known and not has_fault(known) and not shown_stops(known)


def stop_words(family: Family) -> tuple[Code, ...]:
    """Return the codes whose values can show that a drive is inhibited or in quick stop."""
    rules = family.verbs
    found = [rules.control] if rules is not None else []
    found += family.words
    for stop in family.stops.values():
        found += stop.proofs
    return tuple(dict.fromkeys(found))


def shown_stops(known: Known) -> tuple[tuple[Code, StopAction], ...]:
    """Return the codes that were read and show a stop, and which.

    The control word shows one only where the drive's settings let the line write it.
    """
    rules = rules_of(known.drive, known.family, Verb.ENABLE)
    bits = control_bits(known, rules)
    found: list[tuple[Code, StopAction]] = []
    for action, rule in known.family.stops.items():
        found += [
            (code, action)
            for code, proof in rule.proofs.items()
            if code in known.values and proof.holds(known.values[code])
        ]
    if (known.word(bits.code) or 0) & bits.inhibit:
        found.append((bits.code, StopAction.INHIBIT))
    for code, info in known.configured.words.items():
        word = known.word(code)
        if word is not None and NOT_ENABLED & set(info.shown_states(word)):
            found.append((code, StopAction.INHIBIT))
    if not _line_controls(known, rules):
        found = [one for one in found if one[0] != bits.code]
    return tuple(dict.fromkeys(found))


def _line_controls(known: Known, rules: VerbRules) -> bool:
    return next(objections(known, rules, Access.CONTROL_WORD), None) is None


def status_shows_quick_stop(family: Family) -> bool:
    """Return whether a status word of the family shows a quick stop."""
    return any(
        rule.state is OperatingState.QUICK_STOP
        for word in family.words.values()
        for rule in word.states
    )


def held_stops(known: Known, said: Callable[[Code], Value | None]) -> frozenset[StopAction]:
    """Return the stops that the line has set and the drive shows: no setpoint moves it then.

    The line must have written the command, because C0040 may also read 0 while a terminal inhibits
    the drive; it must read as a stop left it; and a status word must show the stop where one of the
    family can. No status word shows the quick stop of 8200 vector and 93XX: there the settings must
    read as the drive needs them to follow its control word.

    Args:
        known: What the drive has shown just now, of `held_stop_codes`.
        said: Gives what the line wrote last to a code; None: nothing that still counts.

    Source: EDB2102EN 5, 6.2.1, 8.2 (C0040, C0068, C0135, C0150); CMVLC401A 4.2, table 9.
    """
    found = set()
    for action, rule in known.family.stops.items():
        reads = {code: known.values.get(code) for code in rule.proofs}
        commands = (reads.pop(rule.code, None), said(rule.code))
        proof = rule.proofs.get(rule.code)
        if proof is None or not all(one is not None and proof.holds(one) for one in commands):
            continue
        if not reads:
            shown = _follows_control_word(known)
        else:
            shows = [
                rule.proofs[code].holds(value) for code, value in reads.items() if value is not None
            ]
            shown = bool(shows) and all(shows)
        if shown:
            found.add(action)
    return frozenset(found)


def held_stop_codes(family: Family) -> tuple[Code, ...]:
    """Return the codes that `held_stops` needs: settings, status words and commands."""
    codes = [one.condition.code for one in _control_word_demands(family)]
    for rule in family.stops.values():
        codes += [*[code for code in rule.proofs if code != rule.code][:1], rule.code]
    return tuple(dict.fromkeys(codes))


def takes_control(family: Family, code: Code, value: Value) -> bool:
    """Return whether a value of a setting is what the line needs to control the drive."""
    demands = family.verbs.demands if family.verbs is not None else ()
    conditions = [one.condition for one in demands if code in _in_sets(family, one.condition.code)]
    return bool(conditions) and all(one.holds(value) for one in conditions)


def acts_on_setpoints(family: Family, code: Code) -> bool:
    """Return whether a setting limits setpoints, is their 100 %, or selects one of them.

    A motor that runs changes its speed with it, at a setpoint that stays the same.
    """
    if family.verbs is None:
        return False
    least = (rule.least for rule in family.verbs.setpoints if rule.least is not None)
    return any(code in _in_sets(family, one) for one in (*_speed_settings(family.verbs), *least))


def may_move(family: Family, code: Code) -> bool:
    """Return whether a write of a code can move a drive, or change how fast it runs.

    Not only commands do that: a code that says who controls a drive (C0001, C0005, P420) hands a
    running motor to its terminals, and one that limits or selects setpoints (C0011, C0127, P102,
    P103) changes its speed. Nor is it known of a code that is not described.
    """
    info = family.info(code)
    controls = info is not None and info.control_source
    return controls or family.is_command(code) or acts_on_setpoints(family, code)


def _in_sets(family: Family, code: Code) -> list[Code]:
    """Return a code and its like in the further parameter sets."""
    return [Code(code.number + offset, code.subcode) for offset in family.set_offsets]


def _follows_control_word(known: Known) -> bool:
    demands = _control_word_demands(known.family)
    return bool(demands) and all(
        one.condition.holds(known.values.get(one.condition.code)) for one in demands
    )


def _control_word_demands(family: Family) -> list[Demand]:
    demands = family.verbs.demands if family.verbs is not None else ()
    return [one for one in demands if Access.CONTROL_WORD in one.access]


# ---- reset-fault ----------------------------------------------------------------------------


def has_fault(known: Known) -> bool:
    """Return whether a status word that was read reports an active fault."""
    words = ((code, known.word(code)) for code in known.family.words)
    return any(word is not None and known.family.active_fault(code, word) for code, word in words)


def fault_number(known: Known) -> int | None:
    """Return the number of the fault, None where it is not known."""
    rules = rules_of(known.drive, known.family, Verb.RESET_FAULT)
    number = known.number(rules.reset.number)
    return int(number) if number else None


def reset_steps(known: Known) -> tuple[VerbStep, ...]:
    """Return how a fault is reset: always on an inhibited drive, so that no motor starts by it.

    Returns:
        The steps; none where no fault is active.

    Raises:
        OperationError: `setting`, `no-control-word`, `no-verb`.
    """
    rules = rules_of(known.drive, known.family, Verb.RESET_FAULT)
    if not has_fault(known):
        return ()
    demand_met(known, rules, Access.RESET)
    bits, reset = control_bits(known, rules), rules.reset
    if reset.code is None:
        control_word(known, rules)
        # The enable that resets it finds a quick stop, whether or not the drive restarts.
        return (
            InhibitStep(),
            BitsStep(bits.code, set_mask=bits.quick_stop | bits.inhibit),
            RestartStep(bits.code, set_mask=bits.quick_stop, clear_mask=bits.inhibit),
            InhibitStep(),
        )
    if reset.code in known.values or not bits.trip_reset:
        assert reset.value is not None
        return (InhibitStep(), WriteStep(reset.code, reset.value))
    demand_met(known, rules, Access.CONTROL_WORD)
    control_word(known, rules)
    down = BitsStep(bits.code, clear_mask=bits.trip_reset)
    return (InhibitStep(), down, BitsStep(bits.code, set_mask=bits.trip_reset), down)


# ---- states ---------------------------------------------------------------------------------


def states(known: Known) -> tuple[OperatingState, ...]:
    """Return what the drive's words show; quick stop by the command if no status word shows it."""
    family, rules = known.configured, known.family.verbs
    shown = [
        info.shown_states(word)
        for code, info in family.words.items()
        if (word := known.word(code)) is not None
    ]
    word = known.word(rules.control) if rules is not None else None
    if rules is not None and shown and word and word & control_bits(known, rules).quick_stop:
        shown.append((OperatingState.QUICK_STOP,))
    return join_states(shown)
