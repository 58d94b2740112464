"""What must hold of every drive before the first of them is written to.

Every drive is asked and every obstacle named before anything is decided. A drive must answer at the
old rate, or at the new one if an earlier attempt left it there; hold the rate it answers at; be the
one that it should be; be stopped, because it cannot be stopped over the line while the rates
differ; and be writable. What it reports of its motion and what its watchdog will do is shown.

Source: EDB2102EN 6.1.3, 6.3, 6.4 (820X saves only while inhibited), 8.2; CMVLC401A preface, 4.2.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from lecombus.drives.procedures import Standstill, ask_standstill, is_identity, is_passing, text_of
from lecombus.durations import format_duration
from lecombus.fieldbus.lecom.address_codes import CODE_BANK, SHIFTING
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import Code, Value

from .drives import DrivePlace, RebaudDrive, RebaudLine

__all__ = ["Obstacle", "check", "is_same_drive", "standstill"]

NETWORK_LEVEL = Code(1420)


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Why nothing is written.

    Args:
        drive: The drive's name.
        problem: What is wrong.
        remedy: What would be right.
        kind: A stable word for programs.
    """

    drive: str
    problem: str
    remedy: str
    kind: str


async def check(
    line: RebaudLine, drives: Iterable[RebaudDrive], old: int, new: int
) -> list[Obstacle]:
    """Ask every drive whether its baud rate may be changed.

    Args:
        line: Reads the drives.
        drives: All drives of the line; what is found is noted in them.
        old: The present baud rate, bit/s.
        new: The baud rate wanted, bit/s.

    Returns:
        Every obstacle; none: the change may begin.
    """
    obstacles: list[Obstacle] = []
    silent: list[RebaudDrive] = []
    for drive in drives:
        number = await line.read_rate(drive, old, retries=2)
        if number is None:
            silent.append(drive)
        else:
            obstacles += await _check_one(line, drive, old, number)
    for drive in silent:
        number = await line.read_rate(drive, new, retries=2)
        if number is not None:
            obstacles += await _check_one(line, drive, new, number)
        else:
            obstacles.append(_silent(drive, old, new))
    return obstacles


def _silent(drive: RebaudDrive, old: int, new: int) -> Obstacle:
    return Obstacle(
        drive.name,
        f"{drive.name} (address {drive.subject.address}) does not say its baud rate "
        f"({drive.subject.spoken}), neither at {old} nor at {new} baud",
        "every drive of the roster must answer first: check its supply, its address and the "
        "wires, find it by `lecombus scan --port .. --all-bauds`, or take it out of the roster",
        "no-answer",
    )


async def _check_one(
    line: RebaudLine, drive: RebaudDrive, rate: int, number: int
) -> list[Obstacle]:
    """Check a drive that answers at a rate."""
    code, right = drive.subject.spoken, drive.subject.number(rate)
    if number != right:
        problem = f"{drive.name} answers at {rate} baud, but its {code} reads {number}, not {right}"
        remedy = "switch it off and on, or set its baud rate at its keypad, then try again"
        return [Obstacle(drive.name, problem, remedy, "wrong-rate")]
    drive.be(DrivePlace.UNSEEN, rate)
    steps = (_identity, _addressing, _software, _permission, _stopped)
    found = [await step(line, drive, rate) for step in steps]
    await _watchdog(line, drive, rate)
    return [one for one in found if one is not None]


# ---- who it is ----------------------------------------------------------------------------------


async def _identity(line: RebaudLine, drive: RebaudDrive, rate: int) -> Obstacle | None:
    found, differing = {}, []
    for code in drive.subject.asked:
        answer = await line.read(drive, rate, code)
        if answer.value is None and is_passing(answer.kind):
            name = drive.subject.family.spoken(code)
            problem = f"{drive.name} does not say who it is ({name}): {answer.text}"
            return Obstacle(drive.name, problem, "check the line, then try again", "no-answer")
        if answer.value is None:
            continue
        found[code] = answer.value
        if not is_identity(answer.value, drive.subject.expected.get(code)):
            differing.append(code)
    drive.identity = found
    if not differing:
        return None
    told = ", ".join(
        f"{drive.subject.family.spoken(code)} reads {text_of(found[code])}, "
        f"not {drive.subject.expected[code]}"
        for code in differing
    )
    remedy = f"`lecombus accept {drive.name}` or its `identity` in the roster, if it was replaced"
    return Obstacle(drive.name, f"{drive.name} is another drive: {told}", remedy, "swapped")


async def is_same_drive(line: RebaudLine, drive: RebaudDrive, rate: int) -> str:
    """Read the identity again; return what differs, empty when it is the same."""
    for code, before in drive.identity.items():
        answer = await line.read(drive, rate, code)
        spoken = drive.subject.family.spoken(code)
        if answer.value is None:
            return f"it does not say who it is there ({spoken}: {answer.text})"
        if not is_identity(answer.value, text_of(before)):
            return f"{spoken} reads {text_of(answer.value)} there, not {text_of(before)}"
    return ""


# ---- whether it can be written to ---------------------------------------------------------------


async def _addressing(line: RebaudLine, drive: RebaudDrive, rate: int) -> Obstacle | None:
    """In standard addressing a code bank would make another code of C0125."""
    subject = drive.subject
    if subject.form is Form.EXTENDED or subject.family.info(CODE_BANK) is None:
        return None
    for code in reversed(SHIFTING):
        answer = await line.read(drive, rate, code)
        if answer.value is None or answer.value.number != 0:
            shown = answer.value.raw if answer.value is not None else "nothing"
            problem = f"{code} of {drive.name} reads {shown}: a write would reach another code"
            remedy = "switch it off and on, or write `addressing: both` for it in the roster"
            return Obstacle(drive.name, problem, remedy, "locked")
    return None


async def _software(line: RebaudLine, drive: RebaudDrive, rate: int) -> Obstacle | None:
    gate = drive.subject.family.software
    if gate is None:
        return None
    answer = await line.read(drive, rate, gate.code)
    accepted = (*gate.versions, *drive.subject.accept_software)
    if answer.value is not None and any(is_identity(answer.value, one) for one in accepted):
        return None
    shown = text_of(answer.value) if answer.value is not None else "nothing"
    name = drive.subject.family.spoken(gate.code)
    problem = f"{name} of {drive.name} reads software {shown}, not {' or '.join(accepted)}"
    remedy = "nothing is written to it, unless the roster names that in `accept_software`"
    return Obstacle(drive.name, problem, remedy, "locked")


async def _permission(line: RebaudLine, drive: RebaudDrive, rate: int) -> Obstacle | None:
    """Ask an SMVector whether its network may set parameters."""
    if drive.subject.family.info(NETWORK_LEVEL) is None:
        return None
    answer = await line.read(drive, rate, NETWORK_LEVEL)
    if answer.value is not None and answer.value.number != 0:
        return None
    shown = answer.value.raw if answer.value is not None else "nothing"
    problem = f"P420 of {drive.name} reads {shown}: it takes no parameters over the line"
    return Obstacle(drive.name, problem, "set P420 to 1 or more at its keypad", "locked")


# ---- whether it is stopped ----------------------------------------------------------------------


async def _stopped(line: RebaudLine, drive: RebaudDrive, rate: int) -> Obstacle | None:
    found = await standstill(line, drive, rate)
    drive.motion = found.known
    if not found.obstacle:
        return None
    remedy = f"stop it first: `lecombus inhibit {drive.name}`, then end the daemon and try again"
    if found.inhibited:
        remedy = "wait until its motor has come to rest, then try again"
    return Obstacle(drive.name, f"{drive.name} {found.obstacle}", remedy, "not-stopped")


async def standstill(line: RebaudLine, drive: RebaudDrive, rate: int) -> Standstill:
    """Read what a drive reports of its motion."""

    async def read(code: Code) -> Value | None:
        return (await line.read(drive, rate, code)).value

    return await ask_standstill(read, drive.subject.family, drive.subject.code, "its baud rate")


async def _watchdog(line: RebaudLine, drive: RebaudDrive, rate: int) -> None:
    """Note what the watchdog will do: it is not fed while the rates differ."""
    traits = drive.subject.family.watchdog
    if traits is None:
        return
    time = await line.read(drive, rate, traits.time_code)
    action = await line.read(drive, rate, traits.action_code)
    number = action.value.quantity if action.value is not None else None
    word = traits.action_of(int(number)) if number is not None else None
    if time.value is None or word is None:
        drive.note = (
            "its watchdog could not be read: if it is set, it will act; it is stopped anyway"
        )
    elif word != "none" and time.value.number:
        drive.note = _acting(word, time.value.number)


def _acting(word: str, time_ms: object) -> str:
    after = format_duration(int(str(time_ms)) / 1000.0)
    told = f"its watchdog will act ({word} after {after})"
    if word == "trip":
        return f"{told}: it is stopped anyway, and shows a fault until `lecombus reset-fault`"
    return f"{told}: it is stopped anyway"
