"""A drive's control word, and whether the drive is inhibited, as lecombus last knew it.

A quick stop changes one bit of the control word, and must not wait for reading it first. lecombus
is the line's only master, so the word it last read or wrote is the word the drive holds, until
the drive restarts: it is forgotten whenever a drive goes offline or is audited again. It is also
forgotten when a write that changes it went unanswered, or went to a code that moves bits of it: a
quick stop made from an old word could lift an inhibit (EDB2102EN 8.2, C0135 bit 9).

No manual says that a read of the control word shows an inhibit that C0040, the watchdog or the
keypad set. A drive may as well give back what was last written to it, and a quick stop made from
that would lift the inhibit. So the inhibit is kept apart from the word, and a word that is to be
written gets its bit whenever the drive is inhibited:

* An inhibit that went out over the line counts until the drive has shown it and shows it no more.
* An inhibit that a code shows counts until that code, or one that is more exact, shows none.
* That there is none counts for `FRESH_S`, and not beyond a silence in which the drive's watchdog
  may have acted. After that it is not known, and must be read before a quick stop is said.

Source: EDB2102EN 8.2 (C0135, C0040, C0150).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Final

from lecombus.drives.stops import StopProof, inhibit_mask, inhibit_proofs, usable_word
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Settle

if TYPE_CHECKING:
    from lecombus.drives import Family

__all__ = ["ControlWord", "control_word_of", "unknown_until_ended"]

FRESH_S: Final = 5.0
"""So old may be what shows that a drive is not inhibited, seconds: five periods of C0150."""


class ControlWord:
    """One drive's control word, and whether the drive is inhibited.

    Args:
        clock: Monotonic time, seconds.
        code: The control word's code; None: the family has none that a stop needs.
        mask: The bit of it that inhibits, 0 where there is none.
        moved_by: Other codes whose writes change bits of it, as C0040 does bit 9.
        inhibited_by: Codes and what of them shows an inhibit, the most reliable first.
        watchdog_s: After so much silence the drive's watchdog acts, seconds; None: it has none.
        watchdog_inhibits: The watchdog's action is an inhibit.
    """

    __slots__ = (
        "_clock", "_code", "_commanded", "_free_at_s", "_heard_at_s", "_last_free", "_last_said",
        "_last_word", "_mask", "_moved_by", "_moving", "_own_word", "_proofs", "_said", "_shown",
        "_watchdog_inhibits", "_watchdog_s", "_word",
    )  # fmt: skip

    def __init__(
        self,
        clock: Callable[[], float],
        code: Code | None = None,
        *,
        mask: int = 0,
        moved_by: Iterable[Code] = (),
        inhibited_by: Mapping[Code, StopProof] | None = None,
        watchdog_s: float | None = None,
        watchdog_inhibits: bool = False,
    ) -> None:
        self._clock = clock
        self._code = code
        self._mask = mask
        self._moved_by = frozenset() if code is None else frozenset((code, *moved_by))
        self._proofs = dict(inhibited_by or {})
        self._watchdog_s = watchdog_s
        self._watchdog_inhibits = watchdog_inhibits
        self._word: int | None = None
        self._moving = 0  # writes under way that change it
        self._commanded = False  # an inhibit was sent and not shown yet
        self._said: dict[Code, Value] = {}  # what was written last since it was forgotten
        self._last_said: tuple[Code, Value] | None = None  # the last of these, if it was heard
        self._shown: set[Code] = set()  # codes that showed an inhibit last
        self._free_at_s: float | None = None  # when something last showed that there is none
        self._heard_at_s: float | None = None  # when the drive last answered
        self._last_word: int | None = None  # kept when the word is forgotten
        self._own_word: int | None = None  # the same, but not behind a write that was not heard
        self._last_free = False  # what was known last showed no inhibit

    # ---- what happens -------------------------------------------------------------------------

    def heard(self, at_s: float) -> None:
        """The drive answered: any telegram to it fed its watchdog.

        Args:
            at_s: When the telegram to it began, monotonic seconds.
        """
        if self.watchdog_may_have_acted(at_s):
            self._free_at_s = None
        self._heard_at_s = at_s

    def seen(
        self,
        code: Code,
        value: Value,
        at_s: float | None = None,
        *,
        may_be_anothers: bool = False,
    ) -> None:
        """Take a value that was read.

        While a write that moves the word has not ended, what is read may be from before it.

        Args:
            code: What was read.
            value: The value.
            at_s: When the telegram to the drive began, monotonic seconds; None: now. The daemon may
                look at its answer much later, when the drive's watchdog has acted.
            may_be_anothers: Answers come twice on this line: it may be the word of another drive,
                whose direction or fixed speed must not be written to this one. It is kept only
                if it is as this drive's was known last, but for an inhibit known of.
        """
        if code in self._proofs:
            self._look_for_inhibit(code, value, self._clock() if at_s is None else at_s)
        if may_be_anothers and not self._is_as_before(value):
            return
        if self._last_said is not None and self._last_said[0] == code:
            self._see_said(self._last_said[1], value)
        self._keep(code, value)

    def _see_said(self, said: Value, value: Value) -> None:
        """Forget what was said last if the drive does not hold it any more, as after a restart."""
        if said.word is None or value.word is None:
            holds = value.means_same(said)
        else:
            holds = not said.word & ~value.word
        if not holds:
            self._last_said = None

    def _keep(self, code: Code, value: Value) -> None:
        if self._code != code or self._moving:
            return
        word = usable_word(value.word)
        if word is None:
            return
        self._word = self._last_word = self._own_word = word

    def _is_as_before(self, value: Value) -> bool:
        """Say whether a word is as it was known last, but for the bit of an inhibit known of."""
        if value.word is None or self._own_word is None:
            return False
        changed = value.word ^ self._own_word
        return not changed or (changed == self._mask and not self._last_free)

    def _look_for_inhibit(self, code: Code, value: Value, at_s: float) -> None:
        shown = self._proofs[code].shown_by(value)
        if shown is None:
            return
        if shown:
            if code not in self._shown and self._free_at_s is not None:
                self._word = None  # something that is not the line may have changed more
            self._shown.add(code)
            self._commanded, self._free_at_s, self._last_free = False, None, False
            return
        rank = list(self._proofs).index(code)
        self._shown -= set(list(self._proofs)[rank:])
        if not self._shown and not self._commanded and not self._moving:
            self._free_at_s, self._last_free = at_s, True

    def written(self, code: Code, value: Value, *, heard: bool, at_s: float | None = None) -> None:
        """Take a write that was sent and not refused.

        Args:
            code: What was written.
            value: The value.
            heard: The drive acknowledged it.
            at_s: As for `seen`.
        """
        if code not in self._moved_by:
            return
        self._word, self._said[code] = None, value
        self._last_said = (code, value) if heard else None
        if not heard:
            self._own_word = None
        if self._inhibits(code, value):
            self._command()
        else:
            # Perhaps it lifts the inhibit; where the drive did not answer, perhaps it did not.
            at_s = self._clock() if at_s is None else at_s
            self._free_at_s = at_s if heard else None
            if heard:
                self._commanded, self._last_free = False, True
                self._shown.clear()
        if heard:
            self._keep(code, value)

    def written_to_all(self, code: Code, value: Value) -> None:
        """Take a multicast that was sent: the word is taken as written, no more."""
        self.written(code, value, heard=False)
        self._last_said = (code, value)
        self._keep(code, value)

    def inhibiting(self) -> None:
        """An inhibit is about to be sent: no quick stop may lift it."""
        if self._code is not None:
            self._word = None
            self._command()

    def _command(self) -> None:
        self._commanded, self._free_at_s, self._last_free = True, None, False

    def begin_write(self) -> None:
        """A write that may change the word waits or runs: until `end_write` it is not known."""
        self._word = None
        self._moving += 1

    def end_write(self) -> None:
        """A write that may have changed the word has ended."""
        self._word = None
        self._moving -= 1

    def forget(self) -> None:
        """The word is not known any more, nor whether the drive is inhibited."""
        self._word = self._free_at_s = None
        self._commanded, self._last_said, self._own_word = False, None, None
        self._said.clear()
        self._shown.clear()

    # ---- what is known ------------------------------------------------------------------------

    def watchdog_may_have_acted(self, at_s: float) -> bool:
        """Say whether the drive has been silent for its watchdog's time, up to a moment.

        It is not known how long one was silent that was not heard yet: before a restart, perhaps.
        """
        watchdog_s, heard_at_s = self._watchdog_s, self._heard_at_s
        return watchdog_s is not None and (heard_at_s is None or at_s - heard_at_s >= watchdog_s)

    def moves(self, code: Code) -> bool:
        """Say whether a write to a code changes bits of the control word."""
        return code in self._moved_by

    def repeats(self, code: Code, value: Value) -> bool:
        """Say whether a write says again what the line said last to change the word.

        Not while another write that changes it waits or is under way.
        """
        return not self._moving and self._last_said == (code, value)

    def said(self, code: Code) -> Value | None:
        """What the line wrote last to a code that changes it; None: nothing since it was away."""
        return self._said.get(code)

    def word(self) -> int | None:
        """The control word as last read or written, None when it is not known.

        The drive may also be inhibited by another code: then set the inhibit bit before you write
        this word back.
        """
        return self._word

    def inhibited(self) -> bool | None:
        """Say whether the drive is inhibited; None: that must be read."""
        if not self._proofs:
            return False
        if self._commanded or self._shown:
            return True
        if self._free_at_s is None:
            return None
        now_s = self._clock()
        silent_s = now_s - max(self._free_at_s, self._heard_at_s or 0.0)
        if self._watchdog_s and silent_s >= self._watchdog_s:
            return None
        return False if now_s - self._free_at_s <= FRESH_S else None

    def last(self) -> int | None:
        """The control word as it was known last, for a drive that hears and cannot be read.

        With the inhibit in it unless what was known last showed none. None: no word was ever
        known, or the drive's watchdog may have inhibited it since and nothing must lift that.
        """
        if self._last_word is None:
            return None
        if not self._last_free:
            return self._last_word | self._mask
        silent_s = self._clock() - (self._heard_at_s or 0.0)
        if self._watchdog_inhibits and self._watchdog_s and silent_s >= self._watchdog_s:
            return None
        return self._last_word

    def missing(self) -> Code | None:
        """Name what must be read before `get` knows; None: nothing."""
        if self._code is None or self.get() is not None:
            return None
        return self._code if self._word is None else next(iter(self._proofs))

    def get(self) -> int | None:
        """The control word with the inhibit in it, None while the one or the other is not known."""
        word, inhibited = self._word, self.inhibited()
        if word is None:
            return None
        if word & self._mask:
            return word
        return None if inhibited is None else word | self._mask if inhibited else word

    def _inhibits(self, code: Code, value: Value) -> bool:
        """Say whether a write inhibits the drive."""
        number = value.number
        if code == self._code:
            return isinstance(number, int) and bool(number & self._mask)
        proof = self._proofs.get(code)
        return proof is not None and proof.holds(value)


def control_word_of(
    family: Family,
    clock: Callable[[], float],
    *,
    watchdog_s: float | None,
    watchdog_inhibits: bool,
) -> ControlWord:
    """Return what is to be known of the control word of a drive of a family; nothing is yet.

    Args:
        family: The family.
        clock: Monotonic time, seconds.
        watchdog_s: After so much silence the drive's watchdog acts, seconds; None: it has none.
        watchdog_inhibits: The watchdog's action is an inhibit.
    """
    found = ControlWord(clock)
    for rule in family.stops.values():
        if rule.value is None:
            found = ControlWord(
                clock,
                rule.code,
                mask=inhibit_mask(family, rule.code),
                moved_by=(one.code for one in family.stops.values() if one is not rule),
                inhibited_by=inhibit_proofs(family),
                watchdog_s=watchdog_s,
                watchdog_inhibits=watchdog_inhibits,
            )
    return found


def unknown_until_ended(words: Iterable[ControlWord], code: Code, settle: Settle) -> Settle:
    """Treat words as unknown from now until a write that may move them has ended.

    Args:
        words: Of the drives the write goes to.
        code: What is written.
        settle: Called at the end of the write.

    Returns:
        What the write's request must be settled with.
    """
    moved = [word for word in words if word.moves(code)]
    for word in moved:
        word.begin_write()

    def end(outcome: Outcome, reason: str) -> None:
        for word in moved:
            word.end_write()
        settle(outcome, reason)

    return end
