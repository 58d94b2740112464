"""Carrying out a plan: inhibit, write, prove, compare all, save.

1. The drive is inhibited: ramps and limits are not changed under a turning motor, and some codes
   are stored only then (EDB2102EN 6.4). Before every write its inhibit is read again: a drive that
   was enabled is no longer written to. After a loss of the line, when a watchdog or a power cycle
   may have changed its state, it is inhibited once more.
2. Each code is written and read back. A write that fails because of the line waits until the drive
   is back, then the code is read first: it may have been written. What the drive refuses is tried
   once more after the others, since limits may depend on another code, and before what comes last.
3. All codes of the plan, also those that had their value already, are read once more and compared:
   a change from elsewhere is found.
4. Only then, and only if all is as wanted, it is saved where the family needs that.

A stop of the drive ends a restore at any place. It never enables a drive.

How far it came is written as lines of a file (`Progress`). The first line says what is restored
into which drive, every further line names a code that was written and read back, or the mark of the
drive's stops after our own: after a stop by another one the drive does not count as enabled before.
Lines are only added, so that a restore that is killed in the middle leaves whole lines and at most
one torn one, which is ignored. What stands there is never taken for the drive's word: a restore
that goes on reads everything again. It is needed for what the drive does not report: that values
were written and not saved yet, and that it was enabled before. Where the file is, the command line
knows.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from lecombus.drives import Family, StopAction, confirm_codes, is_last, knows_stop, stop_confirmed
from lecombus.drives.procedures import DriveAccess, ReadAttempt, WriteAttempt, is_passing
from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

from .restore_plan import RestorePlan, RestoreStep
from .taking import Listener, RestoreAccess, take, wait_until_usable

__all__ = [
    "SUPERSEDED",
    "Progress",
    "Restored",
    "done_line",
    "head_line",
    "is_inhibited",
    "read_progress",
    "restore",
    "stops_line",
]

TRIES: Final = 4
"""How often one code is written while the line comes and goes."""

NOT_INHIBITED: Final = "its inhibit was lifted from elsewhere: nothing more is written to it"


@dataclass(slots=True)
class Restored:
    """How a restore ended.

    Args:
        written: What was written and read back.
        refused: What the drive did not take, and why.
        changed: What reads otherwise in the end: wanted and found.
        inhibited_here: The drive was not inhibited before, and was inhibited by this restore.
        inhibited_now: It reports its inhibit in the very end; None: it does not say.
        saved: The parameters were saved at the end; None where nothing needs saving.
        stopped: Why it ended before its end; empty when it did not.
    """

    written: dict[Code, Value] = field(default_factory=dict)
    refused: dict[Code, str] = field(default_factory=dict)
    changed: dict[Code, tuple[Value, ReadAttempt]] = field(default_factory=dict)
    inhibited_here: bool = False
    inhibited_now: bool | None = None
    saved: bool | None = None
    stopped: str = ""

    @property
    def complete(self) -> bool:
        """Whether the drive now reads what the backup holds, for good."""
        return not (self.refused or self.changed or self.stopped or self.saved is False)


STOPPED: Final = "nothing more is written to the drive"

SUPERSEDED: Final = "superseded"
"""The kind of a write that a stop ended."""


class StopRestoreError(Exception):
    """The restore must not go on; the message says why."""


async def restore(
    access: RestoreAccess,
    plan: RestorePlan,
    *,
    patience_s: float,
    listener: Listener,
    written: Callable[[Code, Value], None],
    unsaved: bool = False,
) -> Restored:
    """Carry out a plan without blockers.

    Args:
        access: The drive.
        plan: What to do.
        patience_s: How long to wait, each time, for a drive or a line that is away, seconds.
        listener: Called with the progress.
        written: Called with each code that was written and read back, before the next is begun.
        unsaved: An earlier restore wrote values that were never saved.
    """
    work = Work(access, plan, patience_s, listener, written)
    try:
        await work.inhibit()
        await work.write_all()
        await work.compare()
        if plan.steps or unsaved:
            await work.save()
    except StopRestoreError as exc:
        work.result.stopped = str(exc)
    work.result.inhibited_now = await is_inhibited(access, plan.family)
    return work.result


class Work:
    """One restore under way.

    Args: as for `restore`.
    """

    def __init__(
        self,
        access: RestoreAccess,
        plan: RestorePlan,
        patience_s: float,
        listener: Listener,
        written: Callable[[Code, Value], None],
    ) -> None:
        self.result = Restored()
        self._access = access
        self._plan = plan
        self._patience_s = patience_s
        self._listener = listener
        self._written = written
        self._was_away = False
        self._settled = 0

    async def inhibit(self) -> None:
        """Inhibit the drive, unless it is.

        Raises:
            StopRestoreError: It cannot be.
        """
        for _ in range(TRIES):
            await self._wait()
            state = await is_inhibited(self._access, self._plan.family)
            if state is True:
                return
            if state is None:  # it did not say
                self._was_away = True
                continue
            said = await self._access.inhibit()
            if said.done:
                self.result.inhibited_here = True
                self._listener.say("the drive was not inhibited, and is now")
                return
            if said.kind == SUPERSEDED:
                raise StopRestoreError(f"{STOPPED}: {said.text}")
            if not is_passing(said.kind):
                break
        raise StopRestoreError("the drive could not be inhibited: nothing more is written to it")

    async def write_all(self) -> None:
        """Write every step, those that were refused once more, then what comes last."""
        family = self._plan.family
        early = [step for step in self._plan.steps if not is_last(family, step.code)]
        late = [step for step in self._plan.steps if is_last(family, step.code)]
        await self._write_each(early)
        again = [step for step in early if step.code in self.result.refused]
        if again and self.result.written:
            self._listener.say("once more what was refused: limits may depend on another code")
            await self._write_each(again)
        await self._write_each(late)
        await self._check_inhibit()

    async def compare(self) -> None:
        """Read everything that was to be once more.

        Raises:
            StopRestoreError: It could not be read.
        """
        wanted = self._plan.wanted
        taken = await take(
            self._access,
            list(wanted),
            patience_s=self._patience_s,
            listener=WithoutProgress(self._listener),
        )
        if taken.unsettled:
            raise StopRestoreError(f"not compared in the end: {taken.unsettled[0].text}")
        for code, value in wanted.items():
            answer = taken.answers[code]
            if code in self.result.refused:
                continue
            if answer.value is None or not answer.value.means_same(value):
                self.result.changed[code] = value, answer

    async def save(self) -> None:
        """Save the parameters, where that is needed and all of them are right.

        Raises:
            StopRestoreError: It is not known whether they were saved.
        """
        if self._plan.save is None:
            return
        self.result.saved = False
        if self.result.refused or self.result.changed:
            self._listener.say("not saved: not everything is as it should be")
            return
        code, value = self._plan.save
        await self._wait()
        said = await self._access.write(code, value, verify=False)
        if not said.done:
            raise StopRestoreError(f"not saved by {self._plan.family.spoken(code)}: {said.text}")
        self.result.saved = True

    async def _write_each(self, steps: Sequence[RestoreStep]) -> None:
        for step in steps:
            said = await self._write(step)
            if said.done:
                self.result.refused.pop(step.code, None)
                self.result.written[step.code] = step.value
                self._written(step.code, step.value)
            else:
                self.result.refused[step.code] = said.text
                spoken = self._plan.family.spoken(step.code)
                name = step.name.removeprefix(f"{spoken} ")
                self._listener.say(f"{spoken} ({name}) not taken: {said.text}")
            self._settled = len(self.result.written) + len(self.result.refused)
            self._listener.advance(self._settled, len(self._plan.steps))

    async def _write(self, step: RestoreStep) -> WriteAttempt:
        """Write one code until it is clear what came of it.

        Raises:
            StopRestoreError: The drive stays away, or is not inhibited any more.
        """
        said = WriteAttempt(False, "unknown", "")
        for _ in range(TRIES):
            await self._check_inhibit()
            said = await self._access.write(step.code, step.value, verify=True)
            if said.kind == SUPERSEDED:
                raise StopRestoreError(f"{STOPPED}: {said.text}")
            if said.done or not is_passing(said.kind):
                return said
            self._was_away = True
            await self._wait()
            # It may have been written before the answer was lost: what it reads decides.
            answer = await self._access.read(step.code)
            if answer.value is not None and answer.value.means_same(step.value):
                await self._check_inhibit()
                return WriteAttempt(True)
        raise StopRestoreError(
            f"{self._plan.family.spoken(step.code)} could not be written: {said.text}"
        )

    async def _check_inhibit(self) -> None:
        """See that the drive is inhibited; after an absence, see to it.

        Raises:
            StopRestoreError: It was enabled.
        """
        for _ in range(TRIES):
            state = await is_inhibited(self._access, self._plan.family)
            if state is True:
                self._was_away = False
                return
            if state is False and not self._was_away:
                raise StopRestoreError(NOT_INHIBITED)
            self._was_away = True
            await self._wait()
            if state is False:
                await self.inhibit()
        raise StopRestoreError("the drive does not say whether it is inhibited")

    async def _wait(self) -> None:
        """Wait for the line and the drive.

        Raises:
            StopRestoreError: They stay away.
        """
        why = await wait_until_usable(self._access, self._patience_s, self._listener)
        if why:
            raise StopRestoreError(why)


class WithoutProgress:
    """Passes on messages, and not the progress of a reading."""

    def __init__(self, inner: Listener) -> None:
        self._inner = inner

    def advance(self, done: int, total: int) -> None:
        """Say nothing: the bar belongs to the writes."""

    def say(self, text: str) -> None:
        """Pass it on."""
        self._inner.say(text)


async def is_inhibited(access: DriveAccess, family: Family) -> bool | None:
    """Whether a drive reports that it is inhibited.

    Returns:
        None where it did not say: no answer, or none of the codes that show it.
    """
    if not knows_stop(family, StopAction.INHIBIT):
        return None
    for code in confirm_codes(family, StopAction.INHIBIT):
        answer = await access.read(code)
        if answer.value is not None:
            return stop_confirmed(family, StopAction.INHIBIT, code, answer.value)
        if is_passing(answer.kind):
            return None
    return None


@dataclass(frozen=True, slots=True)
class Progress:
    """What an unfinished restore left behind.

    Args:
        file: The backup that was being restored.
        digest: Its content's digest, to recognize an edited file.
        begun: When it began, RFC 3339.
        enabled: The drive was enabled when it began.
        done: What was written and read back.
        stops: Changes with every stop of the drive; as it was when this restore last wrote.
    """

    file: str
    digest: str
    begun: str
    enabled: bool
    done: Mapping[Code, str] = field(default_factory=dict)
    stops: str = ""


def head_line(progress: Progress) -> str:
    """Return the first line."""
    document = {
        "restore": progress.file, "digest": progress.digest, "begun": progress.begun,
        "enabled": progress.enabled, "stops": progress.stops,
    }  # fmt: skip
    return json.dumps(document) + "\n"


def stops_line(stops: str) -> str:
    """Return the line for a mark of the drive's stops that changed."""
    return json.dumps({"stops": stops}) + "\n"


def done_line(code: Code, value: Value) -> str:
    """Return the line for a code that was written and read back."""
    return json.dumps({"code": str(code), "value": value.raw}) + "\n"


def read_progress(text: str) -> Progress | None:
    """Read what an unfinished restore left behind; None where nothing usable is."""
    documents = [one for line in text.splitlines() if (one := _document(line)) is not None]
    if not documents or "restore" not in documents[0]:
        return None
    head, *rest = documents
    done: dict[Code, str] = {}
    stops = head.get("stops", "")
    for one in rest:
        stops = one.get("stops", stops)
        try:
            done[Code.parse(str(one.get("code")))] = Value.parse(str(one.get("value"))).raw
        except CodeValueError:
            continue
    return Progress(
        str(head["restore"]),
        str(head.get("digest")),
        str(head.get("begun")),
        head.get("enabled") is True,
        done,
        str(stops),
    )


def _document(line: str) -> dict[str, Any] | None:
    """Read one line; a torn one is none."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
