"""Reading a drive whole, through short losses of the line.

All codes are given to the access together, which reads a few at a time. What failed because of the
line (no answer, no port, the drive being audited) is asked again when the drive can be asked,
a bounded number of times; what the drive itself refused is not. When the drive stays away longer
than the user has patience, what is missing is left missing, with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from lecombus.drives.procedures import DriveAccess, ReadAttempt, WriteAttempt, is_passing
from lecombus.parameters import Code

__all__ = ["Listener", "NotUsable", "RestoreAccess", "Taken", "take", "wait_until_usable"]

LOOK_AGAIN_S: Final = 1.0

TRIES: Final = 4
"""How often one code is asked: more than a line that is plugged in again ever needs."""


@dataclass(frozen=True, slots=True)
class NotUsable:
    """Why a drive cannot be asked now.

    Args:
        text: The reason.
        is_offline: The line is open, and the drive does not answer.
    """

    text: str
    is_offline: bool = False


class RestoreAccess(DriveAccess, Protocol):
    """One drive behind a daemon, in the background class, as backups and restores use it."""

    async def read_many(self, codes: Sequence[Code], heard: Callable[[ReadAttempt], None]) -> None:
        """Read codes, a few at a time; `heard` is called with one answer for each, in any order."""

    async def inhibit(self) -> WriteAttempt:
        """Inhibit the drive and see that it is."""

    async def enable(self) -> WriteAttempt:
        """Lift the inhibit."""

    async def why_not_usable(self) -> NotUsable | None:
        """Return why the drive cannot be asked now; None when it can."""

    async def pause(self, for_s: float) -> None:
        """Wait, seconds."""

    def now_s(self) -> float:
        """Return monotonic time, seconds."""


class Listener(Protocol):
    """Is called with the progress of the work."""

    def advance(self, done: int, total: int) -> None:
        """So many codes are done, of so many."""

    def say(self, text: str) -> None:
        """Something that is worth a line."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What came of reading a drive.

    Args:
        answers: One for each code, in the order of codes.
        gave_up: Why some codes were not asked to the end; empty when all were.
    """

    answers: dict[Code, ReadAttempt]
    gave_up: str = ""

    @property
    def unsettled(self) -> list[ReadAttempt]:
        """What could not be read for a reason that may pass."""
        return [one for one in self.answers.values() if one.value is None and is_passing(one.kind)]


async def take(
    access: RestoreAccess, codes: Sequence[Code], *, patience_s: float, listener: Listener,
    pass_over: bool = False,
) -> Taken:  # fmt: skip
    """Read codes.

    Args:
        access: The drive.
        codes: What to read.
        patience_s: How long to wait, each time, for a drive or a line that is away, seconds.
        listener: Called with the progress.
        pass_over: Do not wait for a drive that is offline before anything was read of it; one
            that falls silent later has probably restarted, and is waited for.
    """
    answers: dict[Code, ReadAttempt] = {}
    pending = list(dict.fromkeys(codes))
    total, why = len(pending), ""

    def heard(answer: ReadAttempt) -> None:
        answers[answer.code] = answer
        listener.advance(sum(not is_unsettled(one) for one in answers.values()), total)

    for _ in range(TRIES):
        is_begun = any(one.value is not None for one in answers.values())
        why = await wait_until_usable(
            access, patience_s, listener, also_offline=is_begun or not pass_over
        )
        if why or not pending:
            break
        await access.read_many(pending, heard)
        pending = [code for code in pending if is_unsettled(answers.get(code))]
        if not pending:
            break
    for code in pending:
        answers.setdefault(code, ReadAttempt(code, None, "offline", why))
    return Taken(dict(sorted(answers.items())), why)


def is_unsettled(answer: ReadAttempt | None) -> bool:
    """Whether a code has to be asked again."""
    return answer is None or (answer.value is None and is_passing(answer.kind))


async def wait_until_usable(
    access: RestoreAccess, patience_s: float, listener: Listener, *, also_offline: bool = True
) -> str:
    """Wait until a drive can be asked.

    Args:
        access: The drive.
        patience_s: How long, seconds.
        listener: Called once when the wait begins, and once when it ends.
        also_offline: Wait for a drive that is offline, too.

    Returns:
        Why it still cannot be asked; empty when it can.
    """
    since_s, said = access.now_s(), ""
    while why := await access.why_not_usable():
        if why.is_offline and not also_offline:
            return why.text
        if why.text != said:
            listener.say(f"waiting: {why.text}")
            said = why.text
        if access.now_s() - since_s >= patience_s:
            return why.text
        await access.pause(LOOK_AGAIN_S)
    if said:
        listener.say("going on")
    return ""
