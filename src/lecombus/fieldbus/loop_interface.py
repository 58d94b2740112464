"""The exchange loop of a protocol, as all others see it: what it is given, owes, and reports.

What a loop owes the schedule (`schedule.Schedule`), with times of the event loop in seconds:

1. When the line is free it asks `next`. After None it asks again at `wake_at_s`, after `nudge`, and
   at least once a second, and counts that in `rests`.
2. Directly before each telegram it asks `why_unwanted` of the request. One with a reason is not
   sent: `defer` it to now, then `withdraw` it as refused, with that reason.
3. A request whose telegram may not be sent yet goes back with `defer`. A feed must not, since it
   would be chosen again immediately: `finished` without `reached`, then `end`.
4. It gives up an answer `cut_by_s` earlier than it would otherwise.
5. Each exchange ends with one `finished`, with the time at which the line is free again; a loss of
   the port is such an end too. An answer counts for the exchange that it belongs to, never for a
   later one.
6. After a write, also one that was not answered, it calls `hold` with the `hold_s` of the station
   if that is not 0; after a multicast for each drive that it reaches.
7. Then the job is asked (`Job.advance`). None: set `cut_outcome` of the request to the job's and
   give it back with `again`; else `end` the request. Every request ends once.

`Observer.exchange_ended` is called for each exchange. `look_ahead`, `planned`, `follow` and
`may_idle` need not be used.

The reports are in words that fit any protocol.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Final, NamedTuple, Protocol

from lecombus.errors import LineLostError
from lecombus.fieldbus.port import Port, Receiver
from lecombus.fieldbus.requests import JobStep
from lecombus.parameters import Value
from lecombus.schedule import Priority

__all__ = [
    "AnswerKind",
    "DriveAnswer",
    "ExchangeLoop",
    "ExchangeReport",
    "ExchangeResult",
    "LateWakes",
    "Observer",
    "OpenConnection",
    "ResultKind",
    "SecondAnswerCount",
    "WorkerOptions",
]


class ResultKind(StrEnum):
    """How an exchange ended on the wire."""

    ANSWERED = "answered"
    SENT = "sent"
    NO_REPLY = "no reply"
    GARBLED = "garbled"
    ECHO = "echo"
    LOST = "line lost"


class AnswerKind(Enum):
    """What a drive answered."""

    VALUE = "value"
    ACKNOWLEDGED = "acknowledged"
    REFUSED = "refused"
    NO_SUCH_CODE = "no such code"
    OTHER = "other"


class DriveAnswer(Protocol):
    """What a drive answered; a protocol's own classes of answers have these attributes."""

    @property
    def kind(self) -> AnswerKind:
        """What it is."""

    @property
    def value(self) -> Value | None:
        """The value that was read, if it is one."""

    @property
    def text(self) -> str:
        """Why a read brought no value, for people; empty where `kind` says it."""


class ExchangeResult(Protocol):
    """How one exchange ended; times are monotonic seconds."""

    @property
    def kind(self) -> ResultKind:
        """How it ended on the wire."""

    @property
    def answer(self) -> DriveAnswer | None:
        """The drive's answer, when `kind` is ANSWERED."""

    @property
    def started_s(self) -> float:
        """When the telegram was handed to the port."""

    @property
    def ended_s(self) -> float:
        """When the answer was complete, or when it was given up."""

    @property
    def older_by_s(self) -> float:
        """How much older than `ended_s` the answer may be, because the process did not run."""

    @property
    def fault(self) -> str:
        """Why it failed, in words; empty when it did not."""

    @property
    def late(self) -> int:
        """How many answers to something else came during the exchange."""

    @property
    def clean(self) -> bool:
        """False when anything but the answer was heard."""


@dataclass(slots=True)
class ExchangeReport:
    """One exchange that ended.

    Args:
        drive: The drive's (for a multicast the group's) name.
        step: What was sent.
        result: How it ended.
        priority: The class it ran in.
        waited_s: From the moment the schedule took the request to the telegram.
        quarantined_s: How long the line is left alone because of it.
        members: For a multicast: the drives it reached.
        address: The address that was used; the name may belong to another device by now.
        attempt: Which exchange of its request it was, 1 for the first.
        may_be_anothers: The value may be the second answer of another drive: answers come twice on
            this line, and another drive was asked for the same lately.
    """

    drive: str
    step: JobStep
    result: ExchangeResult
    priority: Priority
    waited_s: float
    quarantined_s: float
    members: tuple[str, ...] = ()
    address: int = 0
    attempt: int = 1
    may_be_anothers: bool = False


class Observer(Protocol):
    """Receives the events of the line; its methods must return quickly and never raise."""

    def exchange_ended(self, report: ExchangeReport) -> None:
        """An exchange ended; called while the next drive is already thinking, if there is one."""

    def line_changed(self, up: bool, reason: str) -> None:
        """The port was opened (`up`) or lost."""

    def thinking(self, for_s: float) -> None:
        """A telegram went out; nothing can arrive for so many seconds."""

    def stray_bytes(self, data: bytes, late_answer: bool) -> None:
        """Bytes came outside an exchange; `late_answer`: they were a late answer, whole."""


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """How one line is worked.

    Args:
        turnaround_s: Least pause between the end of an answer and the next telegram, seconds.
        late_answer_s: How late an answer may still come after it was given up, seconds.
        stall_s: Silence from all drives after which the port is reopened, seconds; 0: never.
        echo: Whether the line echoes; None: find out.
        quarantine: Keep silence after a failed exchange. False only to show what it is good for.
    """

    turnaround_s: float = 0.002
    late_answer_s: float = 0.5
    stall_s: float = 30.0
    echo: bool | None = None
    quarantine: bool = True


DRIVES_PER_PAIR: Final = 5
"""Of so many drives that answer one may share its address with another."""
LEAST_OF_MOST: Final = 1 / 6
"""A drive after whose answers fewer come than this part of the most has had strays."""

LEAST_SECOND_ANSWERS: Final = 3
"""Fewer second answers than this within a minute mean nothing."""

PART_OF_KNOWN: Final = 0.5
PART_OF_FEW: Final = 0.85
PART_OF_LATELY: Final = 0.75
PART_OF_ALL: Final = 1 / 3
"""Where two drives have one address, so many of those whose drive is known come after its answers,
and so many of those may have that came after anyone's lately; and so many of all. What only one
drive is asked for is known to be its own also where all come twice. A second answer that comes
while another drive is asked for the same is taken for its, whose own is the second one then: of
those known some are others'. Of few drives one has so many also where all come twice:
`PART_OF_FEW` of those known must be its."""


class SecondAnswerCount(NamedTuple):
    """Answers of the last minute that no question was open for.

    Args:
        whose: For each the drives after whose answers it may have come, which were asked shortly
            before for an answer that looks the same.
        drives: How many drives have answered anything in that time.
    """

    whose: Sequence[Collection[str]] = ()
    drives: int = 1

    @property
    def total(self) -> int:
        """How many there were."""
        return len(self.whose)

    @property
    def alone(self) -> Mapping[str, int]:
        """Of those that can only belong to one drive, how many came after its answers."""
        return Counter(name for names in self.whose if len(names) == 1 for name in names)

    @property
    def is_remarkable(self) -> bool:
        """Whether they are more than what noise makes."""
        return self.total >= LEAST_SECOND_ANSWERS

    def may_be_two(self, drive: str) -> bool:
        """Whether two drives may have this drive's address.

        Many of the latest may have come after its answers, or after those of a few drives of the
        line, and so did a large part of those that are known (`PART_OF_KNOWN`; on lines of few
        drives `PART_OF_FEW`): an adapter that delivers answers twice does it to all drives alike.
        """
        known = Counter(self.alone)
        most = known.most_common(max(self.drives // DRIVES_PER_PAIR, 1))
        least = max(LEAST_SECOND_ANSWERS, LEAST_OF_MOST * most[0][1] if most else 0)
        few = {name: count for name, count in most if count >= least}
        part = PART_OF_FEW if self.drives <= DRIVES_PER_PAIR else PART_OF_KNOWN
        if drive not in few or sum(few.values()) < part * known.total():
            return False
        explained = sum(not few.keys().isdisjoint(names) for names in self.whose)
        lately = sum(map(bool, self.whose))
        return explained >= max(PART_OF_LATELY * lately, PART_OF_ALL * self.total)


class LateWakes(Protocol):
    """Records how late timers fired."""

    def note(self, late_s: float) -> None:
        """Take one, seconds."""


class OpenConnection(Protocol):
    """The port as an exchange loop uses it; the worker opens and reopens it."""

    @property
    def port(self) -> Port | None:
        """The port; None while there is none."""

    @property
    def is_lost(self) -> bool:
        """Whether the port is unusable: the loop then ends."""

    def say(self, telegram: bytes) -> LineLostError | None:
        """Hand a telegram to the port; gives the loss, if that is how it is found out."""

    def settled(self) -> None:
        """Something was heard over the port."""

    def note_loss(self, exc: Exception | None) -> None:
        """Record that the port is unusable."""

    def reopen(self, why: str) -> None:
        """Give up a port of which no error is known, to open it again."""


class ExchangeLoop(Receiver, Protocol):
    """Runs one exchange after the other on an open port: asks the schedule, sends, reports.

    Attributes:
        observer: Is called for each event on the line.
        exchanges: Exchanges so far.
        rests: How often nothing was due: it grows at least once a second on an idle line.
    """

    observer: Observer
    exchanges: int
    rests: int

    def start(self, port: Port) -> Awaitable[None]:
        """Start on a port that was just opened.

        Returns:
            Done when the port is lost or `end` was called; raises the error that ended it.
        """

    def end(self) -> None:
        """End after the exchange under way; `nudge` is called next."""

    def clear(self) -> None:
        """Cancel all timers: the port is gone."""

    def nudge(self) -> None:
        """Check the schedule again: something changed in it."""

    def stop_came(self) -> None:
        """A stop was submitted: it must go out as soon as it can."""

    def second_answers(self, now_s: float) -> SecondAnswerCount:
        """Count the answers of the last minute that came without a request."""
        return SecondAnswerCount()
