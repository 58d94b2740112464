"""Lines a person types to a running simulator: `trip feeder 50`, `unplug 3s`, `help`.

Strategy: one table names every command with its form and what it does; a line is split into words
and handed to the command's function with the end's lock held. What is wrong with a line is a
`ControlError` whose text says what would be right. `unplug 3s` waits in the caller's thread.

A person sees and sets a drive as at its keypad: also what the line may only read, such as the
software in C0200 or P420, within the limits of the code.
"""

from __future__ import annotations

import re
import shlex
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final, Protocol

from lecombus.durations import DurationError, parse_duration

from .drive import SimDrive
from .faults import parse_faults
from .line import SimLine
from .parameters import Refusal

__all__ = ["Control", "ControlError"]

_CODE: Final = re.compile(r"([CP]?)(\d{1,5})(?:/(\d{1,3}))?\Z", re.ASCII | re.IGNORECASE)


def parse_code(word: str) -> tuple[int, int]:
    """Read `C0039/1`, `39/1` or `P425` (which is C1425).

    Raises:
        ValueError: It is not a code.
    """
    match = _CODE.match(word)
    number = -1 if match is None else int(match[2]) + (1000 if match[1] in "Pp" and match[1] else 0)
    subcode = 0 if match is None else int(match[3] or 0)
    if not 0 <= number <= 65535 or subcode > 255:
        raise ValueError(f"`{word}` is not a code, write C0012, C0039/1 or P425")
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


SWAP_S = 10.0
"""The least time of a replacement of a drive, seconds: its master loses it for that time."""


class ControlError(ValueError):
    """A line that is not understood or cannot be done."""


class Plug(Protocol):
    """What can be pulled off a line and put back."""

    def unplug(self) -> None:
        """Pull the plug."""

    def replug(self) -> None:
        """Plug in again."""


class Control:
    """Does what lines of text say to a simulated line.

    Args:
        line: The line.
        lock: What to hold while touching it.
        plug: The end the host has plugged in.
    """

    def __init__(self, line: SimLine, lock: threading.RLock, plug: Plug) -> None:
        self.line = line
        self.lock = lock
        self.plug = plug

    def do(self, text: str) -> str:
        """Do a line.

        Args:
            text: A command and its words; an empty line does nothing.

        Returns:
            What to show; no newline at its end.

        Raises:
            ControlError: It is not understood, or cannot be done.
        """
        try:
            words = shlex.split(text)
        except ValueError as exc:
            raise ControlError(f"{text!r}: {exc}; close the quotation mark") from None
        if not words:
            return ""
        name, *rest = words
        command = _COMMANDS.get(name)
        if command is None:
            raise ControlError(f"there is no `{name}`: one of {', '.join(_COMMANDS)}")
        if not command.least <= len(rest) <= command.most:
            raise ControlError(f"write {command.form}")
        try:
            if not command.locks:
                return command.function(self, rest)
            with self.lock:
                self.line.advance(time.monotonic())
                return command.function(self, rest)
        except ValueError as exc:  # what is wrong with a value is what is wrong with the line
            raise ControlError(str(exc)) from None

    def drive(self, word: str) -> SimDrive:
        """Find a drive by name or address.

        Raises:
            ControlError: There is none.
        """
        try:
            return self.line[int(word) if word.isdecimal() else word]
        except KeyError:
            there = ", ".join(drive.name for drive in self.line.drives)
            near = get_close_matches(word, [drive.name for drive in self.line.drives], n=1)
            right = f"did you mean {near[0]}?" if near else f"one of {there}"
            raise ControlError(f"there is no drive `{word}`: {right}") from None


# The commands. Each is given the words after its name, as many as its form has.


def _help(control: Control, words: list[str]) -> str:
    if words and words[0] not in _COMMANDS:
        raise ControlError(f"there is no `{words[0]}`: one of {', '.join(_COMMANDS)}")
    chosen = [_COMMANDS[words[0]]] if words else _COMMANDS.values()
    return "\n".join(f"{command.form:<44} {command.does}" for command in chosen)


def _drives(control: Control, words: list[str]) -> str:
    return "\n".join(summary(drive) for drive in control.line.drives)


def _show(control: Control, words: list[str]) -> str:
    return describe(control.drive(words[0]))


def _log(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    count = _whole(words[1], "a number of telegrams") if len(words) > 1 else 10
    now_s = time.monotonic()
    lines = [
        f"{now_s - entry.time_s:8.2f} s ago  {entry.kind:<5} {code_text(entry.code, entry.subcode)}"
        f" {entry.text}{'' if entry.accepted else ' refused'}"
        for entry in list(drive.log)[-count:]
    ]
    return "\n".join(lines) or f"{drive.name} has heard nothing yet"


def _trip(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    numbers = drive.model.troubles.numbers()
    number = _whole(words[1], f"the number of a fault here: {numbers}")
    if words[2:] not in ([], ["stays"]):
        raise ControlError(f"`{words[2]}`? write {_COMMANDS['trip'].form}")
    drive.trip(number, stays=len(words) > 2)
    return summary(drive)


def _clear(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    drive.clear_fault()
    return summary(drive)


def _power_cycle(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    off_s = _duration(words[1]) if len(words) > 1 else None
    drive.power_cycle(time.monotonic(), off_s)
    return f"{drive.name} starts; what only its module knew is gone"


def _factory_reset(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    drive.factory_reset()
    return f"{drive.name} has the maker's parameters; the line still reaches it"


def _swap(control: Control, words: list[str]) -> str:
    old = control.drive(words[0])
    given = dict(_setting(word) for word in words[1:])
    family = given.pop("family", None)
    codes = {parse_code(name): text for name, text in given.items()}
    trial = SimDrive(old.address, family or old.family, old.name)
    for (number, subcode), text in codes.items():
        set_value(trial, number, subcode, text)
    new = control.line.swap(old.address, time.monotonic(), family)
    for (number, subcode), text in codes.items():
        set_value(new, number, subcode, text)
    new.power_cycle(time.monotonic(), SWAP_S)
    return (
        f"another drive stands there, new from the maker, and answers in {SWAP_S:g} s: "
        f"{summary(new)}"
    )


def _set(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    number, subcode = parse_code(words[1])
    set_value(drive, number, subcode, words[2])
    return f"{drive.name} {code_text(number, subcode)}: {drive.text(number, subcode)}"


def _get(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    number, subcode = parse_code(words[1])
    return f"{drive.name} {code_text(number, subcode)}: {value_of(drive, number, subcode)}"


def _wear(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    counts = sorted(drive.model.params.wear.items(), key=lambda item: -item[1])
    lines = [f"{code_text(*key)}: {count}" for key, count in counts]
    writes = "1 write" if drive.wear == 1 else f"{drive.wear} writes"
    return "\n".join((f"{drive.name}: {writes} into its memory", *lines))


def _terminal(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    if words[1] not in ("open", "closed"):
        raise ControlError(f"write {_COMMANDS['terminal'].form}")
    drive.set_terminal(high=words[1] == "closed")
    return summary(drive)


def _absent(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    drive.present = False
    return f"{drive.name} does not answer until `present {drive.name}`"


def _present(control: Control, words: list[str]) -> str:
    drive = control.drive(words[0])
    drive.present = True
    return f"{drive.name} answers"


def _unplug(control: Control, words: list[str]) -> str:
    wait_s = _duration(words[0]) if words else None
    control.plug.unplug()
    if wait_s is None:
        return "unplugged until `plug`"
    time.sleep(wait_s)
    control.plug.replug()
    return f"plugged in again after {words[0]}"


def _plug(control: Control, words: list[str]) -> str:
    control.plug.replug()
    return "plugged in"


def _faults(control: Control, words: list[str]) -> str:
    text = "" if words[0] == "none" else words[0]
    wanted = parse_faults(text)
    if wanted.trips:
        raise ControlError("drives get their faults by `trip`, not here")
    there = {drive.address for drive in control.line.drives}
    if unknown := wanted.absent - there:
        raise ControlError(f"no drive has the address {min(unknown)}: one of {sorted(there)}")
    control.line.faults = wanted
    return f"faults of the line: {text or 'none'}"


# Words


def _whole(word: str, what: str) -> int:
    if not word.isdecimal() or len(word) > 5:
        raise ControlError(f"`{word}` is not {what}")
    return int(word)


def _duration(word: str) -> float:
    try:
        return parse_duration(word)
    except DurationError as exc:
        raise ControlError(f"{word} {exc}") from None


def _setting(word: str) -> tuple[str, str]:
    name, equals, text = word.partition("=")
    if not equals or not text:
        raise ControlError(f"`{word}`? write {_COMMANDS['swap'].form}")
    return name, text


@dataclass(frozen=True, slots=True)
class _Command:
    """One command.

    Attributes:
        form: How it is written.
        does: What it does.
        least: Least number of words after its name.
        most: Greatest number of them.
        function: Does it.
        locks: Whether the line is locked during the command.
    """

    form: str
    does: str
    least: int
    most: int
    function: Callable[[Control, list[str]], str]
    locks: bool = True


_SWAP = "swap DRIVE [family=FAMILY] [C0200=TEXT] .."

_COMMANDS: Final[dict[str, _Command]] = {
    "help": _Command("help [COMMAND]", "what can be written here", 0, 1, _help, locks=False),
    "drives": _Command("drives", "every drive and how it is", 0, 0, _drives),
    "show": _Command("show DRIVE", "all about one drive", 1, 1, _show),
    "log": _Command("log DRIVE [COUNT]", "the last telegrams it has heard", 1, 2, _log),
    "trip": _Command("trip DRIVE NUMBER [stays]", "a fault; stays: no reset helps", 2, 3, _trip),
    "clear": _Command("clear DRIVE", "its faults' causes go; a TRIP waits for reset", 1, 1, _clear),
    "terminal": _Command("terminal DRIVE open|closed", "its enable terminal", 2, 2, _terminal),
    "set": _Command("set DRIVE CODE VALUE", "a value, as at its keypad", 3, 3, _set),
    "get": _Command("get DRIVE CODE", "a value, without a telegram", 2, 2, _get),
    "wear": _Command("wear DRIVE", "writes into its memory, by code", 1, 1, _wear),
    "power-cycle": _Command("power-cycle DRIVE [TIME]", "off and on", 1, 2, _power_cycle),
    "factory-reset": _Command("factory-reset DRIVE", "the maker's values", 1, 1, _factory_reset),
    "swap": _Command(_SWAP, "another drive in its place", 1, 20, _swap),
    "absent": _Command("absent DRIVE", "it does not answer", 1, 1, _absent),
    "present": _Command("present DRIVE", "it answers again", 1, 1, _present),
    "unplug": _Command("unplug [TIME]", "pull the host's plug", 0, 1, _unplug, locks=False),
    "plug": _Command("plug", "plug it in again", 0, 0, _plug, locks=False),
    "faults": _Command("faults late=0.05:0.5s,.. | none", "what goes wrong on it", 1, 1, _faults),
}
