"""Reading a drive whole, through losses of the line."""

from __future__ import annotations

import asyncio

from lecombus.backups import Taken, take
from lecombus.parameters import Code
from support.fake_drive import Ear, FakeDrive

CODES = [Code(number) for number in (1, 11, 12, 13)]


def drive(**more: object) -> FakeDrive:
    return FakeDrive("8200vector", {1: "3", 11: "50", 13: "5"}, **more)  # type: ignore[arg-type]


def taken(one: FakeDrive, ear: Ear, patience_s: float = 60.0, *, pass_over: bool = False) -> Taken:
    return asyncio.run(take(one, CODES, patience_s=patience_s, listener=ear, pass_over=pass_over))


def test_every_code_gets_its_answer_and_what_the_drive_refuses_is_asked_once() -> None:
    asked: list[Code] = []
    ear = Ear()
    found = taken(drive(before_read=lambda one, code: asked.append(code)), ear)
    assert {str(code): answer.kind for code, answer in found.answers.items()} == {
        "C0001": "", "C0011": "", "C0012": "no-such-code", "C0013": "",
    }  # fmt: skip
    assert asked == CODES
    assert ear.advanced[-1] == (4, 4)
    assert (found.gave_up, found.unsettled) == ("", [])


def test_after_a_loss_of_the_line_only_what_is_missing_is_asked_again() -> None:
    asked: list[int] = []

    def pull(one: FakeDrive, code: Code) -> None:
        asked.append(code.number)
        if len(asked) == 2:
            one.lose(back_after=3)

    ear = Ear()
    one = drive(before_read=pull)
    found = taken(one, ear)
    assert [answer.kind for answer in found.answers.values()] == ["", "", "no-such-code", ""]
    assert asked == [1, 11, 12, 13, 11, 12, 13]
    assert ear.said == ["waiting: the line is lost", "going on"]
    assert one.pauses == 3


def test_a_line_that_stays_away_ends_the_patience_and_says_so() -> None:
    one = drive(away="the line is lost", back_after=1000)
    found = taken(one, Ear(), patience_s=20.0)
    assert found.gave_up == "the line is lost"
    assert [answer.kind for answer in found.unsettled] == ["offline"] * 4
    assert 20.0 <= one.clock_s <= 22.0


def test_a_drive_that_is_offline_is_not_waited_for_where_others_come_after_it() -> None:
    one = drive(away="no answer", back_after=1000, is_offline=True)
    ear = Ear()
    found = taken(one, ear, pass_over=True)
    assert (found.gave_up, len(found.unsettled)) == ("no answer", 4)
    assert (one.pauses, ear.said) == (0, [])
    assert taken(drive(away="starting", back_after=5), ear, pass_over=True).unsettled == []


def test_a_drive_that_falls_silent_while_it_is_read_is_waited_for_even_then() -> None:
    def restart(one: FakeDrive, code: Code) -> None:
        if code.number == 11 and one.pauses == 0:
            one.lose(back_after=5)

    one = drive(before_read=restart, is_offline=True)
    assert (taken(one, Ear(), pass_over=True).unsettled, one.pauses) == ([], 5)


def test_a_code_that_never_answers_does_not_hold_up_the_rest_for_ever() -> None:
    asked: list[int] = []

    def drop(one: FakeDrive, code: Code) -> None:
        asked.append(code.number)
        one.away = "no answer" if code.number == 11 else ""
        one.back_after = 0

    found = taken(drive(before_read=drop), Ear())
    assert [str(answer.code) for answer in found.unsettled] == ["C0011"]
    assert asked.count(11) == 4
    assert asked.count(13) == 1
