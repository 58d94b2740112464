"""Paths and bodies of requests, checked before they are sent: names, codes, values, durations."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from typing import Final, Literal
from urllib.parse import quote

from lecombus.client.connection import Json
from lecombus.client.errors import ProblemError

__all__ = [
    "ValueToWrite",
    "code_text",
    "exact",
    "expires_document",
    "lease_document",
    "path_of",
    "write_document",
]

ValueToWrite = int | float | Decimal | str
"""A number, or text as on the wire: `"35.4"`, `"H0008"`, `"O1A2B"`."""

LONGEST_NAME: Final = 64
"""Characters of a drive's or a group's name in a roster."""

LONGEST_EXPIRY_S: Final = 3600.0

CODE: Final = re.compile(r"([CP]?[0-9]{1,5})(?:/([0-9]{1,3}))?", re.ASCII | re.IGNORECASE)


def path_of(kind: Literal["drive", "group"], name: str) -> str:
    """Return the path of a drive or a group.

    Raises:
        ProblemError: No name is like this, and in a path it would mean something else.
    """
    if name in ("", ".", "..") or "/" in name or len(name) > LONGEST_NAME:
        shown = name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}..."
        remedy = f"`lecombus {'status' if kind == 'drive' else 'check'}` shows the {kind}s"
        raise ProblemError(404, f"there is no {kind} `{shown}`", remedy, f"no-such-{kind}")
    return f"/v1/{kind}s/{quote(name, safe='')}"


def code_text(code: str | int) -> str:
    """Return a code as it stands in a path.

    Raises:
        ValueError: It is none.
    """
    match = CODE.fullmatch(str(code))
    if match is None:
        raise ValueError(f"{code!r} is not a code, write it like C0150, 150 or C0039/1")
    return match[0].upper()


def write_document(
    value: ValueToWrite, verify: bool | None = None, expires_s: float | None = None
) -> dict[str, Json]:
    """Return the body of a write.

    Args:
        value: What to write.
        verify: Whether to read it back; None: as the daemon sees fit.
        expires_s: After so long it is not sent any more, seconds; None: the daemon's own limit.

    Raises:
        ValueError: The value or the duration is none.
    """
    document: dict[str, Json] = {"value": exact(value)}
    if verify is not None:
        document["verify"] = verify
    return document | expires_document(expires_s)


def exact(value: ValueToWrite) -> int | Decimal | str:
    """Return a value as it is sent: a float as the decimal that it is written as, such as 35.4.

    Raises:
        ValueError: It is not a value.
    """
    if isinstance(value, bool):
        raise ValueError(f"{value} is not a value of a drive, write 1 or 0")
    if isinstance(value, float):
        value = Decimal(repr(value))
    is_number = isinstance(value, int) or (isinstance(value, Decimal) and value.is_finite())
    if not is_number and not (isinstance(value, str) and value):
        raise ValueError(f"{value!r} is not a value of a drive, give a number or a text")
    return value


def lease_document(targets: Iterable[str], time_s: float, take_over: str) -> dict[str, Json]:
    """Return the body that asks for a lease.

    Raises:
        ValueError: The time is out of range.
    """
    if not 0.001 <= time_s <= LONGEST_EXPIRY_S:
        raise ValueError(f"time_s is {time_s:g}, 0.001 to {LONGEST_EXPIRY_S:g} is possible")
    document: dict[str, Json] = {
        "targets": list(targets), "time": f"{round(time_s * 1000)}ms", "counter": 1,
    }  # fmt: skip
    return document | ({"take_over": take_over} if take_over else {})


def expires_document(expires_s: float | None) -> dict[str, Json]:
    """Return the part of a body that says how long a request may wait.

    Raises:
        ValueError: It is out of range.
    """
    if expires_s is None:
        return {}
    if not 0.001 <= expires_s <= LONGEST_EXPIRY_S:
        raise ValueError(f"expires_s is {expires_s:g}, 0.001 to {LONGEST_EXPIRY_S:g} is possible")
    return {"expires": f"{round(expires_s * 1000)}ms"}
