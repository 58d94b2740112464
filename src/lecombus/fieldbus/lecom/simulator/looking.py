"""A simulated drive as a person sees and sets it, who controls a running simulator.

At the keypad can be set what the line may only read, such as the software in C0200 or P420, within
the limits of the code.
"""

from __future__ import annotations

import re
from typing import Final

from .drive import SimDrive
from .parameters import Refusal

__all__ = ["code_text", "describe", "parse_code", "set_value", "summary", "value_of"]

_CODE: Final = re.compile(r"([CP]?)(\d{1,5})(?:/(\d{1,3}))?\Z", re.ASCII | re.IGNORECASE)


def parse_code(word: str) -> tuple[int, int]:
    """Read `C0039/1`, `39/1` or `P425` (which is C1425).

    Raises:
        ValueError: It is no code.
    """
    match = _CODE.match(word)
    number = -1 if match is None else int(match[2]) + (1000 if match[1] in "Pp" and match[1] else 0)
    subcode = 0 if match is None else int(match[3] or 0)
    if not 0 <= number <= 65535 or subcode > 255:
        raise ValueError(f"`{word}` is no code, write C0012, C0039/1 or P425")
    return number, subcode


def code_text(number: int, subcode: int) -> str:
    """Write a code as people do."""
    return f"C{number:04d}/{subcode}" if subcode else f"C{number:04d}"


def summary(drive: SimDrive) -> str:
    """One line about a drive."""
    return f"{drive.name}: address {drive.address}, {drive.family}, {_state(drive)}"


def _state(drive: SimDrive) -> str:
    model = drive.model
    if not drive.present:
        return "absent"
    troubles = model.troubles
    for kind, number in (("TRIP", troubles.trip), ("message", troubles.message)):
        if number:
            return f"{kind} {number}"
    state = "inhibited" if model.inhibited() else "stopped" if model.stop_wanted() else "enabled"
    warned = f", warning {troubles.warning}" if troubles.warning else ""
    return f"{state}, at {model.motor.speed:g} {model.speed_unit}{warned}"


def describe(drive: SimDrive) -> str:
    """All about a drive, a line each."""
    model, fired = drive.model, drive.watchdog_fired
    lines = (
        summary(drive),
        f"  baud rate           {drive.baud}",
        f"  control word        H{model.control:04X}",
        f"  enable terminal     {'closed' if model.terminal_enable else 'open'}",
        f"  fault memory        {' '.join(map(str, model.troubles.memory)) or 'empty'}",
        f"  watchdog acted      {'once' if fired == 1 else f'{fired} times'}",
        f"  writes into memory  {drive.wear}",
        f"  telegrams heard     {drive.heard}",
    )
    return "\n".join(lines)


def value_of(drive: SimDrive, number: int, subcode: int) -> str:
    """Give a value as wire text.

    Raises:
        ValueError: There is no such code.
    """
    try:
        return drive.text(number, subcode)
    except Refusal:
        raise ValueError(f"{drive.name} has no code C{number:04d}/{subcode}") from None


def set_value(drive: SimDrive, number: int, subcode: int, text: str) -> None:
    """Set a value.

    Args:
        drive: The drive.
        number: 0..65535.
        subcode: 0..255.
        text: A number, a word such as H0008, or a string without its letter.

    Raises:
        ValueError: No such code, no such value, or one that the drive computes itself.
    """
    value_of(drive, number, subcode)
    model = drive.model
    spec = model.params.find(number, subcode)
    if number in model.readers and number not in model.writers:
        raise ValueError(f"C{number:04d} is what the drive itself measures")
    try:
        value = spec.at_keypad(text)
    except Refusal:
        limits = f"{spec.low} to {spec.high}" if spec.writable else "a value of its format"
        raise ValueError(f"C{number:04d} cannot be `{text}`: {limits}") from None
    model.preset((number, subcode), value)
