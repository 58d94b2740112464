"""All that is replaced before two records are compared, because it varies from run to run.

Nothing else may be left out of a record. Each row: what it is, a pattern, and what takes its place.
"""

from __future__ import annotations

import json
import re
from typing import Any

NORMAL: tuple[tuple[str, str, str], ...] = (
    ("the Date header", r"(?m)^(date: ).*$", r"\1DATE"),
    ("a time of day in a document", r'"\d{4}-\d\d-\d\dT[\d:.]+Z"', '"TIME"'),
    ("a time of day as text", r"\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z", "TIME"),
    ("the age of a value, seconds", r'("(?:\w+_)?age_s": )[\d.]+', r"\1AGE"),
    ("the age of a value in words", r"\b\d+(?:\.\d+)? s ago", "AGE ago"),
    ("a run of the daemon, where stops are counted", r'("stops": ")[0-9a-f]{8}-', r"\1RUN-"),
    ("the token of a lease", r'("token": ")[^"]+', r"\1TOKEN"),
    ("the number of a lease, which counts from the time of day", r'("number": )\d{13}\b', r"\1N"),
    ("the process that holds a lease", r'("pid": ")\d+', r"\1PID"),
    ("the time of a lease so far", r'("(?:expires_in|held)_s": )[\d.]+', r"\1TIME"),
    ("the number of exchanges so far", r"\d+ exchanges so far", "N exchanges so far"),
    ("the folder of the run", r"/tmp/lc-[^/ \"']+", "FOLDER"),
    ("the TCP port of the run", r"127\.0\.0\.1:\d{4,5}\b", "127.0.0.1:PORT"),
    ("what the process took", r"(?m)^((?:process|python)_\S*(?:\{.*\})?) \S+$", r"\1 N"),
    ("a metric that counts or measures", r"(?m)^(lecombus_\S*(?:_total|_count|_sum|"
     r"_bucket|_created|_seconds|_ratio)(?:\{.*\})?) \S+( # .*)?$", r"\1 N"),
)  # fmt: skip

_COMPILED = tuple((re.compile(pattern), text) for _, pattern, text in NORMAL)


def normal(text: str) -> str:
    """Return a text without what varies."""
    for pattern, instead in _COMPILED:
        text = pattern.sub(instead, text)
    return text


def normal_plan(body: str) -> str:
    """Return GET /v1/plan with the roster whole, and of what was measured only its kinds."""
    document = json.loads(body)
    parts = {key: part if key == "roster" else _kinds(part) for key, part in document.items()}
    return json.dumps(parts)


def _kinds(part: Any) -> Any:
    """Return the keys of a document and the kinds of its values, each kind of a list once."""
    if isinstance(part, dict):
        return {re.sub(r"^C\d{4}.*", "CODE", key): _kinds(one) for key, one in part.items()}
    if isinstance(part, list):
        return sorted({json.dumps(_kinds(one)) for one in part})
    if isinstance(part, str):
        return re.sub(r"^C\d{4}.*", "CODE", part)
    return "number" if isinstance(part, int | float) else part
