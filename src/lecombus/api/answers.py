"""Answers: JSON documents, and problem documents (RFC 9457) for every refusal and failure.

Strategy: every failure becomes one `ProblemDocument`, made in one of two ways: `problem_of` from an
error of lecombus' tree, `report_problem` from a write that ended in anything but `done` or
`verified`. The status follows from the problem's kind by one table, and the OpenAPI document
shows the same table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from email.utils import formatdate
from typing import Final

from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lecombus.api.decimal_json import encode, short
from lecombus.config import RosterError
from lecombus.errors import (
    CodeValueError,
    CutReplyError,
    ExchangeError,
    LecombusError,
    LineClosedError,
    LineError,
    NakError,
    NoReplyError,
    OperationError,
    QueueFullError,
    RefusedError,
    ScheduleError,
    UnknownCodeError,
)
from lecombus.operations.operation_reports import GroupReport, VerbReport, WriteReport
from lecombus.parameters import Json
from lecombus.schedule.request import Outcome

__all__ = [
    "JSON_TYPE",
    "PROBLEM_TYPE",
    "STATUS_BY_KIND",
    "ProblemDocument",
    "RefusedRequestError",
    "date_header",
    "dated",
    "json_response",
    "problem_of",
    "report_problem",
    "report_response",
    "roster_problem",
    "status_response",
    "text_response",
]

JSON_TYPE: Final = "application/json"
PROBLEM_TYPE: Final = "application/problem+json"

STATUS_BY_KIND: Final[Mapping[str, tuple[int, str]]] = {
    "bad-http": (400, "Not HTTP"),
    "bad-host": (400, "Not one host"),
    "doubled-header": (400, "A header stands twice"),
    "too-many-parameters": (400, "Too many query parameters"),
    "no-token": (401, "A token is needed"),
    "bad-token": (401, "Token not valid"),
    "client-gone": (408, "The client is gone"),
    "cross-site": (403, "Asked by another web page"),
    "read-only": (403, "Only reads are answered here"),
    "not-writable": (403, "Not writable"),
    "not-permitted": (403, "Not permitted"),
    "locked": (403, "Nothing but stops is written to this drive"),
    "lease-required": (403, "Control of this drive needs a lease"),
    "no-such-lease": (404, "No such lease"),
    "no-such-drive": (404, "No such drive"),
    "no-such-group": (404, "No such group"),
    "no-journal": (404, "No journal"),
    "no-such-address": (404, "No such address"),
    "no-such-code": (404, "No such code"),
    "no-such-path": (404, "No such path"),
    "wrong-method": (405, "Method not allowed"),
    "nak": (409, "Refused by the drive"),
    "refused": (409, "Refused"),
    "superseded": (409, "Superseded"),
    "not-in-effect": (409, "Written, but not in effect"),
    "in-roster": (409, "An address of the roster"),
    "starting": (409, "Drive not audited yet"),
    "lease-lost": (409, "The lease has ended"),
    "lease-held": (409, "Another lease holds the drive"),
    "stale-counter": (409, "Renewed with this counter before"),
    "latched": (409, "The drive must be enabled first"),
    "does-not-fit": (409, "Would make a watchdog feed late"),
    "no-stop": (409, "No such stop for this drive"),
    "no-verb": (409, "No such verb for this drive"),
    "setting": (409, "A setting of the drive stands against it"),
    "fault-active": (409, "The drive has a fault"),
    "busy": (409, "Another verb is under way"),
    "other-identity": (409, "Another drive than it should be"),
    "address-taken": (409, "Address in use"),
    "not-stopped": (409, "The drive is not stopped"),
    "no-control-word": (409, "Control word not known"),
    "roster-refused": (409, "Roster refused"),
    "no-roster": (409, "No roster file"),
    "too-big": (413, "Body too big"),
    "target-too-long": (414, "Path and query too long"),
    "foreign-host": (421, "Wrong host"),
    "too-many-writes": (429, "Stored parameter written too often"),
    "too-many-failures": (429, "Too many wrong tokens"),
    "too-many-refusals": (429, "Refused too often"),
    "head-too-big": (431, "Request head too big"),
    "bad-request": (422, "Request not understood"),
    "bad-value": (422, "Value cannot be sent"),
    "key-reused": (422, "Idempotency-Key used for another request"),
    "internal": (500, "Mistake in lecombus"),
    "garbled": (502, "Answer not usable"),
    "journal-failing": (503, "The journal cannot be written"),
    "line-lost": (503, "Line lost"),
    "line-closed": (503, "Line closed"),
    "queue-full": (503, "Queue full"),
    "too-many-readers": (503, "Too many readers of events"),
    "expired": (503, "Expired before it was sent"),
    "not-ready": (503, "Not ready"),
    "unhealthy": (503, "Not healthy"),
    "no-answer": (504, "No answer"),
    "offline": (504, "Drive offline"),
    "unknown": (504, "Outcome unknown"),
}
"""Kind of a problem: HTTP status and title. A kind not listed is a refusal, 409."""

RETRY_AFTER_S: Final[Mapping[str, int]] = {
    "line-lost": 1,
    "queue-full": 1,
    "not-ready": 1,
    "too-many-readers": 5,
}

KIND_BY_OUTCOME: Final[Mapping[Outcome, str]] = {
    Outcome.REFUSED: "refused",
    Outcome.EXPIRED: "expired",
    Outcome.SUPERSEDED: "superseded",
    Outcome.UNKNOWN: "unknown",
}


@dataclass(frozen=True, slots=True)
class ProblemDocument:
    """One problem document.

    Args:
        kind: A stable word for programs; the last part of `type`.
        detail: What happened, for people.
        drive: The drive concerned.
        code: The code concerned, as text.
        cause: The likely cause.
        remedy: What to do about it.
        outcome: For a write: its outcome.
        more: Further members, such as a group's.
        headers: HTTP headers besides the media type.
    """

    kind: str
    detail: str
    drive: str = ""
    code: str = ""
    cause: str = ""
    remedy: str = ""
    outcome: str = ""
    more: Mapping[str, Json] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def status(self) -> int:
        """The HTTP status."""
        return STATUS_BY_KIND.get(self.kind, (409, ""))[0]

    def as_json(self) -> dict[str, Json]:
        """Return the document; members without content are null, so that all are always there."""
        title = STATUS_BY_KIND.get(self.kind, (409, "Refused"))[1]
        return {
            "type": f"urn:lecombus:problem:{self.kind}",
            "title": title,
            "status": self.status,
            "detail": self.detail,
            "drive": self.drive or None,
            "code": self.code or None,
            "cause": self.cause or None,
            "remedy": self.remedy or None,
            "outcome": self.outcome or None,
            **self.more,
        }

    def shortened(self) -> ProblemDocument:
        """Return the same with its names cut short, for a client may send names of any length."""
        return replace(self, drive=short(self.drive), code=short(self.code))

    def response(self) -> Response:
        """Return the HTTP response."""
        headers = dict(self.headers)
        if self.kind in RETRY_AFTER_S:
            headers["Retry-After"] = str(RETRY_AFTER_S[self.kind])
        return Response(encode(self.as_json()), self.status, headers, PROBLEM_TYPE)


class RefusedRequestError(LecombusError):
    """A request that cannot be served; carries its problem document."""

    def __init__(self, problem: ProblemDocument) -> None:
        super().__init__(problem.detail)
        self.problem = problem


def problem_of(error: LecombusError, *, drive: str = "", code: str = "") -> ProblemDocument:
    """Return the problem document of an error.

    Args:
        error: What was raised.
        drive: The drive asked for, where the error does not name one.
        code: The code asked for, where the error does not name one.
    """
    if isinstance(error, RefusedRequestError):
        return error.problem
    if isinstance(error, OperationError):
        return ProblemDocument(
            error.kind,
            str(error),
            drive=error.drive or drive,
            code=error.code or code,
            remedy=error.remedy,
            headers=retry_headers(error.retry_after_s),
        )
    kind, cause, remedy = kind_of(error), "", ""
    if isinstance(error, ExchangeError):
        cause, remedy = error.cause, error.remedy
    remedy = remedy or REMEDIES.get(kind, "")
    return ProblemDocument(kind, str(error), drive=drive, code=code, cause=cause, remedy=remedy)


def retry_headers(after_s: float | None) -> dict[str, str]:
    """Return the header that says when to ask again, if there is such a time."""
    return {} if after_s is None else {"Retry-After": str(math.ceil(after_s))}


REMEDIES: Final[Mapping[str, str]] = {
    "no-answer": "check power, address, baud rate and wiring; `lecombus status` shows its state",
    "garbled": "check wiring, termination and shielding; other masters on the line",
    "line-lost": "the port is being reopened; ask again when `lecombus status` shows the line open",
    "line-closed": "the daemon is shutting down; ask again once it runs",
    "queue-full": "ask less often, or wait for answers before asking again",
    "expired": "allow more time, or ask for less at once",
}


def kind_of(error: LecombusError) -> str:
    """Return the kind of an error that does not carry one."""
    for cls, kind in KINDS:
        if isinstance(error, cls):
            return kind
    return "internal"


KINDS: Final[tuple[tuple[type[LecombusError], str], ...]] = (
    (CodeValueError, "bad-value"),
    (UnknownCodeError, "no-such-code"),
    (NakError, "nak"),
    (NoReplyError, "no-answer"),
    (CutReplyError, "line-lost"),
    (RefusedError, "refused"),
    (ExchangeError, "garbled"),
    (LineClosedError, "line-closed"),
    (LineError, "line-lost"),
    (QueueFullError, "queue-full"),
    (ScheduleError, "expired"),
)
"""The first that fits counts: subclasses stand before their parents."""


def report_response(
    report: WriteReport | VerbReport | GroupReport, ignored: Sequence[str] = ()
) -> Response:
    """Return the answer to a write, a verb, a group write or a stop.

    Args:
        report: How it ended.
        ignored: What of a stop's request was ignored.
    """
    problem = group_problem(report) if isinstance(report, GroupReport) else report_problem(report)
    more: dict[str, Json] = {"ignored": list(ignored)} if ignored else {}
    if problem is None:
        return json_response(report.as_json() | more)
    return replace(problem, more={**problem.more, **more}).response()


def report_problem(report: WriteReport | VerbReport) -> ProblemDocument | None:
    """Return the problem of a write or a verb that was not done, or None."""
    if report.outcome.is_good:
        return None
    kind = report.kind or KIND_BY_OUTCOME[report.outcome]
    if report.outcome is not Outcome.REFUSED:
        # Expired, superseded and unknown say what a client may conclude, whatever the reason was.
        kind = KIND_BY_OUTCOME[report.outcome]
    more: dict[str, Json] = {}
    if isinstance(report, VerbReport):
        code = report.written[-1][0] if report.written else None
        document = report.as_json()
        more = {key: document[key] for key in ("verb", "states", "written")}
    else:
        code = report.code
    return ProblemDocument(
        kind,
        report.reason or kind,
        drive=report.drive,
        code="" if code is None else str(code),
        cause=report.cause,
        remedy=report.remedy,
        outcome=report.outcome.value,
        more=more,
    )


def group_problem(report: GroupReport) -> ProblemDocument | None:
    """Return the problem of a group write or stop that was not done everywhere, or None.

    Its kind is that of the member with the highest status, so a lost answer outweighs a refusal.
    """
    problems = [problem for one in report.members if (problem := report_problem(one)) is not None]
    if not problems and report.outcome.is_good:
        return None
    sent = len(problems) < len(report.members) or any(one.kind != "client-gone" for one in problems)
    # What was done to a part of a group was done: `client-gone` says that nothing was sent.
    worst = max(problems, key=lambda one: (one.kind != "client-gone", one.status), default=None)
    if worst is not None and worst.kind == "client-gone" and sent:
        worst = replace(worst, kind="refused")
    kind = worst.kind if worst else KIND_BY_OUTCOME[report.outcome]
    failed = ", ".join(problem.drive for problem in problems)
    document = report.as_json()
    return ProblemDocument(
        kind,
        report.reason or f"{report.target}: not done by {failed}",
        cause=worst.cause if worst else "",
        remedy=worst.remedy if worst else "",
        outcome=report.outcome.value,
        more={key: document[key] for key in ("target", "how", "members")},
    )


def roster_problem(error: RosterError) -> ProblemDocument:
    """Return the problem of a roster that was refused, with every mistake in its place."""
    mistakes: list[Json] = [
        {
            "file": one.file,
            "line": one.line,
            "column": one.column,
            "what": one.what,
            "right": one.right,
        }
        for one in error.mistakes
    ]
    count = f"{len(mistakes)} mistakes" if len(mistakes) > 1 else "a mistake"
    return ProblemDocument(
        "roster-refused",
        f"{error.file} has {count}: {error.mistakes[0]}",
        remedy="correct the file and reload; until then the old roster is used",
        outcome="refused",
        more={"mistakes": mistakes},
    )


def status_response(kind: str, check: tuple[bool, str]) -> Response:
    """Return health or readiness."""
    good, detail = check
    if good:
        return json_response({"status": "ok", "detail": detail})
    return ProblemDocument(kind, detail).response()


def json_response(document: Json) -> Response:
    """Return a document."""
    return text_response(encode(document))


def text_response(text: str | bytes) -> Response:
    """Return JSON text; no cache may keep it, its age counts from now."""
    return Response(text, headers={"Cache-Control": "no-store"}, media_type=JSON_TYPE)


def date_header() -> tuple[bytes, bytes]:
    """Return the header that says when an answer was made: now."""
    return b"date", formatdate(usegmt=True).encode()


def dated(app: ASGIApp) -> ASGIApp:
    """Date each answer of an application with the moment at which it is made (RFC 9110, 6.6.1).

    An answer is made when the outcome is known, which may be seconds after its request came.
    """

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        async def send_dated(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [date_header(), *message.get("headers", ())]
            await send(message)

        await app(scope, receive, send_dated)

    return answer
