"""The drives' control words as lecombus last saw or wrote them.

A quick stop changes one bit of the control word, and must not wait for reading it first. lecombus
is the line's only master, so the word it last read or wrote is the word the drive holds, until
the drive restarts: it is forgotten whenever a drive goes offline or is audited anew. It is also
forgotten when a write that changes it went unanswered, or went to a code that moves bits of it: a
quick stop made from an old word could lift an inhibit (EDB2102EN 8.2, C0135 bit 9).

The line is not all that moves the word: a keypad, or the drive's own watchdog, inhibits the drive
as well. So it is also forgotten when a status word begins to show an inhibit.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lecombus.drives.stops import StopProof
from lecombus.protocol.addressing import Code
from lecombus.protocol.values import Value
from lecombus.schedule import Outcome, Settle

__all__ = ["ControlWords"]


WORD_MAX = 0xFFFF


class ControlWords:
    """Remembers one word per drive."""

    def __init__(self) -> None:
        self._codes: dict[str, Code] = {}
        self._moved_by: dict[str, frozenset[Code]] = {}
        self._words: dict[str, int] = {}
        self._moving: dict[str, int] = {}
        self._inhibited_by: dict[str, Mapping[Code, StopProof]] = {}
        self._inhibited: dict[tuple[str, Code], bool] = {}

    def watch(
        self,
        drive: str,
        code: Code,
        *,
        moved_by: Iterable[Code] = (),
        inhibited_by: Mapping[Code, StopProof] | None = None,
    ) -> None:
        """Remember this code of this drive from now on.

        Args:
            drive: The drive.
            code: Its control word.
            moved_by: Other codes whose writes change bits of it, as C0040 does bit 9.
            inhibited_by: Status words and what of them shows an inhibit.
        """
        self._codes[drive] = code
        self._moved_by[drive] = frozenset((code, *moved_by))
        self._inhibited_by[drive] = dict(inhibited_by or {})

    def seen(self, drive: str, code: Code, value: Value) -> None:
        """Take a value that was read, or written and acknowledged.

        While a write that moves the word has not ended, what is read may be from before it.
        """
        self._look_for_inhibit(drive, code, value)
        if self._codes.get(drive) == code and not self._moving.get(drive):
            number = value.number
            if isinstance(number, int) and 0 <= number <= WORD_MAX:
                self._words[drive] = number

    def _look_for_inhibit(self, drive: str, code: Code, value: Value) -> None:
        """Forget the word when a status word begins to show an inhibit.

        Only when it begins: one that lasts, such as an open terminal's, is older than the word.
        """
        proof = self._inhibited_by.get(drive, {}).get(code)
        if proof is None:
            return
        shown = proof.holds(value)
        if shown and self._inhibited.get((drive, code)) is False:
            self.forget(drive)
        self._inhibited[drive, code] = shown

    def guard(self, drives: Iterable[str], code: Code, settle: Settle) -> Settle:
        """Treat the word as unknown from now until a write that may move it has ended.

        Args:
            drives: The drives the write goes to.
            code: What is written.
            settle: Told of the end afterwards.

        Returns:
            What the write's request must be settled with.
        """
        moved = [drive for drive in drives if code in self._moved_by.get(drive, ())]
        for drive in moved:
            self.forget(drive)
            self._moving[drive] = self._moving.get(drive, 0) + 1

        def end(outcome: Outcome, reason: str) -> None:
            for drive in moved:
                self.forget(drive)
                self._moving[drive] -= 1
            settle(outcome, reason)

        return end

    def disturbed(self, drive: str, code: Code) -> None:
        """Take note that a write went out: what it may have changed is no longer known."""
        if code in self._moved_by.get(drive, ()):
            self.forget(drive)

    def moves(self, drive: str, code: Code) -> bool:
        """Say whether a write to a code changes bits of the drive's control word."""
        return code in self._moved_by.get(drive, ())

    def forget(self, drive: str) -> None:
        """Nothing is known of this drive's word any more."""
        self._words.pop(drive, None)

    def get(self, drive: str) -> int | None:
        """The drive's control word, None when it is not known."""
        return self._words.get(drive)
