"""Carrying out a plan: inhibit, write, prove, compare, save, through losses and other people."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from backups.backups import answers, backup_of
from lecombus.backups import Restored, make_plan, restore
from lecombus.drives import family
from lecombus.parameters import Code, Value
from support.fake_drive import ENABLED, Ear, FakeDrive
from support.golden import Golden

FILE = {"C0001": "3", "C0011": "60", "C2011": "70"}
NOW = {1: "0", 11: "50", 2011: "50"}


def drive(texts: Mapping[int, str] = NOW, kind: str = "8200vector", **more: object) -> FakeDrive:
    return FakeDrive(kind, dict(texts), **more)  # type: ignore[arg-type]


def restored(
    one: FakeDrive, file: Mapping[str, str] = FILE, *, ear: Ear | None = None,
    noted: list[str] | None = None, unsaved: bool = False, patience_s: float = 60.0,
) -> Restored:  # fmt: skip
    now = answers({f"C{number:04d}": raw for number, raw in one.texts.items()})
    plan = make_plan(backup_of(one.kind, file), family(one.kind), now)
    assert plan.blockers == ()
    return asyncio.run(
        restore(
            one, plan, patience_s=patience_s, listener=ear or Ear(), unsaved=unsaved,
            written=lambda code, value: (noted if noted is not None else []).append(str(code)),
        )
    )  # fmt: skip


def test_an_enabled_drive_is_inhibited_written_in_order_and_left_inhibited() -> None:
    one, noted = drive({**NOW, **ENABLED}), list[str]()
    result = restored(one, noted=noted)
    assert one.writes == [("inhibit", ""), ("C0001", "3"), ("C0011", "60"), ("C2011", "70")]
    assert (result.complete, result.inhibited_here, result.saved) == (True, True, None)
    assert result.inhibited_now is True
    assert noted == ["C0001", "C0011", "C2011"]
    assert one.texts[40] == "0"


def test_an_inhibited_drive_is_not_inhibited_again() -> None:
    one = drive()
    assert not restored(one).inhibited_here
    assert one.writes[0] == ("C0001", "3")


def test_a_drive_that_somebody_enables_is_no_longer_written_to() -> None:
    one = drive(after_write=lambda one, code: one.enable_it())
    result = restored(one)
    assert [code for code, _ in one.writes] == ["C0001"]
    assert "lifted from elsewhere" in result.stopped
    assert not result.complete
    assert result.inhibited_now is False


def test_a_stop_ends_it_and_what_was_written_is_told(golden: Golden) -> None:
    one = drive()

    def stop(here: FakeDrive, code: Code) -> None:
        here.stopped = code == Code(11)

    one.before_write = stop
    result = restored(one)
    assert one.writes == [("C0001", "3")]
    assert [str(code) for code in result.written] == ["C0001"]
    golden(result.stopped)
    assert (result.complete, result.refused) == (False, {})


def test_a_stop_keeps_it_from_saving() -> None:
    one = drive({5: "1000"}, kind="93xx")

    def stop(here: FakeDrive, code: Code) -> None:
        here.stopped = code == Code(3)

    one.before_write = stop
    result = restored(one, {"C0005": "1011"})
    assert "not saved by C0003: ended by a stop of the drive" in result.stopped
    assert not result.complete


def test_an_enable_after_the_last_write_is_found_out_too() -> None:
    one = drive(after_write=lambda one, code: one.enable_it() if code.number == 2011 else None)
    assert "lifted from elsewhere" in restored(one).stopped


def test_after_a_loss_the_drive_is_inhibited_again_and_the_code_written() -> None:
    def pull(one: FakeDrive, code: Code) -> None:
        if code.number == 11 and ("C0011", "60") not in one.writes and not lost:
            lost.append(1)
            one.enable_it()  # a power cycle: it comes back as it starts
            one.lose()

    lost: list[int] = []
    one, ear = drive(before_write=pull), Ear()
    result = restored(one, ear=ear)
    assert result.complete
    assert [code for code, _ in one.writes] == ["C0001", "inhibit", "C0011", "C2011"]
    assert "waiting: the line is lost" in ear.said


def test_a_write_whose_answer_was_lost_is_not_repeated_when_it_happened() -> None:
    def pull(one: FakeDrive, code: Code) -> None:
        if code.number == 11:
            one.lose()

    one = drive(after_write=pull)
    assert restored(one).complete
    assert [code for code, _ in one.writes] == ["C0001", "C0011", "C2011"]


def test_a_line_that_stays_away_ends_it_and_says_why() -> None:
    one = drive(before_write=lambda one, code: one.lose(back_after=10**6))
    result = restored(one, patience_s=5.0)
    assert (result.stopped, result.complete, result.written) == ("the line is lost", False, {})


def test_what_is_refused_is_tried_once_more_after_the_others() -> None:
    def limits(one: FakeDrive, code: Code, value: Value) -> str:
        low = code.number == 11 and one.texts[2011] == "50"
        return "out of range" if low else ""

    one = drive(refuses=limits)
    result = restored(one)
    assert result.complete
    assert [code for code, _ in one.writes] == ["C0001", "C2011", "C0011"]


def test_what_stays_refused_is_told_and_the_rest_is_written() -> None:
    one = drive(refuses=lambda one, code, value: "NAK" if code.number == 11 else "")
    result = restored(one)
    assert result.refused == {Code(11): "NAK"}
    assert (result.complete, list(result.changed)) == (False, [])
    assert set(result.written) == {Code(1), Code(2011)}


def test_a_change_by_somebody_else_is_found_in_the_end() -> None:
    def meddle(one: FakeDrive, code: Code) -> None:
        if code.number == 2011:
            one.texts[1] = "2"

    result = restored(drive(after_write=meddle))
    wanted, found = result.changed[Code(1)]
    assert (wanted.raw, found.value) == ("3", Value.parse("2"))
    assert not result.complete


def test_what_was_right_already_is_compared_in_the_end_too() -> None:
    def meddle(one: FakeDrive, code: Code) -> None:
        one.texts[2011] = "1"

    result = restored(drive({**NOW, 2011: "70"}, after_write=meddle))
    assert list(result.changed) == [Code(2011)]


def test_a_93xx_is_saved_once_at_the_end() -> None:
    one = drive({5: "1000"}, kind="93xx")
    result = restored(one, {"C0005": "1011"})
    assert one.writes == [("C0005", "1011"), ("C0003", "1")]
    assert (result.saved, result.complete) == (True, True)


def test_nothing_half_right_is_saved() -> None:
    one = drive(
        {5: "1000", 12: "1"},
        kind="93xx",
        refuses=lambda one, code, value: "NAK" if code.number == 5 else "",
    )
    result = restored(one, {"C0005": "1011", "C0012": "2"})
    assert one.writes == [("C0012", "2")]
    assert (result.saved, result.complete, result.stopped) == (False, False, "")


def test_values_that_an_earlier_restore_left_unsaved_are_saved() -> None:
    one = drive({5: "1011"}, kind="93xx")
    assert restored(one, {"C0005": "1011"}, unsaved=True).saved is True
    assert one.writes == [("C0003", "1")]


def test_an_smvector_keeps_its_door_open_to_the_end() -> None:
    one = drive({1103: "50", 1420: "3"}, kind="smvector")
    assert restored(one, {"P420": "0", "P103": "60"}).complete
    assert one.writes == [("C1103", "60"), ("C1420", "0")]


def test_a_refused_code_is_named_as_at_the_keypad() -> None:
    one, ear = drive({1122: "1"}, kind="smvector", refuses=lambda one, code, value: "NAK"), Ear()
    restored(one, {"P122": "9"}, ear=ear)
    assert "P122 (function of terminal TB-13B) not taken: NAK" in ear.said
