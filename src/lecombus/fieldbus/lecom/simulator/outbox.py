"""What drives say, and the bytes on their way to the host.

Strategy: an answer is one `Speech`; its bytes travel as one run, which lies in a heap by the time
its next byte arrives. Runs that overlap come through byte by byte, in the order of arrival. Whether
an EOT cut a speech off, or the host spoke over it, is looked at when a byte is due, because both
may happen after the bytes were put on their way.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush

from .drive import SimDrive
from .faults import Spoiler
from .receiver import ReceivedRequest

__all__ = ["Outbox", "Speech"]


@dataclass(slots=True, eq=False)
class Speech:
    """What one drive says once.

    Attributes:
        begin_s: When its first character starts on the wire.
        held_up_s: How long an adapter holds it back.
        stubborn: An EOT does not stop it.
        own_chars: How many of its characters are the drive's, before any damage.
        cut_at_s: When an EOT stopped it, if one did.
        garbled_from_s: When the host began to speak over it, if it did.
        heard: A write that the drive processes and has not taken yet; there is no data then.
    """

    drive: SimDrive
    data: bytes
    begin_s: float
    held_up_s: float
    stubborn: bool
    own_chars: int
    cut_at_s: float | None = None
    garbled_from_s: float | None = None
    heard: ReceivedRequest | None = None

    def end_s(self, char_s: float) -> float:
        """When its last character leaves the wire; none does after an EOT has stopped it."""
        end_s = self.begin_s + len(self.data) * char_s
        return end_s if self.cut_at_s is None else min(end_s, self.cut_at_s)


@dataclass(slots=True, eq=False)
class _Run:
    """Bytes one behind the other: byte n arrives at `base_s + (n + 1) * char_s`."""

    base_s: float
    char_s: float
    data: bytes
    speech: Speech | None
    taken: int = 0

    def at_s(self, place: int) -> float:
        return self.base_s + (place + 1) * self.char_s


class Outbox:
    """Bytes on their way to the host, by time of arrival.

    Args:
        spoiler: Garbles what the host spoke over.

    Attributes:
        runs: What is on its way, by when its next bytes are due; to be looked at alone.
    """

    def __init__(self, spoiler: Spoiler) -> None:
        self._spoiler = spoiler
        self.runs: list[tuple[float, int, _Run]] = []
        self._count = 0

    def put(self, base_s: float, data: bytes, speech: Speech | None, char_s: float = 0.0) -> None:
        """Let bytes begin to arrive.

        Args:
            base_s: When the first one starts.
            data: The bytes.
            speech: What they are part of; without one they are the host's own echo.
            char_s: How long each takes; 0: all are there immediately.
        """
        self._count += 1
        run = _Run(base_s, char_s, data, speech)
        heappush(self.runs, (run.at_s(0), self._count, run))

    def take(self, now_s: float) -> bytes:
        """Give what has arrived by now."""
        heap = self.runs
        if len(heap) == 1:  # nearly always: nothing comes between its bytes
            return self._take_alone(now_s)
        arrived = b""
        while heap and heap[0][0] <= now_s:
            _, count, run = heappop(heap)
            begin = run.taken
            end = self._end(run, count, now_s)
            arrived += self._as_heard(run, begin, end)
            if end < len(run.data):
                run.taken = end
                heappush(heap, (run.at_s(end), count, run))
        return arrived

    def _take_alone(self, now_s: float) -> bytes:
        """Give what has arrived of the only run."""
        at_s, count, run = self.runs[0]
        if at_s > now_s:
            return b""
        base_s, char_s = run.base_s, run.char_s
        begin, size = run.taken, len(run.data)
        end = begin + 1
        if base_s + size * char_s <= now_s:
            end = size
        while end < size:
            at_s = base_s + (end + 1) * char_s
            if at_s > now_s:
                run.taken = end
                self.runs[0] = (at_s, count, run)
                return self._as_heard(run, begin, end)
            end += 1
        self.runs.clear()
        return self._as_heard(run, begin, end)

    def _end(self, run: _Run, count: int, now_s: float) -> int:
        """Return the end of what a run has due by now and before the next byte of another run."""
        others = self.runs[0][:2] if self.runs else None
        end, size = run.taken + 1, len(run.data)
        while end < size:
            at_s = run.at_s(end)
            if at_s > now_s or (others is not None and others < (at_s, count)):
                break
            end += 1
        return end

    def clear(self) -> None:
        """Forget everything."""
        self.runs.clear()

    def _as_heard(self, run: _Run, begin: int, end: int) -> bytes:
        speech = run.speech
        if speech is None or (speech.cut_at_s is None and speech.garbled_from_s is None):
            return run.data[begin:end]
        heard = b""
        for place in range(begin, end):
            wire_s = run.at_s(place) - speech.held_up_s
            if speech.cut_at_s is not None and wire_s > speech.cut_at_s:
                break
            byte = run.data[place : place + 1]
            if speech.garbled_from_s is not None and wire_s > speech.garbled_from_s:
                byte = self._spoiler.garbled(byte)
            heard += byte
        return heard
