"""Asking an address of which nothing is known: what a scan is made of.

Here silence is an answer, and "no such code" a good one: something is there. Nothing is repeated
and nothing is kept: the scan decides what an answer means. There is deliberately no way to
write to an address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from lecombus.config import DriveEntry
from lecombus.drives import family
from lecombus.errors import (
    ChecksumReportedError,
    CutReplyError,
    EchoError,
    ExchangeError,
    NakError,
    NoReplyError,
    OperationError,
    UnknownCodeError,
)
from lecombus.fieldbus.protocols import Fieldbus
from lecombus.fieldbus.requests import Station
from lecombus.operations.awaited_requests import Requests
from lecombus.parameters import AddressForm, Code, Value
from lecombus.schedule import Priority

__all__ = ["Heard", "HeardKind", "check_address", "read_address"]

PATIENT_ANSWER_TIME_S = 0.3
"""Waited for twice as long: more than an adapter has ever been seen to hold an answer up."""
ASKED_WITHIN_S = 30.0
"""A background read on a full line waits its turn."""


class HeardKind(StrEnum):
    """What came back."""

    VALUE = "value"
    NO_SUCH_CODE = "no-such-code"
    TRANSMISSION_ERROR = "transmission-error"
    """The drive saw a transmission error in the question (`?`): it is there."""
    REFUSED = "refused"
    """NAK: it is there, and does not carry out the question."""
    SILENCE = "silence"
    GARBLED = "garbled"
    ECHO = "echo"
    """What came back of our own telegram was not what was sent."""


_KINDS: tuple[tuple[type[ExchangeError], HeardKind], ...] = (
    (UnknownCodeError, HeardKind.NO_SUCH_CODE),
    (NakError, HeardKind.REFUSED),
    (ChecksumReportedError, HeardKind.TRANSMISSION_ERROR),
    (NoReplyError, HeardKind.SILENCE),
    (EchoError, HeardKind.ECHO),
    (ExchangeError, HeardKind.GARBLED),
)
"""The first that fits counts."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What came back from an address.

    Args:
        kind: What it was.
        value: The value, if it was one.
        received: Bytes that were not a usable answer, parity bits included; the first of them.
        disturbances: How often, ever, the line has carried something that was no answer to its
            question; more than before means that something was heard besides.
    """

    kind: HeardKind
    value: Value | None = None
    received: bytes = b""
    disturbances: int = 0

    @property
    def is_answer(self) -> bool:
        """Whether a drive answered, with a value or a refusal."""
        return self.kind in (
            HeardKind.VALUE,
            HeardKind.NO_SUCH_CODE,
            HeardKind.TRANSMISSION_ERROR,
            HeardKind.REFUSED,
        )

    @property
    def text(self) -> str:
        """The value as people read it; empty where there is none."""
        return "" if self.value is None else str(self.value.number)

    @property
    def exists(self) -> bool | None:
        """Whether the drive has the code; None where it did not say."""
        if self.kind is HeardKind.VALUE:
            return True
        return False if self.kind is HeardKind.NO_SUCH_CODE else None


def check_address(
    fieldbus: Fieldbus, address: int, family_name: str, entries: Iterable[DriveEntry]
) -> None:
    """See that an address may be asked: a drive can have it, and none of the roster does.

    Raises:
        OperationError: It may not.
    """
    if not fieldbus.is_address(address):
        raise OperationError(
            f"no drive has the address {address}",
            kind="no-such-address",
            remedy=f"it is {fieldbus.addresses}",
        )
    if family_name not in fieldbus.families:
        raise OperationError(
            f"there is no family {family_name}",
            kind="bad-request",
            remedy=f"known are: {', '.join(fieldbus.families)}",
        )
    for entry in entries:
        if entry.address == address:
            raise OperationError(
                f"the roster has address {address}: it is {entry.name}",
                kind="in-roster",
                drive=entry.name,
                remedy="read its codes by its name; a scan asks the other addresses",
            )


async def read_address(
    requests: Requests,
    address: int,
    code: Code,
    *,
    form: AddressForm,
    family_name: str,
    patient: bool,
    priority: Priority,
    disturbances: Callable[[], int],
) -> Heard:
    """Read a code at an address, once.

    Args:
        requests: Sends it.
        address: 1..99, not ending in 0.
        code: What to read.
        form: In this addressing form and no other.
        family_name: Whose answer times to wait by.
        patient: Wait longer than any description says.
        priority: The class to run in.
        disturbances: Counts what the line carries that is no answer to its question.

    Raises:
        OperationError: It was never sent, or cannot be.
        CutReplyError: The line was lost during the read.
        LineError: There is no line.
        QueueFullError: Too many wait.
    """
    answer_time_s = PATIENT_ANSWER_TIME_S if patient else None
    name = f"address {address}"
    station = Station(name, address, family(family_name), (form,), answer_time_s=answer_time_s)
    try:
        value = await requests.read(station, code, priority, timeout_s=ASKED_WITHIN_S, retries=0)
    except CutReplyError:
        raise
    except ExchangeError as exc:
        kind = next(kind for cls, kind in _KINDS if isinstance(exc, cls))
        return Heard(kind, None, exc.record.received, disturbances())
    return Heard(HeardKind.VALUE, value, disturbances=disturbances())
