"""Whether a drive stands, and would store what is written: asked before it is moved elsewhere.

While its address or baud rate changes nobody can stop a drive over the line. And an 820X stores a
parameter only while it is inhibited: in quick stop it acknowledges, and forgets with its supply.

Strategy: a generator that asks for codes and is sent what they read, so that a daemon and a command
on a port of its own share it.

What must not live here: how codes are read; what is written.
Source: EDB2102EN 6.4 (820X saves only while inhibited), 8.2 (C0050).
"""

from __future__ import annotations

from collections.abc import Generator

from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value

from .family import Family
from .stops import StopAction, confirm_codes, knows_stop, stop_confirmed

__all__ = ["Asking", "standing"]

OUTPUT_FREQUENCY = Code(50)

Asking = Generator[Code, Value | None, str]
"""Yields codes to be read, is sent what they read (None: nothing), returns what speaks against."""


def standing(family: Family, code: Code, what: str) -> Asking:
    """Ask whether a drive stands and would store a code.

    Of a device that is not described nothing is known: whoever asks for this knows it.

    Args:
        family: The drive's family.
        code: What shall be written.
        what: The same in words, such as `its address`.

    Returns:
        Why not, to stand behind the drive's name; empty when it stands.
    """
    if not family.stops or (yield from _shows(family, StopAction.INHIBIT)):
        return ""
    info = family.info(code)
    if info is not None and info.needs_inhibit:
        return f"is not inhibited, so it would not store {what}"
    if not (yield from _shows(family, StopAction.QUICK_STOP)):
        return "is neither inhibited nor in quick stop"
    if family.info(OUTPUT_FREQUENCY) is None:
        return ""
    turns = yield OUTPUT_FREQUENCY
    if turns is not None and turns.number == 0:
        return ""
    return "is in quick stop, but does not stand yet"


def _shows(family: Family, action: StopAction) -> Generator[Code, Value | None, bool]:
    """Whether a drive's first proof of a stop holds now."""
    if not knows_stop(family, action):
        return False
    code = confirm_codes(family, action)[0]
    value = yield code
    return value is not None and stop_confirmed(family, action, code, value)
