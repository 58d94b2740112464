"""Reads of one drive, and of an address that the roster does not have."""

from __future__ import annotations

from lecombus.config.mistakes import one_of
from lecombus.drive_state.readings import Reading
from lecombus.errors import OperationError, RefusedError
from lecombus.operations.address_reads import Heard, check_address, read_address
from lecombus.operations.context import OperationContext
from lecombus.parameters import AddressForm, Code, ParameterRules
from lecombus.schedule import Priority

__all__ = ["READ_WITHIN_S", "Reads"]

READ_WITHIN_S = 10.0
"""A read that is not begun within this time is given up: its client has gone."""


class Reads:
    """Reads codes of the drives of one line."""

    def __init__(self, context: OperationContext) -> None:
        self._context = context

    async def read(
        self,
        drive: str,
        code: Code,
        *,
        priority: Priority = Priority.INTERACTIVE,
        timeout_s: float = READ_WITHIN_S,
    ) -> Reading:
        """Read a code from the drive now.

        Args:
            drive: The drive's name.
            code: What to read; any code may be.
            priority: The class to run in.
            timeout_s: Not begun after this long, seconds.

        Raises:
            OperationError: No such drive, or nothing was sent.
            ExchangeError: The drive did not answer, or refused.
            LineError: There is no line.
            QueueFullError: Too many requests wait.
        """
        station = self._context.station(drive)
        try:
            await self._context.requests.read(station, code, priority, timeout_s=timeout_s)
        except RefusedError as exc:
            self._context.diagnosis.explain_read(exc, station, code)
            raise
        reading = self._context.store.reading(drive, code)
        if reading is None:
            raise OperationError(
                f"the roster changed while {station.family.spoken(code)} of {drive} was read",
                kind="not-ready",
                drive=drive,
                code=str(code),
                remedy="ask again",
            )
        return reading

    async def read_address(
        self, address: int, code: Code, *, addressing: str, family_name: str, patient: bool
    ) -> Heard:
        """Read a code at an address that the roster does not have, once, when nothing else is due.

        Args:
            address: 1..99, not ending in 0.
            code: What to read.
            addressing: In this addressing form and no other.
            family_name: Whose answer times to wait by.
            patient: Wait longer than any description says.

        Raises:
            OperationError: No drive can have the address, the roster has it, or nothing was sent.
            LineError: There is no line.
            QueueFullError: Too many requests wait.
        """
        fieldbus = self._context.requests.worker.fieldbus
        form = form_of(fieldbus.rules, addressing)
        check_address(fieldbus, address, family_name, self._context.entries.values())
        return await read_address(
            self._context.requests,
            address,
            code,
            form=form,
            family_name=family_name,
            patient=patient,
            priority=Priority.BACKGROUND,
            disturbances=self._context.disturbances,
        )


def form_of(rules: ParameterRules, addressing: str) -> AddressForm:
    """Return the addressing form of a word.

    Raises:
        OperationError: `bad-request`: the protocol knows no such form.
    """
    if addressing not in rules.forms:
        known = one_of(rules.forms)
        raise OperationError(
            f"addressing takes {known}", kind="bad-request", remedy=f"give {known}"
        )
    return rules.forms[addressing]
