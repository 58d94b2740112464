"""The requests that lecombus makes to drives; their stations are made in `drive_changes`.

Here roster, descriptions and cost model meet: every request is given its cost
and its worst case here, so that the schedule, the time-outs and the plan use the same
numbers. What a read costs is kept, for the same few are made for years, until the station is
another one or its measured times are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final, NamedTuple

from lecombus.drives import Family, StopAction, stop_steps
from lecombus.drives.measured import SlowAnswers
from lecombus.drives.stops import STOP_PATIENCE_S, asks_to_stop, stops_every_drive
from lecombus.drives.verbs import may_move
from lecombus.errors import OperationError
from lecombus.fieldbus.costs import Cost, LineTiming
from lecombus.fieldbus.lecom.address_codes import address_code
from lecombus.fieldbus.lecom.exchanges.jobs import MulticastJob, ReadBackJob, ReadJob, WriteJob
from lecombus.fieldbus.lecom.exchanges.late_answers import Duplicates
from lecombus.fieldbus.lecom.exchanges.read_back_proof import WrittenValue
from lecombus.fieldbus.lecom.exchanges.stop_job import LongestTimes, StopJob
from lecombus.fieldbus.lecom.protocol.telegrams import ACK_CHARS, write_request_chars
from lecombus.fieldbus.lecom.telegram_costs import read_cost, write_cost
from lecombus.fieldbus.requests import Station
from lecombus.parameters import AddressForm, Code, Format, Value
from lecombus.schedule import Outcome, Priority, Request, Settle, ignore_end
from lecombus.schedule.fan_out import Part

__all__ = ["LecomRequestMaker"]


MAX_KEPT: Final = 8192
"""Costs of reads kept: a line has at most 90 drives with some ten codes each."""


class _ReadCost(NamedTuple):
    """What a read costs, by the measured times it was reckoned with."""

    slow: SlowAnswers
    cost: Cost
    line_s: float
    worst_s: float
    documented: tuple[float, float] | None


class _FeedCost(NamedTuple):
    """Cost and longest time of a feed, as measured and as documented, seconds; see `_ReadCost`."""

    slow: SlowAnswers
    measured: tuple[float, float]
    documented: tuple[float, float]


@dataclass(frozen=True, slots=True)
class LecomRequestMaker:
    """Makes requests with their costs.

    Args:
        timing: Baud rate and latencies of the line.
        retries: How often a failed attempt is repeated.
        count: Called at the end of every request.
        duplicates: What is known of answers that come twice on this line.
    """

    timing: LineTiming
    retries: int
    count: Callable[[Priority, Outcome], None]
    duplicates: Duplicates | None = None
    _costs: dict[tuple[Station, Code], _ReadCost] = field(default_factory=dict, init=False)
    _feed_costs: dict[Station, _FeedCost] = field(default_factory=dict, init=False)
    _unheeded: dict[Priority, Settle] = field(default_factory=dict, init=False)

    def _counted(self, priority: Priority, settle: Settle) -> Settle:
        """Count the end of a request, then call its waiter; most requests have none."""
        count = self.count
        if settle is ignore_end:
            if priority not in self._unheeded:
                self._unheeded[priority] = lambda outcome, reason: count(priority, outcome)
            return self._unheeded[priority]

        def end(outcome: Outcome, reason: str) -> None:
            count(priority, outcome)
            settle(outcome, reason)

        return end

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
        """Make a request that reads one code."""
        cost = self._read_cost(station, code)
        job = ReadJob(station, code, self.retries if retries is None else retries, instead)
        return Request(
            station.name,
            priority,
            cost.line_s,
            cost.worst_s,
            self._counted(priority, settle),
            job,
            expires_at_s=expires_at_s,
            documented=cost.documented,
        )

    def _documented(self, documented: Cost, measured: Cost) -> tuple[float, float] | None:
        """Give cost and longest time by manual and roster, where others were measured."""
        pause_s = self.timing.turnaround_s
        return (
            None
            if documented == measured
            else (documented.expected_s + pause_s, documented.worst_s + pause_s)
        )

    def feed(self, station: Station, instead: tuple[Code, ...]) -> Request:
        """Make the read that feeds a watchdog, reckoned with in the longest form it may be said in.

        Behind a lost answer it is said in the other form, and must be in time then, too. Where late
        answers may still come in all forms of all codes of `instead`, others of the drive feed it.
        """
        code = station.family.feed_code
        instead = (*instead, *_further_codes(station.family, instead))
        request = self.read(station, code, Priority.WATCHDOG, retries=0, instead=instead)
        kept, slow = self._feed_costs.get(station), station.measured.slow
        if kept is None or kept.slow is not slow:
            if len(self._feed_costs) >= MAX_KEPT:
                self._feed_costs.clear()
            kept = self._feed_costs[station] = _FeedCost(
                slow,
                self._dearest(station, code, station.answer_s(code)),
                self._dearest(station, code, station.answer_time_s),
            )
        request.cost_s, request.worst_s = kept.measured
        if request.documented is not None:
            request.documented = kept.documented
        return request

    def _dearest(self, station: Station, code: Code, answer_s: float | None) -> tuple[float, float]:
        """Return cost and longest time of a read, in any addressing form."""
        pause_s = self.timing.turnaround_s
        costs = [
            read_cost(self.timing, station.family, code, form, answer_s)
            for form in station.forms
            if form.carries(code)
        ]
        usual_s = max(cost.expected_s for cost in costs) + pause_s
        return usual_s, max(cost.worst_s for cost in costs) + pause_s

    def cost_of_read_s(self, station: Station, code: Code) -> float:
        """Give the line time of a read that is answered, seconds."""
        return self._read_cost(station, code).cost.expected_s

    def _read_cost(self, station: Station, code: Code) -> _ReadCost:
        kept = self._costs.get((station, code))
        slow = station.measured.slow
        if kept is None or kept.slow is not slow:
            if len(self._costs) >= MAX_KEPT:
                self._costs.clear()
            form, pause_s = form_of(station, code), self.timing.turnaround_s
            cost = read_cost(self.timing, station.family, code, form, station.answer_s(code))
            documented = read_cost(self.timing, station.family, code, form, station.answer_time_s)
            kept = _ReadCost(
                slow, cost, cost.expected_s + pause_s, cost.worst_s + pause_s,
                self._documented(documented, cost),
            )  # fmt: skip
            self._costs[station, code] = kept
        return kept

    def part_of_write(self, station: Station, code: Code, value: Value) -> Part:
        """Give what a write that is read back takes of the line.

        A drive with shortened response time acknowledges without delay and gets a pause after it.
        """
        cost = write_cost(
            self.timing, station.family, code, value, form_of(station, code),
            station.answer_s(code, write=True),
        )  # fmt: skip
        said_s = cost.expected_s
        if station.answers_early:
            said_s = cost.request_s + ACK_CHARS * self.timing.char_s
        turnaround_s = self.timing.turnaround_s
        prove_s = self.cost_of_read_s(station, code) + turnaround_s
        return Part(said_s + turnaround_s, station.hold_s, prove_s)

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
        """Make a request that writes one code.

        What moves the drive runs in the control class, also against `urgency`; a later setpoint
        for the same code replaces one that still waits. A stop ends any write.
        """
        form, answer_s = form_of(station, code), station.answer_s(code, write=True)
        cost = write_cost(self.timing, station.family, code, value, form, answer_s)
        documented = write_cost(
            self.timing, station.family, code, value, form, station.answer_time_s
        )
        info = station.family.info(code)
        write_class = station.family.write_class(code, value)
        job = WriteJob(
            station, code, value, write_class=write_class, retries=self.retries, verify=verify,
            duplicates=self.duplicates,
        )  # fmt: skip
        # Read back in either form: after another drive's proof it is the longer one.
        back_s = self._dearest(station, code, station.answer_s(code))[1] if verify else 0.0
        motion = info is not None and info.motion
        setpoint = motion and value.format == "VD" and not is_switch(station, code)
        priority = Priority.CONTROL if motion else urgency or Priority.INTERACTIVE
        return Request(
            station.name,
            priority,
            cost.expected_s + self.timing.turnaround_s,
            max(cost.worst_s + self.timing.turnaround_s, back_s),
            self._counted(priority, settle),
            job,
            expires_at_s=expires_at_s,
            supersedes=(station.name, code) if setpoint else None,
            writes=True,
            hold_s=station.hold_s,
            documented=self._documented(documented, cost),
            says=code,
            halts=asks_to_stop(station.family, code, value),
            lifts_nothing=stops_every_drive(station.family, code, value),
            may_move=may_move(station.family, code),
        )

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
        """Make a request that reads whether a code holds a value, and whose answer that is."""
        cost = self._read_cost(station, code)
        job = ReadBackJob(station, WrittenValue(code, value), self.retries, self.duplicates)
        return Request(
            station.name,
            priority,
            cost.line_s,
            cost.worst_s,
            self._counted(priority, settle),
            job,
            expires_at_s=expires_at_s,
            documented=cost.documented,
        )

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
        repeats: bool = False,
        silent: bool = False,
        offline: bool = False,
        may_inhibit: bool = True,
        patience_s: float = STOP_PATIENCE_S,
    ) -> Request:
        """Make a request that stops one drive and proves it."""
        times = self._longest_of_stop(station, action)
        job = StopJob(
            station, action, word=word, inhibited=inhibited, retries=self.retries, said=said,
            repeats=repeats, silent=silent, offline=offline, may_inhibit=may_inhibit,
            duplicates=self.duplicates, patience_s=patience_s, last_word=last_word, times=times,
        )  # fmt: skip
        usual = self._read_cost(station, station.family.stops[action].code)
        return Request(
            station.name,
            Priority.STOP,
            usual.line_s,
            times.any_s,
            self._counted(Priority.STOP, settle),
            job,
            stops=(station.name,),
            yields=repeats,
        )

    def _longest_of_stop(self, station: Station, action: StopAction) -> LongestTimes:
        """Return the longest that one telegram of a stop can hold the line, in any form."""
        of, written_s, read_s = station.family, 0.0, 0.0
        # A stop may take the drive's own address to be shown.
        for code, value in [*stop_steps(of, action), (address_code(of), None)]:
            answer_s = station.answer_s(code, write=value is not None)
            for form in station.forms:
                if not form.carries(code):
                    continue
                if value is None:
                    cost = read_cost(self.timing, of, code, form, answer_s)
                    read_s = max(read_s, cost.worst_s)
                else:
                    cost = write_cost(self.timing, of, code, value, form, answer_s)
                    written_s = max(written_s, cost.worst_s)
        pause_s = self.timing.turnaround_s
        return LongestTimes(max(written_s, read_s) + pause_s, read_s + pause_s)

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
        """Make a request that writes one code of all members with one telegram.

        The line waits for the slowest member to have done with it. A member with shortened
        response time is left alone instead, and others are spoken to meanwhile; but not after a
        stop, whose proofs leave nobody alone.
        """
        waiting = members
        if priority is not Priority.STOP:
            waiting = tuple(one for one in members if not one.answers_early)
        waited_for_s = max((thinks_s(one, code) for one in waiting), default=0.0)
        form = form_of(group, code)
        wire_s = write_request_chars(form, len(value.raw)) * self.timing.char_s
        whole_s = wire_s + waited_for_s + self.timing.adapter_latency_s
        job = MulticastJob(
            group, code, value, processing_s=waited_for_s,
            holds={one.name: one.hold_s for one in members if one.hold_s},
        )  # fmt: skip
        return Request(
            group.name,
            priority,
            whole_s,
            whole_s,
            self._counted(priority, settle),
            job,
            stops=stops,
            writes=not stops,
            members=tuple(one.name for one in members),
            hold_s=max((one.hold_s for one in members), default=0.0),
            expires_at_s=expires_at_s,
            says=code,
            halts=all(asks_to_stop(one.family, code, value) for one in members),
            lifts_nothing=all(stops_every_drive(one.family, code, value) for one in members),
            may_move=any(may_move(one.family, code) for one in members),
        )

    def shared_form(self, stations: Sequence[Station], code: Code) -> AddressForm | None:
        """The form of one telegram to several drives: the first that all of them know.

        A drive whose code bank is set is addressed in extended addressing only: a multicast in the
        other would write another code of it.
        """
        known = (form for form in stations[0].forms if form.carries(code))
        return next((form for form in known if all(form in one.forms for one in stations)), None)

    def probe(self, station: Station) -> Callable[[], Request]:
        """Give the maker of the read that asks an offline drive whether it is back.

        Its code and form are chosen so that a late answer to it blocks no other reads.
        """
        forms = tuple(reversed(station.forms))
        quiet = dataclasses.replace(station, forms=forms)
        polled = {code for code, _ in station.family.status}
        rare = [code for code in station.family.identity if code not in polled]
        code = rare[0] if rare else station.family.feed_code

        def make() -> Request:
            return self.read(quiet, code, Priority.CYCLIC, retries=0)

        return make


MOST_FURTHER: Final = 16
"""So many further codes feed a drive: each is two answers that can be told apart."""


@lru_cache(maxsize=64)
def _further_codes(of: Family, first: tuple[Code, ...]) -> tuple[Code, ...]:
    """Give codes that feed a drive where none of the first ones may be read, the shortest first.

    None is answered later than the slowest of those.
    """
    known_s = max(of.longest_answer_time_s(code, write=False) for code in (of.feed_code, *first))
    found = [
        (info.chars, code)
        for code, info in of.codes.items()
        if info.format in (Format.VH, Format.VD)
        and code not in (of.feed_code, *first)
        and not code.subcode
        and not info.secret
        and of.longest_answer_time_s(code, write=False) <= known_s
    ]
    return tuple(code for _, code in sorted(found)[:MOST_FURTHER])


def form_of(station: Station, code: Code) -> AddressForm:
    """The form a code is usually said in: the first of the station's that can carry it.

    Raises:
        OperationError: `no-such-code`: none can; it could never be sent.
    """
    for form in station.forms:
        if form.carries(code):
            return form
    raise OperationError(
        f"{station.name}: {station.family.spoken(code)} cannot be asked for in standard addressing",
        kind="no-such-code",
        drive=station.name,
        code=str(code),
        remedy="standard addressing carries C0000 to C6229 without subcodes; write "
        "`addressing: both` for this drive if it knows extended addressing",
    )


def thinks_s(station: Station, code: Code) -> float:
    """How long a drive may take over a write without acknowledgement, seconds."""
    longest_s = station.family.longest_answer_time_s(code, write=True)
    return max(longest_s, station.answer_s(code, write=True) or 0.0)


def is_switch(station: Station, code: Code) -> bool:
    """Whether a code switches rather than sets, such as C0040: every write of it counts."""
    return any(rule.code == code for rule in station.family.stops.values())
