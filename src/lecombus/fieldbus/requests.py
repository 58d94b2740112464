"""What is asked of the line: a station to speak to, the job of a request with its steps, its maker.

A job is the part of a request that knows the protocol. The schedule carries it as the `work` of the
request without looking in; the loop asks it for the next step, runs that step as one exchange and
gives it the result, until the job says how the request ended. Between two steps of a job anything
more urgent may run. Those that wait for the end of a request read from its job what the classes
with `Work` in their names define.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from lecombus.drives import Family, StopAction
from lecombus.drives.measured import MeasuredTimes, manual_s
from lecombus.drives.stops import STOP_PATIENCE_S
from lecombus.errors import ExchangeError
from lecombus.fieldbus.costs import LineTiming
from lecombus.parameters import AddressForm, Code, Value
from lecombus.schedule import Outcome, Priority, Request, Settle, ignore_end
from lecombus.schedule.fan_out import Part

__all__ = [
    "Job",
    "JobStep",
    "MulticastWork",
    "ReadWork",
    "RequestMaker",
    "Station",
    "StepKind",
    "StopWork",
    "Verdict",
    "WriteWork",
]

Verdict = tuple[Outcome, str] | None
"""How a request ended and why, or None when another step is wanted."""


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A drive as the line sees it.

    Args:
        name: Its name in the roster.
        address: Its address on the line; for a multicast the group address.
        family: Its description, with the roster's overrides applied.
        forms: The addressing forms it is spoken to in, the preferred first.
        hold_s: How long it is left alone after a write, seconds: it may acknowledge before it has
            taken the value over. Until it is known whether it does, it is taken to.
        answers_early: It is known to acknowledge that early.
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

    Where `only` is set the read waits until its `form` is free. Where `apart` is set, and answers
    come twice, it is not sent directly behind a question to another drive for the same answer.
    """

    kind: StepKind
    code: Code
    value: Value | None = None
    form: AddressForm | None = None
    only: bool = False
    apart: bool = False


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


class ReadWork:
    """The job of a read.

    Attributes:
        value: What was read; None: it was not.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    value: Value | None
    error: ExchangeError | None
    attempts: int


class WriteWork:
    """The job of a write.

    Attributes:
        code: What is written.
        proof: What was read back; None: nothing was.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    code: Code
    proof: Value | None
    error: ExchangeError | None
    attempts: int


class StopWork:
    """The job of a stop.

    Attributes:
        station: Who is stopped.
        action: How, which may have become an inhibit.
        proof_code: What was read to show the stop.
        proof: What that read; None: nothing was read.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    station: Station
    action: StopAction
    proof_code: Code | None
    proof: Value | None
    error: ExchangeError | None
    attempts: int

    def begin_unsaid(self) -> None:
        """The multicast that was to say it was not sent: say it first."""


class MulticastWork:
    """The job of a multicast.

    Attributes:
        step: What is sent.
        error: What the exchange failed with, if it did.
    """

    __slots__ = ()

    step: JobStep
    error: ExchangeError | None


class RequestMaker(Protocol):
    """Makes requests with their costs.

    `settle` is called with the outcome at the end, `expires_at_s` is the time from which on a
    request that was not begun expires (None: never), `retries` is how often a failed attempt is
    repeated (None: as the roster says).

    What has a body here is right for a protocol without multicasts whose answers carry an address.
    """

    @property
    def timing(self) -> LineTiming:
        """The times of the line."""

    def read(
        self,
        station: Station,
        code: Code,
        priority: Priority,
        *,
        settle: Settle = ignore_end,
        retries: int | None = None,
        instead: tuple[Code, ...] = (),
        expires_at_s: float | None = None,
    ) -> Request:
        """Make a request that reads one code (`ReadWork`), or one of `instead`."""

    def feed(self, station: Station, instead: tuple[Code, ...]) -> Request:
        """Make the read that feeds a watchdog."""
        return self.read(
            station, station.family.feed_code, Priority.WATCHDOG, retries=0, instead=instead
        )

    def cost_of_read_s(self, station: Station, code: Code) -> float:
        """Give the line time of a read that is answered, seconds."""

    def part_of_write(self, station: Station, code: Code, value: Value) -> Part:
        """Give what a write that is read back takes of the line."""

    def write(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        settle: Settle,
        verify: bool,
        expires_at_s: float | None = None,
        urgency: Priority | None = None,
    ) -> Request:
        """Make a request that writes one code (`WriteWork`) and reads it back if `verify`."""

    def read_back(
        self,
        station: Station,
        code: Code,
        value: Value,
        priority: Priority,
        *,
        settle: Settle,
        expires_at_s: float,
    ) -> Request:
        """Make a request that reads whether a code holds a value (`ReadWork`)."""
        return self.read(station, code, priority, settle=settle, expires_at_s=expires_at_s)

    def stop(
        self,
        station: Station,
        action: StopAction,
        *,
        word: Callable[[], int | None],
        inhibited: Callable[[], bool | None] = lambda: False,
        last_word: Callable[[], int | None] = lambda: None,
        said: bool,
        settle: Settle,
        repeats: bool = False,
        silent: bool = False,
        offline: bool = False,
        may_inhibit: bool = True,
        patience_s: float = STOP_PATIENCE_S,
    ) -> Request:
        """Make a request that stops one drive and proves it (`StopWork`).

        Args:
            station: The drive.
            action: How it shall stop.
            word: Gives its control word, None when not known; asked when the stop is sent.
            inhibited: Says whether it is inhibited, None when not known; asked likewise.
            last_word: Gives its control word as it was known last.
            said: A multicast has said the stop already: begin with the proof.
            settle: See above.
            repeats: A multicast has said it to a drive that read as stopped before: it is said
                once more, and feeds may go first.
            silent: The drive did not answer before.
            offline: It did not answer for so long that it was taken for absent.
            may_inhibit: A quick stop that cannot be had may become an inhibit.
            patience_s: How long it is tried, seconds.
        """

    def multicast(
        self,
        group: Station,
        members: tuple[Station, ...],
        code: Code,
        value: Value,
        priority: Priority,
        *,
        settle: Settle,
        stops: tuple[str, ...] = (),
        expires_at_s: float | None = None,
    ) -> Request:
        """Make a request that writes one code of all members with one telegram (`MulticastWork`).

        Args:
            group: The group's name and address, in the form that `shared_form` gave.
            members: The drives that it reaches.
            code: What to write.
            value: The value.
            priority: The class to run in.
            settle: See above.
            stops: The drives that it stops.
            expires_at_s: See above.
        """
        raise RuntimeError("this protocol has no multicasts")

    def shared_form(self, stations: Sequence[Station], code: Code) -> AddressForm | None:
        """Give the form of one telegram that all of several drives take; None: there is none."""
        return None

    def probe(self, station: Station) -> Callable[[], Request]:
        """Give the maker of the read that asks an offline drive whether it is back."""
        return lambda: self.read(station, station.family.feed_code, Priority.CYCLIC, retries=0)
