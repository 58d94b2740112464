"""What is written for a speed: which code, in which unit, within which range.

A speed has a unit, `Hz` or `%` of the highest frequency or speed; without it a number could mean
either. It is converted where the drive has a setting that defines 100 %, and compared with the
range in force, so that a value outside is refused with the range and not by a bare NAK. That
setting is the one of the parameter set in use, which the status word shows; where no word shows it
and the sets differ, nothing is converted. A drive that ignores its setpoint, because a JOG value is
selected, is given none.

Source: EDB2102EN 5, 6.1, 6.4.1, 6.5, 8.2 (C0046, C0127, C0141); CMVLC401A 4.2, table 9.
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import ROUND_HALF_EVEN, Decimal

from lecombus import parameters
from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

from .verb_facts import (
    Known,
    control_bits,
    control_word,
    demand_met,
    holds,
    rules_of,
    settings_in_force,
)
from .verb_rules import Access, SetpointRule, Verb, VerbRules, WriteStep

__all__ = ["speed_step"]

MOST = 1_000_000
"""No unit gives a speed more than this; what is more could not even be converted exactly."""

FINEST = Decimal("0.0001")
"""No number on the wire is finer (EDB2102EN 8.3.1)."""

CONVERTED = Decimal("0.1")
"""What a converted speed is rounded to where the manual gives no step: its own example of C0046 has
one decimal place (EDB2102EN 8.3.2), and a drive may refuse more."""


def speed_step(known: Known, number: Decimal, unit: str) -> WriteStep:
    """Return what is written for a speed.

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
    scale = _scale(known, rule)
    if rule.unit != unit and (not scale or unit not in ("Hz", "%")):
        raise _bad_speed(known, rule, in_force, f"{number} {unit} is not a speed of {known.drive}")
    if abs(number) > MOST:
        raise _bad_speed(known, rule, in_force, f"{number:.3G} {unit} is not a speed of anything")
    given = number
    if rule.unit != unit:
        if len(set(scale.values())) > 1 or len(scale) < len(_scale_settings(known, rule)):
            raise _unknown_set(known, scale, f"{number} {unit}", rule)
        given = _converted(number, rule, next(iter(scale.values())))
    low, high = _bounds(known, rule, scale)
    if not low <= given <= high:
        given_as = (
            f"{number} {unit}" if rule.unit == unit else f"{number} {unit} ({given} {rule.unit})"
        )
        raise _bad_speed(known, rule, in_force, f"{given_as} is out of the range of {known.drive}")
    finest = rule.step or FINEST
    if given % finest:
        raise _bad_speed(known, rule, in_force, f"{number} {unit} is finer than {finest}")
    decimals = parameters.rules_of(known.family.protocol).decimals
    return WriteStep(rule.code, Value.decimal(given, decimals))


def _converted(number: Decimal, rule: SetpointRule, full: Decimal) -> Decimal:
    """Convert between Hz and % of the highest frequency, to what the drive can hold."""
    exact = number * full / 100 if rule.unit == "Hz" else number * 100 / full
    step = rule.step or CONVERTED
    return (exact / step).quantize(Decimal(1), ROUND_HALF_EVEN) * step


def _bounds(
    known: Known, rule: SetpointRule, scale: Mapping[Code, Decimal]
) -> tuple[Decimal, Decimal]:
    """Return the range in force, which settings of the drive may make narrower.

    Where the parameter set in use is not known the widest counts: a frequency means the same in
    all of them, and the drive holds its own limit.
    """
    low = max(rule.low, _positive(known.number(rule.least) if rule.least else None) or rule.low)
    high = rule.high if rule.unit == "%" or not scale else min(rule.high, max(scale.values()))
    return low, high


def _scale(known: Known, rule: SetpointRule) -> dict[Code, Decimal]:
    """Return what 100 % is in each parameter set that may be in use; a setting of 0 is ignored."""
    settings = _scale_settings(known, rule).items()
    return {code: full for code, value in settings if (full := _positive(value.quantity))}


def _scale_settings(known: Known, rule: SetpointRule) -> dict[Code, Value]:
    return settings_in_force(known, rule.full_scale) if rule.full_scale is not None else {}


def _positive(number: Decimal | int | None) -> Decimal | None:
    return Decimal(number) if number is not None and number > 0 else None


def _unknown_set(
    known: Known, scale: Mapping[Code, Decimal], speed: str, rule: SetpointRule
) -> OperationError:
    """Refuse a conversion that would have to guess which parameter set is in use."""
    assert rule.full_scale is not None
    return known.refused(
        f"{known.drive} does not show which parameter set is in use, and 100 % differs between "
        f"them ({_listed(known, scale)}): {speed} could mean several speeds, nothing was sent",
        rule.full_scale,
        f"give the speed in {rule.unit}, or set {rule.full_scale} alike in all parameter sets",
    )


def _listed(known: Known, scale: Mapping[Code, Decimal]) -> str:
    if len(set(scale.values())) == 1:
        scale = dict([next(iter(scale.items()))])
    return ", ".join(f"{known.family.spoken(code)} = {full} Hz" for code, full in scale.items())


def _refuse_jog(known: Known, rules: VerbRules) -> None:
    """A setpoint that the drive does not look at must not be called done."""
    bits = control_bits(known, rules)
    if not bits.jog:
        return
    jog = control_word(known, rules) & bits.jog
    if jog:
        spoken = known.family.spoken(bits.code)
        raise known.refused(
            f"{known.drive} takes its speed from JOG value {jog}, by the low bits of {spoken}: "
            "a setpoint would have no effect, nothing was sent",
            bits.code,
            f"clear bits 0 and 1 of {spoken}",
        )


def _no_way(known: Known, rules: VerbRules) -> OperationError:
    when = next(rule.when for rule in rules.setpoints if rule.when is not None)
    right = sorted(
        number for rule in rules.setpoints if rule.when is not None for number in rule.when.values
    )
    spoken, values = known.family.spoken, settings_in_force(known, when.code)
    reads = ", ".join(f"{spoken(code)} reads {value.raw}" for code, value in values.items())
    reads = reads or f"{spoken(when.code)} is not there"
    return known.refused(
        f"{known.drive} takes no setpoint from the line: {reads}",
        when.code,
        f"set {spoken(when.code)} = {' or '.join(map(str, right))}",
    )


def _bad_speed(
    known: Known, rule: SetpointRule, in_force: list[SetpointRule], what: str
) -> OperationError:
    ranges = []
    for one in in_force:
        scale = _scale(known, one)
        low, high = _bounds(known, one, scale)
        by = f" ({_listed(known, scale)})" if scale and one.unit == "Hz" else ""
        ranges.append(f"{low} to {high} {one.unit}{by}")
    remedy = f"it takes {' or '.join(ranges)}"
    if rule.step is not None:
        remedy += f", in steps of {rule.step}"
    scale = _scale(known, rule)
    if len(in_force) == 1 and len(set(scale.values())) == 1:
        remedy += ", or % of that" if rule.unit == "Hz" else f", or Hz of {_listed(known, scale)}"
    bits = control_bits(known, rules_of(known.drive, known.family, Verb.SET_SPEED))
    if bits.direction and rule.low >= 0:
        place = bits.direction.bit_length() - 1
        word = known.family.spoken(bits.code)
        remedy += f"; its direction of rotation is bit {place} of {word}, not a sign"
    return known.refused(f"{what}: nothing was sent", rule.code, remedy, kind="bad-value")
