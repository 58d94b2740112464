"""What is known of a lease, and of the control of one drive."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

__all__ = [
    "DriveControl",
    "EndOfLease",
    "EndedLease",
    "HeldLease",
    "Latch",
    "LeaseTerms",
    "Use",
    "is_same_token",
]


class Use(StrEnum):
    """What a write is for; a latched drive takes only some."""

    SETTING = "setting"
    """A described parameter that is none of the others."""
    SETPOINT = "setpoint"
    """A code that holds a speed setpoint and nothing else, or a setting that acts on setpoints."""
    TAKE_CONTROL = "take-control"
    """A setting that says who controls the drive, with a value that gives control to the line."""
    MOTION = "motion"
    """A control word, a code that no description knows, or any other that can move the drive."""
    ENABLE = "enable"
    """A step of the verbs `enable` and `reset-fault`."""


class Latch(StrEnum):
    """Why a drive must be enabled again before it takes setpoints."""

    STARTED = "started"
    """lecombus was started, or the roster requires the lease since a reload: nobody holds one."""
    LAPSED = "lapsed"
    RELEASED = "released"


class EndOfLease(StrEnum):
    """How a lease ended."""

    LAPSED = "lapsed"
    RELEASED = "released"
    TAKEN_OVER = "taken-over"
    NONE_TAKEN = "none-taken"
    """There was none: none was taken in time after the start."""
    CAME_BACK = "came-back"
    """It ended before; the drive was away and is not shown stopped now."""


@dataclass(frozen=True, slots=True)
class LeaseTerms:
    """What the roster says of the lease of one drive.

    Args:
        required: Whether control of the drive needs one.
        time_s: The longest time that a client may ask for, seconds.
        on_lapse: What is done at the end: quick-stop, inhibit, silence or hold.
        has_enable: Whether its family has the verb `enable`; else taking a lease enables it.
    """

    required: bool
    time_s: float
    on_lapse: str
    has_enable: bool = True


@dataclass(slots=True)
class HeldLease:
    """A lease that is held.

    Args:
        name: Its name, given by the client.
        number: Its number; each lease of the line has a larger one than those before.
        secret: The random part of its token.
        targets: Drives and groups as the client named them.
        drives: The drives.
        time_s: It lapses so long after its last renewal, seconds.
        counter: The largest counter that the client sent.
        taken_at_s: When it was taken.
        ends_at_s: When it lapses unless it is renewed.
        holder: Who took it, as logged.
    """

    name: str
    number: int
    secret: str = field(repr=False)
    targets: tuple[str, ...]
    drives: tuple[str, ...]
    time_s: float
    counter: int
    taken_at_s: float
    ends_at_s: float
    holder: Mapping[str, str]

    @property
    def token(self) -> str:
        """The token that writes must carry; never logged."""
        return f"{self.number}-{self.secret}"


@dataclass(frozen=True, slots=True)
class EndedLease:
    """The end of a lease that has no successor, to be carried out once.

    Args:
        name: Its name; empty: there was none.
        number: Its number, 0: there was none.
        drives: The drives without a controller from now on.
        end: How it ended.
        at_s: When.
    """

    name: str
    number: int
    drives: tuple[str, ...]
    end: EndOfLease
    at_s: float


@dataclass(slots=True)
class DriveControl:
    """Who controls one drive.

    Args:
        terms: What the roster says.
        lease: The lease that is held for it; None: there is none.
        latch: Why it must be enabled again first; None: it need not.
        due_s: After a start: when it is stopped if it runs and nobody took a lease.
        ended: How its last lease ended; None: it had none since the start.
        successor: The name of the lease that took over, if that is how it ended.
    """

    terms: LeaseTerms
    lease: HeldLease | None = None
    latch: Latch | None = None
    due_s: float | None = None
    ended: EndedLease | None = None
    successor: str = ""


def is_same_token(one: str, other: str) -> bool:
    """Compare tokens in constant time."""
    encoded = (text.encode(errors="backslashreplace") for text in (one, other))
    return hmac.compare_digest(*encoded)
