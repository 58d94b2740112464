"""What is written for a speed: which code, in which unit, within which range.

A speed has a unit, `Hz` or `%` of the highest frequency or speed; without it a number could mean
either. It is converted where the drive has a setting that says what 100 % is, and held against the
range in force, so that a value out of it is refused with the range and not by a bare NAK. A drive
that would not look at its setpoint, because a JOG value is selected, is not given one.

What must not live here: the other verbs (`verbs`).

Source: EDB2102EN 5, 6.4.1, 6.5, 8.2 (C0046, C0127, C0141); CMVLC401A 4.2, table 9.
"""

from __future__ import annotations

from decimal import ROUND_HALF_EVEN, Decimal

from lecombus.errors import OperationError
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from .verb_facts import Known, control_bits, control_word, demand_met, holds, rules_of
from .verb_rules import Access, SetpointRule, Verb, VerbRules
from .verb_steps import WriteStep

__all__ = ["speed_step"]

MOST = 1_000_000
"""No unit gives a speed more than this; what is more could not even be converted exactly."""


def speed_step(known: Known, number: Decimal, unit: str) -> WriteStep:
    """Say what is written for a speed.

    Args:
        known: The drive.
        number: The speed.
        unit: `Hz` or `%`; of the highest frequency or speed.

    Raises:
        OperationError: `bad-value`: wrong unit or out of range; `setting`; `no-verb`.
    """
    rules = rules_of(known.drive, known.family, Verb.SET_SPEED)
    demand_met(known, rules, Access.SETPOINT)
    _refuse_jog(known, rules)
    in_force = [rule for rule in rules.setpoints if holds(known, rule.when)]
    if not in_force:
        raise _no_way(known, rules)
    rule = next((one for one in in_force if one.unit == unit), in_force[0])
    full = _setting(known, rule.full_scale)
    if rule.unit != unit and (full is None or unit not in ("Hz", "%")):
        raise _bad_speed(known, rule, in_force, f"{number} {unit} is no speed of {known.drive}")
    if abs(number) > MOST:
        raise _bad_speed(known, rule, in_force, f"{number:.3G} {unit} is no speed of anything")
    given = number if rule.unit == unit or full is None else _converted(number, rule, full)
    low, high = _bounds(known, rule, full)
    if not low <= given <= high:
        told = f"{number} {unit}" if rule.unit == unit else f"{number} {unit} ({given} {rule.unit})"
        raise _bad_speed(known, rule, in_force, f"{told} is out of the range of {known.drive}")
    if given % rule.step:
        raise _bad_speed(known, rule, in_force, f"{number} {unit} is finer than {rule.step}")
    return WriteStep(rule.code, Value.decimal(given))


def _converted(number: Decimal, rule: SetpointRule, full: Decimal) -> Decimal:
    """Convert between Hz and % of the highest frequency, to what the drive can hold."""
    exact = number * full / 100 if rule.unit == "Hz" else number * 100 / full
    return (exact / rule.step).quantize(Decimal(1), ROUND_HALF_EVEN) * rule.step


def _bounds(known: Known, rule: SetpointRule, full: Decimal | None) -> tuple[Decimal, Decimal]:
    """Give the range in force, which settings of the drive may make narrower."""
    low = max(rule.low, _setting(known, rule.least) or rule.low)
    high = rule.high if rule.unit == "%" or full is None else min(rule.high, full)
    return low, high


def _setting(known: Known, code: Code | None) -> Decimal | None:
    """Give a setting that bounds or scales a speed; one of 0 does neither."""
    number = known.number(code) if code is not None else None
    return Decimal(number) if number is not None and number > 0 else None


def _refuse_jog(known: Known, rules: VerbRules) -> None:
    """A setpoint that the drive does not look at must not be called done."""
    bits = control_bits(known, rules)
    if not bits.jog:
        return
    jog = control_word(known, rules) & bits.jog
    if jog:
        raise OperationError(
            f"{known.drive} takes its speed from JOG value {jog}, by the low bits of {bits.code}: "
            "a setpoint would have no effect, nothing was sent",
            kind="setting",
            drive=known.drive,
            code=str(bits.code),
            remedy=f"clear bits 0 and 1 of {bits.code}",
        )


def _no_way(known: Known, rules: VerbRules) -> OperationError:
    when = next(rule.when for rule in rules.setpoints if rule.when is not None)
    right = sorted(
        number for rule in rules.setpoints if rule.when is not None for number in rule.when.values
    )
    value = known.values.get(when.code)
    reads = f"reads {value.raw}" if value is not None else "is not there"
    return OperationError(
        f"{known.drive} takes no setpoint from the line: {when.code} {reads}",
        kind="setting",
        drive=known.drive,
        code=str(when.code),
        remedy=f"set {when.code} = {' or '.join(map(str, right))}",
    )


def _bad_speed(
    known: Known, rule: SetpointRule, in_force: list[SetpointRule], what: str
) -> OperationError:
    ranges = []
    for one in in_force:
        full = _setting(known, one.full_scale)
        low, high = _bounds(known, one, full)
        by = f" ({one.full_scale} = {full} Hz)" if full is not None and one.unit == "Hz" else ""
        ranges.append(f"{low} to {high} {one.unit}{by}")
    remedy = f"it takes {' or '.join(ranges)}, in steps of {rule.step}"
    if len(in_force) == 1 and _setting(known, rule.full_scale) is not None:
        remedy += f", or {'%' if rule.unit == 'Hz' else 'Hz'} of that"
    bits = control_bits(known, rules_of(known.drive, known.family, Verb.SET_SPEED))
    if bits.direction and rule.low >= 0:
        place = bits.direction.bit_length() - 1
        remedy += f"; its direction of rotation is bit {place} of {bits.code}, not a sign"
    return OperationError(
        f"{what}: nothing was sent",
        kind="bad-value",
        drive=known.drive,
        code=str(rule.code),
        remedy=remedy,
    )
