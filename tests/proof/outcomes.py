"""Every request that the line took ends in exactly one outcome: counted where it is submitted.

The daemon's own assertion says so too; this counts without it, for every request that anybody
makes (clients, audits, probes of faults), by standing between each and whoever waits for it.
"""

from __future__ import annotations

from collections.abc import Callable

from lecombus.errors import LecombusError
from lecombus.line.worker import LineWorker
from lecombus.schedule import Outcome, Request
from lecombus.schedule.request import OUT

__all__ = ["Outcomes"]


class Outcomes:
    """Counts the outcomes of the requests of one line.

    Args:
        worker: The line.
        say: Told what did not hold.
        taken: Told of every request; gives who wants to know its outcome.
    """

    def __init__(
        self,
        worker: LineWorker,
        say: Callable[[str], None],
        taken: Callable[[Request], Callable[[Outcome], None] | None] = lambda _: None,
    ) -> None:
        self._say = say
        self._taken = taken
        self._submit = worker.submit
        self._open: dict[Request, None] = {}
        self.ended = 0
        worker.submit = self._take  # type: ignore[method-assign]

    def _take(self, request: Request) -> None:
        settle, ends = request.settle, 0
        wants_to_know = self._taken(request)

        def end(outcome: Outcome, reason: str) -> None:
            nonlocal ends
            ends += 1
            self.ended += 1
            self._open.pop(request, None)
            if ends > 1:
                self._say(f"a request to {request.drive} had a second outcome: {outcome}")
            elif wants_to_know is not None:
                wants_to_know(outcome)
            settle(outcome, reason)

        request.settle = end
        try:
            self._submit(request)
        except LecombusError:  # who is turned away here never was a request
            if wants_to_know is not None:
                wants_to_know(Outcome.REFUSED)
            raise
        if not ends:
            self._open[request] = None

    def end(self) -> None:
        """Look for requests that were forgotten: taken, without an outcome, and nowhere."""
        for request in self._open:
            if request.state == OUT:
                self._say(f"a request to {request.drive} was forgotten: it has no outcome")
