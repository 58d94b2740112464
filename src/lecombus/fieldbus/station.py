"""What a job is to the exchange loop: a station to speak to, the next step, and how it ended.

A job is the part of a request that knows the protocol. The schedule carries it without looking
in; the loop asks it for the next step, runs that step as one exchange and gives it the result,
until the job says how the request ended. Between two steps of a job anything more urgent may run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from ..drives import Family
from ..drives.measured import MeasuredTimes, manual_s
from ..errors import ExchangeError
from ..parameters import AddressForm, Code, Value
from ..schedule.request import Outcome

__all__ = ["Job", "JobStep", "Station", "StepKind", "Verdict"]

Verdict = tuple[Outcome, str] | None
"""How a request ended and why, or None when another step is wanted."""


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A drive as the line sees it.

    Args:
        name: Its name in the roster.
        address: 1..99, not ending in 0; for a multicast the group address.
        family: Its description, with the roster's overrides applied.
        forms: The addressing forms it is spoken to in, the preferred first.
        hold_s: How long it is left alone after a write, seconds: with shortened response time
            (C1921 = 1) the module acknowledges before it has passed the value on. Until it is
            known whether it does, it is taken to.
        answers_early: It is known to have shortened response time.
        answer_time_s: The roster's word on how long it thinks, seconds; None: the family's.
        measured: How long it really thinks.
    """

    name: str
    address: int
    family: Family
    forms: tuple[AddressForm, ...]
    hold_s: float = 0.0
    answer_time_s: float | None = None
    measured: MeasuredTimes = field(default_factory=MeasuredTimes)
    answers_early: bool = False

    def answer_s(self, code: Code, *, write: bool = False) -> float | None:
        """Return how long it thinks, for calculations; None: what its family says."""
        return self.measured.slow.time_s(
            self.family, code, write=write, answer_time_s=self.answer_time_s
        )

    def documented_s(self, code: Code, *, write: bool = False) -> float:
        """Return the longest that manual and roster let it think, seconds."""
        return manual_s(self.family, code, write=write, answer_time_s=self.answer_time_s)


class StepKind(StrEnum):
    """What one exchange does."""

    READ = "read"
    WRITE = "write"
    MULTICAST = "multicast"


class JobStep(NamedTuple):
    """One exchange to be run: read `code`, in `form` if that is free, or write `value` to it.

    Where `only` is set the read waits until its `form` is free.
    """

    kind: StepKind
    code: Code
    value: Value | None = None
    form: AddressForm | None = None
    only: bool = False


class Job(Protocol):
    """What the exchange loop needs of a job."""

    station: Station
    error: ExchangeError | None

    @property
    def step(self) -> JobStep:
        """The next exchange to run."""

    @property
    def cut_outcome(self) -> Outcome | None:
        """How it ends if it is cut off between two steps; None: nothing was changed."""

    def advance(self, result: Any) -> Verdict:
        """Take the result of the step that was run, of the protocol's own class."""
