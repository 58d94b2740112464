"""One telegram for several drives: whether there is one that all of them understand.

Whether a group is spoken to by multicast at all is the roster's: its members are exactly the drives
of one decade or all of them (`config`). Here stands what a multicast needs besides: an addressing
form that every member knows.

What must not live here: what is written, and what comes of it.
"""

from __future__ import annotations

from collections.abc import Sequence

from lecombus.line.jobs import MulticastJob
from lecombus.line.station import Station, Step
from lecombus.protocol.addressing import Code, Form
from lecombus.schedule import Request

__all__ = ["said_by", "shared_form"]


def shared_form(stations: Sequence[Station], code: Code) -> Form | None:
    """The form in which one telegram says a code to all: the first that every member knows.

    A drive whose code bank is set is spoken to in extended addressing only: a multicast in the
    other would write another code of it.
    """
    known = (form for form in stations[0].forms if code.knows(form))
    return next((form for form in known if all(form in one.forms for one in stations)), None)


def said_by(request: Request) -> Step:
    """The telegram of a multicast."""
    job = request.work
    assert isinstance(job, MulticastJob)
    return job.step
