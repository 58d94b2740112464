"""What is said for each request, and how often: counted on the wire, held against who asked.

* A read is said once and for each of the roster's retries again, and no oftener; a plain write
  likewise, or twice after a refusal; and one that is an edge once: it may have happened.
* A write that nobody has asked for, or that is over, is never said. One that has expired is not
  begun, and of two setpoints the older never goes after the later.
* After a stop of a drive nothing that was asked for before it is written to that drive.
* What ends as expired or superseded was never said. What ends as done or verified was taken by the
  drive, as the drive itself remembers it, and the verified was read from it afterwards.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

from lecombus.drives import family
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.lecom.exchanges.jobs import ReadBackJob, ReadJob, WriteJob
from lecombus.fieldbus.lecom.simulator.families.f82xx import Drive82XX
from lecombus.fieldbus.lecom.simulator.line import SimLine
from lecombus.parameters import Code
from lecombus.schedule import Outcome, Priority, Request
from proof.lines import RandomLine
from proof.telegrams import Telegram

__all__ = ["Sayings"]

EDGES = {(43, 0)}
"""Codes whose write must never be repeated, of those that clients write here."""
STOPPING = {(40, 0), (135, 0)}
"""Stops write these too, so that a telegram does not show whose it is."""
ASKED = {Priority.INTERACTIVE, Priority.BACKGROUND}
NEVER_SAID = {Outcome.EXPIRED, Outcome.SUPERSEDED}
AFTER_NAK = 2
"""A plain write that a drive refuses is said once more: a damaged one is refused, too."""
VALUE_READINGS, ADDRESS_READINGS = 4, 10
"""What was written is read in two forms, and the drive's own address a few times. A reading
directly behind another drive's same question proves nothing and is made again: at most so many."""
KEPT = 4
Key = tuple[int, tuple[int, int]]


@dataclass(slots=True)
class _Write:
    """A write that somebody asked for."""

    drive: str
    text: str
    serial: int
    asked_s: float
    expires_at_s: float | None
    setpoint: bool
    said: int = 0
    over: bool = False
    stopped: bool = False


@dataclass(slots=True)
class _Reads:
    """The reads of one code of one drive that are open: how many, and what they may still say."""

    open: int = 0
    most: int = 0
    said: int = 0


class Sayings:
    """Watches what is said for the requests of one line.

    Args:
        line: The line.
        sim: Its drives.
        clock: Line time.
        say: Told what did not hold.
    """

    def __init__(
        self,
        line: RandomLine,
        sim: SimLine,
        clock: Callable[[], float],
        say: Callable[[str], None],
    ) -> None:
        self._sim = sim
        self._told_apart = line.is_told_apart
        self._clock = clock
        self._say = say
        self._sayings = 1 + line.roster.line.retries
        self._addresses = {drive.name: drive.address for drive in line.roster.drives}
        self._families = {drive.name: family(drive.family) for drive in line.roster.drives}
        self._writes: defaultdict[Key, list[_Write]] = defaultdict(list)
        self._last: dict[Key, int] = {}
        self._reads: defaultdict[Key, _Reads] = defaultdict(_Reads)
        self._serial = 0

    # -- requests ----------------------------------------------------------------------------

    def taken(self, request: Request) -> Callable[[Outcome], None] | None:
        """Somebody asks for something; give who wants to know what became of it."""
        job = request.work
        if isinstance(job, ReadJob):
            return self._read_taken(request, job.step.code)
        if isinstance(job, ReadBackJob):
            return self._read_taken(request, job.written.code, VALUE_READINGS)
        if isinstance(job, WriteJob):
            return self._write_taken(request, job)
        return None

    def _key(self, drive: str, code: Code) -> Key:
        return self._addresses[drive], (code.number, code.subcode)

    def _read_taken(
        self, request: Request, code: Code, readings: int = 1
    ) -> Callable[[Outcome], None]:
        reads = self._reads[self._key(request.drive, code)]
        reads.open += 1
        reads.most += readings * self._sayings
        itself = self._itself_taken(request.drive) if readings > 1 else None

        def ended(_: Outcome) -> None:
            reads.open -= 1
            if itself is not None:
                itself.open -= 1

        return ended

    def _itself_taken(self, drive: str) -> _Reads:
        """What reads back may ask the drive for its own address too."""
        reads = self._reads[self._key(drive, address_code(self._families[drive]))]
        reads.open += 1
        reads.most += self._sayings * self._sayings * ADDRESS_READINGS
        return reads

    def _write_taken(self, request: Request, job: WriteJob) -> Callable[[Outcome], None]:
        self._serial += 1
        one = _Write(
            request.drive, job.value.raw, self._serial, self._clock(), request.expires_at_s,
            request.supersedes is not None,
        )  # fmt: skip
        key = self._key(request.drive, job.code)
        writes = self._writes[key]
        over = [other for other in writes if other.over]
        if len(over) > KEPT:
            writes.remove(over[0])
        writes.append(one)
        proofs = self._reads[key]  # each saying may be proven, each proof be repeated
        proofs.open += 1
        proofs.most += self._sayings * self._sayings * VALUE_READINGS
        itself = self._itself_taken(request.drive)

        def ended(outcome: Outcome) -> None:
            proofs.open -= 1
            itself.open -= 1
            one.over = True
            self._judge_end(key, one, outcome)

        return ended

    def _judge_end(self, key: Key, one: _Write, outcome: Outcome) -> None:
        what = f"the write of {one.text} to C{key[1][0]:04d} of {one.drive}"
        if outcome in NEVER_SAID and one.said:
            self._say(f"{what} ended as {outcome} and had been said")
        if outcome not in (Outcome.DONE, Outcome.VERIFIED) or not self._told_apart:
            return
        drive = self._sim[one.drive]
        if isinstance(drive.model, Drive82XX) and drive.model.shortened():
            return  # it is acknowledged before it is done
        entries = [
            entry for entry in drive.log
            if entry.time_s >= one.asked_s and (entry.code, entry.subcode) == key[1]
        ]  # fmt: skip
        done = [e for e in entries if e.kind == "write" and e.accepted and e.text == one.text]
        otherwise = key[1] in STOPPING or self._was_written_as_group(key, one)
        if not done and outcome is Outcome.VERIFIED and otherwise:
            # Another write may have brought the drive there: then a reading proves it.
            done = [e for e in entries if e.kind == "read" and e.accepted and e.text == one.text]
            if done:
                return
        if not done:
            self._say(f"{what} ended as {outcome} and the drive has not taken it")
        elif outcome is Outcome.VERIFIED and not any(
            e.kind == "read" and e.time_s > done[0].time_s for e in entries
        ):
            self._say(f"{what} ended as {outcome} and was never read back")

    def _was_written_as_group(self, key: Key, one: _Write) -> bool:
        """Whether the drive has this value from a group's write: members share their values."""
        entries = [
            entry for entry in self._sim[one.drive].log
            if entry.kind != "read" and entry.accepted and (entry.code, entry.subcode) == key[1]
        ]  # fmt: skip
        return bool(entries) and (entries[-1].kind, entries[-1].text) == ("group", one.text)

    # -- stops -------------------------------------------------------------------------------

    def stop_asked(self, drive: str) -> None:
        """A drive is to be stopped: what was asked of it before is not said any more."""
        address = self._addresses[drive]
        for key, writes in self._writes.items():
            if key[0] == address:
                for one in writes:
                    one.stopped = one.stopped or not one.over

    # -- telegrams ---------------------------------------------------------------------------

    def said(self, telegram: Telegram) -> None:
        """A telegram goes out: find the write that it says."""
        if telegram.text is None or telegram.group or telegram.code in STOPPING:
            return
        key = telegram.address, telegram.code
        found = [one for one in self._writes[key] if one.text == telegram.text and not one.over]
        what = f"{telegram.text} was written to C{key[1][0]:04d} of {key[0]}"
        if not found:
            self._say(f"{what}, which nobody wants now")
            return
        one = min(found, key=lambda write: (write.said, write.serial))
        one.said += 1
        if one.stopped:
            self._say(f"{what} after the stop of {one.drive} was asked for")
        if one.said == 1 and one.expires_at_s is not None and telegram.said_s > one.expires_at_s:
            self._say(f"{what} after it had expired")
        again = max(self._sayings, AFTER_NAK)
        if one.said > (1 if telegram.code in EDGES else again):
            self._say(f"{what} for the {one.said}. time")
        if one.setpoint:
            if one.serial < self._last.get(key, 0):
                self._say(f"{what} after a later setpoint")
            self._last[key] = one.serial

    def judge(self, one: Telegram) -> None:
        """Count a telegram that read for somebody."""
        if one.text is not None or one.priority not in (*ASKED, Priority.CONTROL):
            return
        reads = self._reads[one.address, one.code]
        reads.said += 1
        if reads.said > reads.most:
            times = f"{reads.said} times, {reads.most} are right"
            self._say(f"C{one.code[0]:04d} of {one.address} was read {times}")
        if not reads.open:
            reads.most = reads.said = 0
