"""A simulated drive in words, for people who control a running simulator."""

from __future__ import annotations

import re
from typing import Final

from lecombus.fieldbus.lecom.simulator.drive import SimDrive

__all__ = ["code_text", "describe", "parse_code", "summary"]

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
