"""The book of leases: take, renew, take over, release, lapse, latch, enable, and a reload."""

from __future__ import annotations

import pytest

from lecombus.errors import OperationError
from lecombus.leases import EndOfLease, HeldLease, Latch, LeaseBook, LeaseTerms, Use

REQUIRED = LeaseTerms(True, 2.0, "quick-stop")
FREE = LeaseTerms(False, 5.0, "quick-stop")


def a_book(now_s: float = 0.0, **terms: LeaseTerms) -> LeaseBook:
    book = LeaseBook(6)
    book.set_terms(terms or {"a": REQUIRED, "b": REQUIRED, "c": FREE}, now_s)
    return book


def taken(
    book: LeaseBook, name: str = "plc", drives: str = "ab", now_s: float = 0.0, take_over: str = ""
) -> HeldLease:
    return book.take(
        name, drives, drives, 2.0, 1, now_s, secret=f"{name}{now_s}", take_over=take_over
    )


def objection(book: LeaseBook, drive: str, token: str, now_s: float, use: Use = Use.MOTION) -> str:
    found = book.objection(drive, token, use, now_s)
    return "" if found is None else found.kind


def refused(call: object, *args: object, **kwargs: object) -> OperationError:
    with pytest.raises(OperationError) as caught:
        call(*args, **kwargs)  # type: ignore[operator]
    return caught.value


def test_after_a_start_a_drive_that_needs_a_lease_takes_nothing_until_it_is_enabled() -> None:
    book = a_book()
    assert objection(book, "a", "", 0.0) == "lease-required"
    assert objection(book, "c", "", 0.0) == ""
    lease = taken(book, now_s=1.0)
    assert (lease.number, lease.ends_at_s) == (7, 3.0)
    assert objection(book, "a", lease.token, 1.0) == "latched"
    assert objection(book, "a", lease.token, 1.0, Use.SETTING) == ""
    assert objection(book, "a", lease.token, 1.0, Use.ENABLE) == ""
    assert book.enabled("a", lease.token, 1.5)
    assert objection(book, "a", lease.token, 1.5) == ""
    assert objection(book, "b", lease.token, 1.5) == "latched", "each drive is enabled alone"
    assert objection(book, "a", "", 1.5) == "lease-required"


def test_a_lease_lapses_at_its_time_and_its_end_is_handed_out_once() -> None:
    book = a_book()
    lease = taken(book)
    book.enabled("a", lease.token, 0.5)
    assert book.next_s() == 2.0
    assert objection(book, "a", lease.token, 1.999) == ""
    assert objection(book, "a", lease.token, 2.0) == "lease-lost"
    ended = book.take_ended(2.0)
    assert [(one.name, one.drives, one.end) for one in ended] == [
        ("plc", ("a", "b"), EndOfLease.LAPSED)
    ]
    assert book.take_ended(3.0) == []
    assert book.drives["a"].latch is Latch.LAPSED
    assert refused(book.renew, "plc", lease.token, 2, 2.5).kind == "lease-lost"
    assert "lease plc lapsed 1s ago" in str(book.objection("a", lease.token, Use.MOTION, 3.0))


def test_a_renewal_needs_a_larger_counter() -> None:
    book = a_book()
    lease = taken(book)
    assert book.renew("plc", lease.token, 5, 1.0).ends_at_s == 3.0
    for counter in (5, 4, 1):
        assert refused(book.renew, "plc", lease.token, counter, 1.5).kind == "stale-counter"
    assert lease.ends_at_s == 3.0
    assert refused(book.renew, "plc", "7-guessed", 9, 1.5).kind == "lease-lost"


def test_a_lease_is_taken_over_only_by_its_name_and_its_token_counts_no_more() -> None:
    book = a_book()
    old = taken(book)
    book.enabled("a", old.token, 0.0)
    assert refused(taken, book, "other", "a").kind == "lease-held"
    assert refused(taken, book, "plc", "c").kind == "lease-held"
    assert refused(taken, book, "other", "ab", take_over="someone").kind == "no-such-lease"
    assert "also holds b" in str(refused(taken, book, "other", "a", take_over="plc"))
    assert objection(book, "a", old.token, 1.0) == "", "what is refused changes nothing"
    new = taken(book, "other", "abc", 1.0, take_over="plc")
    assert objection(book, "a", old.token, 1.0) == "lease-lost"
    assert refused(book.renew, "plc", old.token, 9, 1.0).kind == "lease-lost"
    assert refused(book.release, "plc", old.token, 1.0).kind == "lease-lost"
    assert objection(book, "a", new.token, 1.0) == "", "the drive goes on"
    assert objection(book, "b", new.token, 1.0) == "latched", "one that waited waits on"
    assert objection(book, "c", new.token, 1.0) == ""
    assert book.take_ended(1.0) == [], "nothing is stopped"
    assert "was taken over by other 1s ago" in str(book.objection("a", old.token, Use.MOTION, 2.0))


def test_a_client_that_lost_its_token_takes_its_own_lease_over() -> None:
    book = a_book()
    old = taken(book)
    new = taken(book, now_s=1.0, take_over="plc")
    assert new.number == old.number + 1
    assert refused(book.renew, "plc", old.token, 9, 1.0).kind == "lease-lost"
    assert book.renew("plc", new.token, 2, 1.0) is new


def test_a_lease_that_is_given_up_stops_the_drives_that_need_one_and_no_others() -> None:
    book = a_book()
    lease = taken(book, drives="ac")
    book.enabled("a", lease.token, 0.0)
    book.release("plc", lease.token, 1.0)
    ended = book.take_ended(1.0)
    assert [(one.drives, one.end) for one in ended] == [(("a",), EndOfLease.RELEASED)]
    assert book.drives["a"].latch is Latch.RELEASED
    assert objection(book, "c", "", 1.0) == ""
    assert objection(book, "c", lease.token, 1.0) == "lease-lost", (
        "its token does not count as none"
    )


def test_a_lapse_stops_and_latches_also_a_drive_that_needs_no_lease() -> None:
    book = a_book()
    lease = taken(book, drives="c")
    assert objection(book, "c", "", 1.0) == "lease-required", "someone holds it"
    assert [one.drives for one in book.take_ended(2.0)] == [("c",)]
    assert objection(book, "c", "", 2.0) == "lease-required"
    new = taken(book, "again", "c", 3.0)
    assert objection(book, "c", new.token, 3.0) == "latched"
    assert not book.enabled("c", lease.token, 3.0)
    assert book.enabled("c", new.token, 3.0)
    book.release("again", new.token, 4.0)
    assert objection(book, "c", "", 4.0) == ""


def test_a_drive_without_the_verb_enable_is_enabled_by_the_lease_itself() -> None:
    book = a_book(a=LeaseTerms(True, 2.0, "silence", has_enable=False))
    lease = taken(book, drives="a")
    assert objection(book, "a", lease.token, 0.0) == ""


@pytest.mark.parametrize("time_s", [0.05, 2.5, 3600.0, -1.0])
def test_a_time_is_refused_that_the_roster_does_not_allow(time_s: float) -> None:
    book = a_book()
    problem = refused(book.take, "plc", "ac", "ac", time_s, 1, 0.0, secret="x")
    assert (problem.kind, problem.remedy) == ("bad-value", "ask for 100ms to 2s")


def test_after_a_start_each_drive_is_due_once_unless_a_lease_is_taken() -> None:
    book = a_book()
    assert (book.next_s(), book.due(1.9)) == (2.0, [])
    taken(book, drives="a", now_s=1.0)
    assert book.due(2.0) == ["b"]
    book.start_done("b")
    assert book.due(99.0) == []


def test_a_reload_that_requires_a_lease_latches_the_drive() -> None:
    book = a_book(c=FREE)
    book.set_terms({"c": REQUIRED}, 10.0)
    assert (book.drives["c"].latch, book.due(12.0)) == (Latch.STARTED, ["c"])
    book.set_terms({"c": FREE}, 13.0)
    assert objection(book, "c", "", 13.0) == ""
    lease = taken(book, drives="c", now_s=13.0)
    book.set_terms({"c": REQUIRED}, 14.0)
    assert book.drives["c"].latch is None, "its holder goes on"
    assert objection(book, "c", lease.token, 14.0) == ""


def test_a_reload_shortens_leases_and_takes_drives_out() -> None:
    book = a_book(a=FREE, b=FREE)
    lease = book.take("plc", "ab", "ab", 5.0, 1, 0.0, secret="x")
    book.set_terms({"a": REQUIRED}, 1.0)
    assert (lease.drives, lease.time_s, lease.ends_at_s) == (("a",), 2.0, 3.0)
    book.set_terms({}, 2.0)
    assert book.leases(2.0) == []
    assert book.take_ended(9.0) == []


def test_a_token_is_not_shown() -> None:
    lease = taken(a_book())
    assert lease.secret not in repr(lease)


def test_a_token_of_any_characters_is_compared() -> None:
    book = a_book()
    taken(book)
    for token in ("\ud800", "ü", "7-", "7-plc0.00", " 7-plc0.0"):
        assert objection(book, "a", token, 0.0) == "lease-lost"
