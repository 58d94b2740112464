"""What an exchange costs on the line, and until when its answer may come.

The time on the wire follows from baud rate, addressing and value length, the drive's answer time
(t3) from family and code. The expected cost uses both as they usually are. Time-outs are made from
the longest answer time, twice, as the manual asks ("approx. twice as long as the maximum response
time"), plus what the adapter and a busy computer add.

The length of an answer is known for a described code only as its usual length, and not at all for
another. So the whole answer gets the longest its format allows plus the usual one: where the length
is fixed (C0150) that is twice its time on the wire.

Costs are needed for every exchange, so they are cached by timing, family, code and form. The pause
before a telegram (turnaround) is kept by the sender and is not a part of a cost.

Source: EDB2102EN 3.5, 8.3.5.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Final

from lecombus.drives import family as family_of
from lecombus.drives import stop_steps
from lecombus.drives.code_info import CodeInfo
from lecombus.drives.family import Family
from lecombus.drives.measured import LATENESS_S
from lecombus.fieldbus.costs import Cost, LineTiming
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.protocol.telegrams import (
    ACK_CHARS,
    answer_chars,
    read_request_chars,
    write_request_chars,
)
from lecombus.parameters import HIGHEST_VALUE_CHARS, AddressForm, Code, Format, Value
from lecombus.roster import DriveEntry

__all__ = ["RosterCosts", "read_cost", "write_cost"]

GAP_CHARS: Final = 4
"""Characters' worth of silence inside an answer that a drive is granted."""

USUAL_UNKNOWN_CHARS: Final = 9
"""Value length assumed without a description: that of the manual's tables (EDB2102EN 3.5)."""

LONGEST_CHARS: Final = {Format.VD: 12, Format.VH: 9, Format.VS: 40}
"""Longest value of a described code by format: `-214748.3648`, `H` and 8 digits, and for strings
twice the 20 characters that the manuals print at most; octets may have 240."""

CACHE: Final = 8192


def read_cost(
    timing: LineTiming,
    family: Family,
    code: Code,
    form: AddressForm,
    answer_time_s: float | None = None,
) -> Cost:
    """Cost a read.

    Args:
        timing: The line.
        family: The drive's family.
        code: The code read.
        form: The addressing form used.
        answer_time_s: The roster's word on how long this drive thinks, seconds; None leaves it to
            the family.
    """
    return _read_cost(timing, family, code, form, answer_time_s)


def write_cost(
    timing: LineTiming,
    family: Family,
    code: Code,
    value: Value,
    form: AddressForm,
    answer_time_s: float | None = None,
) -> Cost:
    """Cost a write with its acknowledgement; arguments as for `read_cost`."""
    return _write_cost(timing, family, code, len(value.raw), form, answer_time_s)


@lru_cache(maxsize=CACHE)
def _read_cost(
    timing: LineTiming, family: Family, code: Code, form: AddressForm, answer_time_s: float | None
) -> Cost:
    usual, longest = _value_chars(family.info(code))
    return _cost(
        timing,
        request_chars=read_request_chars(form),
        answer=(answer_chars(form, usual), answer_chars(form, longest)),
        think=_think(family, code, answer_time_s, write=False),
    )


@lru_cache(maxsize=CACHE)
def _write_cost(
    timing: LineTiming,
    family: Family,
    code: Code,
    value_chars: int,
    form: AddressForm,
    answer_time_s: float | None,
) -> Cost:
    return _cost(
        timing,
        request_chars=write_request_chars(form, value_chars),
        answer=(ACK_CHARS, ACK_CHARS),
        think=_think(family, code, answer_time_s, write=True),
    )


def _cost(
    timing: LineTiming, *, request_chars: int, answer: tuple[int, int], think: tuple[float, float]
) -> Cost:
    """Put a cost together from answer lengths (usual, longest) and times (usual, patience)."""
    char_s = timing.char_s
    request_s = request_chars * char_s
    late_s = timing.adapter_latency_s + LATENESS_S
    first_byte_s = request_s + think[1] + late_s
    whole_s = first_byte_s + (answer[0] + answer[1]) * char_s
    return Cost(
        expected_s=request_s + think[0] + answer[0] * char_s,
        first_byte_s=first_byte_s,
        whole_s=whole_s,
        gap_s=GAP_CHARS * char_s + late_s,
        worst_s=whole_s + timing.quarantine_s,
        request_s=request_s,
    )


def _think(
    family: Family, code: Code, answer_time_s: float | None, *, write: bool
) -> tuple[float, float]:
    """Return the usual thinking time, and how long to wait for the answer to begin."""
    usual_s = family.answer_time_s(code, write=write)
    if answer_time_s is not None:
        own = code.number in family.answer_times
        usual_s = max(usual_s, answer_time_s) if own else answer_time_s
    return usual_s, family.patience_s(code, write=write, answer_time_s=answer_time_s)


def _value_chars(info: CodeInfo | None) -> tuple[int, int]:
    """Return the usual and the longest length of a code's value."""
    if info is None:
        return USUAL_UNKNOWN_CHARS, HIGHEST_VALUE_CHARS
    if info.hex_digits is not None:
        return info.chars, info.chars
    return info.chars, LONGEST_CHARS.get(info.format, HIGHEST_VALUE_CHARS)


class RosterCosts:
    """What exchanges with the drives of a roster cost, in each addressing form."""

    def reads(self, timing: LineTiming, drive: DriveEntry, code: Code) -> Sequence[Cost]:
        """Return the cost in each form; the longer one is used while a late answer may come."""
        of = family_of(drive.family)
        answer_s = _answer_s(of, drive, code, write=False)
        return [read_cost(timing, of, code, form, answer_s) for form in _forms(drive, code)]

    def write(self, timing: LineTiming, drive: DriveEntry, code: Code, value: Value) -> Cost:
        """Return the cost in the first form that carries the code."""
        of = family_of(drive.family)
        answer_s = _answer_s(of, drive, code, write=True)
        return write_cost(timing, of, code, value, _forms(drive, code)[0], answer_s)

    def stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Sequence[Cost]:
        """Return the cost of its writes and proofs; one may be a read of the drive's address."""
        return list(self._stop_attempts(timing, drive))

    def _stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Iterator[Cost]:
        of = family_of(drive.family)
        for action in of.stops:
            for code, value in [*stop_steps(of, action), (address_code(of), None)]:
                answer_s = _answer_s(of, drive, code, write=value is not None)
                for form in drive.forms:
                    if not form.carries(code):
                        continue
                    if value is None:
                        yield read_cost(timing, of, code, form, answer_s)
                    else:
                        yield write_cost(timing, of, code, value, form, answer_s)


def _forms(drive: DriveEntry, code: Code) -> Sequence[AddressForm]:
    return [form for form in drive.forms if form.carries(code)] or [Form.EXTENDED]


def _answer_s(of: Family, drive: DriveEntry, code: Code, *, write: bool) -> float | None:
    return drive.slow.time_s(of, code, write=write, answer_time_s=drive.answer_time_s)
