"""What requests cost and how they stand to each other, as they are made for a drive."""

from __future__ import annotations

import pytest

from lecombus.drives import StopAction, family
from lecombus.errors import OperationError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.exchanges.jobs import MulticastJob, ReadJob, WriteJob
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker, form_of
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code, Value
from lecombus.schedule import Outcome, Priority, Request, ignore_end

COUNTED: list[tuple[Priority, Outcome]] = []
TIMING = LineTiming(9600, adapter_latency_s=0.016, quarantine_s=0.05)


def maker() -> LecomRequestMaker:
    COUNTED.clear()
    return LecomRequestMaker(
        TIMING, 2, lambda priority, outcome: COUNTED.append((priority, outcome))
    )


def station(kind: str = "8200vector", **more: object) -> Station:
    described = family(kind)
    return Station("a", 1, described, described.forms, **more)  # type: ignore[arg-type]


def write(number: int, value: str, urgency: Priority | None = None) -> Request:
    return maker().write(
        station(), Code(number), Value.parse(value), settle=ignore_end, verify=False,
        urgency=urgency,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("number", "value", "priority", "supersedes"),
    [
        (46, "20", Priority.CONTROL, ("a", Code(46))),
        (40, "1", Priority.CONTROL, None),
        (135, "H0008", Priority.CONTROL, None),
        (11, "60", Priority.INTERACTIVE, None),
        (4711, "1", Priority.INTERACTIVE, None),
    ],
)
def test_what_moves_a_drive_runs_as_control_and_only_a_setpoint_gives_way_to_a_later_one(
    number: int, value: str, priority: Priority, supersedes: object
) -> None:
    made = write(number, value)
    assert (made.priority, made.writes, made.supersedes) == (priority, True, supersedes)


def test_a_write_may_wait_for_idle_line_time_unless_it_moves_the_drive() -> None:
    assert write(11, "60", Priority.BACKGROUND).priority is Priority.BACKGROUND
    assert write(40, "0", Priority.BACKGROUND).priority is Priority.CONTROL


def test_a_stop_ends_the_motion_of_its_drive() -> None:
    made = maker().stop(
        station(), StopAction.INHIBIT, word=lambda: None, said=False, settle=ignore_end
    )
    assert (made.priority, made.stops) == (Priority.STOP, ("a",))


def test_every_end_is_counted_and_told_once() -> None:
    told: list[tuple[Outcome, str]] = []
    made = maker().read(station(), Code(150), Priority.CYCLIC, settle=lambda *end: told.append(end))
    made.end(Outcome.DONE, "x")
    assert told == [(Outcome.DONE, "x")]
    assert COUNTED == [(Priority.CYCLIC, Outcome.DONE)]


def test_a_request_costs_no_more_than_its_worst() -> None:
    for made in (
        maker().read(station(), Code(150), Priority.CYCLIC),
        write(46, "20"),
        maker().probe(station())(),
    ):
        assert 0.0 < made.cost_s < made.worst_s


def test_a_multicast_leaves_the_slowest_member_its_time_also_by_the_roster_s_word() -> None:
    members = (station(), station("820x"), station(answer_time_s=0.8, hold_s=0.23))
    group = Station("g", 10, members[0].family, members[0].forms)
    made = maker().multicast(
        group, members, Code(46), Value.decimal(20), Priority.CONTROL, settle=ignore_end
    )
    assert isinstance(made.work, MulticastJob)
    assert made.work.processing_s == 0.8
    assert made.work.holds == {"a": 0.23}
    assert made.cost_s > 0.8


def test_a_multicast_waits_for_no_member_that_acknowledges_early_unless_it_is_a_stop() -> None:
    members = (station(), station("820x", hold_s=0.23, answers_early=True))
    group = Station("g", 10, members[0].family, members[0].forms)
    waited_s = []
    for priority in (Priority.CONTROL, Priority.STOP):
        made = maker().multicast(
            group, members, Code(40), Value.decimal(0), priority, settle=ignore_end
        )
        assert isinstance(made.work, MulticastJob)
        waited_s.append(made.work.processing_s)
    assert waited_s == [
        members[0].family.longest_answer_time_s(Code(40), write=True),
        members[1].family.longest_answer_time_s(Code(40), write=True),
    ]


def test_a_probe_asks_in_the_rarer_form_for_a_code_nobody_polls() -> None:
    one = station()
    job = maker().probe(one)().work
    assert isinstance(job, ReadJob)
    assert job.step.code not in {code for code, _ in one.family.status}
    assert job.station.forms == tuple(reversed(one.forms))
    assert job.retries == 0


def test_a_probe_of_an_undescribed_device_asks_for_what_there_is() -> None:
    job = maker().probe(station("generic"))().work
    assert isinstance(job, ReadJob)
    assert job.step.code == Code(150)


def test_a_code_is_said_in_the_first_form_that_can_carry_it() -> None:
    assert form_of(station(), Code(46)) is Form.STANDARD
    assert form_of(station(), Code(39, 1)) is Form.EXTENDED
    assert form_of(station(), Code(7000)) is Form.EXTENDED


def test_a_code_that_no_form_of_the_device_can_carry_is_refused_before_it_waits() -> None:
    with pytest.raises(OperationError) as caught:
        maker().read(station("generic"), Code(39, 1), Priority.INTERACTIVE)
    assert caught.value.kind == "no-such-code"


def test_retries_are_the_roster_s_unless_told_otherwise() -> None:
    many = maker().read(station(), Code(150), Priority.INTERACTIVE).work
    none = maker().read(station(), Code(150), Priority.CYCLIC, retries=0).work
    assert isinstance(many, ReadJob)
    assert isinstance(none, ReadJob)
    assert (many.retries, none.retries) == (2, 0)
    job = write(46, "20").work
    assert isinstance(job, WriteJob)
    assert job.retries == 2
