"""Why a write was not done: the stable word of the API for it, and what to do then."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from lecombus.errors import CutReplyError, NakError
from lecombus.operations.reports import WriteReport
from lecombus.operations.requests import Ending, is_line_lost
from lecombus.parameters import Code
from lecombus.schedule import Outcome
from lecombus.schedule.request import CLIENT_GONE, STOPPED

__all__ = ["CUT_REMEDY", "REMEDIES", "STOPPED_REMEDY", "kind_of", "stopped_first"]

REMEDIES: Final[Mapping[str, str]] = {
    "nak": "check that the code may be written now: inhibited, in range, the control source set "
    "to LECOM",
    "no-answer": "check the drive's supply and the wires, then read the code to see what it holds",
    "not-in-effect": "the drive took the telegram but not the value: look at what it reads",
    "line-lost": "the port is being reopened; ask again when the line is open",
    "expired": "allow more time, or ask less of the line",
}
STOPPED_REMEDY: Final = "ask for it again if it is still wanted: a stop ends all that waits"
OTHER_RUN_REMEDY: Final = "look at the drive, then begin again"
CUT_REMEDY = "the port is being reopened; read the code then to see what it holds"
"""The write may have happened, so repeating it without a look is no remedy."""


def stopped_first(drive: str, code: Code, why: str = STOPPED) -> WriteReport:
    """The report of a write that was not sent yet when its drive was stopped."""
    return WriteReport(
        drive, code, Outcome.SUPERSEDED, f"{why}: nothing was sent", kind="superseded",
        remedy=STOPPED_REMEDY if why == STOPPED else OTHER_RUN_REMEDY,
    )  # fmt: skip


def kind_of(ending: Ending, outcome: Outcome, reason: str) -> str:
    """Return the stable word for why a write was not done."""
    if outcome in (Outcome.EXPIRED, Outcome.SUPERSEDED):
        return outcome.value
    if reason == CLIENT_GONE:
        return "client-gone"
    error = ending.error
    if error is None and is_line_lost(reason):
        return "line-lost"
    if error is None:
        return "not-in-effect" if ending.was_sent else "offline"
    if isinstance(error, NakError):
        return "nak"
    return "line-lost" if isinstance(error, CutReplyError) else "no-answer"
