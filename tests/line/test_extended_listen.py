"""How often the line listens longer: after misses in a row, seldom, and more seldom in vain."""

from __future__ import annotations

from itertools import pairwise

from lecombus.drives import family
from lecombus.fieldbus.lecom.exchanges.idle_receive import ExtendedListen
from lecombus.fieldbus.requests import Station
from lecombus.parameters import Code
from lecombus.schedule.shares import LISTEN_EVERY_S

STATUS, OTHER = Code(150), Code(46)


def station(name: str = "a") -> Station:
    kind = family("8200vector")
    return Station(name, 1, kind, kind.forms)


def test_only_misses_in_a_row_make_the_line_listen() -> None:
    patience, drive = ExtendedListen(), station()
    assert [patience.wanted(drive, STATUS, at_s) for at_s in (1.0, 2.0, 3.0)] == [
        False,
        False,
        True,
    ]
    drive.measured.note(STATUS, 0.02, 0.01, 4.0, write=False)
    assert [patience.wanted(drive, STATUS, at_s) for at_s in (5.0, 6.0, 7.0)] == [
        False,
        False,
        True,
    ]


def test_a_code_that_never_answers_is_listened_for_more_and_more_seldom() -> None:
    patience, drive, listened = ExtendedListen(), station(), list[float]()
    for second in range(36_000):
        if patience.wanted(drive, STATUS, float(second)):
            listened.append(float(second))
            patience.in_vain(drive, STATUS, float(second))
    waits = [late - early for early, late in pairwise(listened)]
    assert waits[:4] == [300.0, 600.0, 1200.0, 2400.0]
    assert set(waits[4:]) == {3600.0}


def test_a_line_with_many_absent_drives_listens_once_a_minute_at_most() -> None:
    patience, drives, listened = (
        ExtendedListen(),
        [station(str(one)) for one in range(31)],
        list[float](),
    )
    for second in range(3600):
        for drive in drives:
            if patience.wanted(drive, STATUS, float(second)):
                listened.append(float(second))
                patience.in_vain(drive, STATUS, float(second))
    assert len(listened) <= 3600 / LISTEN_EVERY_S
    assert len(listened) > 30


def test_an_answer_is_followed_by_one_more_try_and_then_by_a_minute() -> None:
    patience, drive, listened = ExtendedListen(), station(), list[float]()
    for second in range(600):
        if patience.wanted(drive, OTHER, float(second)):
            listened.append(float(second))
            patience.heard(float(second))
    assert len(listened) == 20
    assert listened[1] - listened[0] == 1.0
    assert listened[2] - listened[1] == LISTEN_EVERY_S


def test_what_was_cut_short_is_tried_again_soon_but_not_at_once() -> None:
    patience, drive = ExtendedListen(), station()
    for at_s in (1.0, 2.0, 3.0):
        patience.wanted(drive, STATUS, at_s)
    patience.cut(3.0)
    assert not patience.wanted(drive, STATUS, 3.5)
    assert patience.wanted(drive, STATUS, 5.0)
