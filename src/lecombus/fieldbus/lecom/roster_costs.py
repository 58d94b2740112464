"""What LECOM exchanges with the drives of a roster cost, in each addressing form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lecombus.drives import Family, family, stop_steps
from lecombus.fieldbus.costs import Cost, LineTiming
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.lecom.costs import read_cost, write_cost
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import AddressForm, Code, Value
from lecombus.roster import DriveEntry

__all__ = ["RosterCosts"]


class RosterCosts:
    """See `ExchangeCosts`."""

    def reads(self, timing: LineTiming, drive: DriveEntry, code: Code) -> Sequence[Cost]:
        """Return the cost in each form; the longer one is used while an old answer may come."""
        of = family(drive.family)
        answer_s = _answer_s(of, drive, code, write=False)
        return [read_cost(timing, of, code, form, answer_s) for form in _forms(drive, code)]

    def write(self, timing: LineTiming, drive: DriveEntry, code: Code, value: Value) -> Cost:
        """Return the cost in the first form that carries the code."""
        of = family(drive.family)
        answer_s = _answer_s(of, drive, code, write=True)
        return write_cost(timing, of, code, value, _forms(drive, code)[0], answer_s)

    def stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Sequence[Cost]:
        """Return the cost of its writes and proofs; one may be a read of the drive's address."""
        return list(self._stop_attempts(timing, drive))

    def _stop_attempts(self, timing: LineTiming, drive: DriveEntry) -> Iterator[Cost]:
        of = family(drive.family)
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
