"""Leases against a model: many clients that take, renew, fall silent, take over; and restarts."""

from __future__ import annotations

from typing import Any

import hypothesis.strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from lecombus.errors import OperationError
from lecombus.leases import EndOfLease, HeldLease, LeaseBook, LeaseTerms, Use

DRIVES = ("a", "b", "c")
NAMES = ("one", "two", "three")
names = st.sampled_from(NAMES)
drives = st.lists(st.sampled_from(DRIVES), min_size=1, unique=True)
GRANULARITY_S = 0.01


class LeaseMachine(RuleBasedStateMachine):
    """Keeps by itself who holds what; the book must agree after each step.

    The timer of the watch comes up to `GRANULARITY_S` late; what was handed out by then was ended.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 100.0
        self.book = LeaseBook(0)
        self.holder: dict[str, HeldLease] = {}
        self.former: list[HeldLease] = []
        self.ends: dict[int, float] = {}
        self.numbers: list[int] = []
        self.latched: dict[str, bool] = {}
        self.lapsed: dict[int, int] = {}
        self.required: dict[str, bool] = {}

    @initialize(required=st.lists(st.booleans(), min_size=3, max_size=3))
    def begin(self, required: list[bool]) -> None:
        self.required = dict(zip(DRIVES, required, strict=True))
        self._start()

    def _start(self) -> None:
        terms = {one: LeaseTerms(self.required[one], 2.0, "quick-stop") for one in DRIVES}
        self.book.set_terms(terms, self.now_s)
        self.latched = dict(self.required)

    @rule()
    def restart(self) -> None:
        """No lease outlives the process; the last numbers may be lost, but a leap covers them."""
        self.now_s += 1.0
        saved = max(self.numbers[:-5], default=0)
        self.book = LeaseBook(max(saved + 10_000, int(1000 * self.now_s)))
        self.former += self.holder.values()
        self.holder = {}
        self._start()

    @rule(name=names, wanted=drives, time_s=st.floats(0.1, 2.0), over=st.none() | names)
    def take(self, name: str, wanted: list[str], time_s: float, over: str | None) -> None:
        now = self._held()
        by_name = {lease.name: lease for lease in now.values()}
        old = by_name.get(over or "")
        may = over is None or (old is not None and set(old.drives) <= set(wanted))
        may &= by_name.get(name) in (None, old)
        may &= all(now.get(one) in (None, old) for one in wanted)
        lease = self._try(
            self.book.take, name, wanted, wanted, time_s, 1, self.now_s,
            secret=f"{name}{self.now_s}", take_over=over or "",
        )  # fmt: skip
        assert (lease is not None) is may
        if lease is None:
            return
        assert all(lease.number > number for number in self.numbers)
        self.numbers.append(lease.number)
        if old is not None:
            self.former.append(old)
        for one in wanted:
            self.holder[one] = lease
        self.ends[lease.number] = self.now_s + time_s

    @rule(name=names, step=st.integers(-2, 3))
    def renew(self, name: str, step: int) -> None:
        lease = next((one for one in self.holder.values() if one.name == name), None)
        if lease is None:
            return
        alive, before = lease in self._held().values(), lease.counter
        renewed = self._try(self.book.renew, name, lease.token, before + step, self.now_s)
        assert (renewed is not None) is (alive and step > 0)
        if renewed is not None:
            self.ends[lease.number] = self.now_s + lease.time_s

    @rule(name=names)
    def release(self, name: str) -> None:
        lease = next((one for one in self._held().values() if one.name == name), None)
        if lease is None:
            return
        self.book.release(name, lease.token, self.now_s)
        for one in lease.drives:
            del self.holder[one]
            self.latched[one] |= self.required[one]
        self.former.append(lease)
        self.ends[lease.number] = self.now_s

    @rule(drive=st.sampled_from(DRIVES))
    def enable(self, drive: str) -> None:
        lease = self._held().get(drive)
        for former in self.former[-5:]:
            assert not self.book.enabled(drive, former.token, self.now_s)
        assert not self.book.enabled(drive, "", self.now_s)
        if lease is not None:
            assert self.book.enabled(drive, lease.token, self.now_s) is self.latched[drive]
            self.latched[drive] = False

    @rule(for_s=st.floats(0.0, 1.5), late_s=st.floats(0.0, GRANULARITY_S))
    def wait(self, for_s: float, late_s: float) -> None:
        """Time passes; the timer is woken for each end, a little late."""
        until_s = self.now_s + for_s
        while (next_s := self.book.next_s()) is not None and next_s <= until_s:
            self.now_s = max(self.now_s, next_s) + late_s
            self._take_ended()
            for one in self.book.due(self.now_s):
                self.book.start_done(one)
        self.now_s = max(self.now_s, until_s)
        self._take_ended()

    def _take_ended(self) -> None:
        for ended in self.book.take_ended(self.now_s):
            self.lapsed[ended.number] = self.lapsed.get(ended.number, 0) + 1
            assert self.lapsed[ended.number] == 1, "an end was handed out twice"
            if ended.end is EndOfLease.LAPSED:
                assert self.ends[ended.number] <= self.now_s
                assert self.now_s <= self.ends[ended.number] + GRANULARITY_S + 1e-9
        for drive, lease in list(self.holder.items()):
            if self.ends[lease.number] <= self.now_s:
                del self.holder[drive]
                self.latched[drive] = True
                self.former.append(lease)

    def _held(self) -> dict[str, HeldLease]:
        self._take_ended()
        return dict(self.holder)

    def _try(self, call: Any, *args: Any, **kwargs: Any) -> HeldLease | None:
        try:
            return call(*args, **kwargs)  # type: ignore[no-any-return]
        except OperationError:
            return None

    @invariant()
    def only_the_holder_of_the_newest_token_moves_a_drive(self) -> None:
        for drive in DRIVES:
            if drive not in self.required:
                return
            lease = self._held().get(drive)
            for former in self.former[-20:]:
                for use in Use:
                    assert self.book.objection(drive, former.token, use, self.now_s) is not None
            open_to_all = lease is None and not self.required[drive] and not self.latched[drive]
            assert (self.book.objection(drive, "", Use.MOTION, self.now_s) is None) is open_to_all
            if lease is not None:
                found = self.book.objection(drive, lease.token, Use.MOTION, self.now_s)
                assert (found is None) is not self.latched[drive]
                assert self.book.drives[drive].lease is lease


TestLeases = LeaseMachine.TestCase
