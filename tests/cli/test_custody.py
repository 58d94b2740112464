"""accept, readdress, wear and forget-times: shown before done, and never done unasked."""

from __future__ import annotations

import json
from typing import Any

import click
import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.cli import drive_commands

pytestmark = pytest.mark.clock

OLD, NEW = {"C1810": "OLD", "C1811": "x"}, {"C1810": "NEW", "C1811": "x"}


def identity(found: dict[str, str], accepted: dict[str, str], problem: str | None = None) -> str:
    return json.dumps(
        {"drive": "feeder", "found": found, "accepted": accepted, "roster": {},
         "accepted_at": None, "problem": problem}
    )  # fmt: skip


def posted(daemon: DaemonStub) -> list[tuple[str, Any]]:
    return [(asked, json.loads(body)) for asked, body in daemon.asked if asked.startswith("POST")]


@pytest.fixture
def swapped(daemon: DaemonStub) -> DaemonStub:
    daemon.answers["GET /v1/drives/feeder/identity"] = (200, identity(NEW, OLD, "swapped"))
    daemon.answers["POST /v1/drives/feeder/accept"] = (200, identity(NEW, NEW))
    return daemon


def test_accept_in_a_pipe_shows_both_and_does_nothing_unseen(run: Run, swapped: DaemonStub) -> None:
    ran = run("accept", "feeder")
    assert ran.status == 2
    assert "C1810\tOLD\tNEW" in ran.out
    assert "--seen C1810=NEW" in ran.err
    assert posted(swapped) == []


def test_accept_repeats_the_whole_identity_to_the_daemon(run: Run, swapped: DaemonStub) -> None:
    ran = run("accept", "feeder", "--seen", "C1810=NEW")
    assert ran.status == 0
    assert posted(swapped) == [("POST /v1/drives/feeder/accept", {"identity": NEW})]


@pytest.mark.parametrize("seen", [["C1810=OTHER"], ["C1811=x"], ["C1810=NEW", "C0200=Q"]])
def test_accept_of_something_else_than_is_there_is_refused(
    run: Run, swapped: DaemonStub, seen: list[str]
) -> None:
    words = [word for one in seen for word in ("--seen", one)]
    ran = run("accept", "feeder", *words)
    assert ran.status == 2
    assert "--seen C1810=NEW" in ran.err
    assert posted(swapped) == []


@pytest.mark.parametrize("seen", ["C1810", "C1810=", "=NEW", "CX=1"])
def test_what_is_no_code_and_value_is_said(run: Run, swapped: DaemonStub, seen: str) -> None:
    assert run("accept", "feeder", "--seen", seen).status == 2


@pytest.mark.parametrize(("answer", "status"), [(True, 0), (False, 1)])
def test_accept_asks_whoever_can_be_asked(
    run: Run, swapped: DaemonStub, monkeypatch: pytest.MonkeyPatch, answer: bool, status: int
) -> None:
    monkeypatch.setattr(drive_commands, "on_terminal", lambda: True)
    monkeypatch.setattr(click, "confirm", lambda text: answer)
    assert run("accept", "feeder").status == status
    assert bool(posted(swapped)) is answer


def test_a_drive_that_is_the_one_it_was_needs_no_accepting(run: Run, daemon: DaemonStub) -> None:
    stand_there(daemon, "online")
    ran = run("accept", "feeder")
    assert ran.status == 0
    assert "is the same drive as before" in ran.out
    assert posted(daemon) == []
    asked = [one for one, _ in daemon.asked if "/codes/" in one]
    assert [one.partition("?")[0].rpartition("/")[2] for one in asked] == ["C1810", "C1811"]
    assert all("fresh=true" in one for one in asked), "its audit may be long ago"


def test_a_drive_that_says_otherwise_when_asked_again_is_not_the_one_it_was(
    run: Run, daemon: DaemonStub
) -> None:
    stand_there(daemon, "starting", "C1810 reads NEW, not OLD: to be audited")
    ran = run("accept", "feeder")
    assert ran.status == 1
    assert "feeder is starting: C1810 reads NEW, not OLD: to be audited" in ran.err
    assert "is the same drive as before" not in ran.out


def stand_there(daemon: DaemonStub, state: str, reason: str = "") -> None:
    daemon.answers["GET /v1/drives/feeder/identity"] = (200, identity(OLD, OLD))
    for code in OLD:
        daemon.answers[f"GET /v1/drives/feeder/codes/{code}?fresh=true"] = (200, "{}")
    daemon.answers["GET /v1/drives/feeder"] = (
        200, json.dumps({"state": state, "reason": reason or None})
    )  # fmt: skip


REPORT = (
    '{"drive": "feeder", "code": "C0009", "subcode": 0, "outcome": "verified",'
    ' "reason": "it answers at address 35 now", "cause": null, "remedy": "write it", '
    '"reading": null}'
)
DRIVE = '{"drive": "feeder", "address": 11, "family": "821x", "identity": {"C1810": "OLD"}}'


@pytest.fixture
def movable(daemon: DaemonStub) -> DaemonStub:
    daemon.answers["GET /v1/drives/feeder"] = (200, DRIVE)
    daemon.answers["POST /v1/drives/feeder/address"] = (200, REPORT)
    return daemon


def test_readdress_is_not_done_unasked(run: Run, movable: DaemonStub) -> None:
    ran = run("readdress", "feeder", "35")
    assert (ran.status, posted(movable)) == (2, [])
    assert "--yes" in ran.err


def test_an_address_that_no_drive_can_have_is_refused_before_anybody_is_asked(
    run: Run, movable: DaemonStub
) -> None:
    ran = run("readdress", "feeder", "20")
    assert (ran.status, movable.asked) == (2, [])
    assert "20 is not a drive's address; 1 to 99 without 10, 20 .. 90 would be right" in ran.err


def test_readdress_says_how_it_ended_and_what_to_do(run: Run, movable: DaemonStub) -> None:
    ran = run("readdress", "feeder", "35", "--yes")
    assert ran.status == 0
    assert posted(movable) == [("POST /v1/drives/feeder/address", {"address": 35})]
    assert ran.out == "feeder\tC0009\tverified\t\tit answers at address 35 now; write it\n"
    assert run("readdress", "feeder", "35", "--yes", "--json").out == REPORT + "\n"


@pytest.mark.parametrize(("answer", "status"), [(True, 0), (False, 1)])
def test_readdress_asks_whoever_can_be_asked(
    run: Run, movable: DaemonStub, monkeypatch: pytest.MonkeyPatch, answer: bool, status: int
) -> None:
    monkeypatch.setattr(drive_commands, "on_terminal", lambda: True)
    monkeypatch.setattr(click, "confirm", lambda text: answer)
    ran = run("readdress", "feeder", "35")
    assert ran.status == status
    assert "feeder at address 11 (821x), which is C1810 OLD" in ran.out
    assert bool(posted(movable)) is answer


@pytest.mark.parametrize("address", ["0", "100", "x", "1.5"])
def test_readdress_takes_addresses_only(run: Run, movable: DaemonStub, address: str) -> None:
    assert run("readdress", "feeder", address, "--yes").status == 2


def test_wear_lists_what_was_written(run: Run, daemon: DaemonStub) -> None:
    document = (
        '{"drive": "feeder", "burst": 30, "every_s": 600.000, "codes": [{"code": "C0012", "name": '
        '"acceleration time", "writes": 42, "to_this_device": 2, "wait_s": 90.000}]}'
    )
    daemon.answers["GET /v1/drives/feeder/wear"] = (200, document)
    assert run("wear", "feeder").out.startswith("C0012\tacceleration time\t42\t2\t")
    assert run("wear", "feeder", "--json").out == document + "\n"


def test_on_a_terminal_codes_are_named_as_at_the_keypad(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = {"code": "C1425", "name": "time-out", "writes": 4, "to_this_device": 2}
    forgotten = {"code": "C1425", "write": False, "manual_s": 0.02, "measured_s": 0.25}
    texts = {"C1502": "1"}
    daemon.answers["GET /v1/drives/feeder"] = (
        200, json.dumps({"drive": "feeder", "family": "smvector", "state": "online"})
    )  # fmt: skip
    daemon.answers["GET /v1/drives/feeder/wear"] = (200, json.dumps({"codes": [row]}))
    daemon.answers["POST /v1/drives/feeder/forget-times"] = (
        200, json.dumps({"forgotten": [forgotten]})
    )  # fmt: skip
    daemon.answers["GET /v1/drives/feeder/identity"] = (200, identity(texts, texts, "x"))
    words = ("wear", "forget-times", "accept")
    assert [run(word, "feeder").out[:5] for word in words] == ["C1425", "C1425", "C1502"]
    monkeypatch.setattr(drive_commands, "on_terminal", lambda: True)
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    assert [run(word, "feeder").out[:4] for word in words] == ["P425", "P425", "P502"]
    daemon.answers["GET /v1/drives/feeder"] = (404, "{}")
    assert run("wear", "feeder").out.startswith("C1425\t")


def test_forget_times_shows_what_is_forgotten(run: Run, daemon: DaemonStub) -> None:
    row = {"code": "C0150", "write": False, "manual_s": 0.02, "measured_s": 0.25}
    document = json.dumps({"drive": "feeder", "forgotten": [row]})
    daemon.answers["POST /v1/drives/feeder/forget-times"] = (200, document)
    ran = run("forget-times", "feeder")
    assert (ran.status, ran.out) == (0, "C0150\tread\t0.020\t0.250\n")
    assert run("forget-times", "feeder", "--json").out.strip() == document


def test_forget_times_says_in_a_pipe_too_that_there_was_nothing(
    run: Run, daemon: DaemonStub
) -> None:
    document = json.dumps({"drive": "feeder", "forgotten": []})
    daemon.answers["POST /v1/drives/feeder/forget-times"] = (200, document)
    ran = run("forget-times", "feeder")
    assert (ran.status, ran.out) == (0, "")
    assert "nothing was measured of feeder" in ran.err


UNKNOWN = json.dumps(
    {
        "type": "urn:lecombus:problem:unknown", "title": "Outcome unknown", "status": 504,
        "detail": "lecombus started again since this was asked for", "drive": None, "code": None,
        "cause": None, "remedy": "look at the drive, then ask for it again", "outcome": "unknown",
    }
)  # fmt: skip


@pytest.mark.parametrize(
    ("words", "path"),
    [
        (("accept", "feeder", "--seen", "C1810=NEW"), "/v1/drives/feeder/accept"),
        (("forget-times", "feeder"), "/v1/drives/feeder/forget-times"),
        (("reload",), "/v1/reload"),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_what_is_not_known_to_be_done_is_not_said_to_be(
    run: Run, swapped: DaemonStub, words: tuple[str, ...], path: str, as_json: bool
) -> None:
    swapped.answers[f"POST {path}"] = (504, UNKNOWN)
    ran = run(*words, *(["--json"] if as_json else []))
    assert (ran.status, ran.out) == (1, "")
    assert "lecombus started again since this was asked for" in ran.err
