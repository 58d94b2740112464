"""What drives say, and the bytes on their way to the host.

Strategy: an answer is one `Speech`; its bytes lie in a heap by the time they arrive. Whether an EOT
cut a speech off, or the host spoke over it, is looked at when a byte is due, because both may
happen after the bytes were put on their way.

Must not live here: who speaks when.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush

from lecombus.simulator.drive import SimDrive
from lecombus.simulator.spoiling import Spoiler

__all__ = ["Outbox", "Speech"]


@dataclass(slots=True, eq=False)
class Speech:
    """What one drive says once.

    Attributes:
        begin_s: When its first character starts on the wire.
        held_up_s: How long an adapter holds it back.
        stubborn: An EOT does not stop it.
        cut_at_s: When an EOT stopped it, if one did.
        garbled_from_s: When the host began to speak over it, if it did.
    """

    drive: SimDrive
    data: bytes
    begin_s: float
    held_up_s: float
    stubborn: bool
    cut_at_s: float | None = None
    garbled_from_s: float | None = None

    def end_s(self, char_s: float) -> float:
        """When its last character leaves the wire."""
        return self.begin_s + len(self.data) * char_s


class Outbox:
    """Bytes on their way to the host, by time of arrival.

    Args:
        spoiler: Garbles what the host spoke over.
    """

    def __init__(self, spoiler: Spoiler) -> None:
        self._spoiler = spoiler
        self._heap: list[tuple[float, int, bytes, Speech | None]] = []
        self._count = 0

    def put(self, at_s: float, data: bytes, speech: Speech | None) -> None:
        """Let bytes arrive at a time; without a speech they are the host's own echo."""
        self._count += 1
        heappush(self._heap, (at_s, self._count, data, speech))

    def next_s(self) -> float | None:
        """When the next bytes are due."""
        return self._heap[0][0] if self._heap else None

    def take(self, now_s: float) -> bytes:
        """Give what has arrived by now."""
        heap = self._heap
        arrived = []
        while heap and heap[0][0] <= now_s:
            at_s, _, data, speech = heappop(heap)
            arrived.append(data if speech is None else self._as_heard(data, speech, at_s))
        return b"".join(arrived)

    def clear(self) -> None:
        """Forget everything."""
        self._heap.clear()

    def _as_heard(self, data: bytes, speech: Speech, at_s: float) -> bytes:
        wire_s = at_s - speech.held_up_s
        if speech.cut_at_s is not None and wire_s > speech.cut_at_s:
            return b""
        if speech.garbled_from_s is not None and wire_s > speech.garbled_from_s:
            return self._spoiler.garbled(data)
        return data
