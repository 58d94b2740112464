"""How much one request may be: every bound that is looked at before anything is decoded.

The longest request that lecombus understands has a body of some hundred bytes and ten headers.
The bounds are many times that, and small enough that no request at its bounds takes the loop from
the line for longer than a millisecond or two.

What must not live here: where bytes are counted (`connection`, `checking`).
"""

from __future__ import annotations

from typing import Final

from lecombus.api.problems import Problem

__all__ = [
    "BODY_LIMIT",
    "BODY_TOO_BIG",
    "CHUNKED_LIMIT",
    "HEADERS_LIMIT",
    "HEAD_LIMIT",
    "HEAD_TOO_LONG",
    "NOT_HTTP",
    "PARAMETERS_LIMIT",
    "TARGET_BYTES",
    "TARGET_TOO_LONG",
    "TOO_MANY_HEADERS",
    "TOO_MANY_PARAMETERS",
]

HEAD_LIMIT: Final = 16 * 1024
HEADERS_LIMIT: Final = 64
TARGET_BYTES: Final = 2048
PARAMETERS_LIMIT: Final = 16
BODY_LIMIT: Final = 8 * 1024
"""JSON of this length takes two milliseconds at the worst, mistakes told."""

CHUNKED_LIMIT: Final = 2 * BODY_LIMIT
"""Bytes of a body as sent, with what its chunks add and what follows the last one."""

NOT_HTTP: Final = Problem(
    "bad-http",
    "what came on this connection is not a request in HTTP/1.1",
    remedy="use an HTTP client; requests before it were carried out",
)
HEAD_TOO_LONG: Final = Problem(
    "head-too-big",
    f"the head of the request is longer than {HEAD_LIMIT} bytes",
    remedy="send fewer and shorter headers",
)
TOO_MANY_HEADERS: Final = Problem(
    "head-too-big",
    f"the request has more than {HEADERS_LIMIT} headers",
    remedy="send fewer headers: lecombus reads Host, Content-Length and Idempotency-Key",
)
TARGET_TOO_LONG: Final = Problem(
    "target-too-long",
    f"path and query of the request are longer than {TARGET_BYTES} bytes",
    remedy="send a shorter path; what there is stands in /openapi.json",
)
TOO_MANY_PARAMETERS: Final = Problem(
    "too-many-parameters",
    f"the request has more than {PARAMETERS_LIMIT} query parameters",
    remedy="no path takes more than three; they stand in /openapi.json",
)
BODY_TOO_BIG: Final = Problem(
    "too-big",
    f"the body is longer than {BODY_LIMIT} bytes, or than {CHUNKED_LIMIT} with its chunks",
    remedy="a write is one value; send it alone",
    headers={"Connection": "close"},
)
