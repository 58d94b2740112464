"""The operating states that drives report, in the same words for every family.

A rule is a mask and a number (`StateRule`, from the family's data file). A state has a rule only
where the manual gives the bit that one meaning: bits that users assign have none, and neither have
bits that two manuals contradict each other about (the "power stage energized" bits of SMVector).
The absence of a state proves nothing: "not inhibited" does not mean that the motor turns. An output
frequency of 0 does not mean standstill: only a drive that measures its speed reports that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["OperatingState", "StateRule", "believed_states", "join_states"]


class OperatingState(StrEnum):
    """One thing that a drive reports of itself."""

    READY = "ready"
    """Ready for operation: no fault, no overvoltage or undervoltage."""
    INITIALISING = "initialising"
    START_LOCK = "start_lock"
    """Autostart lock, switch-on inhibit: it waits for a fresh enable."""
    INHIBITED = "inhibited"
    """Controller inhibit."""
    OPERATION_INHIBITED = "operation_inhibited"
    """By the controller status: the line, a terminal or the drive itself inhibits it."""
    ENABLED = "enabled"
    """Operation enabled: not that the motor turns."""
    QUICK_STOP = "quick_stop"
    PULSES_INHIBITED = "pulses_inhibited"
    AT_SETPOINT = "at_setpoint"
    RAMP_DONE = "ramp_done"
    """The ramp generator's output has reached its input."""
    OUTPUT_FREQUENCY_0 = "output_frequency_0"
    """An inverter puts out a frequency of 0: its motor may still coast."""
    ZERO_SPEED = "zero_speed"
    """The drive measures an actual speed of 0; only a 93XX does."""
    BELOW_THRESHOLD = "below_threshold"
    ABOVE_THRESHOLD = "above_threshold"
    CURRENT_LIMIT = "current_limit"
    TORQUE_LIMIT = "torque_limit"
    DIRECTION_CCW = "direction_ccw"
    PARAMETER_SET_2 = "parameter_set_2"
    FLYING_RESTART = "flying_restart"
    DC_BRAKING = "dc_braking"
    HOMING = "homing"
    HOMED = "homed"
    OVERVOLTAGE = "overvoltage"
    WARNING = "warning"
    MESSAGE = "message"
    """It has stopped the pulses by itself and goes on when the cause is gone."""
    FAULT = "fault"
    POWER_OFF = "power_off"


@dataclass(frozen=True, slots=True)
class StateRule:
    """Values of a word that show a state: `word & mask == equals`."""

    state: OperatingState
    mask: int
    equals: int

    def holds(self, word: int) -> bool:
        """Return whether a word shows the state."""
        return word & self.mask == self.equals


OPPOSITES = {
    OperatingState.ENABLED: OperatingState.INHIBITED,
    OperatingState.INHIBITED: OperatingState.ENABLED,
}


def join_states(words: Iterable[Iterable[OperatingState]]) -> tuple[OperatingState, ...]:
    """Join the states that several words of a drive show.

    Words are read at different times: where one contradicts another, the earlier in the list is
    believed and the other says nothing.

    Args:
        words: The states of each word, the word that is read most often first.
    """
    found: dict[OperatingState, None] = {}
    for states in words:
        known = frozenset(found)
        found |= {state: None for state in states if OPPOSITES.get(state) not in known}
    return tuple(sorted(found, key=ORDER.__getitem__))


def believed_states(
    words: Sequence[tuple[float, Collection[OperatingState], Collection[OperatingState]]],
) -> list[tuple[OperatingState, ...]]:
    """Leave out of each word what a newer one denies.

    A word denies what it could show and does not show, and the opposite of what it shows.

    Args:
        words: Age in seconds, states shown and states that could be shown, of each word.
    """
    denied = [
        (age_s, (set(able) - set(shown)) | {OPPOSITES[one] for one in shown if one in OPPOSITES})
        for age_s, shown, able in words
    ]
    return [
        tuple(
            state
            for state in shown
            if not any(newer_s < age_s and state in states for newer_s, states in denied)
        )
        for age_s, shown, _ in words
    ]


ORDER = {state: number for number, state in enumerate(OperatingState)}
