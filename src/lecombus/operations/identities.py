"""Who each drive is: what it says of itself, what it said before, and what the roster says.

Strategy: the first identity a drive shows is recorded. When it later differs in a code that can be
read, or from the roster, another device (or the same with other software) answers at its address:
the difference stands as a remark that lets nothing but stops be written, until a person who has
seen both accepts it, or the roster names what is there. The roster decides for the codes it names,
the record for all others. What cannot be read is not a difference.

Two devices of one kind with the same software say the same: they cannot be distinguished.
Source: EDB2102EN 8.2 (C1810, C1811), CMVLC401A table 9 (C0200, C0201), 8.1.3 (C1099), 9.2 (P502).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lecombus.drive_state.drive_runtime import Drive, LineDrives
from lecombus.drive_state.readings import IDENTITY_LOCK, DriveState, rfc3339
from lecombus.drive_state.store import Store
from lecombus.drives.procedures import is_identity, is_same_text, text_of
from lecombus.errors import OperationError
from lecombus.line_events import ExchangeEvent, LineRequests
from lecombus.parameters import Code, Json, Value
from lecombus.saved_state import State

__all__ = ["Identities", "IdentityReport"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class IdentityReport:
    """What is known of who a drive is.

    Args:
        drive: Its name.
        found: What it said when it was last asked, by code.
        accepted: What is recorded of it.
        roster: What the roster says.
        accepted_at: When the record was made, RFC 3339; empty: there is none.
        problem: Why it is not written to; empty when it is the drive it should be.
    """

    drive: str
    found: Mapping[str, str]
    accepted: Mapping[str, str]
    roster: Mapping[str, str]
    accepted_at: str
    problem: str

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "drive": self.drive,
            "found": dict(self.found),
            "accepted": dict(self.accepted),
            "roster": dict(self.roster),
            "accepted_at": self.accepted_at or None,
            "problem": self.problem or None,
        }


class Identities:
    """Compares and remembers the identities of one line's drives.

    Args:
        state: Where they are kept.
        store: Gets what was found, and the remarks.
        wall: The time of day, Unix seconds.
        drives: The drives.
        line: Audits a drive that was accepted, or that says otherwise than it did.
    """

    def __init__(
        self,
        state: State,
        store: Store,
        wall: Callable[[], float],
        drives: LineDrives,
        line: LineRequests,
    ) -> None:
        self._state = state
        self._store = store
        self._wall = wall
        self._drives = drives
        self._line = line

    def differing(self, drive: Drive, found: Mapping[Code, Value]) -> list[Code]:
        """Return the codes that read otherwise than the roster or the record says."""
        roster, record = drive.entry.identity, self._state.drive(drive.name).identity
        return [
            code for code, value in found.items()
            if not is_identity(value, roster.get(code, record.get(str(code))))
        ]  # fmt: skip

    def unconfirmed(self, drive: Drive, found: Mapping[Code, Value]) -> list[Code]:
        """Return the codes that read otherwise than was said, and those of which nothing was."""
        roster, record = drive.entry.identity, self._state.drive(drive.name).identity
        differing = self.differing(drive, found)
        return [
            code for code in found
            if code in differing or (code not in roster and str(code) not in record)
        ]  # fmt: skip

    def judge(self, drive: Drive, found: Mapping[Code, Value]) -> None:
        """Take what a drive says of itself: record it, or lock the drive where it differs.

        Args:
            drive: The drive.
            found: What could be read, by code.
        """
        drive.identity.found = {code: text_of(value) for code, value in found.items()}
        texts = drive.identity.as_text()
        self._store.identify(drive.name, texts)
        differing = self.differing(drive, found)
        if not differing:
            self._record(drive.name, texts)
        self._remark(drive.name, self._difference(drive, differing, texts))

    def exchange_ended(self, event: ExchangeEvent) -> None:
        """Take an exchange: only values that were read say something."""
        if event.read is not None and event.code in event.drives[0].identity.found:
            self.seen(event.drives[0], event.code, event.read)

    def seen(self, drive: Drive, code: Code, value: Value) -> None:
        """Take any value read: a drive that says otherwise than at its audit is audited again.

        A drive under audit is judged when that has ended.
        """
        known = drive.identity.found.get(code)
        if known is None or is_same_text(text_of(value), known):
            return
        if self._store.state(drive.name) is DriveState.ONLINE:
            spoken = drive.station.family.spoken(code)
            self._line.doubt(drive, f"{spoken} reads {text_of(value)}, not {known}: to be audited")

    def report(self, name: str) -> IdentityReport:
        """Return what is known of who a drive is.

        Raises:
            OperationError: `no-such-drive`.
        """
        info = self._store.drive(name)
        facts = self._state.drive(name)
        drive = self._drives.get(name)
        return IdentityReport(
            name,
            drive.identity.as_text(),
            facts.identity,
            {str(code): text for code, text in drive.entry.identity.items()},
            facts.accepted_at,
            info.remarks.get(IDENTITY_LOCK, ""),
        )

    def accept(self, name: str, shown: Mapping[str, str]) -> IdentityReport:
        """Take the drive that is there for the drive of this name.

        Args:
            name: The drive.
            shown: Its identity as it was shown to the user who accepts it.

        Raises:
            OperationError: No such drive; nothing was read of it yet; it is not what was shown;
                or the roster says otherwise.
        """
        report = self.report(name)
        if not report.found:
            raise OperationError(
                f"{name} has not said who it is",
                kind="not-ready",
                drive=name,
                remedy="accept it when it is online and has been audited",
            )
        if dict(shown) != dict(report.found):
            raise OperationError(
                f"{name} is {_listed(report.found)}, not {_listed(shown)}",
                kind="other-identity",
                drive=name,
                remedy="look at what it is now, and accept that",
            )
        against = [
            code for code, text in self._drives.get(name).entry.identity.items()
            if str(code) in report.found and not is_same_text(report.found[str(code)], text)
        ]  # fmt: skip
        if against:
            raise OperationError(
                f"the roster says otherwise of {', '.join(map(str, against))} of {name}",
                kind="other-identity",
                drive=name,
                remedy="correct `identity` in the roster and reload, or put the drive back",
            )
        self._take(name, report)
        return self.report(name)

    def _take(self, name: str, report: IdentityReport) -> None:
        facts = self._state.drive(name)
        if any(facts.identity.get(code) != text for code, text in report.found.items()):
            logger.warning(
                "drive=%s event=identity-accepted from=%s to=%s",
                name, _listed(facts.identity), _listed(report.found),
            )  # fmt: skip
            facts.identity = dict(report.found)
            facts.accepted_at = rfc3339(self._wall())
            facts.writes_before = dict(facts.writes)
            facts.last_enable = None  # another device's
            self._state.touch()
        self._store.note(name, IDENTITY_LOCK, None)
        self._line.audit_soon(self._drives.get(name))

    def _record(self, name: str, texts: Mapping[str, str]) -> None:
        """Keep what is new; a code that could not be read this time stays as it was."""
        facts = self._state.drive(name)
        new = {code: text for code, text in texts.items() if facts.identity.get(code) != text}
        if not new:
            return
        logger.info("drive=%s event=identity-recorded identity=%s", name, _listed(texts))
        facts.identity = {**facts.identity, **texts}
        facts.accepted_at = rfc3339(self._wall())
        self._state.touch()

    def _difference(
        self, drive: Drive, differing: list[Code], texts: Mapping[str, str]
    ) -> str | None:
        """Say what differs and what to do about it; None where nothing does."""
        if not differing:
            return None
        roster, record = drive.entry.identity, self._state.drive(drive.name).identity
        parts = [
            f"{drive.station.family.spoken(code)} reads {texts[str(code)]}, "
            + (f"the roster says {roster[code]}" if code in roster else f"not {record[str(code)]}")
            for code in differing
        ]
        by_roster = any(code in roster for code in differing)
        remedy = (
            "correct `identity` in the roster and reload"
            if by_roster
            else f"`lecombus accept {drive.name}`"
        )
        return (
            f"this is not the drive that was there: {'; '.join(parts)}; nothing is written to it "
            f"but stops; if it was replaced on purpose: {remedy}"
        )

    def _remark(self, name: str, text: str | None) -> None:
        before = self._store.drive(name).remarks.get(IDENTITY_LOCK)
        if text is not None and text != before:
            logger.warning("drive=%s event=drive-swapped reason=%s", name, text)
        self._store.note(name, IDENTITY_LOCK, text)


def _listed(identity: Mapping[str, str]) -> str:
    return ", ".join(f"{code} {text}" for code, text in identity.items()) or "nothing"
