"""Whether a drive runs, what stops it, how fast it is and should be: from what is known of it.

Strategy: every word that can show a stop is looked at, the status words and those that prove a stop
(`drives.stops`), and each stop is reported with the words that show it. While the first status word
is fresh only fresh values count, and what a newer status word denies does not, so that an old word
cannot contradict a new one; otherwise all is reported as last known, and marked so. An old word
that no newer one denies and that showed a stop makes it unknown whether the drive is enabled: many
drives show a quick stop in no word that is read often. What was read before the last command to
stop or to run does not count at all. After a silence in which its watchdog may have acted a drive
is not said to be enabled until a status word that can show a quick stop shows none, or the drive
has acknowledged a write of the code of its quick stop. "Stopped" means that something keeps the
drive from driving its motor. The shaft may turn all the same, as that of a coasting motor does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from lecombus.drive_state.readings import (
    WRITTEN_SINCE,
    ActiveFault,
    Quality,
    Reading,
    json_value,
    seconds,
)
from lecombus.drives import Family, OperatingState, StopAction, believed_states
from lecombus.drives.stops import shown_after
from lecombus.drives.verb_facts import Known, active_set_word, settings_in_force
from lecombus.drives.verb_rules import SetpointRule
from lecombus.parameters import Code, Json, Value

__all__ = [
    "Doing",
    "Lapse",
    "Motion",
    "Speed",
    "Stop",
    "learnt_setpoint",
    "motion_of",
    "overtaken_commands",
    "setpoint_codes",
    "shown_after_lapse",
]

OUTPUT: Final = Code(50)
SETPOINT: Final = Code(46)

TEXTS: Final = {
    OperatingState.FAULT: "fault",
    OperatingState.MESSAGE: "message",
    OperatingState.POWER_OFF: "power off",
    OperatingState.INITIALISING: "initialising",
    OperatingState.START_LOCK: "start lock",
    OperatingState.QUICK_STOP: "quick stop",
    OperatingState.INHIBITED: "inhibited",
}
"""The states that stop a drive, the most conclusive first."""

NOT_ENABLED: Final = (OperatingState.OPERATION_INHIBITED, OperatingState.PULSES_INHIBITED)
"""What a drive shows besides the cause; reported only where no cause is shown."""

AT_ZERO: Final = (OperatingState.ZERO_SPEED, OperatingState.OUTPUT_FREQUENCY_0)
"""A measured speed (93XX), or the output frequency of an inverter."""

OF_ACTION: Final = {
    "quick-stop": OperatingState.QUICK_STOP,
    "inhibit": OperatingState.INHIBITED,
}


class Doing(StrEnum):
    """What a drive does with its motor."""

    RUNNING = "running"
    STOPPING = "stopping"
    """It ramps down in a quick stop."""
    STOPPED = "stopped"
    ENABLED = "enabled"
    """Nothing stops it, and it reports output speed 0 or none: a setpoint lets it turn."""
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Stop:
    """One thing that stops a drive.

    Args:
        name: A stable word for it.
        text: What it is.
        shown_by: The words that show it, such as `C0135 reads H0008`.
    """

    name: str
    text: str
    shown_by: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Speed:
    """A speed, actual or wanted.

    Args:
        reading: Its code and value.
        written: It is what was written and acknowledged, and not read since.
    """

    reading: Reading
    written: bool = False

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        one = self.reading
        return {
            "code": f"C{one.code.number:04d}",
            "value": None if one.value is None else json_value(one.value),
            "raw": None if one.value is None else one.value.raw,
            "unit": one.unit,
            "age_s": None if one.age_s is None else seconds(one.age_s),
            "stale": one.quality is not Quality.GOOD,
            "known_by": "written" if self.written else "read",
        }


@dataclass(frozen=True, slots=True)
class Motion:
    """What a drive does, as far as that is known.

    Args:
        doing: What it does with its motor.
        stops: What stops it; where `doing` is unknown, what stopped it as last known.
        speed: Its output frequency; None where its family has none with a unit, or none was read.
        zero: Whether its output frequency is 0 (93XX: its speed); None where that is not known. A
            motor that coasts behind an inverter still turns then.
        setpoint: The speed wanted, as last read or written; None where none is known.
        age_s: Age of the oldest word it rests on, seconds; None where none is known.
        stale: It is reported as last known: the words are not fresh.
    """

    doing: Doing
    stops: tuple[Stop, ...] = ()
    speed: Speed | None = None
    zero: bool | None = None
    setpoint: Speed | None = None
    age_s: float | None = None
    stale: bool = False

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "doing": self.doing.value,
            "stops": [
                {"name": one.name, "text": one.text, "shown_by": list(one.shown_by)}
                for one in self.stops
            ],
            "speed": None if self.speed is None else self.speed.as_json(),
            "zero": self.zero,
            "setpoint": None if self.setpoint is None else self.setpoint.as_json(),
            "age_s": None if self.age_s is None else seconds(self.age_s),
            "stale": self.stale,
        }


@dataclass(frozen=True, slots=True)
class Lapse:
    """The last silence in which a drive's watchdog may have acted.

    Args:
        age_s: How long ago it ended, seconds: what is older was read before that.
        may_quick_stop: It may have set a quick stop, and the drive has acknowledged no write of the
            code of its quick stop since.
    """

    age_s: float
    may_quick_stop: bool = True


WATCHDOG: Final = Stop("watchdog", "its watchdog may have acted", ())
"""What may stop a drive that was silent for its watchdog's time."""


def setpoint_codes(family: Family) -> tuple[Code, ...]:
    """Name the codes that hold a family's speed setpoint."""
    codes = [rule.code for rule in family.verbs.setpoints] if family.verbs is not None else []
    if _has_unit(family, SETPOINT):
        codes.append(SETPOINT)
    return tuple(dict.fromkeys(codes))


def learnt_setpoint(family: Family) -> Code | None:
    """Name the code that shows the setpoint of a drive of which nothing was written yet."""
    codes = setpoint_codes(family)
    return SETPOINT if SETPOINT in codes else next(iter(codes), None)


def motion_of(
    family: Family,
    fault: ActiveFault | None,
    known: Callable[[Code], Reading | None],
    written: Iterable[Reading],
    lapse: Lapse | None = None,
) -> Motion:
    """Say what a drive does.

    Args:
        family: Its family.
        fault: The fault it has.
        known: Gives what is known of a code, with its quality; None: never asked for.
        written: The setpoints that were written and acknowledged.
        lapse: The last silence in which its watchdog may have acted.
    """
    speed = known(OUTPUT) if _has_unit(family, OUTPUT) else None
    actual = None if speed is None or speed.value is None else Speed(speed)
    first = next((known(code) for code in family.words), None)
    if first is None or _usable(first, stale=True) is None:
        return Motion(Doing.UNKNOWN, speed=actual, setpoint=_setpoint(family, known, written))
    stale = first.quality is not Quality.GOOD
    proofs = [code for rule in family.stops.values() for code in rule.proofs]
    overtaken = overtaken_commands(family, known)
    last_known = [
        reading
        for code in dict.fromkeys((*family.words, *proofs))
        if code not in overtaken and (reading := _usable(known(code), stale=True)) is not None
    ]
    words = [one for one in last_known if stale or one.quality is Quality.GOOD]
    states = _states(family, words)
    stops = _stops(states, fault)
    zero = _zero(family, _usable(speed, stale=stale), states)
    doing = _doing(stops, states, zero)
    is_free = doing in (Doing.ENABLED, Doing.UNKNOWN)
    if is_free and (old := _stops(_states(family, last_known), None)):
        doing, stops, words, stale = Doing.UNKNOWN, old, last_known, True
    elif lapse is not None and not _runs_since(lapse, family, doing, words, actual):
        doing, stops = Doing.UNKNOWN, (WATCHDOG,)
    return Motion(
        doing,
        stops,
        actual,
        zero,
        _setpoint(family, known, written),
        max((one.age_s or 0.0 for one in words), default=first.age_s),
        stale,
    )


def _runs_since(
    lapse: Lapse, family: Family, doing: Doing, words: list[Reading], speed: Speed | None
) -> bool:
    """Return whether what was read since a lapse shows what a drive does; a stop is a stop anyway.

    A control word that reads no quick stop shows nothing: a drive may give back what was last
    written to it, and not what its watchdog set (ADR 38).
    """
    if doing not in (Doing.RUNNING, Doing.ENABLED):
        return True
    since = {one.code for one in words if (one.age_s or 0.0) <= lapse.age_s}
    if next(iter(family.words)) not in since:
        return False
    if doing is Doing.RUNNING:
        return speed is None or (speed.reading.age_s or 0.0) <= lapse.age_s
    possible = {state for code in since & family.words.keys()
                for state in family.words[code].possible_states}  # fmt: skip
    return not lapse.may_quick_stop or OperatingState.QUICK_STOP in possible


def shown_after_lapse(family: Family, *, quick_stops: bool) -> tuple[Code, ...]:
    """Return what must be read before it is known what a drive does after a lapse of its watchdog.

    In an order in which no word read so far shows a drive as enabled that has a quick stop.

    Args:
        family: Its family.
        quick_stops: What its watchdog does is a quick stop.
    """
    rule = family.stops.get(StopAction.QUICK_STOP) if quick_stops else None
    stops = () if rule is None else shown_after(family, rule.code)
    speed = (OUTPUT,) if _has_unit(family, OUTPUT) else ()
    return tuple(dict.fromkeys((*stops, *list(family.words)[:1], *speed)))


def overtaken_commands(family: Family, known: Callable[[Code], Reading | None]) -> frozenset[Code]:
    """Name the commands to stop (C0040, C0135) whose old value says nothing of what stops a drive.

    A keypad may have changed it, and a fresh status word can show what it does. Where none can, or
    the one that can is old too, the command stays the last that is known.

    Args:
        family: Its family.
        known: Gives what is known of a code, with its quality; None: never asked for.
    """
    shown = {
        state
        for code, word in family.words.items()
        if (one := known(code)) is not None and one.quality is Quality.GOOD
        for state in word.possible_states
    }
    effects: dict[Code, set[OperatingState]] = {}
    for action, rule in family.stops.items():
        effects.setdefault(rule.code, set()).add(OF_ACTION[action])
    return frozenset(
        code
        for code, states in effects.items()
        if (command := known(code)) is not None
        and command.quality is not Quality.GOOD
        and states <= shown
    )


def _usable(reading: Reading | None, *, stale: bool) -> Reading | None:
    """Give a word that counts: a fresh one, or any where the drive is reported as last known."""
    if reading is None or reading.value is None or reading.reason == WRITTEN_SINCE:
        return None
    return reading if stale or reading.quality is Quality.GOOD else None


def _states(family: Family, words: list[Reading]) -> dict[OperatingState, list[str]]:
    """Give each state that the words show, with the words that show it."""
    seen = [
        (one.age_s or 0.0, *_shown_by(family, one.code, one.value)) for one in words if one.value
    ]
    found: dict[OperatingState, list[str]] = {}
    for reading, shown in zip(words, believed_states(seen), strict=True):
        assert reading.value is not None
        for state in dict.fromkeys(shown):
            found.setdefault(state, []).append(
                f"{family.spoken(reading.code)} reads {reading.value.raw}"
            )
    return found


def _shown_by(
    family: Family, code: Code, value: Value
) -> tuple[list[OperatingState], set[OperatingState]]:
    """Give the states that a word shows, and those that it can report: only a status word can.

    A command that does not stop a drive denies no stop: a terminal may stop it all the same.
    """
    word = family.words.get(code)
    shown: list[OperatingState] = []
    possible: set[OperatingState] = set()
    if word is not None and type(value.number) is int:
        shown += word.shown_states(value.number)
        possible |= word.possible_states
    for action, rule in family.stops.items():
        proof = rule.proofs.get(code)
        shows = None if proof is None else proof.shown_by(value)
        if shows:
            shown.append(OF_ACTION[action])
        if shows is not None and word is not None:
            possible.add(OF_ACTION[action])
    return shown, possible


def _stops(states: dict[OperatingState, list[str]], fault: ActiveFault | None) -> tuple[Stop, ...]:
    found = []
    if fault is not None and fault.kind != "warning":
        found.append(Stop(str(fault.kind), str(fault), (fault.shown_by,)))
    for state, text in TEXTS.items():
        is_told = found and state in (OperatingState.FAULT, OperatingState.MESSAGE)
        if state in states and not is_told:
            found.append(Stop(state.value.replace("_", "-"), text, tuple(states[state])))
    if not found and OperatingState.ENABLED not in states:
        shown = [said for state in NOT_ENABLED for said in states.get(state, ())]
        if shown:
            found.append(Stop("not-enabled", "not enabled", tuple(dict.fromkeys(shown))))
    return tuple(found)


def _zero(
    family: Family, speed: Reading | None, states: dict[OperatingState, list[str]]
) -> bool | None:
    """Return whether the output is 0, by the code that shows it or by the status word."""
    if speed is not None and speed.value is not None:
        return speed.value.number == 0
    rules = [rule for word in family.words.values() for rule in word.states]
    if any(rule.state in AT_ZERO for rule in rules):
        return any(state in states for state in AT_ZERO)
    return None


def _doing(
    stops: tuple[Stop, ...], states: dict[OperatingState, list[str]], zero: bool | None
) -> Doing:
    if stops:
        ramps = all(one.name == "quick-stop" for one in stops) and zero is False
        return Doing.STOPPING if ramps else Doing.STOPPED
    if zero is False:
        return Doing.RUNNING
    return Doing.ENABLED if OperatingState.ENABLED in states else Doing.UNKNOWN


def _setpoint(
    family: Family, known: Callable[[Code], Reading | None], written: Iterable[Reading]
) -> Speed | None:
    """Give the setpoint that was read or written last, of the codes that the drive obeys.

    A drive without a setting for that obeys the code that was written last (820X).
    """
    unused = _unused_setpoints(family, known)
    said = [Speed(one, written=True) for one in written if one.code not in unused]
    read = (_usable(known(code), stale=True) for code in setpoint_codes(family))
    found = said + [Speed(one) for one in read if one is not None and one.code not in unused]
    if said:
        last = min(said, key=lambda one: one.reading.age_s or 0.0)
        found = [one for one in found if one.reading.code == last.reading.code]
    newest = min(found, key=lambda one: (one.reading.age_s or 0.0, one.written), default=None)
    if newest is None or newest.reading.unit:
        return newest
    info = family.info(newest.reading.code)
    return replace(newest, reading=replace(newest.reading, unit=info.unit if info else None))


def _unused_setpoints(family: Family, known: Callable[[Code], Reading | None]) -> set[Code]:
    """Name the codes of setpoints that have no effect, by a setting that is known (C0127).

    Source: EDB2102EN 6.5.
    """
    rules = family.verbs.setpoints if family.verbs is not None else ()
    word = active_set_word(family)
    asked = {word} if word is not None else set()
    for rule in rules:
        if rule.when is not None:
            code = rule.when.code
            asked |= {Code(code.number + offset, code.subcode) for offset in family.set_offsets}
    read = {code: _usable(known(code), stale=True) for code in asked}
    facts = Known("", family, {
        code: one.value for code, one in read.items() if one is not None and one.value is not None
    })  # fmt: skip

    def is_unused(rule: SetpointRule) -> bool:
        if rule.when is None:
            return False
        settings = settings_in_force(facts, rule.when.code).values()
        return bool(settings) and not any(map(rule.when.holds, settings))

    used = {rule.code for rule in rules if not is_unused(rule)}
    return {rule.code for rule in rules} - used


def _has_unit(family: Family, code: Code) -> bool:
    info = family.info(code)
    return info is not None and bool(info.unit)
