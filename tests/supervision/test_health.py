"""How a drive's state follows from what its exchanges come to."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lecombus.drive_state.drive_runtime import Drive, LineDrives
from lecombus.drive_state.readings import DriveState, LineState
from lecombus.drive_state.store import Store
from lecombus.drives import family
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.line_events import LineChange
from lecombus.roster import WatchdogEntry
from lecombus.schedule import Outcome, Priority, Request, Schedule
from lecombus.supervision.health import AuditQueue, Health
from support.single_drives import drive_of, stop_of_group

STARTING, ONLINE, DEGRADED, OFFLINE = (
    DriveState.STARTING, DriveState.ONLINE, DriveState.DEGRADED, DriveState.OFFLINE,
)  # fmt: skip
GOOD, MISSED = ResultKind.ANSWERED, ResultKind.NO_REPLY


class CountedAudits(AuditQueue):
    """A queue of audits that nobody makes."""

    asked = 0

    def ask(self, drive: Drive, *, restarted: bool = True) -> None:
        self.asked += 1


class Ward:
    """A health with one drive."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.schedule = Schedule()
        self.schedule.add_drive("a")
        self.store = Store(lambda: self.now_s, lambda: 1e9)
        self.store.line_state(LineState.OPEN)
        self.store.add_drive("a", 1, family("8200vector"))
        self.drives = LineDrives()
        self.drive = drive_of("a")
        self.drive.probe = self._probe
        self.drives.put(self.drive)
        self.queue = CountedAudits()
        self.health = Health(self.drives, self.schedule, self.store, lambda: self.now_s)
        self.health.audits = self.queue
        self.health.begin(self.drive)

    @property
    def audits(self) -> int:
        return self.queue.asked

    @property
    def state(self) -> DriveState:
        return self.drive.health.state

    def _probe(self) -> Request:
        return Request("a", Priority.CYCLIC, 0.05, 0.1, lambda outcome, reason: None)

    def exchange(self, *kinds: ResultKind) -> DriveState:
        for kind in kinds:
            self.health.judge(self.drive, kind, "no answer in time")
        return self.state

    def online(self) -> Ward:
        self.exchange(GOOD)
        self.health.audited(self.drive)
        return self


def test_a_drive_is_online_only_when_it_was_audited_not_when_it_answers() -> None:
    ward = Ward()
    assert ward.exchange(GOOD, GOOD) is STARTING
    ward.health.audited(ward.drive)
    assert ward.state is ONLINE


@pytest.mark.parametrize(
    ("before", "misses", "state"),
    [(True, 1, DEGRADED), (True, 3, DEGRADED), (True, 4, OFFLINE), (False, 1, OFFLINE)],
)  # fmt: skip
def test_misses_in_a_row_degrade_a_drive_and_then_take_it_offline(
    before: bool, misses: int, state: DriveState
) -> None:
    ward = Ward().online() if before else Ward()
    assert ward.exchange(*[MISSED] * misses) is state


def test_a_drive_that_has_answered_keeps_the_patience_of_one_while_it_waits_for_its_audit() -> None:
    ward = Ward()
    assert ward.exchange(GOOD, MISSED, MISSED, MISSED) is STARTING
    assert ward.exchange(MISSED) is OFFLINE


def test_a_single_miss_is_forgiven_without_an_audit() -> None:
    ward = Ward().online()
    assert ward.exchange(MISSED, GOOD) is ONLINE
    assert ward.audits == 0


def test_two_misses_in_a_row_cost_an_audit_before_the_drive_is_online_again() -> None:
    ward = Ward().online()
    assert ward.exchange(MISSED, MISSED, GOOD) is DEGRADED
    assert ward.audits == 1
    assert ward.exchange(GOOD) is DEGRADED
    ward.health.audited(ward.drive)
    assert ward.state is ONLINE


def test_a_single_miss_while_an_audit_is_due_does_not_stand_in_for_it() -> None:
    ward = Ward().online()
    ward.exchange(MISSED, MISSED, GOOD)
    assert ward.exchange(MISSED, GOOD) is DEGRADED
    ward.health.audited(ward.drive)
    assert ward.state is ONLINE


def test_a_lost_line_is_no_drive_s_fault() -> None:
    ward = Ward().online()
    assert ward.exchange(*[ResultKind.LOST] * 10) is ONLINE


@pytest.mark.parametrize("kind", [ResultKind.GARBLED, ResultKind.ECHO])
def test_every_other_failure_counts_as_a_miss(kind: ResultKind) -> None:
    assert Ward().online().exchange(*[kind] * 4) is OFFLINE


def test_an_offline_drive_is_probed_and_what_waits_for_it_ends() -> None:
    ward = Ward().online()
    ends: list[tuple[Outcome, str]] = []
    waiting = Request("a", Priority.INTERACTIVE, 0.05, 0.1, lambda *end: ends.append(end))
    ward.schedule.submit(waiting, ward.now_s)
    ward.exchange(*[MISSED] * 4)
    assert ends[0][0] is Outcome.REFUSED
    assert "a is offline: 4 exchanges in a row failed" in ends[0][1]
    probe = ward.schedule.next(ward.now_s)
    assert probe is not None
    assert probe.priority is Priority.CYCLIC


def test_an_offline_drive_that_answers_is_audited_and_stays_starting_until_then() -> None:
    ward = Ward().online()
    ward.exchange(*[MISSED] * 4)
    assert ward.exchange(GOOD) is STARTING
    assert ward.audits == 1
    assert ward.store.drive("a").reason == "it answers again: being audited"
    ward.health.audited(ward.drive)
    assert ward.state is ONLINE


def test_an_audit_that_ends_after_the_drive_went_offline_changes_nothing() -> None:
    ward = Ward().online()
    ward.exchange(*[MISSED] * 4)
    ward.health.audited(ward.drive)
    ward.health.audit_failed(ward.drive, "too late")
    assert ward.state is OFFLINE
    assert "4 exchanges" in ward.store.drive("a").reason


def test_a_reopened_line_begins_anew_with_every_drive() -> None:
    ward = Ward().online()
    ward.exchange(*[MISSED] * 4)
    ward.health.line_changed(LineChange(True, ""))
    assert ward.state is STARTING
    assert ward.audits == 1
    assert ward.schedule.next(ward.now_s) is None, "it is no longer probed"


@pytest.mark.parametrize(
    "call",
    [
        lambda ward: ward.health.audited(ward.drive),
        lambda ward: ward.health.audit_failed(ward.drive, "x"),
        lambda ward: ward.health.doubted(ward.drive, "x"),
        lambda ward: ward.health.line_changed(LineChange(True, "")),
    ],
)
def test_what_is_said_of_a_drive_taken_out_is_ignored(call: Callable[[Ward], None]) -> None:
    ward = Ward().online()
    ward.drives.take_out(ward.drive)
    ward.store.remove_drive("a")
    call(ward)
    assert ward.audits == 0


@pytest.mark.parametrize(("silent_s", "state"), [(4.0, DEGRADED), (6.0, STARTING)])
def test_a_drive_silent_long_enough_to_be_another_is_not_written_to_before_its_audit(
    silent_s: float, state: DriveState
) -> None:
    ward = Ward().online()
    ward.exchange(MISSED)
    ward.now_s += silent_s
    assert ward.exchange(MISSED, GOOD) is state
    assert ward.audits == 1
    ward.health.audited(ward.drive)
    assert ward.exchange(MISSED, GOOD) is ONLINE, "one failure alone is none of this"


def test_a_drive_whose_audit_takes_too_long_is_written_to_no_longer() -> None:
    ward = Ward().online()
    assert ward.exchange(MISSED, MISSED, GOOD) is DEGRADED
    for later_s in (4.0, 5.0):
        ward.now_s += later_s
        ward.exchange(MISSED, MISSED, GOOD)  # once more: it is due since the first time
        ward.health.audit_failed(ward.drive, "no answer in time")
        ward.health.check_overdue()
        assert ward.state is DEGRADED
    ward.now_s += 1.0
    ward.health.check_overdue()
    assert ward.state is STARTING
    assert "not audited yet" in ward.store.drive("a").reason
    ward.health.audited(ward.drive)
    ward.now_s += 100.0
    ward.health.check_overdue()
    assert ward.state is ONLINE


def test_one_missed_answer_makes_no_audit_due() -> None:
    ward = Ward().online()
    ward.exchange(MISSED, GOOD)
    ward.now_s += 100.0
    ward.health.check_overdue()
    assert ward.state is ONLINE


@pytest.mark.parametrize("kind", [GOOD, MISSED, ResultKind.LOST])
def test_a_silence_lasts_while_a_stop_waits_or_is_under_way_and_then_a_watchdog_time(
    kind: ResultKind,
) -> None:
    """Each telegram of a stop feeds the drive, also one that is not answered."""
    ward, watchdog_s = Ward(), 3.0
    watchdog = WatchdogEntry(time_s=watchdog_s, action="inhibit", configure=True)
    ward.drive.entry = ward.drive.entry.model_copy(update={"watchdog": watchdog})
    ward.health.silence(ward.drive, "so that its watchdog acts")
    assert not ward.health.is_silence_over(ward.drive)
    ward.now_s += watchdog_s
    assert ward.health.is_silence_over(ward.drive)
    ward.schedule.submit(
        Request("a", Priority.STOP, 0.02, 0.1, lambda outcome, reason: None), ward.now_s
    )
    assert not ward.health.is_silence_over(ward.drive), "its stop waits"
    stop = ward.schedule.next(ward.now_s)
    assert stop is not None
    assert not ward.health.is_silence_over(ward.drive), "its stop is under way"
    ward.now_s += 0.1
    ward.schedule.finished(stop, ward.now_s - 0.1, ward.now_s, kind is GOOD)
    ward.health.judge(ward.drive, kind, "")
    assert not ward.health.is_silence_over(ward.drive), "the stop fed it"
    ward.now_s += watchdog_s
    assert ward.health.is_silence_over(ward.drive)


@pytest.mark.parametrize("kind", [ResultKind.SENT, ResultKind.LOST])
def test_a_silence_lasts_while_a_group_is_stopped_and_then_a_watchdog_time(
    kind: ResultKind,
) -> None:
    """A multicast feeds each of its members."""
    ward, watchdog_s = Ward(), 3.0
    watchdog = WatchdogEntry(time_s=watchdog_s, action="inhibit", configure=True)
    ward.drive.entry = ward.drive.entry.model_copy(update={"watchdog": watchdog})
    ward.health.silence(ward.drive, "so that its watchdog acts")
    ward.now_s += watchdog_s
    stop = Request(
        "all", Priority.STOP, 0.02, 0.1, lambda outcome, reason: None, stops=("a",), members=("a",)
    )
    ward.schedule.submit(stop, ward.now_s)
    assert not ward.health.is_silence_over(ward.drive), "it waits"
    assert ward.schedule.next(ward.now_s) is stop
    assert not ward.health.is_silence_over(ward.drive), "it is under way"
    ward.now_s += 0.1
    ward.schedule.finished(stop, ward.now_s - 0.1, ward.now_s, reached=False)
    ward.health.exchange_ended(stop_of_group(ward.drive, kind, ward.now_s))
    assert not ward.health.is_silence_over(ward.drive), "it fed the drive"
    ward.now_s += watchdog_s
    assert ward.health.is_silence_over(ward.drive)


def test_only_drives_that_are_spoken_to_say_whether_a_line_is_silent() -> None:
    ward = Ward().online()
    other = drive_of("b")
    ward.schedule.add_drive("b")
    ward.store.add_drive("b", 2, family("8200vector"))
    ward.drives.put(other)
    ward.health.silence(ward.drive, "so that its watchdog acts")
    found = []
    for state in (ONLINE, OFFLINE):  # of the one that is asked
        other.health.state = state
        found.append(ward.health.is_silent)
    ward.health.silence(other, "so that its watchdog acts")
    assert [*found, ward.health.is_silent] == [False, True, False]


def test_a_line_that_was_silent_before_its_drives_were_silenced_stays_silent() -> None:
    ward = Ward().online()
    ward.exchange(*[MISSED] * 4)
    found = [ward.health.is_silent]
    ward.health.silence(ward.drive, "so that its watchdog acts")
    found.append(ward.health.is_silent)
    ward.exchange(GOOD)  # a stop of it
    assert [*found, ward.health.is_silent] == [True, True, False]


def test_a_drive_that_missed_one_answer_before_it_was_silenced_says_nothing_of_the_line() -> None:
    ward = Ward().online()
    ward.exchange(MISSED)
    ward.health.silence(ward.drive, "so that its watchdog acts")
    assert not ward.health.is_silent
