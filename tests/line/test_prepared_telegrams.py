"""From a step to a telegram: its form, its time-outs, and when it may not be said yet."""

from __future__ import annotations

import math

import pytest

from lecombus.drives import StopAction, WriteClass, family
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.lecom.exchanges.jobs import MulticastJob, ReadJob, WriteJob
from lecombus.fieldbus.lecom.exchanges.late_answers import (
    COPY_S,
    DOUBTED_S,
    Duplicates,
    PendingLateAnswers,
)
from lecombus.fieldbus.lecom.exchanges.prepared_telegrams import PreparedTelegram, TelegramPreparer
from lecombus.fieldbus.lecom.exchanges.stop_job import StopJob
from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD
from lecombus.fieldbus.lecom.telegram_costs import read_cost
from lecombus.fieldbus.requests import Job, Station
from lecombus.parameters import Code, Value

VECTOR, SLOW = family("8200vector"), family("820x")
TIMING = LineTiming(9600, adapter_latency_s=0.016, quarantine_s=0.05)
STATUS, SETPOINT = Code(150), Code(46)


def station(kind: str = "8200vector", **more: object) -> Station:
    described = family(kind)
    return Station("a", 1, described, described.forms, **more)  # type: ignore[arg-type]


def preparer(*doubtful: bytes) -> TelegramPreparer:
    late_answers = PendingLateAnswers(0.5)
    for field in doubtful:
        late_answers.add(field, 0.0)
    return TelegramPreparer(TIMING, late_answers, Duplicates())


def ask(
    where: TelegramPreparer, job: Job, now_s: float = 0.1, *, urgent: bool = False
) -> PreparedTelegram:
    prepared = where.ask(job, now_s, urgent=urgent)
    assert isinstance(prepared, PreparedTelegram), f"it may not be said before {prepared}"
    return prepared


def field(code: Code, form: Form = Form.STANDARD) -> bytes:
    return encode_code(code, form)


def writing() -> WriteJob:
    return WriteJob(station(), SETPOINT, Value.decimal(20), write_class=WriteClass.PLAIN, retries=2)


def test_a_read_carries_parity_where_we_make_it_and_not_where_a_device_does() -> None:
    where = preparer()
    assert ask(where, ReadJob(station(), STATUS, 0)).ask.sent == b"\x84\x30\xb1\x3f\x30\x05"
    where.opened(parity=False)
    assert ask(where, ReadJob(station(), STATUS, 0)).ask.sent == b"\x0401?0\x05"


@pytest.mark.parametrize("kind", ["820x", "8200vector", "93xx", "smvector", "generic"])
@pytest.mark.parametrize("number", [150, 46, 1923])
def test_the_time_outs_are_those_the_cost_model_gives_for_drive_code_and_form(
    kind: str, number: int
) -> None:
    one, code = station(kind), Code(number)
    made = ask(preparer(), ReadJob(one, code, 0)).ask
    cost = read_cost(TIMING, one.family, code, Form.STANDARD)
    assert (made.request_s, made.first_byte_s, made.whole_s, made.gap_s) == (
        cost.request_s, cost.first_byte_s, cost.whole_s, cost.gap_s,
    )  # fmt: skip
    longest_s = one.family.longest_answer_time_s(code, write=False)
    assert made.whole_s > made.first_byte_s > made.request_s + longest_s


def test_the_roster_s_word_on_the_answer_time_goes_before_the_family_s() -> None:
    made = ask(preparer(), ReadJob(station(answer_time_s=0.3), STATUS, 0)).ask
    assert made.first_byte_s == pytest.approx(made.request_s + 0.6 + 0.036)


def test_a_read_in_doubt_is_said_in_the_other_form_and_then_waits() -> None:
    one = preparer(field(STATUS))
    assert ask(one, ReadJob(station(), STATUS, 0)).ask.field == field(STATUS, Form.EXTENDED)
    sole = ReadJob(station(), STATUS, 0, form=Form.STANDARD, only=True)
    assert one.ask(sole, 0.1, urgent=False) == 0.5, "that one form is wanted"
    assert ask(preparer(field(STATUS, Form.EXTENDED)), sole).ask.field == field(STATUS)
    both = preparer(field(STATUS), field(STATUS, Form.EXTENDED))
    assert both.ask(ReadJob(station(), STATUS, 0), 0.1, urgent=False) == 0.5
    assert both.ask(ReadJob(station(), STATUS, 0), 0.1, urgent=True) == 0.5, "a stop's read too"


def test_a_read_waits_for_the_form_that_is_free_first_and_no_longer() -> None:
    late_answers = PendingLateAnswers(0.5)
    where, job = TelegramPreparer(TIMING, late_answers, Duplicates()), ReadJob(station(), STATUS, 0)
    late_answers.add(field(STATUS), 0.0)
    assert ask(where, ReadJob(station(), Code(50), 0)).ask.field == field(Code(50))
    late_answers.add(field(STATUS, Form.EXTENDED), 0.2)
    assert where.ask(job, 0.3, urgent=False) == 0.5
    assert ask(where, job, 0.5).ask.field == field(STATUS)


def proving(duplicates: Duplicates) -> StopJob:
    """A quick stop that a multicast has sent: what comes next reads C0135."""
    return StopJob(
        station(), StopAction.QUICK_STOP, word=lambda: 0, retries=2, said=True,
        duplicates=duplicates,
    )  # fmt: skip


def test_where_answers_come_twice_no_proof_is_read_directly_behind_another_drive_s() -> None:
    """A copy of that one's answer would come when this one's is waited for (ADR 40)."""
    duplicates, word = Duplicates(), Code(135)
    where = TelegramPreparer(TIMING, PendingLateAnswers(0.5), duplicates)
    apart_s = 0.04 + 20 * TIMING.char_s

    def asked(form: Form, drive: str, ended_s: float) -> None:
        duplicates.asked(field(word, form), drive, ended_s - 0.3)
        duplicates.ended(field(word, form), ended_s)

    asked(Form.STANDARD, "b", 1.0)
    asked(Form.EXTENDED, "c", 1.03)
    assert ask(where, proving(duplicates), 1.05, urgent=True).ask.field == field(word)
    duplicates.came(field(word), 1.05)
    assert where.ask(proving(duplicates), 1.05, urgent=True) == pytest.approx(1.0 + apart_s)
    assert ask(where, ReadJob(station(), word, 0), 1.05).ask.field == field(word), "no proof"
    assert ask(where, proving(duplicates), 1.0 + apart_s, urgent=True).ask.field == field(word)
    asked(Form.STANDARD, "c", 1.1)
    again = ask(where, proving(duplicates), 1.03 + apart_s, urgent=True)
    assert again.ask.field == field(word, Form.EXTENDED)
    for form in Form:  # the drive's own questions keep it from nothing: one of both is sent
        asked(form, "a", 1.5)
    ask(where, proving(duplicates), 1.51, urgent=True)


def test_where_answers_come_too_late_no_proof_is_read_that_another_drive_may_still_answer() -> None:
    duplicates, word = Duplicates(), Code(135)
    where = TelegramPreparer(TIMING, PendingLateAnswers(0.5), duplicates)
    forms = [field(word, form) for form in Form]
    for at_s, one in zip((1.0, 1.2), forms, strict=True):
        duplicates.unanswered(one, "b", at_s)
    ask(where, proving(duplicates), 1.8, urgent=True)  # nothing came late yet
    duplicates.unanswered(field(Code(50)), "c", 1.1)
    duplicates.came(field(Code(50)), 1.8)
    assert where.ask(proving(duplicates), 1.8, urgent=True) == pytest.approx(1.0 + COPY_S)
    ask(where, ReadJob(station(), word, 0), 1.8)  # it proves nothing
    duplicates.unanswered(forms[0], "a", 2.0)  # its own answer is no other drive's
    duplicates.late_came(forms[0])  # of a or b: not known
    assert where.ask(proving(duplicates), 2.0, urgent=True) == pytest.approx(1.0 + COPY_S)
    duplicates.late_came(forms[1])
    assert ask(where, proving(duplicates), 2.0, urgent=True).ask.field == forms[1]
    assert ask(where, proving(duplicates), 1.0 + COPY_S, urgent=True).ask.field in forms
    duplicates.unanswered(forms[0], "b", 1.8 + DOUBTED_S)
    duplicates.unanswered(forms[1], "b", 1.8 + DOUBTED_S)
    ask(where, proving(duplicates), 1.9 + DOUBTED_S, urgent=True)  # the last came long ago


@pytest.mark.parametrize(
    ("unanswered_s", "late"),
    [
        (None, False),  # all have answered: it is a second one
        (1.0, True),
        (-2.0, False),  # no answer is so late
    ],
)
def test_which_answers_without_a_request_are_late(
    *, unanswered_s: float | None, late: bool
) -> None:
    duplicates, one = Duplicates(), field(Code(50))
    if unanswered_s is not None:
        duplicates.unanswered(one, "b", unanswered_s)
    duplicates.came(one, 2.1)
    assert is_late(duplicates, 2.2) is late


def test_answers_are_late_where_more_of_them_may_be_late_than_are_second_ones() -> None:
    duplicates, one = Duplicates(), field(Code(50))

    def come(*, second: int, late: int) -> None:
        for _ in range(second):
            duplicates.came(one, 1.0)
        for _ in range(late):
            duplicates.unanswered(one, "b", 1.0)
            duplicates.came(one, 1.0)

    come(second=2, late=2)
    assert not is_late(duplicates, 1.1)
    come(second=0, late=30)
    assert is_late(duplicates, 1.1)
    come(second=10, late=0)
    assert is_late(duplicates, 1.1)
    come(second=30, late=10)
    assert not is_late(duplicates, 1.1)
    duplicates.unanswered(one, "b", 1.0 + DOUBTED_S)
    duplicates.came(one, 1.0 + DOUBTED_S)
    assert is_late(duplicates, 1.1 + DOUBTED_S), "those before came too long ago"


def test_what_can_no_longer_come_is_not_waited_for_however_long_nothing_else_is_missing() -> None:
    duplicates, one = Duplicates(), field(Code(135))
    duplicates.unanswered(one, "b", 1.0)
    duplicates.came(one, 2.0)
    duplicates.unanswered(one, "b", 10.0)
    assert duplicates.late_until_s(one, "a") == 10.0 + COPY_S
    duplicates.asked(field(Code(50)), "b", 10.0 + COPY_S)
    assert duplicates.late_until_s(one, "a") == -math.inf
    duplicates.unanswered(one, "b", 2.0 + DOUBTED_S)
    assert duplicates.late_until_s(one, "a") == -math.inf, "nothing came late since"


def test_what_comes_soon_after_a_port_was_opened_is_neither_late_nor_second() -> None:
    duplicates, one = Duplicates(), field(Code(135))
    duplicates.opened(1.0)
    for _ in range(5):
        duplicates.came(one, 4.9)
    assert duplicates.doubtful(5.0)
    duplicates.unanswered(one, "b", 5.1)
    duplicates.came(one, 5.9)
    assert is_late(duplicates, 6.0)


def is_late(duplicates: Duplicates, at_s: float) -> bool:
    """Return whether another drive's answer, missing since then, is waited for."""
    duplicates.unanswered(field(Code(135)), "b", at_s)
    return duplicates.late_until_s(field(Code(135)), "a") == at_s + COPY_S


def test_a_code_only_the_extended_form_can_say_waits_for_that() -> None:
    where, code = preparer(field(Code(39, 1), Form.EXTENDED)), Code(39, 1)
    assert where.ask(ReadJob(station(), code, 0), 0.1, urgent=False) == 0.5
    assert ask(where, ReadJob(station(), code, 0), 0.5).ask.field == field(code, Form.EXTENDED)


def test_a_drive_found_slow_is_given_longer_at_its_next_read() -> None:
    one, where = station(), preparer()
    before = ask(where, ReadJob(one, STATUS, 0))
    assert ask(where, ReadJob(one, STATUS, 0)) is before, "made once"
    for at_s in (1.0, 2.0):
        one.measured.note(STATUS, before.documented_s, before.documented_s + 0.1, at_s, write=False)
    after = ask(where, ReadJob(one, STATUS, 0))
    assert after.ask.first_byte_s > before.ask.first_byte_s + 0.1
    assert after.documented_s == before.documented_s == one.documented_s(STATUS)


def test_what_is_cut_off_a_slow_drive_s_patience_leaves_what_its_manual_allows() -> None:
    """Seed 31111 of the proof: a feed of a slow code read another code, and waited for no time."""
    one, where = station(), preparer()
    before = ask(where, ReadJob(one, STATUS, 0))
    write = WriteJob(one, SETPOINT, Value.decimal(20), write_class=WriteClass.PLAIN, retries=2)
    written = ask(where, write)
    for at_s in (1.0, 2.0):
        one.measured.note(STATUS, before.documented_s, before.documented_s + 0.4, at_s, write=False)
        one.measured.note(
            SETPOINT, written.documented_s, written.documented_s + 0.4, at_s, write=True
        )
    quick = ask(where, ReadJob(one, Code(1923), 0))
    assert quick.cut_by(0.7) == quick, "nothing was measured of this code"
    for slow, manual in (
        (ask(where, ReadJob(one, STATUS, 0)), before), (ask(where, write), written),
    ):  # fmt: skip
        least, whole = manual.ask.first_byte_s, manual.ask.whole_s
        cut = slow.cut_by(0.1).ask
        assert cut.first_byte_s == pytest.approx(slow.ask.first_byte_s - 0.1)
        assert cut.first_byte_s > least
        cut = slow.cut_by(5.0).ask
        assert (cut.first_byte_s, cut.whole_s) == (least, whole)


def test_a_device_with_one_form_waits_at_once() -> None:
    where = preparer(field(STATUS))
    assert where.ask(ReadJob(station("generic"), STATUS, 0), 0.1, urgent=False) == 0.5


def test_a_feed_takes_another_code_instead() -> None:
    where = preparer(field(STATUS), field(STATUS, Form.EXTENDED))
    job = ReadJob(station(), STATUS, 0, instead=(STATUS, Code(50)))
    assert ask(where, job).ask.field == field(Code(50))
    assert job.step.code == Code(50), "the answer is booked under the code that was asked for"


def test_a_write_waits_while_an_old_acknowledgement_may_come_and_a_stop_does_not() -> None:
    where = preparer(ACK_FIELD)
    assert where.ask(writing(), 0.1, urgent=False) == 0.5
    stop = StopJob(station(), StopAction.INHIBIT, word=lambda: None, retries=0)
    assert ask(where, stop, urgent=True).ask.field == ACK_FIELD
    assert isinstance(where.ask(writing(), 0.5, urgent=False), PreparedTelegram)


def test_a_multicast_waits_for_nothing_and_expects_nothing() -> None:
    group = Station("g", 10, VECTOR, VECTOR.forms)
    job = MulticastJob(group, SETPOINT, Value.decimal(20), processing_s=0.2)
    made = ask(preparer(ACK_FIELD), job)
    assert (made.ask.field, made.hold_s, made.quarantine_s) == (b"", 0.0, 0.0)
    assert made.ask.whole_s >= made.ask.request_s + 0.2


def test_a_write_holds_its_drive_off_and_a_read_does_not() -> None:
    held = station("820x", hold_s=0.23)
    job = WriteJob(held, SETPOINT, Value.decimal(20), write_class=WriteClass.PLAIN, retries=0)
    assert ask(preparer(), job).hold_s == 0.23
    assert ask(preparer(), ReadJob(held, STATUS, 0)).hold_s == 0.0


def test_stations_with_the_same_address_do_not_share_telegrams_made_before() -> None:
    """A reloaded roster makes a new station: its answer time must count."""
    where = preparer()
    before = ask(where, ReadJob(station(), STATUS, 0))
    after = ask(where, ReadJob(station(answer_time_s=1.0), STATUS, 0))
    assert after.ask.first_byte_s > before.ask.first_byte_s
