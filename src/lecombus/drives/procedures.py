"""What procedures of several reads and writes share: access to one drive, identity, standstill.

Such procedures are a backup, a restore, a change of address or baud rate. A failure is an answer to
them, not an exception: a backup goes on without a code, a restore waits until a line is back, a
change of baud rate looks for the drive at the other rate.

During a change of address or baud rate a drive cannot be stopped over the line, so it must be
inhibited or in quick stop first (`ask_standstill`). An 820X stores a parameter only while it is
inhibited: in quick stop it acknowledges the write, and loses it when it is switched off. Only a
93XX measures standstill (C0150 bit 6, n = 0, where its signal configuration is known). An inverter
knows its output frequency: that is 0 immediately after an inhibit, while the motor coasts. So the
result says in words what is known.

Source: EDB2102EN 6.4 (820X saves only while inhibited), 8.2 (C0150 bit 6; identity: C1810, C1811);
CMVLC401A table 9 (C0200, C0201), 8.1.3 (C1099), 9.2 (P502).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from lecombus.drives.family import Family
from lecombus.drives.stops import StopAction, confirm_codes, knows_stop, stop_confirmed
from lecombus.drives.words import OperatingState
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

__all__ = [
    "DriveAccess",
    "ReadAttempt",
    "Standstill",
    "WriteAttempt",
    "ask_standstill",
    "identity_codes",
    "is_identity",
    "is_passing",
    "is_same_text",
    "text_of",
]

SOFTWARE_CODES = (Code(200), Code(201))
"""Software and its date: not in the 2102 module's manual, but behind it most drives have them."""


def identity_codes(named: Iterable[Code], of_family: tuple[Code, ...]) -> tuple[Code, ...]:
    """Return what a drive is asked to know who it is.

    Args:
        named: What its roster names besides.
        of_family: What its family has; empty for a device nothing is known of.
    """
    usual = (*of_family, *SOFTWARE_CODES) if of_family else ()
    return tuple(dict.fromkeys((*usual, *named)))


def text_of(value: Value) -> str:
    """Return an identity code's value as people know it, strings without their letter."""
    number = value.number
    return number if isinstance(number, str) else value.raw


def is_identity(value: Value, text: str | None) -> bool:
    """Return whether a value is what is said of it; what is not said cannot differ."""
    return text is None or is_same_text(text_of(value), text) or value.raw == text


def is_same_text(found: str, text: str) -> bool:
    """Return whether two texts are one identity; `1.2` and `1.20` are."""
    if found == text:
        return True
    try:
        return Value.parse(found).means_same(Value.parse(text))
    except CodeValueError:
        return False


PASSING: Final = frozenset({
    "does-not-fit", "expired", "garbled", "line-lost", "no-answer", "not-ready", "offline",
    "queue-full", "starting", "unhealthy", "unknown", "unreachable",
})  # fmt: skip
"""Kinds of failure that say nothing of the code: a second attempt may bring an answer."""


@dataclass(frozen=True, slots=True)
class ReadAttempt:
    """The result of reading one code.

    Args:
        code: The code.
        value: What it reads; None where it could not be read.
        kind: Why not, as a stable word, such as `no-such-code`.
        text: Why not, for people.
    """

    code: Code
    value: Value | None
    kind: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class WriteAttempt:
    """The result of writing one code.

    Args:
        done: It was acknowledged, and read back where that was asked for.
        kind: Why not, as a stable word.
        text: Why not, for people.
    """

    done: bool
    kind: str = ""
    text: str = ""


def is_passing(kind: str) -> bool:
    """Whether a failure says nothing of the code, so that a second attempt may succeed."""
    return kind in PASSING


class DriveAccess(Protocol):
    """One drive."""

    async def read(self, code: Code) -> ReadAttempt:
        """Read a code."""

    async def write(self, code: Code, value: Value, *, verify: bool) -> WriteAttempt:
        """Write a code once; `verify`: and read it back."""


OUTPUT_FREQUENCY: Final = Code(50)
STATUS_WORD: Final = Code(150)

NOT_MEASURED: Final = "whether its motor still turns it does not measure"


@dataclass(frozen=True, slots=True)
class Standstill:
    """What is known of a drive before it is moved elsewhere.

    Args:
        obstacle: Why it may not be moved, to stand behind its name; empty: it may.
        known: What is known of its motion, such as `inhibited; it measures a speed of 0`.
        inhibited: It is inhibited already: no stop would change anything.
    """

    obstacle: str
    known: str
    inhibited: bool = False


Read = Callable[[Code], Awaitable[Value | None]]
"""Reads a code of the drive; None: it did not answer with a value."""


async def ask_standstill(read: Read, family: Family, code: Code, what: str) -> Standstill:
    """Ask a drive what it says of its motion, and whether it would store a code.

    Of a device that is not described nothing is known.

    Args:
        read: Reads a code of the drive.
        family: Its family.
        code: What shall be written.
        what: The same in words, such as `its address`.
    """
    if not family.stops:
        return Standstill("", "its codes are not known, nor its motion")
    family = await _configured(read, family)
    inhibited = await _shows(read, family, StopAction.INHIBIT)
    if not inhibited:
        info = family.info(code)
        if info is not None and info.needs_inhibit:
            return Standstill(f"is not inhibited, so it would not store {what}", "")
        if not (await _shows(read, family, StopAction.QUICK_STOP)):
            return Standstill("is neither inhibited nor in quick stop", "")
    held = "inhibited" if inhibited else "in quick stop"
    at_rest = await _measured(read, family)
    if at_rest is not None:
        if not at_rest:
            return Standstill(f"is {held}, but still turns (C0150 bit 6)", "", inhibited)
        return Standstill("", f"{held}; it measures a speed of 0", inhibited)
    if inhibited:
        return Standstill("", f"{held}; {NOT_MEASURED}", inhibited)
    return await _after_a_ramp(read, family, held)


async def _after_a_ramp(read: Read, family: Family, held: str) -> Standstill:
    """A quick stop leads the motor to 0 by its output frequency: it must have arrived there."""
    if family.info(OUTPUT_FREQUENCY) is None:
        return Standstill(f"is {held}, and does not say that it has come to rest", "")
    frequency = await read(OUTPUT_FREQUENCY)
    if frequency is None or frequency.number != 0:
        return Standstill(f"is {held}, but its output frequency (C0050) is not 0 yet", "")
    return Standstill("", f"{held}, output frequency 0; {NOT_MEASURED}")


async def _measured(read: Read, family: Family) -> bool | None:
    """Return whether the drive measures a speed of 0; None where it does not measure or say."""
    word = family.words[STATUS_WORD]
    if OperatingState.ZERO_SPEED not in {rule.state for rule in word.states}:
        return None
    shown = await read(STATUS_WORD)
    if shown is None or shown.word is None:
        return None
    return OperatingState.ZERO_SPEED in word.shown_states(shown.word)


async def _configured(read: Read, family: Family) -> Family:
    """Return the family as the drive's signal configuration makes it, where it has one."""
    if family.configured_by is None:
        return family
    value = await read(family.configured_by)
    number = value.quantity if value is not None else None
    return family if number is None else family.configured(int(number))


async def _shows(read: Read, family: Family, action: StopAction) -> bool:
    """Return whether a drive's first proof of a stop holds now."""
    if not knows_stop(family, action):
        return False
    code = confirm_codes(family, action)[0]
    value = await read(code)
    return value is not None and stop_confirmed(family, action, code, value)
