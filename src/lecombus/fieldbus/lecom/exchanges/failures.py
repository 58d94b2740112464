"""From the result of an exchange to the error a caller is given.

Valid but unwelcome answers (NAK, `?`, unknown code) are events in the protocol room; above it
they are errors that carry what was on the wire.
"""

from __future__ import annotations

from lecombus.errors import (
    ChecksumReportedError,
    CutReplyError,
    EchoError,
    ExchangeError,
    ExchangeRecord,
    GarbledReplyError,
    NakError,
    NoReplyError,
    UnexpectedReplyError,
    UnknownCodeError,
)
from lecombus.fieldbus.lecom.protocol.exchange import Result
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.station import JobStep, Station, StepKind

from ..protocol.telegrams import NakAnswer, TransmissionErrorAnswer, UnknownCodeAnswer

__all__ = ["error_of"]

_BY_ANSWER: dict[type, tuple[type[ExchangeError], str]] = {
    NakAnswer: (NakError, "the drive refused it (NAK)"),
    TransmissionErrorAnswer: (
        ChecksumReportedError,
        "the drive saw a transmission error in the request",
    ),
    UnknownCodeAnswer: (UnknownCodeError, "the drive has no such code"),
}

REFUSED_WRITE = "the drive refused the write (NAK): nothing was changed"
REFUSED_READ = "the drive refused the read (NAK)"

_BY_KIND: dict[ResultKind, type[ExchangeError]] = {
    ResultKind.NO_REPLY: NoReplyError,
    ResultKind.GARBLED: GarbledReplyError,
    ResultKind.ECHO: EchoError,
    ResultKind.LOST: CutReplyError,
}


def error_of(station: Station, step: JobStep, result: Result, attempt: int) -> ExchangeError:
    """Make the error for an exchange that did not give what was asked for.

    Args:
        station: The drive.
        step: What was sent.
        result: How it ended, anything but the wished-for answer.
        attempt: Which attempt it was, 1 upwards.
    """
    cls, text = _BY_ANSWER.get(type(result.answer), (UnexpectedReplyError, ""))
    if cls is NakError:
        text = REFUSED_READ if step.kind is StepKind.READ else REFUSED_WRITE
    if result.answer is None:
        cls, text = _BY_KIND[result.kind], result.fault
    record = ExchangeRecord(
        address=station.address,
        code=step.code.number,
        subcode=step.code.subcode,
        attempt=attempt,
        elapsed_s=result.ended_s - result.started_s,
        received=result.received,
    )
    code = station.family.spoken(step.code)
    where = f"{station.name} (address {station.address}), {code}"
    return cls(f"{where}: {text} (attempt {attempt})", record)
