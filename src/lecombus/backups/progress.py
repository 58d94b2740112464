"""How far a restore came, as lines of a file: what an interrupted one left behind.

Strategy: the first line says what is restored into which drive, every further line names a code
that was written and read back. Lines are only added, so that a restore that is killed in the
middle leaves whole lines and at most one torn one, which is ignored. What stands here is never
taken for the drive's word: a restore that goes on reads everything again. It is needed for what
the drive does not report: that values were written and not saved yet, and that it was enabled
before.

What must not live here: where the file is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lecombus.errors import CodeValueError
from lecombus.parameters import Code, Value

__all__ = ["Progress", "done_line", "head_line", "read_progress"]


@dataclass(frozen=True, slots=True)
class Progress:
    """What an unfinished restore left behind.

    Args:
        file: The backup that was being restored.
        digest: Its content's digest, to recognize an edited file.
        begun: When it began, RFC 3339.
        enabled: The drive was enabled when it began.
        done: What was written and read back.
    """

    file: str
    digest: str
    begun: str
    enabled: bool
    done: Mapping[Code, str] = field(default_factory=dict)


def head_line(progress: Progress) -> str:
    """Return the first line."""
    document = {
        "restore": progress.file, "digest": progress.digest, "begun": progress.begun,
        "enabled": progress.enabled,
    }  # fmt: skip
    return json.dumps(document) + "\n"


def done_line(code: Code, value: Value) -> str:
    """Return the line for a code that was written and read back."""
    return json.dumps({"code": str(code), "value": value.raw}) + "\n"


def read_progress(text: str) -> Progress | None:
    """Read what an unfinished restore left behind; None where nothing usable is."""
    documents = [one for line in text.splitlines() if (one := _document(line)) is not None]
    if not documents or "restore" not in documents[0]:
        return None
    head, *rest = documents
    done: dict[Code, str] = {}
    for one in rest:
        try:
            done[Code.parse(str(one.get("code")))] = Value.parse(str(one.get("value"))).raw
        except CodeValueError:
            continue
    return Progress(
        str(head["restore"]),
        str(head.get("digest")),
        str(head.get("begun")),
        head.get("enabled") is True,
        done,
    )


def _document(line: str) -> dict[str, Any] | None:
    """Read one line; a torn one is none."""
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None
