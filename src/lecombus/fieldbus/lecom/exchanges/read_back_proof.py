"""When a stop, or a write, counts as shown: which codes are read, and how many answers it takes.

The usual proof is one reading that shows it. Consecutive proofs of several drives alternate
the addressing form, which the answer repeats, so that a second copy of a neighbour's answer is not
taken for the next drive's.

Where that is not enough (the drive did not answer before, or second answers came lately) it takes
three things: an acknowledgement by the drive itself, two readings in two forms or of two codes, and
its address, read from the drive: no other drive of the line gives that answer.

Where other drives have not answered the same within 3 s, their answers may come late and pass for
this drive's. Each comes once, so it takes one reading more than there are such answers, in the form
where they are fewest. They are of the most conclusive code; where two readings are wanted anyway,
one may be of another code.

A reading proves no stop that the drive has refused (NAK) and not acknowledged since: something else
may hold it, and let it go.

A write is proven with less: an answer that no other drive was asked for lately is this drive's, and
an acknowledgement that was lost is not asked for again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from lecombus.drives import Family, StopAction, confirm_codes, stop_confirmed
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.requests import JobStep, Station, StepKind
from lecombus.parameters import AddressForm, Code, Value

from ..protocol.addressing import Form, encode_code
from ..protocol.exchange import ACK_FIELD
from ..protocol.telegrams import UnknownCodeAnswer, ValueAnswer
from .late_answers import COPY_S, Duplicates

__all__ = ["ReadBackProof", "WrittenValue"]

KEPT_APART_S = 1.0
"""A reading waits so long for a pause between questions to other drives for the same, seconds."""

WANTED = 2
"""Readings that it takes in two forms where one may be another drive's."""


class WrittenValue(NamedTuple):
    """What a code should read as after a write."""

    code: Code
    value: Value


def _codes(family: Family, what: StopAction | WrittenValue) -> tuple[Code, ...]:
    """Name the codes that show it, the most conclusive first."""
    return (what.code,) if isinstance(what, WrittenValue) else confirm_codes(family, what)


def _shows(family: Family, what: StopAction | WrittenValue, code: Code, value: Value) -> bool:
    """Say whether a reading shows it."""
    if isinstance(what, WrittenValue):
        return value.means_same(what.value)
    return stop_confirmed(family, what, code, value)


class ReadBackProof:
    """What has been shown of one stop or one write.

    Args:
        duplicates: From which drives answers were requested; None: from no other drive.
        silent: The drive did not answer before.
        offline: It did not answer for so long that it was taken for absent.

    Attributes:
        acknowledged: The drive acknowledged the stop itself.
        silent: It did not answer before, or not always since.
        has_no_address: It does not know the code of its own address.
        repeated: The last reading showed what an earlier one had shown in the same form: the other
            form may not be asked for while a late answer in it may still come.
        proves_nothing: The reading is not kept apart from other drives' any longer.
    """

    def __init__(
        self, duplicates: Duplicates | None, *, silent: bool, offline: bool = False
    ) -> None:
        self._duplicates = duplicates or Duplicates()
        self.silent = silent
        self.acknowledged = False
        self.repeated = self.proves_nothing = False
        self._apart_since_s: float | None = None  # since when the next reading is kept apart
        self._is_refused = False
        self._was_offline = offline
        self._ack_is_own = False
        self._shown: set[bytes] = set()
        self._seen: dict[bytes, tuple[int, int]] = {}  # how often, and how often others may have
        self._is_itself = False
        self._address_read: Value | None = None
        self.has_no_address = False
        self._asked_itself = 0
        self._led_astray: set[AddressForm] = set()

    def said(
        self, *, acknowledged: bool, refused: bool = False, drive: str = "", at_s: float = 0.0
    ) -> None:
        """Record that it was sent: a value read before the acknowledgement is too early.

        Args:
            acknowledged: An acknowledgement came.
            refused: A NAK came.
            drive: Whose it should be; empty: nothing depends on that.
            at_s: When it was sent.
        """
        self.repeated = False
        if acknowledged and drive:
            self._ack_is_own |= not self._duplicates.may_be_anothers(ACK_FIELD, drive, at_s)
        self._is_refused |= refused
        if not self.acknowledged:
            self.acknowledged = acknowledged
            self._forget()

    def step(self, station: Station, what: StopAction | WrittenValue) -> JobStep:
        """Return the next reading."""
        self._apart_since_s, self.proves_nothing = None, False
        other_s = self._duplicates.other_s
        fields = self._wanted(station, what)
        if self._has_enough(station, what) and not self._knows_it:
            code = address_code(station.family)
            forms = [form for form in self._forms(station) if form.carries(code)]
            forms.sort(key=lambda form: other_s(encode_code(code, form), station.name))
            form = forms[self._asked_itself % len(forms)] if forms else None
            return JobStep(StepKind.READ, code, form=form, apart=True)
        if not fields:
            fields = list(self._fields(station, what))
        _, code, form = min(
            fields,
            key=lambda one: (*self._still_owed(one[0], station), other_s(one[0], station.name)),
        )
        only = self.has_shown and self._duplicates.answers_late
        return JobStep(StepKind.READ, code, form=form, only=only, apart=True)

    def waits_apart(self, now_s: float) -> bool:
        """Whether the next reading waits for a pause between questions to other drives.

        If there is none for a second it is sent all the same, and proves nothing.
        """
        if self._apart_since_s is None:
            self._apart_since_s = now_s
        self.proves_nothing = now_s - self._apart_since_s >= KEPT_APART_S
        return not self.proves_nothing

    def take(
        self, station: Station, what: StopAction | WrittenValue, answer: ValueAnswer, code: Code
    ) -> bool:
        """Take a reading; return whether it shows what it should."""
        self.repeated = answer.field in self._shown
        if code == address_code(station.family) and code not in _codes(station.family, what):
            self._asked_itself += 1
            self._address_read = answer.value
            self._is_itself = answer.value.number == station.address
            return self._is_itself
        if not _shows(station.family, what, code, answer.value):
            if self._shown:
                self._lead_astray(station, answer.field)
            self._forget()
            return False
        seen, most = self._seen.get(answer.field, (0, 0))
        others = 0
        if code != address_code(station.family):  # another drive's is another value
            others = self._duplicates.left_out(answer.field, station.name)
        most = max(most, others)
        self._seen[answer.field] = (seen + 1, most)
        if not others or seen >= most:
            self._shown.add(answer.field)
        return True

    def _forget(self) -> None:
        self._shown.clear()
        self._seen.clear()

    def refused(self, station: Station, code: Code, answer: object) -> bool:
        """Record a read without value; return whether to continue in another way."""
        if type(answer) is UnknownCodeAnswer and code != address_code(station.family):
            shown = bool(self._shown)
            return shown and self._lead_astray(station, answer.field)
        if code != address_code(station.family):
            return False
        self._asked_itself += 1
        self.has_no_address |= type(answer) is UnknownCodeAnswer
        return True

    def _lead_astray(self, station: Station, field: bytes) -> bool:
        """Ask no more in a form that leads to another code; return whether there is another.

        A code bank or an input selection that was left set does that (C0249, C0248).
        """
        form = Form.EXTENDED if field[:1] == b"!" else Form.STANDARD
        left = [one for one in self._forms(station) if one is not form]
        if left:
            self._led_astray.add(form)
        return bool(left)

    @property
    def has_shown(self) -> bool:
        """Whether a reading showed it."""
        return bool(self._shown)

    @property
    def is_begun(self) -> bool:
        """Whether the drive showed the stop, so that only more readings are wanted.

        A drive that was told by a multicast acknowledges nothing. If it has answered always, and
        no second answers come, it is not told by itself only to outnumber late answers.
        """
        wants_ack = self.silent or self._is_refused or self._duplicates.is_doubtful
        return bool(self._seen) and (self.acknowledged or not (self._shown or wants_ack))

    def begin(self) -> None:
        """Start again, with another stop."""
        self.acknowledged = self._ack_is_own = self._is_refused = False
        self._forget()

    def is_enough(self, station: Station, what: StopAction | WrittenValue, now_s: float) -> bool:
        """Whether the stop is shown."""
        if self._is_refused and not self.acknowledged:
            return False
        if not (self.silent or self._duplicates.doubtful(now_s)):
            return bool(self._shown)
        if not self._is_shown_by_itself(station, what, now_s):
            return False
        return not self.wants_own_ack(station, what, now_s)

    def _is_shown_by_itself(
        self, station: Station, what: StopAction | WrittenValue, now_s: float
    ) -> bool:
        if not self.acknowledged or not self._has_enough(station, what):
            return False
        return self._knows_it and not (
            self.has_no_address and any(self._is_old(one, station, now_s) for one in self._seen)
        )

    def wants_own_ack(
        self, station: Station, what: StopAction | WrittenValue, now_s: float
    ) -> bool:
        """Whether only an acknowledgement is missing that no other drive can have given.

        A drive that was offline may have missed the stop. Where second answers come, the
        acknowledgement and both readings may be those of drives that were asked lately.
        """
        if not self._was_offline or not self._duplicates.doubtful(now_s) or self._ack_is_own:
            return False
        if not self._is_shown_by_itself(station, what, now_s):
            return False
        return all(self._is_old(one, station, now_s) for one in self._seen)

    def is_written(self, station: Station, what: WrittenValue, now_s: float) -> bool:
        """Whether a write is shown, acknowledged or not."""
        own = any(not self._is_old(one, station, now_s) for one in self._shown)
        if own or not (self.silent or self._duplicates.doubtful(now_s)):
            return bool(self._shown)
        if what.code == address_code(station.family):
            return bool(self._shown)  # no other drive reads as this one's address
        return self._is_itself and self._has_enough(station, what)

    def may_be_two(self, station: Station, now_s: float) -> str:
        """Say that one of two drives at this address may have shown it; empty: one is there."""
        if not self._duplicates.found(now_s).may_be_two(station.name):
            return ""
        return (
            f"second answers come after its own, as from two drives at address {station.address}: "
            "one may not have stopped"
        )

    def missing(self, station: Station) -> str:
        """Say what is not shown, where a reading showed the stop."""
        if self._is_refused and not self.acknowledged:
            return "the drive refused it (NAK): something else may hold it"
        if not self.acknowledged:
            return "the drive did not acknowledge it: the answer may be another drive's"
        if self._was_offline and not self._ack_is_own and self._knows_it:
            return "it was offline, and its acknowledgement may be another drive's"
        return self.not_its_own(station)

    def not_its_own(self, station: Station) -> str:
        """Return why a reading that shows it may be another drive's."""
        what, read = station.family.spoken(address_code(station.family)), self._address_read
        if self._seen and not self._shown:
            return "other drives have not answered the same: their late answers may have shown it"
        if self.has_no_address and not self._is_itself:
            return (
                f"{what}, its address, does not exist in it, and another drive was asked for the "
                "same: the answer may be another drive's"
            )
        if not self._is_itself:
            is_read = "was not read"
            if read is not None:
                is_read = f"reads {read.raw}, not {station.address}"
            return f"{what}, its address, {is_read}: the answer may be another drive's"
        return "second answers come on this line: the answer may be another drive's"

    @property
    def _knows_it(self) -> bool:
        return self._is_itself or self.has_no_address

    def _forms(self, station: Station) -> tuple[AddressForm, ...]:
        return tuple(form for form in station.forms if form not in self._led_astray)

    def _has_enough(self, station: Station, what: StopAction | WrittenValue) -> bool:
        fields = [field for field, _, _ in self._fields(station, what)]
        enough = len(self._seen) >= min(WANTED, len(fields))
        return enough and not self._shown.isdisjoint(fields)  # one of the most conclusive code

    def _is_old(self, field: bytes, station: Station, now_s: float) -> bool:
        return now_s - self._duplicates.other_s(field, station.name) < COPY_S

    def _wanted(
        self, station: Station, what: StopAction | WrittenValue
    ) -> list[tuple[bytes, Code, AddressForm]]:
        """Name the answers that have not shown it yet; of other codes where late ones may come."""
        first = list(self._fields(station, what))
        is_conclusive = any(field in self._shown for field, _, _ in first)
        taken = self._seen if is_conclusive else self._shown  # the second one may be another's
        missing = [one for one in first if one[0] not in taken]
        owed = [self._others_owe(one[0], station) for one in missing]
        if not missing or not all(any(one) for one in owed):
            return missing
        if not all(late_s for late_s, _ in owed):  # they are outnumbered, not waited for
            wants_two = self.silent or self._duplicates.is_doubtful
            if not wants_two or (self._shown and not is_conclusive):
                return missing
        every = self._fields(station, what, all_codes=True)
        return [one for one in every if one[0] not in taken]

    def _others_owe(self, field: bytes, station: Station) -> tuple[float, int]:
        """Return until when it waits for late answers of other drives, and how many it outnumbers.

        Seconds, 0 if it does not wait; and 0 if one reading is enough.
        """
        late_s = max(self._duplicates.late_until_s(field, station.name), 0.0)
        return late_s, self._duplicates.left_out(field, station.name)

    def _still_owed(self, field: bytes, station: Station) -> tuple[float, int]:
        """As `_others_owe`, less the readings that were taken."""
        late_s, owed = self._others_owe(field, station)
        seen, _ = self._seen.get(field, (0, 0))
        return late_s, max(owed - seen, 0)

    def _fields(
        self, station: Station, what: StopAction | WrittenValue, *, all_codes: bool = False
    ) -> Iterator[tuple[bytes, Code, AddressForm]]:
        """Name the answers that may show it: those of the most conclusive code, in each form.

        Where there is one form only, those of the other codes too, or if all are asked for.
        """
        codes, forms = _codes(station.family, what), self._forms(station)
        if len(forms) > 1 and not all_codes:
            codes = codes[:1]
        for code in codes:
            for form in forms:
                if form.carries(code):
                    yield encode_code(code, form), code, form
