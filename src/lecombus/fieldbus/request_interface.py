"""What is asked of the line: requests with their costs, and what their jobs tell at the end.

The schedule carries a request without knowing what is in it; its `work` is a job of the protocol.
Those that wait for the end of a request read from the job what is defined here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from lecombus.drives import StopAction
from lecombus.drives.stops import STOP_PATIENCE_S
from lecombus.errors import ExchangeError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.station import JobStep, Station
from lecombus.parameters import AddressForm, Code, Value
from lecombus.schedule import Priority, Request, Settle, ignore_end
from lecombus.schedule.fan_out import Part

__all__ = ["MulticastWork", "ReadWork", "RequestMaker", "StopWork", "WriteWork"]


class ReadWork:
    """The job of a read.

    Attributes:
        value: What was read; None: it was not.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    value: Value | None
    error: ExchangeError | None
    attempts: int


class WriteWork:
    """The job of a write.

    Attributes:
        code: What is written.
        proof: What was read back; None: nothing was.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    code: Code
    proof: Value | None
    error: ExchangeError | None
    attempts: int


class StopWork:
    """The job of a stop.

    Attributes:
        station: Who is stopped.
        action: How, which may have become an inhibit.
        proof_code: What was read to show the stop.
        proof: What that read; None: nothing was read.
        error: What the last exchange failed with, if it did.
        attempts: How many exchanges were run.
    """

    __slots__ = ()

    station: Station
    action: StopAction
    proof_code: Code | None
    proof: Value | None
    error: ExchangeError | None
    attempts: int


class MulticastWork:
    """The job of a multicast.

    Attributes:
        step: What is sent.
        error: What the exchange failed with, if it did.
    """

    __slots__ = ()

    step: JobStep
    error: ExchangeError | None


class RequestMaker(Protocol):
    """Makes requests with their costs.

    `settle` is called with the outcome at the end, `expires_at_s` is the time from which on a
    request that was not begun expires (None: never), `retries` is how often a failed attempt is
    repeated (None: as the roster says).
    """

    @property
    def timing(self) -> LineTiming:
        """The times of the line."""

    def read(
        self,
        station: Station,
        code: Code,
        priority: Priority,
        *,
        settle: Settle = ignore_end,
        retries: int | None = None,
        instead: tuple[Code, ...] = (),
        expires_at_s: float | None = None,
    ) -> Request:
        """Make a request that reads one code (`ReadWork`), or one of `instead`."""

    def feed(self, station: Station, instead: tuple[Code, ...]) -> Request:
        """Make the read that feeds a watchdog."""

    def cost_of_read_s(self, station: Station, code: Code) -> float:
        """Give the line time of a read that is answered, seconds."""

    def part_of_write(self, station: Station, code: Code, value: Value) -> Part:
        """Give what a write that is read back takes of the line."""

    def write(
        self,
        station: Station,
        code: Code,
        value: Value,
        *,
        settle: Settle,
        verify: bool,
        expires_at_s: float | None = None,
        urgency: Priority | None = None,
    ) -> Request:
        """Make a request that writes one code (`WriteWork`) and reads it back if `verify`."""

    def read_back(
        self,
        station: Station,
        code: Code,
        value: Value,
        priority: Priority,
        *,
        settle: Settle,
        expires_at_s: float,
    ) -> Request:
        """Make a request that reads whether a code holds a value (`ReadWork`)."""

    def stop(
        self,
        station: Station,
        action: StopAction,
        *,
        word: Callable[[], int | None],
        inhibited: Callable[[], bool | None] = lambda: False,
        last_word: Callable[[], int | None] = lambda: None,
        said: bool,
        settle: Settle,
        silent: bool = False,
        offline: bool = False,
        may_inhibit: bool = True,
        patience_s: float = STOP_PATIENCE_S,
    ) -> Request:
        """Make a request that stops one drive and proves it (`StopWork`).

        Args:
            station: The drive.
            action: How it shall stop.
            word: Gives its control word, None when not known; asked when the stop is sent.
            inhibited: Says whether it is inhibited, None when not known; asked likewise.
            last_word: Gives its control word as it was known last.
            said: A multicast has said the stop already: begin with the proof.
            settle: See above.
            silent: The drive did not answer before.
            offline: It did not answer for so long that it was taken for absent.
            may_inhibit: A quick stop that cannot be had may become an inhibit.
            patience_s: How long it is tried, seconds.
        """

    def multicast(
        self,
        group: Station,
        members: tuple[Station, ...],
        code: Code,
        value: Value,
        priority: Priority,
        *,
        settle: Settle,
        stops: tuple[str, ...] = (),
        expires_at_s: float | None = None,
    ) -> Request:
        """Make a request that writes one code of all members with one telegram (`MulticastWork`).

        Args:
            group: The group's name and address, in the form that `shared_form` gave.
            members: The drives that it reaches.
            code: What to write.
            value: The value.
            priority: The class to run in.
            settle: See above.
            stops: The drives that it stops.
            expires_at_s: See above.
        """

    def shared_form(self, stations: Sequence[Station], code: Code) -> AddressForm | None:
        """Give the form of one telegram that all of several drives take; None: there is none."""

    def probe(self, station: Station) -> Callable[[], Request]:
        """Give the maker of the read that asks an offline drive whether it is back."""
