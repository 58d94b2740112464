"""Stopping a drive: which code is written with which value, and what shows that it took effect.

The rules are data (`StopRule` in the family's file). Inhibit writes C0040 = 0 on every described
family. Quick stop sets bit 3 of the control word C0135 and needs the word it changes: a word made
from nothing could lift an inhibit (bit 9), change the direction or the parameter set. TRIP reset
(bit 11) is always cleared, because writing it again could be the edge that resets a fault. A family
without a description has no stop.

An acknowledgement is not an effect. `stop_confirmed` checks what was read back and claims no more
than the manual: that the drive reports the inhibit or the quick stop, or holds the command; never
that the motor stands still.

Source: EDB2102EN 8.2 (C0040, C0068, C0135, C0150); CMVLC401A 4.2 (P420), table 9.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

from pydantic import Field

from lecombus.errors import OperationError
from lecombus.parameters import Code, Value

from .control_words import INHIBIT
from .field_types import WORD_MAX, DescribedCode, Source, WordNumber, WordValue, WritableCode, whole
from .yaml_models import FILE_TABLE, ReadAs, by_key, mistake, without_keys

if TYPE_CHECKING:
    from .family import Family

__all__ = [
    "LEAST_STOP_ATTEMPTS",
    "STOPS",
    "STOP_PATIENCE_S",
    "STOP_PAUSE_S",
    "Proofs",
    "StopAction",
    "StopProof",
    "StopRule",
    "asks_to_stop",
    "confirm_codes",
    "inhibit_mask",
    "inhibit_proofs",
    "knows_stop",
    "may_ignore",
    "needs_control_word",
    "shown_after",
    "stop_confirmed",
    "stop_steps",
    "stop_value",
    "stops_every_drive",
    "usable_word",
]

STOP_PATIENCE_S: Final = 5.0
"""How long a stop is repeated from its first step, while its proof is missing, seconds."""
LEAST_STOP_ATTEMPTS: Final = 2
"""Least telegrams of a stop to a drive that does not answer, however long feeds keep the line."""
STOP_PAUSE_S: Final = 0.1
"""Left to others before each attempt after the first few, seconds; to a drive that is silent a
stop is repeated only when all watchdogs can be fed in time besides (`schedule.silent_stops`)."""

Mask = Annotated[int, whole(1, WORD_MAX)]


class StopAction(StrEnum):
    """What stopping can mean."""

    QUICK_STOP = "quick-stop"
    INHIBIT = "inhibit"


@dataclass(frozen=True, slots=True)
class StopProof:
    """A value that shows a stop was taken: `value & mask == equals`.

    Args:
        mask: The bits looked at; None compares the whole number.
        equals: What they must be.
    """

    __pydantic_config__ = FILE_TABLE

    mask: Mask | None
    equals: WordNumber

    def holds(self, value: Value) -> bool:
        """Return whether a value that was read back shows the stop."""
        return self.shown_by(value) is True

    def shown_by(self, value: Value) -> bool | None:
        """Return whether a value shows the stop; None: it shows neither that nor the opposite.

        A word of more than 16 bits is something else than the word that was asked for.
        """
        if self.mask is None:
            return None if value.quantity is None else value.quantity == self.equals
        number = value.number  # not `usable_word(value.word)`: this runs in every exchange
        if not isinstance(number, int) or not 0 <= number <= WORD_MAX:
            return None
        return number & self.mask == self.equals


@dataclass(frozen=True, slots=True, kw_only=True)
class _Proof(StopProof):
    mask: Mask | None = None
    code: DescribedCode


def _by_code(entries: tuple[_Proof, ...]) -> dict[Code, StopProof]:
    proofs = by_key(entries, lambda one: one.code)
    return {code: StopProof(one.mask, one.equals) for code, one in proofs.items()}


Proofs = Annotated[Mapping[Code, StopProof], ReadAs(tuple[_Proof, ...], _by_code)]
"""What codes must show, the most conclusive first."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StopRule:
    """How one family is stopped in one way.

    Args:
        code: The code written.
        value: The value written; None when bits of the control word are changed instead.
        set_mask: Bits set in the control word.
        clear_mask: Bits cleared in the control word.
        proofs: Codes to read back, the most conclusive first, with what they must show.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: WritableCode
    value: WordValue | None = None
    set_mask: Annotated[Mask, Field(alias="set")] = 0
    clear_mask: Annotated[WordNumber, Field(alias="clear")] = 0
    proofs: Proofs
    source: Source


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Entry(StopRule):
    action: StopAction


def _by_action(entries: tuple[_Entry, ...]) -> dict[StopAction, StopRule]:
    for place, entry in enumerate(entries):
        if (entry.value is None) == (not entry.set_mask):
            raise mistake("either value or set is right here", place)
    stops = by_key(entries, lambda entry: entry.action)
    return {action: without_keys(StopRule, entry) for action, entry in stops.items()}


STOPS = ReadAs(tuple[_Entry, ...], _by_action)
"""Reads the section `stops`."""


def knows_stop(family: Family, action: StopAction) -> bool:
    """Return whether a family can be stopped in this way."""
    return action in family.stops


def needs_control_word(family: Family, action: StopAction) -> bool:
    """Return whether `stop_value` must be given the drive's present control word (C0135)."""
    rule = family.stops.get(action)
    return rule is not None and rule.value is None


def usable_word(word: int | None) -> int | None:
    """Return a control word that bits may be changed of, None for one that is not known.

    A drive that answers with more than 16 bits has said something else than its control word.
    """
    return word if word is not None and 0 <= word <= WORD_MAX else None


def stop_value(family: Family, action: StopAction, control_word: int | None) -> tuple[Code, Value]:
    """Return what to write to stop a drive.

    Args:
        family: The drive's family.
        action: How it shall stop.
        control_word: Its present control word, 0..FFFFh, as last read or written; None where it
            is not known or not needed. What is out of range counts as not known.

    Raises:
        OperationError: kind `no-stop`: the description knows no such stop; kind
            `no-control-word`: the control word is needed and not known.
    """
    rule = _rule(family, action)
    if rule.value is not None:
        return rule.code, rule.value
    control_word = usable_word(control_word)
    if control_word is None:
        spoken = family.spoken(rule.code)
        raise OperationError(
            f"{action} changes bits of {spoken}, whose present value is not known",
            kind="no-control-word",
            code=str(rule.code),
            remedy=f"read {spoken} first, or use inhibit, which needs no control word",
        )
    word = (control_word | rule.set_mask) & ~rule.clear_mask
    return rule.code, Value.hexadecimal(word, 4)


def asks_to_stop(family: Family, code: Code, value: Value) -> bool:
    """Return whether a plain write means that the drive shall not turn.

    It does where it writes what a stop writes, or a control word with a quick stop or an inhibit
    in it.
    """
    for rule in family.stops.values():
        if rule.code == code and rule.value is not None and value.means_same(rule.value):
            return True
        if rule.code == code and rule.value is None and value.word is not None:
            return bool(value.word & (rule.set_mask | inhibit_mask(family, code)))
    return False


def stops_every_drive(family: Family, code: Code, value: Value) -> bool:
    """Return whether a write stops a drive in any state: one fixed value, as C0040 = 0.

    A control word does not: its other bits could lift an inhibit or change what it holds.
    """
    return any(
        rule.code == code and rule.value is not None and value.means_same(rule.value)
        for rule in family.stops.values()
    )


def inhibit_mask(family: Family, code: Code) -> int:
    """Return the bit of the control word that inhibits, 0 where there is none."""
    word = family.control_words.get(code)
    bit = word.bits.get(INHIBIT) if word is not None else None
    return 1 << bit.bit if bit is not None else 0


def confirm_codes(family: Family, action: StopAction) -> tuple[Code, ...]:
    """Return the codes whose value shows that a stop was taken, the most conclusive first.

    Raises:
        OperationError: kind `no-stop`.
    """
    return tuple(_rule(family, action).proofs)


def shown_after(family: Family, code: Code) -> tuple[Code, ...]:
    """Return what is read after a write of a code that stops drives or lets them run.

    First what shows the stop, then the first status word: with it the motion is known. Empty for
    any other code.
    """
    rules = [rule for rule in family.stops.values() if rule.code == code]
    shown_by = [proof for rule in rules for proof in list(rule.proofs)[:1]]
    return tuple(dict.fromkeys((*shown_by, *list(family.words)[:1]))) if rules else ()


def inhibit_proofs(family: Family) -> Mapping[Code, StopProof]:
    """Return what shows that a drive is inhibited, the most conclusive first."""
    rule = family.stops.get(StopAction.INHIBIT)
    return rule.proofs if rule is not None else {}


def stop_steps(family: Family, action: StopAction) -> list[tuple[Code, Value | None]]:
    """List what a stop may send to a drive, in any course it takes.

    Learning the control word and whether the drive is inhibited, saying the stop, its proofs, and
    the same for the inhibit that a quick stop may become.

    Returns:
        Codes, with the value where the code is written and None where it is read.
    """
    found: list[tuple[Code, Value | None]] = []
    for one in {action, StopAction.INHIBIT} & set(family.stops):
        code, value = stop_value(family, one, 0)
        found.append((code, value))
        found.extend((proof, None) for proof in confirm_codes(family, one))
        if needs_control_word(family, one):
            found.append((code, None))
    return found


def stop_confirmed(family: Family, action: StopAction, code: Code, value: Value) -> bool:
    """Return whether a value read after a stop shows that the drive took it.

    False also stands for "this code says nothing of it": see `confirm_codes`. A control word that
    reads as written shows nothing while the drive is not known to follow it: a 93XX does so only
    in signal configurations xxx1 (EDB2102EN 5).
    """
    rule = family.stops.get(action)
    if rule is not None and code == rule.code and _may_ignore(family, rule):
        return False
    proof = rule.proofs.get(code) if rule is not None else None
    return proof is not None and proof.holds(value)


def may_ignore(family: Family, action: StopAction, code: Code, value: Value) -> bool:
    """Return whether a value shows a stop only as a command that this drive may not follow."""
    rule = family.stops.get(action)
    proof = rule.proofs.get(code) if rule is not None else None
    if rule is None or proof is None or code != rule.code:
        return False
    return _may_ignore(family, rule) and proof.holds(value)


def _may_ignore(family: Family, rule: StopRule) -> bool:
    """Return whether a stop is a bit of a control word that this drive is not known to follow."""
    known = family.configuration or family.configured_by is None
    return rule.value is None and not known


def _rule(family: Family, action: StopAction) -> StopRule:
    rule = family.stops.get(action)
    if rule is None:
        raise OperationError(
            f"no {action} is known for a drive of family {family.name}",
            kind="no-stop",
            remedy="write the code that stops this device, or give the drive its family in the "
            "roster",
        )
    return rule
