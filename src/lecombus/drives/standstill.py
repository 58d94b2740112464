"""What is known of a drive's motion before its address or baud rate is changed.

During that change it cannot be stopped over the line, so it must be inhibited or in quick stop
first. An 820X stores a parameter only while it is inhibited: in quick stop it acknowledges the
write, and loses it when it is switched off.

Only a 93XX measures standstill (C0150 bit 6, n = 0, where its signal configuration is known). An
inverter knows its output frequency: that is 0 immediately after an inhibit, while the motor coasts.
So the result says in words what is known.

Source: EDB2102EN 6.4 (820X saves only while inhibited), 8.2 (C0150 bit 6); CMVLC401A table 9.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

from lecombus.drives.family import Family
from lecombus.drives.operating import OperatingState
from lecombus.drives.stops import StopAction, confirm_codes, knows_stop, stop_confirmed
from lecombus.parameters import Code, Value

__all__ = ["Standstill", "ask_standstill"]

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
