"""Which register is where, what it holds, and which codes of a family stand behind it.

The line has the registers 0 to 99, a drive with address A those from 100 A to 100 A + 99, so that
no drive moves when another one joins or leaves. A block has three parts: registers that can always
be read (states, ages, outcomes), registers whose value must be fresh (otherwise the answer is an
exception), and registers that are written. Function codes 3 and 4 read the same registers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cache
from typing import Any, Final

from lecombus.drives import Family, OperatingState, family
from lecombus.drives.faults.fault_tables import FaultKind
from lecombus.parameters import Code

__all__ = [
    "BLOCK",
    "COMMANDS",
    "CONTROL_STATES",
    "DOING",
    "DRIVE",
    "DRIVE_STATES",
    "FAULT_KINDS",
    "FRESH",
    "LINE",
    "LINE_STATES",
    "MAP_VERSION",
    "OUTCOMES",
    "REASONS",
    "SCALE",
    "STATES",
    "UNITS",
    "Command",
    "Register",
    "RegisterPart",
    "Sources",
    "WriteReason",
    "family_rows",
    "layout_rows",
    "map_markdown",
    "numbers_rows",
    "place_of",
    "roster_rows",
    "sources_of",
]

MAP_VERSION: Final = 1
"""In register 0; a change that a program would misunderstand raises it."""

BLOCK: Final = 100
"""Registers of the line, and of each drive."""

SCALE: Final = 10_000
"""A speed or a setpoint of 35.4 is 354000: LECOM carries four decimals, so this is exact."""

OUTPUT_FREQUENCY: Final = Code(50)
FREQUENCY_SETPOINT: Final = Code(46)

HIGH_WORD_FIRST: Final = "32 bit, high word first"
SIGNED: Final = "signed 32 bit, high word first"


class RegisterPart(Enum):
    """What can be done with a register."""

    ALWAYS = "always"
    """Read at any time."""
    FRESH = "fresh"
    """Read while its value is fresh; otherwise the answer is an exception."""
    WRITTEN = "written"
    """Written, with `control: true`; reads what was written last."""


@dataclass(frozen=True, slots=True)
class Register:
    """A register, or two that are one number.

    Args:
        offset: Behind the first register of its block.
        name: Its name in `--map`.
        part: What can be done with it.
        meaning: What it holds.
        words: How many registers it is.
        form: How its bits are read; empty: an unsigned number of 16 bits.
    """

    offset: int
    name: str
    part: RegisterPart
    meaning: str
    words: int = 1
    form: str = ""


class Command(IntEnum):
    """What can be written to a command register."""

    NONE = 0
    QUICK_STOP = 1
    INHIBIT = 2
    ENABLE = 3
    RESET_FAULT = 4

    @property
    def is_stop(self) -> bool:
        """Whether it needs no lease, and goes before everything else."""
        return self in (Command.QUICK_STOP, Command.INHIBIT)

    @property
    def verb(self) -> str:
        """The word of the HTTP API."""
        return self.name.lower().replace("_", "-")


class WriteReason(IntEnum):
    """Why a write was not done, or why there is no lease."""

    NONE = 0
    NO_LEASE = 1
    NOT_FROM_0 = 2
    LATCHED = 3
    HELD_BY_OTHER = 4
    FAULT_ACTIVE = 5
    NO_ANSWER = 6
    NAK = 7
    BAD_VALUE = 8
    NOT_PERMITTED = 9
    SETTING = 10
    NOT_IN_EFFECT = 11
    NOT_READY = 12
    OVERLOADED = 13
    JOURNAL_FAILING = 14
    DAEMON_AWAY = 15
    STOPPED = 16
    OTHER = 99


MEANINGS: Final[Mapping[WriteReason, str]] = {
    WriteReason.NONE: "none",
    WriteReason.NO_LEASE: "no lease: the heartbeat does not count up, or the lease has ended",
    WriteReason.NOT_FROM_0: "the command register was not 0 before, since the lease began",
    WriteReason.LATCHED: "the drive is latched and shows no stop of lecombus: write a stop, then 0",
    WriteReason.HELD_BY_OTHER: "another client of lecombus holds a lease of the drive",
    WriteReason.FAULT_ACTIVE: "a fault is active",
    WriteReason.NO_ANSWER: "the drive does not answer, or the line is lost",
    WriteReason.NAK: "the drive refused it",
    WriteReason.BAD_VALUE: "the value cannot be sent: out of range, too fine",
    WriteReason.NOT_PERMITTED: "the roster or the drive's family does not permit it",
    WriteReason.SETTING: "a setting of the drive prevents it",
    WriteReason.NOT_IN_EFFECT: "the drive acknowledged it and does not show it",
    WriteReason.NOT_READY: "the drive is starting, is another one than before, or is busy",
    WriteReason.OVERLOADED: "it could not be sent in time",
    WriteReason.JOURNAL_FAILING: "the journal cannot be written",
    WriteReason.DAEMON_AWAY: "lecombus does not answer; what was under way may have happened",
    WriteReason.STOPPED: "a stop came first",
    WriteReason.OTHER: "something else: see the log of the bridge",
}

REASONS: Final[Mapping[str, WriteReason]] = {
    "lease-required": WriteReason.NO_LEASE, "lease-lost": WriteReason.NO_LEASE,
    "stale-counter": WriteReason.NO_LEASE, "no-such-lease": WriteReason.NO_LEASE,
    "latched": WriteReason.LATCHED, "lease-held": WriteReason.HELD_BY_OTHER,
    "fault-active": WriteReason.FAULT_ACTIVE,
    "offline": WriteReason.NO_ANSWER, "no-answer": WriteReason.NO_ANSWER,
    "garbled": WriteReason.NO_ANSWER, "line-lost": WriteReason.NO_ANSWER,
    "line-closed": WriteReason.NO_ANSWER, "unknown": WriteReason.NO_ANSWER,
    "nak": WriteReason.NAK, "refused": WriteReason.NAK, "bad-value": WriteReason.BAD_VALUE,
    "not-writable": WriteReason.NOT_PERMITTED, "not-permitted": WriteReason.NOT_PERMITTED,
    "locked": WriteReason.NOT_PERMITTED, "read-only": WriteReason.NOT_PERMITTED,
    "no-verb": WriteReason.NOT_PERMITTED, "no-stop": WriteReason.NOT_PERMITTED,
    "no-such-drive": WriteReason.NOT_PERMITTED, "no-control-word": WriteReason.NOT_READY,
    "setting": WriteReason.SETTING, "not-in-effect": WriteReason.NOT_IN_EFFECT,
    "other-identity": WriteReason.NOT_READY, "starting": WriteReason.NOT_READY,
    "busy": WriteReason.NOT_READY,
    "not-ready": WriteReason.NOT_READY, "unhealthy": WriteReason.NOT_READY,
    "expired": WriteReason.OVERLOADED, "queue-full": WriteReason.OVERLOADED,
    "does-not-fit": WriteReason.OVERLOADED, "too-many-writes": WriteReason.OVERLOADED,
    "journal-failing": WriteReason.JOURNAL_FAILING, "answer-lost": WriteReason.DAEMON_AWAY,
    "superseded": WriteReason.STOPPED, "client-gone": WriteReason.NO_LEASE,
}  # fmt: skip
"""By the words of docs/api.md."""

OUTCOMES: Final = (
    "none yet", "pending", "done", "verified", "refused", "expired", "superseded", "unknown",
)  # fmt: skip
DRIVE_STATES: Final = ("unknown", "starting", "online", "degraded", "offline")
LINE_STATES: Final = ("unknown", "open", "lost", "closed")
DOING: Final = ("unknown", "running", "stopping", "stopped", "enabled")
FAULT_KINDS: Final = ("none", *(str(kind) for kind in FaultKind))
UNITS: Final = ("none", "Hz", "%")
CONTROL_STATES: Final = (
    "the bridge only reads (`control: false`)", "no heartbeat",
    "the heartbeat counts, no lease yet", "lease held",
)  # fmt: skip
STATES: Final = tuple(OperatingState)
"""By bit."""
FRESH: Final = ("status word", "states, motion and fault", "actual speed", "setpoint")
"""By bit."""
COMMANDS: Final = tuple(one.verb for one in Command)
NEVER: Final = "65535: never, or longer"

LINE: Final = (
    Register(0, "map version", RegisterPart.ALWAYS, f"of this table: {MAP_VERSION}"),
    Register(1, "seconds", RegisterPart.ALWAYS, "counts the seconds of the bridge, 65535 to 0"),
    Register(2, "lecombus", RegisterPart.ALWAYS, "1: lecombus answers the bridge; 0: it is away"),
    Register(3, "control", RegisterPart.ALWAYS, "1: the roster says `modbus.control: true`"),
    Register(
        4, "stop sequence", RegisterPart.ALWAYS, "counts the stops of all drives sent by the bridge"
    ),
    Register(5, "stop command", RegisterPart.ALWAYS, "the command with that number"),
    Register(6, "stop outcome", RegisterPart.ALWAYS, "its outcome: that of the worst drive"),
    Register(7, "stop reason", RegisterPart.ALWAYS, "why it was not done"),
    Register(20, "line state", RegisterPart.FRESH, "state of the line"),
    Register(21, "drives", RegisterPart.FRESH, "how many drives the roster has"),
    Register(22, "drives online", RegisterPart.FRESH, "how many are online"),
    Register(23, "drives degraded", RegisterPart.FRESH, "how many are degraded"),
    Register(24, "drives offline", RegisterPart.FRESH, "how many are offline"),
    Register(
        40, "stop all", RegisterPart.WRITTEN, "1 quick stop, 2 inhibit: all drives, without a lease"
    ),
)

DRIVE: Final = (
    Register(0, "drive state", RegisterPart.ALWAYS, "state of the drive"),
    Register(1, "fresh", RegisterPart.ALWAYS, "which values are fresh", form="bits"),
    Register(2, "age of status word", RegisterPart.ALWAYS, f"0.1 s; {NEVER}"),
    Register(3, "age of speed", RegisterPart.ALWAYS, f"0.1 s; {NEVER}"),
    Register(4, "age of setpoint", RegisterPart.ALWAYS, f"0.1 s; {NEVER}"),
    Register(5, "unit of speed", RegisterPart.ALWAYS, "of the actual speed"),
    Register(6, "unit of setpoint", RegisterPart.ALWAYS, "of setpoint and setpoint demand"),
    Register(7, "control state", RegisterPart.ALWAYS, "who controls the drive by this bridge"),
    Register(8, "lease reason", RegisterPart.ALWAYS, "why there is no lease"),
    Register(9, "latched", RegisterPart.ALWAYS, "1: must be enabled under a lease"),
    Register(10, "command sequence", RegisterPart.ALWAYS, "counts the commands that were taken"),
    Register(11, "last command", RegisterPart.ALWAYS, "the command with that number"),
    Register(12, "command outcome", RegisterPart.ALWAYS, "its outcome"),
    Register(13, "command reason", RegisterPart.ALWAYS, "why it was not done"),
    Register(14, "setpoint sequence", RegisterPart.ALWAYS, "counts the setpoints that were taken"),
    Register(15, "setpoint outcome", RegisterPart.ALWAYS, "the outcome of the last one"),
    Register(16, "setpoint reason", RegisterPart.ALWAYS, "why it was not done"),
    Register(20, "status word", RegisterPart.FRESH, "as read from the drive", form="bits"),
    Register(21, "states", RegisterPart.FRESH,
             "what the status words show, the same for all families", 2,
             f"bits, {HIGH_WORD_FIRST}"),
    Register(23, "motion", RegisterPart.FRESH, "what the drive does"),
    Register(24, "fault kind", RegisterPart.FRESH, "the fault that the drive shows now"),
    Register(25, "fault number", RegisterPart.FRESH, "its LECOM number; 0: none, or not known"),
    Register(26, "actual speed", RegisterPart.FRESH, "1/10000 of its unit", 2, SIGNED),
    Register(28, "setpoint", RegisterPart.FRESH, "1/10000 of its unit, as read", 2, SIGNED),
    Register(40, "heartbeat", RegisterPart.WRITTEN, "the PLC counts it up: that holds the lease"),
    Register(41, "command", RegisterPart.WRITTEN, "counts when it was 0 before; stops always"),
    Register(42, "setpoint demand", RegisterPart.WRITTEN, "1/10000 of the unit of setpoint", 2,
             SIGNED),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sources:
    """Which codes of a family stand behind the registers of a drive.

    Args:
        status: The status word; None: the family has none.
        speed: The actual speed or output frequency; None: the family has none.
        speed_unit: Its unit, one of `UNITS`.
        setpoints: The codes that may hold the setpoint.
        setpoint_unit: Their unit, one of `UNITS`.
    """

    status: Code | None
    speed: Code | None
    speed_unit: str
    setpoints: tuple[Code, ...]
    setpoint_unit: str


@cache
def sources_of(of: Family) -> Sources:
    """Return the codes behind the registers of a family, from its data file."""
    speed = of.info(OUTPUT_FREQUENCY)
    has_speed = speed is not None and speed.unit in UNITS
    rules = of.verbs.setpoints if of.verbs is not None else ()
    unit = rules[0].unit if rules else UNITS[0]
    codes = [rule.code for rule in rules if rule.unit == unit]
    frequency = of.info(FREQUENCY_SETPOINT)
    if rules and frequency is not None and frequency.unit == unit:
        codes.append(FREQUENCY_SETPOINT)
    return Sources(
        status=next(iter(of.words), None),
        speed=OUTPUT_FREQUENCY if has_speed else None,
        speed_unit=str(speed.unit) if speed is not None and has_speed else UNITS[0],
        setpoints=tuple(dict.fromkeys(codes)),
        setpoint_unit=unit,
    )


def place_of(register: int) -> tuple[int, int]:
    """Return the drive's address (0: the line) and the offset in its block of a register."""
    return divmod(register, BLOCK)


# -- the map for people and programs ---------------------------------------------------------------

Row = tuple[str, ...]


def layout_rows(registers: Sequence[Register]) -> list[Row]:
    """Return a row for each register: place, name, when it can be read, what it holds."""
    return [
        (
            str(one.offset) if one.words == 1 else f"{one.offset}, {one.offset + 1}",
            one.name,
            one.part.value,
            f"{one.meaning} ({one.form})" if one.form else one.meaning,
        )
        for one in registers
    ]


def numbers_rows() -> Iterator[tuple[str, Row]]:
    """Give each list of numbers: the registers that use it, and what each number means."""
    yield "drive state", numbered(DRIVE_STATES)
    yield "line state", numbered(LINE_STATES)
    yield "motion", numbered(DOING)
    yield "fault kind", numbered(FAULT_KINDS)
    yield "units", numbered(UNITS)
    yield "control state", numbered(CONTROL_STATES)
    yield "command, last command", numbered(COMMANDS)
    yield "outcome", numbered(OUTCOMES)
    yield "reason", tuple(f"{one.value} {text}" for one, text in MEANINGS.items())
    yield "fresh, by bit", numbered(FRESH)
    yield "states, by bit", numbered(STATES)


def numbered(words: Sequence[str]) -> Row:
    """Return words with their numbers, from 0."""
    return tuple(f"{number} {word}" for number, word in enumerate(words))


def family_rows(names: Sequence[str]) -> list[Row]:
    """Return a row for each family: the codes and units behind its registers."""
    rows: list[Row] = []
    for name in names:
        of = family(name)
        found = sources_of(of)
        speed = "none" if found.speed is None else f"{found.speed} ({found.speed_unit})"
        codes = ", ".join(of.spoken(code) for code in found.setpoints)
        rows.append((
            name,
            "none" if found.status is None else str(found.status),
            speed,
            f"{codes} ({found.setpoint_unit})" if codes else "none",
        ))  # fmt: skip
    return rows


def roster_rows(drives: Sequence[tuple[str, int, str]]) -> list[dict[str, Any]]:
    """Return every register of a roster's drives, and of the line, as documents.

    Args:
        drives: Name, address and family of each.
    """
    found = [document("", 0, one, "") for one in LINE]
    for name, address, family_name in drives:
        sources = sources_of(family(family_name))
        codes = {
            "status word": sources.status, "actual speed": sources.speed,
            "setpoint": next(iter(sources.setpoints), None),
            "setpoint demand": next(iter(sources.setpoints), None),
        }  # fmt: skip
        units = {"actual speed": sources.speed_unit}
        for one in DRIVE:
            code = codes.get(one.name)
            row = document(name, address * BLOCK, one, "" if code is None else str(code))
            if one.name in codes and one.words == 2:
                unit = units.get(one.name, sources.setpoint_unit)
                row["scale"] = None if unit == UNITS[0] else f"1/{SCALE} {unit}"
            found.append(row)
    return found


def document(drive: str, first: int, register: Register, code: str) -> dict[str, Any]:
    """Return one register as a document."""
    return {
        "register": first + register.offset, "words": register.words, "drive": drive or None,
        "name": register.name, "part": register.part.value, "meaning": register.meaning,
        "form": register.form or None, "code": code or None,
    }  # fmt: skip


def map_markdown(families: Sequence[str]) -> str:
    """Return the general table, as docs/modbus.md has it."""
    head = ("register", "name", "", "what")
    parts = [
        "### The line: registers 0 to 99", *table(head, layout_rows(LINE)), "",
        "### A drive: from 100 times its address on", *table(head, layout_rows(DRIVE)), "",
        "### Numbers", *table(("registers", "numbers"),
                              [(name, "; ".join(words)) for name, words in numbers_rows()]), "",
        "### Codes behind the registers, by family",
        *table(("family", "status word", "actual speed", "setpoint"), family_rows(families)),
    ]  # fmt: skip
    return "\n".join(parts) + "\n"


def table(head: Row, rows: Sequence[Row]) -> list[str]:
    """Return a table of Markdown."""
    return [
        f"| {' | '.join(head)} |",
        f"|{'---|' * len(head)}",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
