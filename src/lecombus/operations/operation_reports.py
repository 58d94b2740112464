"""How a write, a group write or a stop ended, as operations return it and API and commands show it.

Frozen snapshots; several put together are called by the worst of them. They stand apart from
`operations` because what shows them must not depend on how they came about, and apart from
`schedule` because a report names the likely cause and what to do, which a schedule does not know.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from lecombus.drive_state.readings import Reading, seconds
from lecombus.drives import OperatingState, Verb
from lecombus.drives.measured import AnswerRow
from lecombus.parameters import Code, Json
from lecombus.schedule.request import STOPPED, Outcome

__all__ = [
    "CUT_REMEDY",
    "READ_REMEDY",
    "REMEDIES",
    "STOPPED_REMEDY",
    "GroupFacts",
    "GroupReport",
    "How",
    "Proof",
    "RestoreRights",
    "TimesReport",
    "VerbReport",
    "WriteReport",
    "group_report",
    "stopped_first",
]

How = Literal["multicast", "one-by-one"]

REMEDIES: Final[Mapping[str, str]] = {
    "nak": "check that the code may be written now: inhibited, in range, the control source set "
    "to LECOM",
    "no-answer": "check the drive's supply and the wires, then read the code to see what it holds",
    "not-in-effect": "the drive took the telegram but not the value: look at what it reads",
    "line-lost": "the port is being reopened; ask again when the line is open",
    "expired": "allow more time, or ask less of the line",
}
STOPPED_REMEDY: Final = "ask for it again if it is still wanted: a stop ends all that waits"
READ_REMEDY: Final = "read the code to see what it holds"
OTHER_RUN_REMEDY: Final = "look at the drive, then begin again"
CUT_REMEDY = "the port is being reopened; read the code then to see what it holds"
"""The write may have happened, so repeating it without a look is not a remedy."""


@dataclass(frozen=True, slots=True)
class Proof:
    """The reading that `verified` comes from.

    Args:
        code: What was read.
        raw: What it read, as on the wire.
        shows: What that shows: `inhibited`, `quick stop`, `command held` (the command reads back,
            no more), `enabled`, `no fault` or `value`.
    """

    code: Code
    raw: str
    shows: str

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "code": f"C{self.code.number:04d}",
            "subcode": self.code.subcode,
            "raw": self.raw,
            "shows": self.shows,
        }


@dataclass(frozen=True, slots=True)
class WriteReport:
    """How one write to one drive ended.

    Args:
        drive: The drive's name.
        code: What was written; None where there was nothing to write, as for an unknown stop.
        outcome: The one outcome it had.
        reason: What happened, in words; empty when it was done.
        cause: The likely cause, in words, such as "C0001 is not 3"; empty where none is known.
        kind: A stable word for programs when it was not done, such as `nak`, `offline`,
            `line-lost`, `no-answer`; the HTTP status follows from it.
        remedy: What the user can do about it.
        reading: What was read back, where it was.
        proof: What `verified` comes from; None for other outcomes.
    """

    drive: str
    code: Code | None
    outcome: Outcome
    reason: str = ""
    cause: str = ""
    kind: str = ""
    remedy: str = ""
    reading: Reading | None = None
    proof: Proof | None = None

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "code": None if self.code is None else f"C{self.code.number:04d}",
            "subcode": None if self.code is None else self.code.subcode,
            "outcome": self.outcome.value,
            "reason": self.reason or None,
            "cause": self.cause or None,
            "remedy": self.remedy or None,
            "reading": None if self.reading is None else self.reading.as_json(),
            "proof": None if self.proof is None else self.proof.as_json(),
        }


@dataclass(frozen=True, slots=True)
class VerbReport:
    """How a verb ended.

    Args:
        drive: The drive's name.
        verb: The command.
        outcome: The one outcome it had; `VERIFIED`: the drive shows it.
        reason: What happened, in words.
        cause: The likely cause where it was not done, in words; empty where none is known.
        kind: A stable word for programs when it was not done.
        remedy: What the user can do about it.
        states: What the drive shows afterwards, of itself; empty where it was not read.
        written: What was written, in order: code and value as on the wire.
        reading: What was read back, where it was.
        proof: What `verified` comes from; None for other outcomes.
    """

    drive: str
    verb: Verb
    outcome: Outcome
    reason: str = ""
    cause: str = ""
    kind: str = ""
    remedy: str = ""
    states: tuple[OperatingState, ...] = ()
    written: tuple[tuple[Code, str], ...] = ()
    reading: Reading | None = None
    proof: Proof | None = None

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "verb": self.verb.value,
            "outcome": self.outcome.value,
            "reason": self.reason or None,
            "cause": self.cause or None,
            "remedy": self.remedy or None,
            "states": [state.value for state in self.states],
            "written": [
                {"code": f"C{code.number:04d}", "subcode": code.subcode, "raw": raw}
                for code, raw in self.written
            ],
            "reading": None if self.reading is None else self.reading.as_json(),
            "proof": None if self.proof is None else self.proof.as_json(),
        }


@dataclass(frozen=True, slots=True)
class GroupReport:
    """How a group write or a stop ended.

    Args:
        target: The group's name; for a stop also a drive's, or `all`.
        how: One multicast telegram, or one write after another.
        outcome: The outcome of the whole: the worst of its members'.
        members: One report per drive.
        reason: What happened to the whole, in words.
    """

    target: str
    how: How
    outcome: Outcome
    members: tuple[WriteReport, ...]
    reason: str = ""

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "target": self.target,
            "how": self.how,
            "outcome": self.outcome.value,
            "reason": self.reason or None,
            "members": [one.as_json() for one in self.members],
        }


@dataclass(frozen=True, slots=True)
class GroupFacts:
    """A group of the roster and how it is spoken to.

    Args:
        name: Its name.
        members: Its drives.
        multicast_address: The address one telegram reaches exactly these drives at, or None.
        multicast: Whether writes that are not stops may go there.
    """

    name: str
    members: tuple[str, ...]
    multicast_address: int | None
    multicast: bool = False

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        by_multicast = self.multicast and self.multicast_address is not None
        return {
            "group": self.name,
            "members": list(self.members),
            "how": "one-by-one" if self.multicast_address is None else "multicast",
            "multicast_address": self.multicast_address,
            "writes": "multicast" if by_multicast else "one-by-one",
        }


@dataclass(frozen=True, slots=True)
class RestoreRights:
    """Whether a backup may be restored into a drive.

    Args:
        drive: The drive's name.
        permitted: The roster says `restore: true`, and nothing keeps the drive from being written.
        owned: Codes that lecombus itself sets from the roster: a restore leaves them alone.
        stops: What each write of the restore gives back, so that a stop said since ends it.
        reason: Why it is not permitted.
        remedy: What the user can do about it.
    """

    drive: str
    permitted: bool
    owned: tuple[Code, ...] = ()
    reason: str = ""
    remedy: str = ""
    stops: str = ""

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "permitted": self.permitted,
            "owned": [str(code) for code in self.owned],
            "stops": self.stops,
            "reason": self.reason or None,
            "remedy": self.remedy or None,
        }


@dataclass(frozen=True, slots=True)
class TimesReport:
    """What was dropped of a drive's measured answer times.

    Args:
        drive: The drive.
        forgotten: What time-outs and plans used, the slowest first.
    """

    drive: str
    forgotten: tuple[AnswerRow, ...]

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "forgotten": [
                {
                    "code": str(row.code),
                    "write": row.write,
                    "manual_s": seconds(row.manual_s),
                    "measured_s": seconds(row.measured_s),
                }
                for row in self.forgotten
            ],
        }


_FROM_BEST = (
    Outcome.VERIFIED,
    Outcome.DONE,
    Outcome.SUPERSEDED,
    Outcome.EXPIRED,
    Outcome.REFUSED,
    Outcome.UNKNOWN,
)


def group_report(target: str, how: How, reports: Iterable[WriteReport]) -> GroupReport:
    """Put the members' reports together.

    The whole is called by the worst of them: a reader of one word must not see a better one
    than it is.
    """
    members = tuple(reports)
    worst = max(members, key=lambda one: _FROM_BEST.index(one.outcome))
    return GroupReport(target, how, worst.outcome, members, worst.reason)


def stopped_first(drive: str, code: Code, why: str = STOPPED) -> WriteReport:
    """The report of a write that was not sent yet when its drive was stopped."""
    return WriteReport(
        drive, code, Outcome.SUPERSEDED, f"{why}: nothing was sent", kind="superseded",
        remedy=STOPPED_REMEDY if why == STOPPED else OTHER_RUN_REMEDY,
    )  # fmt: skip
