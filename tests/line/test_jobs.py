"""Which sequence of results makes which outcome, and what is said in between."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import pytest

from lecombus.drives import StopAction, WriteClass, family
from lecombus.drives.stops import STOP_PAUSE_S
from lecombus.errors import ExchangeError, NakError, NoReplyError, UnknownCodeError
from lecombus.fieldbus.lecom.exchanges.jobs import MulticastJob, ReadBackJob, ReadJob, WriteJob
from lecombus.fieldbus.lecom.exchanges.late_answers import Duplicates
from lecombus.fieldbus.lecom.exchanges.read_back_proof import WrittenValue
from lecombus.fieldbus.lecom.exchanges.stop_job import LongestTimes, StopJob
from lecombus.fieldbus.lecom.protocol.addressing import Form, encode_code
from lecombus.fieldbus.lecom.protocol.exchange import ACK_FIELD, Result
from lecombus.fieldbus.lecom.protocol.telegrams import (
    AckAnswer,
    Answer,
    NakAnswer,
    UnknownCodeAnswer,
    ValueAnswer,
)
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.fieldbus.requests import Job, JobStep, Station, StepKind, Verdict
from lecombus.parameters import Code, Value
from lecombus.schedule.request import Outcome
from support.golden import Golden

VECTOR = family("8200vector")
STATION = Station("a", 1, VECTOR, VECTOR.forms)
CODE = Code(11)
SHOWN = {150: "H0080", 9: "1"}
"""What an inhibited drive reads, and its address."""

DONE, VERIFIED, REFUSED, UNKNOWN = (
    Outcome.DONE, Outcome.VERIFIED, Outcome.REFUSED, Outcome.UNKNOWN,
)  # fmt: skip


def answered(answer: Answer) -> Result:
    return Result(ResultKind.ANSWERED, 0.0, 0.02, answer)


def failed(kind: ResultKind) -> Result:
    return Result(kind, 0.0, 0.1, None, kind.value)


RESULTS = {
    "ack": answered(AckAnswer()),
    "nak": answered(NakAnswer()),
    "same": answered(ValueAnswer(b"11", Value.parse("7.0"))),
    "other": answered(ValueAnswer(b"11", Value.parse("5"))),
    "eot": answered(UnknownCodeAnswer(b"11")),
    "none": failed(ResultKind.NO_REPLY),
    "garbled": failed(ResultKind.GARBLED),
    "echo": failed(ResultKind.ECHO),
    "lost": failed(ResultKind.LOST),
    "sent": failed(ResultKind.SENT),
}


def play(job: Job, results: str) -> tuple[str, Outcome | None, str]:
    """Give a job results; say what it did (`R`ead, `W`rite, `M`ulticast) and how it ended."""
    steps = ""
    verdict: tuple[Outcome, str] | None = None
    for name in results.split():
        assert verdict is None, f"it had ended before {name!r}: {verdict}"
        steps += job.step.kind.name[0]
        verdict = job.advance(RESULTS[name])
    return (steps, *(verdict or (None, "")))


# ---- reads ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("results", "outcome"),
    [
        ("same", DONE),
        ("none same", DONE),
        ("garbled echo same", DONE),
        ("none none none", UNKNOWN),
        ("eot same", DONE),
        ("eot eot", REFUSED),
        ("nak same", DONE),
        ("nak nak", REFUSED),
        ("nak none same", DONE),
        ("none nak", REFUSED),
        ("none", None),
        ("lost", UNKNOWN),
        ("none lost", UNKNOWN),
    ],
)
def test_a_read_is_repeated_a_limited_number_of_times(
    results: str, outcome: Outcome | None
) -> None:
    job = ReadJob(STATION, CODE, 2)
    assert play(job, results)[1] is outcome
    assert job.cut_outcome is None, "a read that is cut off has changed nothing"
    assert (job.value is not None) == (outcome is DONE)


@pytest.mark.parametrize("retries", range(4))
@pytest.mark.parametrize("kind", list(WriteClass))
def test_a_refusal_is_repeated_once_at_most_and_only_of_a_plain_value(
    retries: int, kind: WriteClass
) -> None:
    job = WriteJob(STATION, CODE, Value.decimal(7), write_class=kind, retries=retries)
    said = 0
    verdict: tuple[Outcome, str] | None = None
    while verdict is None:
        verdict = job.advance(RESULTS["nak"])
        said += 1
        if verdict is None:
            assert job.cut_outcome is REFUSED, "it was refused, and not said again yet"
    assert said == (2 if kind is WriteClass.PLAIN and retries else 1)
    read = ReadJob(STATION, CODE, retries)
    assert (read.advance(RESULTS["nak"]) is None) == (retries > 0)


def test_the_error_of_a_read_says_who_what_and_how_often(golden: Golden) -> None:
    job = ReadJob(STATION, CODE, 1)
    _, _, reason = play(job, "none none")
    assert isinstance(job.error, NoReplyError)
    assert reason == str(job.error)
    golden(reason)
    assert (job.error.record.address, job.error.record.code, job.error.record.attempt) == (1, 11, 2)
    play(job := ReadJob(STATION, CODE, 0), "eot")
    assert isinstance(job.error, UnknownCodeError)


# ---- writes ---------------------------------------------------------------------------------

TABLE = [
    # class, verify, results, what was said, outcome, a word of the reason
    ("plain", False, "ack", "W", DONE, ""),
    # A NAK may be a damaged telegram: once more, as one of the repetitions.
    ("plain", False, "nak nak", "WW", REFUSED, "NAK"),
    ("plain", True, "nak nak", "WW", REFUSED, "NAK"),
    ("plain", False, "nak ack", "WW", DONE, ""),
    ("plain", True, "nak ack same", "WWR", VERIFIED, ""),
    ("plain", False, "nak none same", "WWR", VERIFIED, ""),
    ("plain", False, "nak none other nak", "WWRW", REFUSED, "NAK"),
    ("plain", False, "nak none other none other", "WWRWR", REFUSED, "still reads 5"),
    ("plain", False, "none same", "WR", VERIFIED, ""),
    ("plain", False, "garbled same", "WR", VERIFIED, ""),
    ("plain", False, "echo same", "WR", VERIFIED, ""),
    ("plain", False, "none other ack", "WRW", DONE, ""),
    ("plain", True, "none other ack same", "WRWR", VERIFIED, ""),
    ("plain", False, "none other nak nak", "WRWW", REFUSED, "NAK"),
    ("plain", False, "none other nak ack", "WRWW", DONE, ""),
    ("plain", False, "none other none other nak", "WRWRW", REFUSED, "NAK"),
    ("plain", False, "none other none other none other", "WRWRWR", REFUSED, "still reads 5"),
    ("plain", False, "none none none none", "WRRR", UNKNOWN, "could not be read back"),
    ("plain", False, "none eot eot", "WRR", UNKNOWN, "not acknowledged and could not be read back"),
    ("plain", False, "none lost", "WR", UNKNOWN, "could not be read back"),
    ("plain", False, "lost", "W", UNKNOWN, "may have happened"),
    ("plain", True, "ack same", "WR", VERIFIED, ""),
    ("plain", True, "ack other", "WR", REFUSED, "acknowledged, but it reads 5"),
    ("plain", True, "ack none same", "WRR", VERIFIED, ""),
    ("plain", True, "ack none none none", "WRRR", UNKNOWN, "acknowledged and could not be"),
    ("plain", True, "ack lost", "WR", UNKNOWN, "acknowledged and could not be"),
    *(
        row
        for kind in ("edge", "step", "save", "reset", "address")
        for row in (
            (kind, False, "ack", "W", DONE, ""),
            (kind, False, "nak", "W", REFUSED, "NAK"),
            (kind, False, "none", "W", UNKNOWN, "not repeated"),
            (kind, False, "garbled", "W", UNKNOWN, "not repeated"),
            (kind, False, "lost", "W", UNKNOWN, "not repeated"),
            (kind, True, "none", "W", UNKNOWN, "not repeated"),
            (kind, True, "ack same", "WR", VERIFIED, ""),
            (kind, True, "ack other", "WR", UNKNOWN, "acknowledged, but it reads 5"),
        )
    ),
]


@pytest.mark.parametrize(("kind", "verify", "results", "said", "outcome", "word"), TABLE)
def test_how_a_write_ends(
    kind: str, verify: bool, results: str, said: str, outcome: Outcome, word: str
) -> None:
    job = WriteJob(
        STATION, CODE, Value.decimal(7), write_class=WriteClass(kind), retries=2, verify=verify
    )
    steps, found, reason = play(job, results)
    assert (steps, found) == (said, outcome)
    assert word in reason


def test_a_write_that_succeeded_in_the_end_has_no_error() -> None:
    job = WriteJob(STATION, CODE, Value.decimal(7), write_class=WriteClass.PLAIN, retries=2)
    play(job, "none same")
    assert job.error is None
    job = WriteJob(STATION, CODE, Value.decimal(7), write_class=WriteClass.PLAIN, retries=2)
    play(job, "none other ack")
    assert job.error is None


def test_a_refused_write_keeps_the_drive_s_word_as_its_error() -> None:
    job = WriteJob(STATION, CODE, Value.decimal(7), write_class=WriteClass.PLAIN, retries=2)
    play(job, "none other nak")
    assert isinstance(job.error, NakError)
    assert isinstance(job.error, ExchangeError)


@pytest.mark.parametrize(
    ("results", "outcome"),
    [("none", UNKNOWN), ("ack", UNKNOWN), ("none other", UNKNOWN), ("ack none", UNKNOWN),
     ("nak", REFUSED)],
)  # fmt: skip
def test_a_write_cut_off_between_two_steps_is_never_called_done(
    results: str, outcome: Outcome
) -> None:
    job = WriteJob(
        STATION, CODE, Value.decimal(7), write_class=WriteClass.PLAIN, retries=2, verify=True
    )
    assert play(job, results)[1] is None
    assert job.cut_outcome is outcome


# ---- stops ----------------------------------------------------------------------------------


def value(code: int, raw: str) -> Result:
    return answered(ValueAnswer(b"%02d" % code, Value.parse(raw)))


def proven(
    job: StopJob, reads: Mapping[int, str], at_s: float = 0.02
) -> tuple[str, tuple[Outcome, str] | None]:
    """Answer what a stop reads to be shown, in the form asked for, until it ends or is said again.

    Returns:
        What was read, such as `150s 150e 9s`, and how it ended.
    """
    asked: list[str] = []
    verdict: tuple[Outcome, str] | None = None
    while verdict is None and job.step.kind is StepKind.READ:
        step = job.step
        assert step.form is not None
        asked.append(f"{step.code.number}{step.form.value[0]}")
        answer = ValueAnswer(
            encode_code(step.code, step.form), Value.parse(reads[step.code.number])
        )
        verdict = job.advance(late(answered(answer), at_s))
    return " ".join(asked), verdict


def test_an_inhibit_is_said_and_read_back() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2)
    assert (job.step.code, str(job.step.value and job.step.value.raw)) == (Code(40), "0")
    assert job.advance(RESULTS["ack"]) is None
    assert (job.step.kind, job.step.code) == (StepKind.READ, Code(150))
    outcome, reason = job.advance(value(150, "H0080")) or (None, "")
    assert outcome is VERIFIED
    assert "C0150 reads H0080" in reason


def test_a_stop_is_not_proven_where_others_are_asked_for_the_same_all_the_time() -> None:
    """Where second answers come, a reading waits a second for a pause; then it proves nothing."""
    duplicates = doubted()
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2, duplicates=duplicates)
    job.advance(RESULTS["ack"])
    verdict, now_s, sent = None, 0.0, 1
    while verdict is None:
        now_s += 0.03
        if job.step.kind is StepKind.WRITE:
            result: Result = RESULTS["ack"]
            sent += 1
        elif job.step.apart and job.instead_of_reading_s(now_s, now_s) is None:
            continue
        else:
            assert not job.step.apart
            result = value(150, "H0080")
        verdict = job.advance(dataclasses.replace(result, started_s=now_s, ended_s=now_s + 0.01))
    assert 5.0 < now_s < 7.0
    assert verdict[0] is UNKNOWN
    assert "other drives are asked for C0150 all the time" in verdict[1]
    assert sent == 5, "it may not have heard it, so it is sent again each time"


def test_a_stop_that_waits_for_a_pause_is_not_sent_again_and_is_proven_in_it() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2)
    job.advance(RESULTS["ack"])
    assert job.instead_of_reading_s(1.0, 1.0) is None
    assert job.step.apart
    assert (job.advance(value(150, "H0080")) or (None,))[0] is VERIFIED


def test_a_stop_that_waits_for_other_drives_late_answers_is_sent_again_until_it_is_shown() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=0, said=True)

    def waits(at_s: float) -> tuple[float | None, StepKind]:
        return job.instead_of_reading_s(at_s, at_s, others_late=True), job.step.kind

    assert waits(1.0) == (0.0, StepKind.WRITE)
    job.advance(late(RESULTS["ack"], 1.0))
    assert waits(1.9) == (None, StepKind.READ), "its acknowledgement is believed for a second"
    assert waits(2.1) == (0.0, StepKind.WRITE)
    job.advance(late(RESULTS["ack"], 2.1))
    assert waits(3.0) == (None, StepKind.READ)
    assert waits(6.1) == (0.0, StepKind.READ), "its time is over: what is read proves nothing"
    outcome, reason = job.advance(late(value(150, "H0080"), 6.1)) or (None, "")
    assert outcome is UNKNOWN
    assert "late answers come on this line" in reason


def test_where_late_answers_may_come_another_code_is_read_too_but_alone_it_proves_nothing() -> None:
    duplicates = late_line()
    for form in Form:
        duplicates.unanswered(encode_code(Code(150), form), "b", 1.0)
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=0, duplicates=duplicates
    )  # fmt: skip
    job.advance(late(RESULTS["ack"], 1.0))
    assert proven(job, {40: "0", 68: "H0080", 150: "H0080", 9: "1"}, 1.1) == (
        "40s 40e 68s 68e 150s 9s", (VERIFIED, "inhibit: C0150 reads H0080"),
    )  # fmt: skip


def test_what_was_shown_is_not_read_again_where_that_could_only_keep_others_waiting() -> None:
    """A reading without an answer would close its form for the proofs of the other drives."""
    duplicates = late_line()
    duplicates.unanswered(encode_code(Code(135), Form.EXTENDED), "b", 1.0)
    job = StopJob(
        STATION, StopAction.QUICK_STOP, word=lambda: 0, retries=0, duplicates=duplicates
    )  # fmt: skip
    job.advance(late(RESULTS["ack"], 1.0))
    assert (job.step.form, job.step.only) == (Form.STANDARD, False)
    field = encode_code(Code(135), Form.STANDARD)
    job.advance(late(answered(ValueAnswer(field, Value.parse("H0008"))), 1.1))
    assert (job.step.form, job.step.only) == (Form.EXTENDED, True)


def late_line() -> Duplicates:
    """A line on which an answer came later than `late_answer`."""
    duplicates = Duplicates()
    duplicates.unanswered(b"50", "b", 0.1)
    duplicates.came(b"50", 0.9)
    return duplicates


def test_the_reading_back_of_a_write_is_kept_apart_too_and_not_without_end() -> None:
    job = WriteJob(
        STATION, CODE, Value.decimal(7), write_class=WriteClass.PLAIN, retries=2, verify=True,
        duplicates=doubted(),
    )  # fmt: skip
    assert job.waits_apart(0.0, 0.0), "the write itself does not"
    job.advance(RESULTS["ack"])
    assert job.step.apart
    verdicts, now_s = list[Verdict](), 1.0
    while not verdicts or verdicts[-1] is None:
        now_s += 0.03
        assert job.waits_apart(now_s, now_s + 1.0), "old answers may come, for as long as they may"
        if not job.waits_apart(now_s, now_s):
            verdicts.append(job.advance(RESULTS["same"]))
    assert 3.0 < now_s < 6.0
    assert verdicts[-1][0] is UNKNOWN


def test_more_proof_of_a_stop_takes_the_time_of_a_reading_and_a_repetition_that_of_a_stop() -> None:
    times = LongestTimes(any_s=0.5, read_s=0.1)
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=0, silent=True, times=times
    )
    taken = [job.longest_s(9.0)]
    for result in (RESULTS["ack"], value(150, "H0080"), RESULTS["none"], RESULTS["ack"]):
        assert job.advance(result) is None
        taken.append(job.longest_s(9.0))
    assert taken == [0.5, 0.5, 0.1, 0.5, 0.1]
    plain = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=0)
    assert plain.longest_s(9.0) == 9.0


def test_a_quick_stop_with_an_unknown_word_reads_it_first_and_changes_only_its_bits() -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: None, retries=2)
    assert (job.step.kind, job.step.code) == (StepKind.READ, Code(135))
    assert job.cut_outcome is None, "nothing was said yet"
    job.advance(value(135, "H0A04"))
    assert job.step.kind is StepKind.WRITE
    assert job.step.value == Value.parse("H020C"), "bit 3 set, the reset bit 11 cleared"


@pytest.mark.parametrize("results", ["none", "garbled", "eot eot", "other"])
def test_a_word_that_cannot_be_read_makes_an_inhibit_of_the_quick_stop(results: str) -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: None, retries=2)
    for result in results.split():
        assert (job.step.kind, job.step.code) == (StepKind.READ, Code(135))
        job.advance(RESULTS[result] if result != "other" else value(135, "SABC"))
    assert (job.step.kind, job.step.code) == (StepKind.WRITE, Code(40))
    job.advance(RESULTS["ack"])
    outcome, reason = proven(job, SHOWN)[1] or (None, "")
    assert outcome is VERIFIED
    assert reason.startswith("quick-stop needs C0135, which ")
    assert reason.endswith("; inhibit: C0150 reads H0080")


def forms_of(job: StopJob, results: str) -> str:
    """Play results; give the addressing form of each step, `s`tandard or `e`xtended."""
    said = ""
    for name in results.split():
        assert job.step.kind is not StepKind.MULTICAST
        said += job.station.forms[0].value[0]
        job.advance(RESULTS[name])
    return said


@pytest.mark.parametrize(
    ("results", "forms"),
    [
        ("nak nak nak", "ses"),
        ("nak ack eot", "see"),
        ("nak none none", "ses"),
        ("none garbled none", "sss"),
        ("ack eot other", "sse"),
        ("ack none other", "sss"),
    ],
)
def test_what_is_refused_is_said_in_the_other_form_and_silence_changes_back(
    results: str, forms: str
) -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=5)
    assert forms_of(job, results) == forms


def test_a_drive_with_one_form_is_spoken_to_in_that_one() -> None:
    station = Station("a", 1, VECTOR, VECTOR.forms[:1])
    job = StopJob(station, StopAction.INHIBIT, word=lambda: None, retries=5)
    assert forms_of(job, "nak nak nak") == "sss"


def quick_stop(*, retries: int) -> StopJob:
    return StopJob(STATION, StopAction.QUICK_STOP, word=lambda: 4, retries=retries)


@pytest.mark.parametrize(
    ("retries", "results", "steps"),
    [(0, "nak other nak", "WRW"), (1, "nak nak", "WW"), (2, "none nak nak other nak", "WWWRW")],
)
def test_a_refused_quick_stop_becomes_an_inhibit_at_once(
    retries: int, results: str, steps: str, golden: Golden
) -> None:
    job = quick_stop(retries=retries)
    assert play(job, results)[:2] == (steps, None)
    assert (job.step.code, job.pause_s) == (Code(40), 0.0)
    job.advance(RESULTS["ack"])
    outcome, reason = proven(job, SHOWN)[1] or (None, "")
    assert outcome is VERIFIED
    golden(reason)


def test_one_refusal_that_a_damaged_telegram_may_have_caused_makes_no_inhibit() -> None:
    job = quick_stop(retries=2)
    assert play(job, "nak nak ack")[:2] == ("WWW", None)
    assert (job.advance(value(135, "H000C")) or (None,))[0] is VERIFIED


def test_a_quick_stop_taken_without_effect_becomes_an_inhibit_after_a_second(
    golden: Golden,
) -> None:
    job = quick_stop(retries=1)
    for at_s in (0.1, 0.5, 0.9):
        job.advance(late(RESULTS["ack"], at_s))
        job.advance(late(value(135, "H0004"), at_s))
        assert job.step.code == Code(135), "the drive is given time to show it"
    job.advance(late(RESULTS["ack"], 1.1))
    job.advance(late(value(135, "H0004"), 1.1))
    assert (job.step.kind, job.step.code) == (StepKind.WRITE, Code(40))
    job.advance(late(RESULTS["ack"], 1.2))
    outcome, reason = job.advance(late(value(150, "H0000"), 5.2)) or (None, "")
    assert outcome is REFUSED
    golden(reason)


def test_an_inhibit_that_follows_a_quick_stop_is_tried_for_a_while_however_late_it_is() -> None:
    job = quick_stop(retries=1)
    for n in range(24):
        job.advance(late(RESULTS["none"], 0.2 * (n + 1)))
    job.advance(late(RESULTS["nak"], 4.85))
    while job.step.code != Code(40):
        job.advance(late(RESULTS["nak"], 4.9))
    job.advance(late(RESULTS["none"], 5.3))
    job.advance(late(RESULTS["none"], 5.6))
    assert job.advance(late(RESULTS["none"], 5.7)) is None, "the quick stop had used up its time"
    job.advance(late(RESULTS["ack"], 5.8))
    assert (proven(job, SHOWN, 5.9)[1] or (None,))[0] is VERIFIED


def late(result: Result, at_s: float) -> Result:
    """The same, later."""
    return dataclasses.replace(result, started_s=at_s - 0.1, ended_s=at_s)


def test_a_stop_is_repeated_at_once_and_then_read_back_all_the_same() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2)
    assert play(job, "none garbled none")[:2] == ("WWW", None)
    assert job.step.kind is StepKind.READ
    assert job.cut_outcome is UNKNOWN
    asked, verdict = proven(job, SHOWN)
    assert (asked, verdict) == ("150s", None), "it was silent: it must acknowledge it itself"
    job.advance(RESULTS["ack"])
    asked, verdict = proven(job, SHOWN)
    assert asked == "150s 150e 9s", "two forms, and the one answer that is no other drive's"
    assert verdict == (VERIFIED, "inhibit: C0150 reads H0080")
    assert job.error is None


def test_a_reading_that_shows_nothing_new_is_repeated_with_pauses() -> None:
    """A form in which a late answer may still come is not asked for: the other one is."""
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2)
    play(job, "none ack")
    for pause_s in (0.0, STOP_PAUSE_S, STOP_PAUSE_S):
        assert job.advance(value(150, "H0080")) is None
        assert (job.step.code, job.pause_s) == (Code(150), pause_s)
    extended = ValueAnswer(encode_code(Code(150), Form.EXTENDED), Value.parse("H0080"))
    assert job.advance(answered(extended)) is None
    assert (job.step.code, job.pause_s) == (Code(9), 0.0)


def test_a_stop_refused_by_nak_is_repeated_and_read_back() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1)
    assert play(job, "nak nak")[:2] == ("WW", None)
    assert job.advance(value(150, "H0000")) is None
    job.advance(late(RESULTS["nak"], 6.0))
    assert (job.advance(late(value(150, "H0000"), 6.0)) or (None,))[0] is REFUSED


def test_a_stop_without_effect_is_said_again_for_five_seconds_with_pauses() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1)
    for sayings, at_s in enumerate((0.1, 1.0, 2.0, 3.0, 4.0, 4.9)):
        assert job.step.kind is StepKind.WRITE
        job.advance(late(RESULTS["ack"], at_s))
        assert job.pause_s == 0.0, "the proof follows at once"
        assert job.advance(late(value(150, "H0000"), at_s)) is None
        assert (job.pause_s > 0.0) is (sayings > 0)
    job.advance(late(RESULTS["ack"], 5.1))
    outcome, reason = job.advance(late(value(150, "H0000"), 5.1)) or (None, "")
    assert outcome is REFUSED
    assert "C0150 reads H0000" in reason


def test_a_drive_that_hears_again_after_seconds_is_stopped() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=2)
    for n in range(20):
        assert job.advance(late(RESULTS["none"], 0.2 * (n + 1))) is None
    while job.step.kind is StepKind.READ:
        job.advance(late(value(150, "H0000"), 4.2))
    job.advance(late(RESULTS["ack"], 4.3))
    assert (proven(job, SHOWN, 4.4)[1] or (None,))[0] is VERIFIED


@pytest.mark.parametrize(("said", "sayings"), [(False, 2), (True, 1)])
def test_however_late_its_turns_come_a_stop_is_said_twice_and_asked_for(
    said: bool, sayings: int
) -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=0, said=said)
    steps, verdict, at_s = "", None, 0.0
    while verdict is None:
        at_s += 60.0
        steps += "W" if job.step.kind is StepKind.WRITE else "R"
        verdict = job.advance(late(RESULTS["none"], at_s))
    assert (steps.count("W"), steps[-1]) == (sayings, "R")
    assert verdict[0] is UNKNOWN


def test_a_stop_of_a_silent_drive_is_unknown_when_its_time_is_over() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, patience_s=1.5)
    steps, outcome, _ = play(job, "none none none none")
    assert (steps, outcome) == ("WWRW", None)
    assert job.advance(late(RESULTS["none"], 1.6)) is None
    assert job.step.kind is StepKind.READ
    outcome, reason = job.advance(late(RESULTS["none"], 1.7)) or (None, "")
    assert outcome is UNKNOWN
    assert "not read back" in reason


def test_a_proof_the_drive_does_not_know_is_asked_for_twice() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1)
    assert play(job, "ack eot ack eot")[:2] == ("WRWR", UNKNOWN)


def test_a_member_that_cannot_be_read_back_after_a_multicast_is_told_alone() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, said=True)
    assert job.advance(late(RESULTS["none"], 9.0)) is None
    assert (job.step.kind, job.step.code) == (StepKind.WRITE, Code(40))


def test_the_control_word_counts_that_is_known_when_the_stop_is_said() -> None:
    words = [4]
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: words[0], retries=1)
    words[0] = 0x0200
    assert job.step.value == Value.parse("H0208")
    words[0] = 4
    assert job.step.value == Value.parse("H0208"), "what is on the wire is what is reported"


def test_a_word_of_more_than_16_bits_is_no_control_word() -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: 0x10000, retries=1)
    assert (job.step.kind, job.step.code) == (StepKind.READ, Code(135))
    assert job.advance(value(135, "H00010004")) is None
    assert (job.step.kind, job.step.code) == (StepKind.WRITE, Code(40))


def test_a_word_that_may_not_be_read_now_makes_an_inhibit_of_the_quick_stop() -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: None, retries=1)
    assert job.step.kind is StepKind.READ
    assert job.instead_of_reading_s(0.0, 0.4) == 0.0
    assert job.step == JobStep(StepKind.WRITE, Code(40), Value.parse("0"))


@pytest.mark.parametrize(
    ("results", "hold_s", "at_s", "until_s", "after_s"),
    [
        ("none", 0.0, 0.1, 0.6, 0.1),
        ("none", 0.0, 0.5, 1.0, 0.0),
        ("none", 0.23, 0.1, 0.6, 0.23),
        ("none", 0.0, 0.1, 0.2, None),  # the reading may be soon
        ("none", 0.0, 5.02, 10.0, None),  # it is no longer repeated
        ("ack", 0.0, 0.02, 0.52, 0.1),  # an old acknowledgement may have come
        ("ack shown", 0.0, 0.02, 0.52, None),
    ],
)
def test_a_stop_is_said_again_while_its_proof_may_not_be_read(
    *, results: str, hold_s: float, at_s: float, until_s: float, after_s: float | None
) -> None:
    station = dataclasses.replace(STATION, hold_s=hold_s)
    job = StopJob(station, StopAction.INHIBIT, word=lambda: None, retries=0, silent=True)
    for name in results.split():
        job.advance(value(150, "H0080") if name == "shown" else RESULTS[name])
    assert job.step.kind is StepKind.READ
    found_s = job.instead_of_reading_s(at_s, until_s)
    assert found_s == (None if after_s is None else pytest.approx(after_s))
    assert job.step.kind is (StepKind.READ if after_s is None else StepKind.WRITE)


def test_a_quick_stop_is_said_directly_after_its_word_was_read_but_else_lets_others_go() -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: None, retries=1)
    behind = [job.advance(one) or job.goes_behind for one in (value(135, "H0004"), RESULTS["none"])]
    assert behind == [False, True]
    silent = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: None, retries=1)
    silent.advance(RESULTS["none"])
    assert silent.goes_behind, "it cost the others one attempt; the next one waits for theirs"


@pytest.mark.parametrize("before", ["", "ack", "none"])
def test_a_stop_ends_unknown_when_the_line_is_lost(before: str) -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1)
    play(job, before)
    assert (job.advance(RESULTS["lost"]) or (None,))[0] is UNKNOWN


def test_after_a_multicast_a_stop_begins_with_reading_back_and_is_said_alone_if_need_be() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, said=True)
    assert job.step.kind is StepKind.READ
    assert job.cut_outcome is UNKNOWN
    assert job.advance(value(150, "H0000")) is None
    assert (job.step.kind, job.step.code) == (StepKind.WRITE, Code(40))


def test_a_quick_stop_said_by_multicast_is_made_good_with_the_word_it_needs() -> None:
    job = StopJob(STATION, StopAction.QUICK_STOP, word=lambda: 4, retries=1, said=True)
    job.advance(value(135, "H0004"))
    assert job.step.value == Value.parse("H000C")


# ---- multicasts -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("result", "outcome"), [("sent", DONE), ("echo", UNKNOWN), ("lost", UNKNOWN)]
)
def test_a_multicast_is_said_once(result: str, outcome: Outcome) -> None:
    job = MulticastJob(STATION, CODE, Value.decimal(7), processing_s=0.05)
    assert play(job, result)[:2] == ("M", outcome)


# ---- whose answer it is ---------------------------------------------------------------------


def doubted() -> Duplicates:
    """A line on which an answer came that nobody had asked for."""
    duplicates = Duplicates()
    duplicates.came(b"?0", 0.0)
    return duplicates


@pytest.mark.parametrize("silent", [False, True])
def test_where_answers_come_twice_or_a_drive_was_silent_one_reading_proves_nothing(
    silent: bool,
) -> None:
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=silent,
        duplicates=None if silent else doubted(),
    )  # fmt: skip
    job.advance(RESULTS["ack"])
    assert proven(job, SHOWN) == ("150s 150e 9s", (VERIFIED, "inhibit: C0150 reads H0080"))


def test_a_multicast_that_is_not_acknowledged_is_said_to_such_a_drive_alone() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, said=True, silent=True)
    assert proven(job, SHOWN) == ("150s", None)
    assert job.step.kind is StepKind.WRITE


@pytest.mark.parametrize(
    ("others_write_s", "verified"), [(None, True), (0.5, False), (-1.5, False), (-2.5, True)]
)
def test_an_offline_drive_needs_something_of_its_own_from_behind_the_time_of_late_answers(
    others_write_s: float | None, verified: bool
) -> None:
    """Where answers come twice: its acknowledgement or one reading, asked of no other drive."""
    duplicates, at_s = doubted(), 1.0
    for one in Form:
        duplicates.asked(encode_code(Code(150), one), "b", at_s - 0.1)
    if others_write_s is not None:
        duplicates.asked(ACK_FIELD, "b", others_write_s)
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=True, offline=True,
        duplicates=duplicates,
    )  # fmt: skip
    job.advance(late(RESULTS["ack"], at_s))
    asked, verdict = proven(job, SHOWN, at_s)
    assert len(asked.split()) == 3
    assert (verdict is not None and verdict[0] is VERIFIED) is verified
    if not verified:
        assert job.step.kind is StepKind.WRITE, "it is sent again for another acknowledgement"
        job.advance(late(RESULTS["ack"], 5.3))  # more than 3 s after the other's
        assert (proven(job, SHOWN, 5.4)[1] or (None,))[0] is VERIFIED


def test_an_offline_drive_that_shows_nothing_of_its_own_is_not_confirmed() -> None:
    duplicates, verdict, at_s = doubted(), None, 0.0
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=True, offline=True,
        duplicates=duplicates,
    )  # fmt: skip
    while verdict is None:
        at_s += 0.25
        for field in (*(encode_code(Code(150), one) for one in Form), ACK_FIELD):
            duplicates.asked(field, "b", at_s)
        job.advance(late(RESULTS["ack"], at_s))
        verdict = proven(job, SHOWN, at_s)[1]
    assert verdict[0] is UNKNOWN
    assert "it was offline, and its acknowledgement may be another drive's" in verdict[1]
    assert 7.0 < at_s < 8.0  # two seconds more for what is missing


def test_another_drives_address_is_no_proof() -> None:
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=True)
    for at_s in (0.1, 1.0, 2.0):
        job.advance(late(RESULTS["ack"], at_s))
        assert proven(job, SHOWN | {9: "2"}, at_s)[1] is None
    job.advance(late(RESULTS["ack"], 5.2))
    outcome, reason = proven(job, SHOWN | {9: "2"}, 6.5)[1] or (None, "")
    assert outcome is UNKNOWN
    assert "C0009, its address, reads 2, not 1: the answer may be another drive's" in reason


def test_a_drive_without_the_code_of_its_address_is_not_said_to_have_second_answers() -> None:
    """It was silent, and its readings are answers that another drive was asked for too."""
    duplicates, verdict, at_s = Duplicates(), None, 0.0
    job = StopJob(
        STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=True,
        duplicates=duplicates,
    )  # fmt: skip
    while verdict is None:
        at_s += 0.25
        for form in Form:
            duplicates.asked(encode_code(Code(150), form), "b", at_s)
        step, result = job.step, RESULTS["ack"]
        if step.kind is StepKind.READ:
            assert step.form is not None
            field = encode_code(step.code, step.form)
            shown = ValueAnswer(field, Value.parse("H0080"))
            result = answered(UnknownCodeAnswer(field) if step.code == Code(9) else shown)
        verdict = job.advance(late(result, at_s))
    outcome, reason = verdict
    assert outcome is UNKNOWN
    assert reason == (
        "inhibit was sent and C0150 reads H0080, but C0009, its address, does not exist in it, and "
        "another drive was asked for the same: the answer may be another drive's"
    )


def test_an_address_that_was_not_asked_for_is_not_said_to_read_otherwise() -> None:
    """The second reading is lost until the time of the stop is over."""
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, silent=True)
    at_s, verdict = 0.0, job.advance(RESULTS["ack"])
    while verdict is None:
        at_s = at_s + 0.1 if at_s < 4.9 else 7.2
        step, result = job.step, RESULTS["ack"]
        if step.kind is StepKind.READ:
            assert step.form is not None
            shown = answered(ValueAnswer(encode_code(step.code, step.form), Value.parse("H0080")))
            is_given = step.form is Form.STANDARD or at_s > 6.0
            result = shown if is_given else RESULTS["none"]
        verdict = job.advance(late(result, at_s))
    outcome, reason = verdict
    assert outcome is UNKNOWN
    assert reason == (
        "inhibit was sent and C0150 reads H0080, but C0009, its address, was not read: the answer "
        "may be another drive's"
    )


def test_a_drive_without_an_address_code_needs_answers_that_nobody_else_was_asked_for() -> None:
    duplicates = doubted()
    duplicates.asked(encode_code(Code(150), Form.EXTENDED), "b", 0.0)
    job = StopJob(STATION, StopAction.INHIBIT, word=lambda: None, retries=1, duplicates=duplicates)
    job.advance(RESULTS["ack"])
    for at_s in (0.1, 4.0):
        while job.step.kind is StepKind.READ and job.step.code == Code(150):
            assert job.step.form is not None
            field = encode_code(job.step.code, job.step.form)
            verdict = job.advance(late(answered(ValueAnswer(field, Value.parse("H0080"))), at_s))
        if job.step.code == Code(9):
            verdict = job.advance(late(RESULTS["eot"], at_s))
            assert verdict is None
    assert verdict is not None
    assert verdict[0] is VERIFIED


def test_proofs_of_several_drives_take_turns_with_the_form() -> None:
    duplicates, asked = Duplicates(), []
    for name, at_s in zip("abcd", (1.0, 1.1, 1.2, 1.3), strict=True):
        station = dataclasses.replace(STATION, name=name)
        job = StopJob(
            station, StopAction.INHIBIT, word=lambda: None, retries=1, duplicates=duplicates
        )
        job.advance(RESULTS["ack"])
        assert job.step.form is not None
        asked.append(job.step.form.value[0])
        duplicates.asked(encode_code(job.step.code, job.step.form), name, at_s)
    assert "".join(asked) == "sese"


def test_what_was_written_is_not_read_twice_in_a_form_in_which_it_was_shown() -> None:
    duplicates, written = doubted(), WrittenValue(CODE, Value.decimal(7))
    for form in Form:
        duplicates.asked(encode_code(CODE, form), "b", 0.0)
    job = ReadBackJob(STATION, written, 2, duplicates)
    first = job.step
    assert not first.only, "either form will do"
    assert first.form is not None
    field = encode_code(CODE, first.form)
    assert job.advance(answered(ValueAnswer(field, Value.parse("7.0")))) is None
    assert job.step.code == CODE
    assert job.step.only
    assert job.step.form is not first.form


# ---- what a quick stop may become -------------------------------------------------------------


def hoist(word: int | None) -> StopJob:
    return StopJob(STATION, StopAction.QUICK_STOP, word=lambda: word, retries=1, may_inhibit=False)


def test_a_refused_quick_stop_that_may_not_become_an_inhibit_stays_one() -> None:
    job, verdict, at_s = hoist(4), None, 0.0
    while verdict is None:
        assert job.step.code == Code(135)
        at_s += 0.1
        refused = RESULTS["nak"] if job.step.kind is StepKind.WRITE else value(135, "H0004")
        verdict = job.advance(late(refused, at_s))
    assert verdict[0] is REFUSED
    assert verdict[1].endswith("it was not inhibited instead: the roster says stop_fallback: none")
    assert 5.0 <= at_s < 6.0


def test_one_that_hears_and_is_not_heard_is_told_to_stop_with_its_last_known_word() -> None:
    job = StopJob(
        STATION, StopAction.QUICK_STOP, word=lambda: None, last_word=lambda: 0x0204, retries=1,
        may_inhibit=False,
    )  # fmt: skip
    verdict, at_s, said = None, 0.0, []
    while verdict is None:
        if job.step.kind is StepKind.WRITE:
            assert job.step.code == Code(135)
            said.append(job.step.value.raw if job.step.value is not None else "")
        at_s += 0.1
        verdict = job.advance(late(RESULTS["none"], at_s))
    assert len(said) > 1
    assert set(said) == {"H020C"}
    assert verdict[0] is UNKNOWN
    assert verdict[1].startswith("made from the control word as it was known last; quick-stop")


@pytest.mark.parametrize("result", ["none", "eot", "other"])
def test_nor_does_one_whose_word_cannot_be_read(result: str) -> None:
    job, verdict, at_s = hoist(None), None, 0.0
    while verdict is None:
        assert (job.step.kind, job.step.code) == (StepKind.READ, Code(135))
        at_s += 0.1
        reads = value(135, "SABC") if result == "other" else RESULTS[result]
        verdict = job.advance(late(reads, at_s))
        assert at_s < 0.4 or job.pause_s, "the line is left to others"
    assert verdict[0] is REFUSED, "nothing was said"
    assert "quick-stop needs C0135, which" in verdict[1]
    assert "stop_fallback: none" in verdict[1]
    assert 5.0 <= at_s < 6.0


def test_nor_one_whose_word_may_not_be_read_now() -> None:
    job = hoist(None)
    assert job.step.code == Code(135)
    assert job.instead_of_reading_s(0.0, 0.4) is None
