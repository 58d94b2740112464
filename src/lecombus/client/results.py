"""How what was asked for ended: one outcome for a write, a verb, a group or a stop.

Strategy: as in `documents`: frozen, made from one JSON document, which is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from lecombus.client.documents import Answer, Document, Reading, kind_of, reading_of, text_of
from lecombus.client.errors import NotDoneError

__all__ = ["GroupResult", "Outcome", "Result", "VerbResult", "WriteResult"]


class Outcome(StrEnum):
    """How a write ended; it has exactly one of these.

    `DONE`: acknowledged. `VERIFIED`: acknowledged and read back, or shown by the drive.
    `REFUSED`: by the drive (NAK), by what it reads afterwards, or by lecombus: nothing of it holds.
    `EXPIRED`: not sent in time. `SUPERSEDED`: not sent, a stop or a later setpoint came before it.
    `UNKNOWN`: it may have happened, for its answer was lost and could not be read back.
    """

    DONE = "done"
    VERIFIED = "verified"
    REFUSED = "refused"
    EXPIRED = "expired"
    SUPERSEDED = "superseded"
    UNKNOWN = "unknown"

    @property
    def is_good(self) -> bool:
        """Whether it happened: `DONE` or `VERIFIED`."""
        return self in (Outcome.DONE, Outcome.VERIFIED)


@dataclass(frozen=True, slots=True)
class Result:
    """How a write, a verb or a stop ended.

    Args:
        outcome: The one outcome it had.
        reason: What happened, in words; empty where nothing needs saying.
        cause: The likely cause; empty where none is known.
        remedy: What to do about it; empty where nothing is known.
        kind: A stable word for programs, such as `nak` (docs/api.md); empty when it was done.
        answer: The daemon's answer; None: it was lost, and so the outcome is `UNKNOWN`.
    """

    outcome: Outcome
    reason: str
    cause: str
    remedy: str
    kind: str
    answer: Answer | None = field(repr=False, compare=False)

    @property
    def is_good(self) -> bool:
        """Whether it happened: `DONE` or `VERIFIED`."""
        return self.outcome.is_good

    @property
    def what(self) -> str:
        """What was asked for, in words."""
        return "the request"

    def check(self) -> None:
        """Raise an error unless it happened.

        Raises:
            NotDoneError: The outcome is neither `DONE` nor `VERIFIED`.
        """
        if not self.is_good:
            raise NotDoneError(self, self.what)


@dataclass(frozen=True, slots=True)
class WriteResult(Result):
    """How a write to one drive ended.

    Args:
        drive: The drive's name.
        code: What was written, such as `C0046`; empty where nothing could be.
        subcode: 0 where there is none.
        reading: What was read back, where it was.
    """

    drive: str
    code: str
    subcode: int
    reading: Reading | None

    @property
    def what(self) -> str:
        """What was asked for, in words."""
        code = f"{self.code}/{self.subcode}" if self.subcode else self.code
        return f"write of {self.drive} {code}".strip()

    @classmethod
    def of(cls, document: Document, answer: Answer | None = None) -> WriteResult:
        """Return the result that a document shows."""
        return cls(
            *common_of(document),
            answer,
            drive=text_of(document, "drive"),
            code=text_of(document, "code"),
            subcode=int(document.get("subcode") or 0),
            reading=reading_of(document),
        )


@dataclass(frozen=True, slots=True)
class VerbResult(Result):
    """How `enable`, `set-speed`, `reset-fault`, `quick-stop` or `inhibit` ended.

    Args:
        drive: The drive's name.
        verb: The command.
        states: What the drive shows afterwards, such as `enabled`; empty where it was not read.
        reading: What was read back, where it was.
    """

    drive: str
    verb: str
    states: tuple[str, ...]
    reading: Reading | None

    @property
    def what(self) -> str:
        """What was asked for, in words."""
        return f"{self.verb} of {self.drive}"

    @classmethod
    def of(cls, document: Document, answer: Answer | None = None) -> VerbResult:
        """Return the result that a document shows."""
        return cls(
            *common_of(document),
            answer,
            drive=text_of(document, "drive"),
            verb=text_of(document, "verb"),
            states=tuple(document.get("states") or ()),
            reading=reading_of(document),
        )


@dataclass(frozen=True, slots=True)
class GroupResult(Result):
    """How a write to a group or a stop ended.

    Args:
        target: The group's name; for a stop also a drive's, or `all`.
        how: `multicast` or `one-by-one`; empty where nothing was sent.
        members: One result for each drive; empty where the daemon gave none.
    """

    target: str
    how: str
    members: tuple[WriteResult, ...]

    @property
    def what(self) -> str:
        """What was asked for, in words."""
        failed = ", ".join(one.drive for one in self.members if not one.is_good)
        return f"{self.target} ({failed})" if failed else self.target

    @classmethod
    def of(cls, document: Document, answer: Answer | None = None) -> GroupResult:
        """Return the result that a document shows."""
        return cls(
            *common_of(document),
            answer,
            target=text_of(document, "target"),
            how=text_of(document, "how"),
            members=tuple(WriteResult.of(one) for one in document.get("members") or ()),
        )


def common_of(document: Document) -> tuple[Outcome, str, str, str, str]:
    """Return outcome, reason, cause, remedy and kind of a result's document."""
    reason = text_of(document, "reason") or text_of(document, "detail")
    cause, remedy = text_of(document, "cause"), text_of(document, "remedy")
    return outcome_of(document), reason, cause, remedy, kind_of(document)


def outcome_of(document: Document) -> Outcome:
    """Return the outcome; a word that this library does not know may mean that it happened."""
    try:
        return Outcome(text_of(document, "outcome"))
    except ValueError:
        return Outcome.UNKNOWN
