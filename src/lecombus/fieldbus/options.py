"""How one line is worked: the roster's word on pauses, echo and patience, in seconds."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["WorkerOptions"]


@dataclass(frozen=True, slots=True)
class WorkerOptions:
    """How one line is worked.

    Args:
        turnaround_s: Least pause between the end of an answer and the next telegram, seconds.
        late_answer_s: How late an answer may still come after it was given up, seconds.
        stall_s: Silence from all drives after which the port is reopened, seconds; 0: never.
        echo: Whether the line echoes; None: find out.
        quarantine: Keep silence after a failed exchange. False only to show what it is good for.
    """

    turnaround_s: float = 0.002
    late_answer_s: float = 0.5
    stall_s: float = 30.0
    echo: bool | None = None
    quarantine: bool = True
