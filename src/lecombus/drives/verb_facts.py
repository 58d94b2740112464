"""Current values of a drive, checked against its family's conditions for a verb.

A setting that the drive does not have blocks nothing, because the drive itself still checks. A
control word that is not known is never guessed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal

from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

from .control_words import DIRECTION, INHIBIT, JOG, QUICK_STOP, TRIP_RESET
from .family import Family
from .stops import usable_word
from .verb_rules import Access, Condition, Demand, Verb, VerbRules
from .words import OperatingState

__all__ = [
    "ControlBits",
    "Known",
    "active_set_word",
    "codes_in_force",
    "control_bits",
    "control_word",
    "demand_met",
    "holds",
    "objected",
    "objections",
    "rules_of",
    "settings_in_force",
]


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of a drive when a verb is asked for.

    Args:
        drive: Its name, for messages.
        family: Its family.
        values: What was just read; a code that the drive does not have is missing.
    """

    drive: str
    family: Family
    values: Mapping[Code, Value]

    def number(self, code: Code) -> Decimal | int | None:
        """Return the number a code holds, None where it is not known or none."""
        value = self.values.get(code)
        return value.quantity if value is not None else None

    def word(self, code: Code) -> int | None:
        """Return the word a code holds, None where it is not known or none."""
        value = self.values.get(code)
        return value.word if value is not None else None

    def refused(
        self, why: str, code: Code, remedy: str, *, kind: str = "setting"
    ) -> OperationError:
        """Return the refusal of a verb because of what a code reads."""
        return OperationError(why, kind=kind, drive=self.drive, code=str(code), remedy=remedy)

    @property
    def configured(self) -> Family:
        """The family as this drive's signal configuration makes it."""
        code = self.family.configured_by
        number = self.number(code) if code is not None else None
        return self.family.configured(int(number) if number is not None else None)


@dataclass(frozen=True, slots=True)
class ControlBits:
    """The bits of a drive's control word that verbs look at; 0 where there is none.

    Args:
        code: The control word.
        quick_stop: Set: quick stop.
        inhibit: Set: controller inhibit.
        trip_reset: Going from 0 to 1 resets a fault.
        direction: Set: counter-clockwise; without it the setpoint's sign says it.
        jog: Not 0: a fixed setpoint is selected, and the line's has no effect.
    """

    code: Code
    quick_stop: int
    inhibit: int
    trip_reset: int
    direction: int
    jog: int


def control_bits(known: Known, rules: VerbRules) -> ControlBits:
    """Return the bits of the control word, as the drive's signal configuration assigns them."""
    word = known.configured.control_words[rules.control]

    def mask(name: str) -> int:
        return 1 << word.bits[name].bit if name in word.bits else 0

    return ControlBits(
        code=word.code,
        quick_stop=mask(QUICK_STOP),
        inhibit=mask(INHIBIT),
        trip_reset=mask(TRIP_RESET),
        direction=mask(DIRECTION),
        jog=word.fields[JOG].mask if JOG in word.fields else 0,
    )


def active_set_word(family: Family) -> Code | None:
    """Return the status word that shows the parameter set in use; None where no word does."""
    return next(
        (
            code
            for code, word in family.words.items()
            if any(rule.state is OperatingState.PARAMETER_SET_2 for rule in word.states)
        ),
        None,
    )


def codes_in_force(known: Known, code: Code) -> tuple[Code, ...]:
    """Return where a setting stands in the parameter sets that may be in use.

    Returns:
        One code where a status word shows the set, or the family has only one; else one code for
        each set.

    Source: EDB2102EN 6.1, 8.2 (C0150 bit 0).
    """
    offsets = known.family.set_offsets
    word = active_set_word(known.family)
    number = known.word(word) if word is not None else None
    if len(offsets) > 1 and word is not None and number is not None:
        shown = known.family.words[word].shown_states(number)
        offsets = (offsets[OperatingState.PARAMETER_SET_2 in shown],)
    return tuple(Code(code.number + offset, code.subcode) for offset in offsets)


def settings_in_force(known: Known, code: Code) -> dict[Code, Value]:
    """Return what a setting reads in the parameter sets that may be in use.

    What the drive does not have in a further set it has once, for all of them (EDB2102EN 8.2).
    """
    found = {}
    for one in codes_in_force(known, code):
        at = one if one in known.values else code
        if at in known.values:
            found[at] = known.values[at]
    return found


def rules_of(drive: str, family: Family, verb: Verb) -> VerbRules:
    """Return the family's rules.

    Raises:
        OperationError: `no-verb`: there are none.
    """
    if family.verbs is None:
        raise OperationError(
            f"{drive} is of family {family.name}, of which nothing is described: no {verb} is "
            "known for it, nothing was sent",
            kind="no-verb",
            drive=drive,
            remedy="write the code that its own manual names, or give the drive its family in "
            "the roster",
        )
    return family.verbs


def control_word(known: Known, rules: VerbRules) -> int:
    """Return the control word that was read.

    Raises:
        OperationError: `no-control-word`: it was not, or what was read is none.
    """
    word = usable_word(known.word(rules.control))
    if word is None:
        value = known.values.get(rules.control)
        reads = f"reads {value.raw}" if value is not None else "is not there"
        raise known.refused(
            f"the control word {rules.control} of {known.drive} {reads}: its bits are not "
            "guessed, nothing was sent",
            rules.control,
            "write the codes by hand if you know what they must be",
            kind="no-control-word",
        )
    return word


def holds(known: Known, condition: Condition | None) -> bool:
    """Return whether a setting is as wanted in the set in use; no condition always holds."""
    if condition is None:
        return True
    values = settings_in_force(known, condition.code).values()
    return bool(values) and all(map(condition.holds, values))


def objections(known: Known, rules: VerbRules, access: Access) -> Iterator[Demand]:
    """Return the demands for an access that the drive's settings do not meet."""
    for demand in rules.demands:
        code = demand.condition.code
        value = known.values.get(code)
        if access in demand.access and value is not None and not demand.condition.holds(value):
            yield demand


def demand_met(known: Known, rules: VerbRules, access: Access) -> None:
    """Refuse an access that the drive's settings keep closed.

    Raises:
        OperationError: `setting`, with the setting and its right value.
    """
    for objection in objections(known, rules, access):
        raise objected(known, objection)


def objected(known: Known, demand: Demand) -> OperationError:
    """Make the refusal of a demand that is not met."""
    code = demand.condition.code
    reads = f"{known.family.spoken(code)} of {known.drive} reads {known.values[code].raw}"
    why = f"{reads}: with that it does not do what it is told over the line, nothing was sent"
    return known.refused(why, code, demand.remedy)
