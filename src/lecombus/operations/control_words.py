"""The drives' control words, and whether the drives are inhibited, as lecombus last knew it.

A quick stop changes one bit of the control word, and must not wait for reading it first. lecombus
is the line's only master, so the word it last read or wrote is the word the drive holds, until
the drive restarts: it is forgotten whenever a drive goes offline or is audited anew. It is also
forgotten when a write that changes it went unanswered, or went to a code that moves bits of it: a
quick stop made from an old word could lift an inhibit (EDB2102EN 8.2, C0135 bit 9).

No manual says that a read of the control word shows an inhibit that C0040, the watchdog or the
keypad set. A drive may as well give back what was last written to it, and a quick stop made from
that would lift the inhibit. So the inhibit is kept apart from the word, and a word that is to be
written gets its bit whenever the drive is inhibited:

* An inhibit that went out over the line counts until the drive has shown it and shows it no more.
* An inhibit that a code shows counts until that code, or one that tells more, shows none.
* That there is none counts for `FRESH_S`, and not beyond a silence in which the drive's watchdog
  may have acted. After that it is not known, and must be read before a quick stop is said.

What must not live here: reading and writing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from lecombus.drives.stops import StopProof, usable_word
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.schedule import Outcome, Settle

__all__ = ["ControlWords"]

FRESH_S: Final = 5.0
"""So old may be what shows that a drive is not inhibited, seconds: five periods of C0150."""


@dataclass(slots=True)
class _Watched:
    """What is known of one drive.

    Args:
        code: Its control word.
        mask: The bit of it that inhibits, 0 where there is none.
        moved_by: Codes whose writes change bits of it, itself included.
        proofs: What shows an inhibit, the most telling first.
        watchdog_s: After so much silence its watchdog may have acted, seconds; None: it has none.
        word: The word, None when not known.
        moving: Writes under way that move it.
        commanded: An inhibit went out and was not shown yet.
        shown: Codes that showed an inhibit last.
        free_at_s: When something last showed that there is none.
        heard_at_s: When it last answered.
    """

    code: Code
    mask: int
    moved_by: frozenset[Code]
    proofs: Mapping[Code, StopProof]
    watchdog_s: float | None
    word: int | None = None
    moving: int = 0
    commanded: bool = False
    shown: set[Code] = field(default_factory=set)
    free_at_s: float | None = None
    heard_at_s: float | None = None
    last_word: int | None = None  # kept when `word` is forgotten
    last_free: bool = False  # what was known last showed no inhibit
    watchdog_inhibits: bool = False


class ControlWords:
    """Remembers one word per drive, and whether the drive is inhibited.

    Args:
        clock: Monotonic time, seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._drives: dict[str, _Watched] = {}

    def watch(
        self,
        drive: str,
        code: Code,
        *,
        mask: int = 0,
        moved_by: Iterable[Code] = (),
        inhibited_by: Mapping[Code, StopProof] | None = None,
        watchdog_s: float | None = None,
        watchdog_inhibits: bool = False,
    ) -> None:
        """Remember this code of this drive from now on.

        Args:
            drive: The drive.
            code: Its control word.
            mask: The bit of it that inhibits.
            moved_by: Other codes whose writes change bits of it, as C0040 does bit 9.
            inhibited_by: Codes and what of them shows an inhibit, the most telling first.
            watchdog_s: After so much silence the drive's watchdog acts, seconds.
            watchdog_inhibits: Its action is an inhibit.
        """
        self._drives[drive] = _Watched(
            code, mask, frozenset((code, *moved_by)), dict(inhibited_by or {}), watchdog_s,
            watchdog_inhibits=watchdog_inhibits,
        )  # fmt: skip

    # ---- what happens -------------------------------------------------------------------------

    def heard(self, drive: str, at_s: float) -> None:
        """Take note that a drive answered: whatever it was asked fed its watchdog."""
        known = self._drives.get(drive)
        if known is None:
            return
        before, known.heard_at_s = known.heard_at_s, at_s
        if known.watchdog_s and before is not None and at_s - before >= known.watchdog_s:
            known.free_at_s = None

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read.

        While a write that moves the word has not ended, what is read may be from before it.
        """
        known = self._drives.get(drive)
        if known is None:
            return
        if code in known.proofs:
            self._look_for_inhibit(known, code, value)
        self._keep(known, code, value)

    def _keep(self, known: _Watched, code: Code, value: Value) -> None:
        number = value.number
        word = usable_word(number if isinstance(number, int) else None)
        if known.code == code and not known.moving and word is not None:
            known.word = known.last_word = word

    def _look_for_inhibit(self, known: _Watched, code: Code, value: Value) -> None:
        shown = known.proofs[code].shown_by(value)
        if shown is None:
            return
        if shown:
            if code not in known.shown and known.free_at_s is not None:
                known.word = None  # something that is not the line may have changed more
            known.shown.add(code)
            known.commanded, known.free_at_s, known.last_free = False, None, False
            return
        rank = list(known.proofs).index(code)
        known.shown -= set(list(known.proofs)[rank:])
        if not known.shown and not known.commanded and not known.moving:
            known.free_at_s, known.last_free = self._clock(), True

    def written(self, drive: str, code: Code, value: Value, *, heard: bool) -> None:
        """Take note of a write that went out and was not refused.

        Args:
            drive: The drive.
            code: What was written.
            value: The value.
            heard: The drive acknowledged it.
        """
        known = self._drives.get(drive)
        if known is None or code not in known.moved_by:
            return
        known.word = None
        if _inhibits(known, code, value):
            self._command(known)
        else:
            # Perhaps it lifts the inhibit; where the drive did not answer, perhaps it did not.
            known.free_at_s = self._clock() if heard else None
            if heard:
                known.commanded, known.last_free = False, True
                known.shown.clear()
        if heard:
            self._keep(known, code, value)

    def said_to_all(self, drive: str, code: Code, value: Value) -> None:
        """Take note of a multicast that went out: the word is taken as written, no more."""
        self.written(drive, code, value, heard=False)
        known = self._drives.get(drive)
        if known is not None:
            self._keep(known, code, value)

    def inhibiting(self, drive: str) -> None:
        """Take note that an inhibit is about to be said: no quick stop may lift it."""
        known = self._drives.get(drive)
        if known is not None:
            known.word = None
            self._command(known)

    def _command(self, known: _Watched) -> None:
        known.commanded, known.free_at_s, known.last_free = True, None, False

    def guard(self, drives: Iterable[str], code: Code, settle: Settle) -> Settle:
        """Treat the word as unknown from now until a write that may move it has ended.

        Args:
            drives: The drives the write goes to.
            code: What is written.
            settle: Told of the end afterwards.

        Returns:
            What the write's request must be settled with.
        """
        moved = [
            known
            for drive in drives
            if (known := self._drives.get(drive)) is not None and code in known.moved_by
        ]
        for known in moved:
            known.word = None
            known.moving += 1

        def end(outcome: Outcome, reason: str) -> None:
            for known in moved:
                known.word = None
                known.moving -= 1
            settle(outcome, reason)

        return end

    def forget(self, drive: str) -> None:
        """Nothing is known of this drive's word any more, nor whether it is inhibited."""
        known = self._drives.get(drive)
        if known is not None:
            known.word = known.free_at_s = None
            known.commanded = False
            known.shown.clear()

    # ---- what is known ------------------------------------------------------------------------

    def moves(self, drive: str, code: Code) -> bool:
        """Say whether a write to a code changes bits of the drive's control word."""
        known = self._drives.get(drive)
        return known is not None and code in known.moved_by

    def word(self, drive: str) -> int | None:
        """The drive's control word as last read or written, None when it is not known.

        An inhibit may stand beside it: whoever writes it back must add that.
        """
        known = self._drives.get(drive)
        return known.word if known is not None else None

    def inhibited(self, drive: str) -> bool | None:
        """Say whether the drive is inhibited; None: that must be read."""
        known = self._drives.get(drive)
        if known is None or not known.proofs:
            return False
        if known.commanded or known.shown:
            return True
        if known.free_at_s is None:
            return None
        now_s = self._clock()
        silent_s = now_s - max(known.free_at_s, known.heard_at_s or 0.0)
        if known.watchdog_s and silent_s >= known.watchdog_s:
            return None
        return False if now_s - known.free_at_s <= FRESH_S else None

    def last(self, drive: str) -> int | None:
        """The control word as it was known last, for a drive that hears and cannot be read.

        With the inhibit in it unless what was known last showed none. None: no word was ever
        known, or the drive's watchdog may have inhibited it since and nothing must lift that.
        """
        known = self._drives.get(drive)
        if known is None or known.last_word is None:
            return None
        if not known.last_free:
            return known.last_word | known.mask
        silent_s = self._clock() - (known.heard_at_s or 0.0)
        if known.watchdog_inhibits and known.watchdog_s and silent_s >= known.watchdog_s:
            return None
        return known.last_word

    def missing(self, drive: str) -> Code | None:
        """Name what must be read before `get` knows; None: nothing."""
        known = self._drives.get(drive)
        if known is None or self.get(drive) is not None:
            return None
        return known.code if known.word is None else next(iter(known.proofs))

    def get(self, drive: str) -> int | None:
        """The control word with the inhibit in it, None while the one or the other is not known."""
        word, inhibited = self.word(drive), self.inhibited(drive)
        if word is None:
            return None
        mask = self._drives[drive].mask
        if word & mask:
            return word
        return None if inhibited is None else word | mask if inhibited else word


def _inhibits(known: _Watched, code: Code, value: Value) -> bool:
    """Say whether a write inhibits the drive."""
    number = value.number
    if code == known.code:
        return isinstance(number, int) and bool(number & known.mask)
    proof = known.proofs.get(code)
    return proof is not None and proof.holds(value)
