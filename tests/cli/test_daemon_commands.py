"""read, write, group, stop and status against a daemon reduced to its answers."""

from __future__ import annotations

import json
import time

import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.api.answers import REMEDIES
from lecombus.cli import status, verb_commands
from lecombus.cli.daemon_access import act
from lecombus.cli.screen import mark
from lecombus.client.documents import Answer
from support.golden import Golden

pytestmark = pytest.mark.clock

READING = (
    '{"drive": "feeder", "code": "C0046", "subcode": 0, "name": "frequency setpoint",'
    ' "value": 50.10, "raw": "50.10", "format": "VD", "unit": "Hz", "quality": "good",'
    ' "reason": null, "time": "2026-11-21T10:15:02.113Z", "age_s": 0.4}'
)
WRITTEN = (
    '{"drive": "feeder", "code": "C0046", "outcome": "verified", "reason": "",'
    f' "reading": {READING}}}'
)
NAK = (
    '{"type": "urn:lecombus:problem:nak", "title": "Refused by the drive", "status": 409,'
    ' "detail": "feeder answered NAK", "drive": "feeder", "code": "C0046",'
    ' "cause": "C0001 is not 3", "remedy": "set C0001 to 3", "outcome": "refused"}'
)


def problem(kind: str, status: int) -> tuple[int, str]:
    text = json.dumps(
        {
            "type": f"urn:lecombus:problem:{kind}",
            "title": "Short",
            "status": status,
            "detail": "what happened",
            "drive": "feeder",
            "code": None,
            "cause": None,
            "remedy": "what to do",
            "outcome": None,
        }
    )
    return status, text


def test_read_asks_the_drive_itself(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/feeder/codes/C0046?fresh=true"] = (200, READING)
    ran = run("read", "feeder", "46")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == "feeder\tC0046\t50.10\tHz\tgood\t\n"


def test_read_stored_asks_what_is_known(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/feeder/codes/C0046"] = (200, READING)
    assert run("read", "feeder", "C46", "--stored").status == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["feeder", "C0046", "--baud", "9600"], "without --port, --baud would do nothing"),
        (["feeder", "C0046", "--family", "93xx"], "without --port, --family would do nothing"),
        (["feeder", "C0046", "--address", "3"], "without --port, --address would do nothing"),
        (["feeder", "C0046", "--stored", "--address", "3", "--baud", "19200"],
         "without --port, --address, --baud would do nothing"),
        (["--port", "/dev/x", "--address", "3", "--stored", "C0046"],
         "--stored shows what a daemon knows; with --port no daemon is asked"),
        (["--port", "/dev/x", "--address", "3", "--socket", "x.sock", "C0046"],
         "--port and a daemon are both given"),
        (["--port", "", "feeder", "C0046"], "it is empty; name the port, or leave it out"),
    ],
)  # fmt: skip
def test_an_option_of_read_that_would_do_nothing_is_refused(
    run: Run, daemon: DaemonStub, words: list[str], said: str
) -> None:
    daemon.answers["GET /v1/drives/feeder/codes/C0046?fresh=true"] = (200, READING)
    daemon.answers["GET /v1/drives/feeder/codes/C0046"] = (200, READING)
    ran = run("read", *words)
    assert (ran.status, ran.out, daemon.asked) == (2, "", [])
    assert said in ran.err


def test_a_subcode_becomes_part_of_the_path(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/a%20b/codes/C0039/1?fresh=true"] = (200, READING)
    assert run("read", "a b", "C0039/1").status == 0


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../line", "x" * 65])
@pytest.mark.parametrize(
    ("kind", "command"),
    [
        ("drive", ["read", "NAME", "C0046"]),
        ("drive", ["write", "NAME", "C0046", "1"]),
        ("drive", ["enable", "NAME"]),
        ("drive", ["why", "NAME"]),
        ("drive", ["wear", "NAME"]),
        ("drive", ["forget-times", "NAME"]),
        ("drive", ["accept", "NAME"]),
        ("drive", ["readdress", "NAME", "12", "--yes"]),
        ("group", ["group", "NAME", "C0046", "1"]),
    ],
)
def test_what_no_drive_is_called_is_never_a_path(
    run: Run, daemon: DaemonStub, kind: str, command: list[str], name: str
) -> None:
    ran = run(*[name if word == "NAME" else word for word in command])
    assert ran.status == 2
    assert f"there is no {kind} `" in ran.err
    assert "/v1" not in ran.err
    assert daemon.asked == []


def test_no_remedy_for_people_is_a_path_of_the_api() -> None:
    assert [one for one in REMEDIES.values() if "/v1" in one or "openapi" in one] == []


def test_json_is_the_daemons_document_to_the_last_digit(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/feeder/codes/C0046?fresh=true"] = (200, READING)
    assert run("read", "feeder", "C0046", "--json").out == READING + "\n"


def test_a_bad_value_is_a_failure_with_its_reason(run: Run, daemon: DaemonStub) -> None:
    bad = READING.replace('"good"', '"bad"').replace('"reason": null', '"reason": "no answer"')
    daemon.answers["GET /v1/drives/feeder/codes/C0046"] = (200, bad)
    ran = run("read", "feeder", "C0046", "--stored")
    assert ran.status == 1
    assert ran.out.endswith("\tbad\tno answer\n")
    assert run("read", "feeder", "C0046", "--stored", "--json").status == 1


@pytest.mark.parametrize(
    ("kind", "http", "status"),
    [
        ("no-such-drive", 404, 2),
        ("no-such-code", 404, 1),
        ("bad-request", 422, 2),
        ("not-writable", 403, 4),
        ("read-only", 403, 4),
        ("line-lost", 503, 1),
        ("no-answer", 504, 1),
        ("internal", 500, 1),
    ],
)
def test_a_problem_is_one_line_and_its_exit_status(
    run: Run, daemon: DaemonStub, kind: str, http: int, status: int
) -> None:
    daemon.answers["GET /v1/drives/feeder/codes/C0046?fresh=true"] = problem(kind, http)
    ran = run("read", "feeder", "C0046")
    assert (ran.status, ran.out) == (status, "")
    assert ran.err == "what happened; what to do\n"


def test_a_problem_is_json_where_json_is_asked_for(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/feeder"] = problem("no-such-drive", 404)
    ran = run("status", "feeder", "--json")
    assert json.loads(ran.err) == {
        "status": 2,
        "problem": "what happened",
        "remedy": "what to do",
        "kind": "no-such-drive",
        "drive": "feeder",
    }


@pytest.mark.parametrize(
    ("word", "sent"),
    [
        ("-5", "-5"),
        ("-.5", "-0.5"),
        ("35.40", "35.40"),
        ("214748.3647", "214748.3647"),
        ("0208", "0208"),
        ("H09ab", "H09AB"),
        ("h0208", "H0208"),
        ("0x0208", "0x0208"),
        ("0X2", "0X2"),
        ("O1A2b", "O1A2B"),
    ],
)
def test_a_value_is_sent_as_text_digit_by_digit(
    run: Run, daemon: DaemonStub, word: str, sent: str
) -> None:
    daemon.answers["PUT /v1/drives/feeder/codes/C0046"] = (200, WRITTEN)
    assert run("write", "feeder", "C0046", word).status == 0
    assert daemon.asked[0][1] == f'{{"value": "{sent}", "verify": false}}'


def test_write_says_what_came_of_it(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["PUT /v1/drives/feeder/codes/C0046"] = (200, WRITTEN)
    ran = run("write", "feeder", "C0046", "50.1", "--verify", "--expires", "1.5s")
    assert ran.out == "feeder\tC0046\tverified\t50.10 Hz\t\n"
    assert json.loads(daemon.asked[0][1]) == {"value": "50.1", "verify": True, "expires": "1500ms"}


def test_a_refused_write_tells_cause_and_remedy(
    run: Run, daemon: DaemonStub, golden: Golden
) -> None:
    daemon.answers["PUT /v1/drives/feeder/codes/C0046"] = (409, NAK)
    ran = run("write", "feeder", "C0046", "50")
    assert ran.status == 1
    assert ran.out.split("\t")[:3] == ["feeder", "C0046", "refused"]
    golden(ran.out)
    assert run("write", "feeder", "C0046", "50", "--json").out == NAK + "\n"


def test_group_shows_every_member(run: Run, daemon: DaemonStub) -> None:
    members = f"[{WRITTEN}, {WRITTEN.replace('verified', 'unknown')}]"
    report = f'{{"how": "one-by-one", "outcome": "unknown", "members": {members}}}'
    daemon.answers["PUT /v1/groups/conveyors/codes/C0046"] = (504, report)
    ran = run("group", "conveyors", "C0046", "-5")
    assert ran.status == 1
    assert [line.split("\t")[2] for line in ran.out.splitlines()] == ["verified", "unknown"]


def test_a_multicast_that_was_only_sent_is_not_done_and_says_why(
    run: Run, daemon: DaemonStub
) -> None:
    members = ", ".join([WRITTEN.replace("verified", "unknown")] * 2)
    report = f'{{"how": "multicast", "outcome": "unknown", "members": [{members}]}}'
    daemon.answers["PUT /v1/groups/conveyors/codes/C0046"] = (504, report)
    ran = run("group", "conveyors", "C0046", "5", "--no-verify")
    assert ran.status == 1
    assert ran.err.count("\n") == 1
    assert "no drive acknowledges, and --no-verify was given" in ran.err
    assert run("group", "conveyors", "C0046", "5").err == ""
    one_by_one = report.replace("multicast", "one-by-one")
    daemon.answers["PUT /v1/groups/conveyors/codes/C0046"] = (504, one_by_one)
    assert run("group", "conveyors", "C0046", "5", "--no-verify").err == ""


@pytest.mark.parametrize(("members", "title"), [(1, False), (2, True)])
def test_how_it_was_sent_is_told_for_several_drives_only(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, members: int, title: bool
) -> None:
    monkeypatch.setattr("lecombus.cli.screen.on_terminal", lambda: True)
    told = ", ".join([WRITTEN] * members)
    report = f'{{"how": "one-by-one", "outcome": "verified", "members": [{told}]}}'
    daemon.answers["POST /v1/stop"] = (200, report)
    assert ("as one write after another: verified" in run("stop").out) is title


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        ([], {"action": "quick-stop", "target": "all"}),
        (["--all"], {"action": "quick-stop", "target": "all"}),
        (["feeder", "--action", "inhibit"], {"action": "inhibit", "target": "feeder"}),
    ],
)
def test_stop_without_a_target_stops_everything(
    run: Run, daemon: DaemonStub, words: list[str], sent: dict[str, str]
) -> None:
    report = f'{{"how": "multicast", "outcome": "verified", "members": [{WRITTEN}]}}'
    daemon.answers["POST /v1/stop"] = (200, report)
    assert run("stop", *words).status == 0
    assert json.loads(daemon.asked[0][1]) == sent


REMEDY = "the motor may turn: look at it"


def stopped(drive: str, outcome: str, reason: str) -> dict[str, object]:
    remedy = None if outcome == "verified" else REMEDY
    return {
        "drive": drive, "code": "C0135", "outcome": outcome, "reason": reason, "remedy": remedy,
    }  # fmt: skip


def answer_stop(daemon: DaemonStub, *members: dict[str, object]) -> None:
    report = {"how": "one-by-one", "outcome": "unknown", "members": members}
    daemon.answers["POST /v1/stop"] = (504, json.dumps(report))


@pytest.mark.parametrize(
    "words",
    [["stop"], ["quick-stop", "infeed"], ["inhibit", "infeed"], ["stop", "--action", "inhibit"]],
)
def test_a_stop_that_is_not_confirmed_says_so_before_everything_else(
    run: Run, daemon: DaemonStub, words: list[str], golden: Golden
) -> None:
    lost = "{} (address 12), C0135: no answer in time (attempt {})"
    answer_stop(
        daemon,
        stopped("a", "verified", "it reads so"),
        stopped("b", "unknown", lost.format("b", 3)),
        stopped("c", "unknown", lost.format("c", 5)),
    )
    ran = run(*words)
    first, *rest = ran.err.splitlines()
    assert ran.status == 1
    golden(first)
    assert rest == [f"b, c: {REMEDY}"]
    assert "\x1b" not in ran.err
    assert [row.split("\t")[2] for row in ran.out.splitlines()] == [
        "verified", "unknown", "unknown",
    ]  # fmt: skip
    document = run(*words, "--json")
    assert (document.status, document.err) == (1, first + "\n")
    assert json.loads(document.out)["outcome"] == "unknown"
    assert "http" not in ran.out + ran.err
    assert "urn:lecombus" not in ran.out + ran.err


def test_a_single_drive_is_told_as_one(run: Run, daemon: DaemonStub, golden: Golden) -> None:
    answer_stop(daemon, stopped("feeder", "unknown", "no answer"))
    golden(run("stop", "feeder").err)


def test_a_confirmed_stop_raises_no_alarm(run: Run, daemon: DaemonStub) -> None:
    answer_stop(daemon, stopped("feeder", "verified", "it reads so"))
    assert run("stop", "feeder").err == ""


@pytest.mark.parametrize("words", [("stop",), ("inhibit", "feeder"), ("stop", "--json")])
def test_a_stop_that_is_not_answered_soon_says_so_while_it_waits(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    said_s: list[float] = []

    def slow(*asked: object) -> Answer:
        time.sleep(0.5)
        said_s.append(time.monotonic())
        return act(*asked)  # type: ignore[arg-type]

    def said(text: str) -> None:
        said_s.append(time.monotonic())
        assert text.endswith("is not confirmed after 0 s: motors may still turn")

    answer_stop(daemon, stopped("feeder", "verified", "it reads so"))
    monkeypatch.setattr(verb_commands, "WAITED_S", 0.05)
    monkeypatch.setattr(verb_commands, "alarm", said)
    monkeypatch.setattr(verb_commands, "act", slow)
    assert run(*words).out
    assert len(said_s) == (1 if "--json" in words else 2)
    assert said_s == sorted(said_s)


def test_on_a_terminal_the_alarm_is_red_and_alike_reasons_stand_once(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    monkeypatch.setattr("click.utils.should_strip_ansi", lambda *_: False)
    answer_stop(
        daemon,
        stopped("b", "unknown", "b (address 12), C0135: no answer in time (attempt 3)"),
        stopped("c", "unknown", "c (address 13), C0135: no answer in time (attempt 5)"),
    )
    ran = run("stop")
    assert ran.err.startswith("\x1b[31m\x1b[1m2 of 2 drives did not confirm")
    assert ran.out.count("no answer in time") == 1
    assert "like b" in ran.out


def test_a_stop_of_one_drive_that_reached_no_drive_names_it(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["POST /v1/stop"] = problem("line-lost", 503)
    for words in (["stop", "feeder"], ["quick-stop", "feeder"]):
        first, *rest = run(*words).err.splitlines()
        assert first.startswith("feeder has not confirmed the quick stop: motors may still turn")
        assert rest == ["what happened; what to do"]


@pytest.mark.parametrize(
    "words", [["stop"], ["quick-stop"], ["inhibit"], ["stop", "--action", "inhibit"]]
)
def test_a_stop_of_a_drive_that_is_not_there_says_first_that_nothing_was_sent(
    run: Run, daemon: DaemonStub, words: list[str], golden: Golden
) -> None:
    said = {
        "type": "urn:lecombus:problem:no-such-drive", "detail": "there is no drive 'fedeer'",
        "remedy": "did you mean feeder?",
    }  # fmt: skip
    daemon.answers["POST /v1/stop"] = (404, json.dumps(said))
    ran = run(*words, "fedeer")
    assert (ran.status, ran.out) == (2, "")
    golden(ran.err)
    assert "confirmed" not in ran.err
    assert json.loads(run(*words, "fedeer", "--json").err)["kind"] == "no-such-drive"


@pytest.mark.parametrize("status", [404, 503])
def test_a_stop_that_reached_no_drive_says_so_first(
    run: Run, daemon: DaemonStub, status: int, golden: Golden
) -> None:
    daemon.answers["POST /v1/stop"] = problem("line-lost", status)
    ran = run("stop")
    assert ran.status != 0
    assert ran.err.splitlines()[1:] == ["what happened; what to do"]
    golden(ran.err)
    assert "circuit" not in run("stop", "--json").err


def test_stop_refuses_to_guess_between_a_target_and_all(run: Run, daemon: DaemonStub) -> None:
    assert run("stop", "feeder", "--all").status == 2

    assert run("stop", "", "--all").status == 2


@pytest.mark.parametrize("words", [["stop"], ["quick-stop"], ["inhibit"]])
@pytest.mark.parametrize("empty", ["", "  "])
def test_an_empty_target_is_no_stop_of_all_drives(
    run: Run, daemon: DaemonStub, words: list[str], empty: str
) -> None:
    """A script whose variable is empty must not stop the line, nor believe that it did."""
    ran = run(*words, empty)
    assert (ran.status, ran.out, daemon.asked) == (2, "", [])
    assert "no drive has confirmed" in ran.err
    assert "TARGET is empty: nothing was stopped; name a drive, a group or all" in ran.err
    assert daemon.asked == []


def test_status_lists_the_drives_with_why(run: Run, daemon: DaemonStub) -> None:
    line = '{"line": "hall-3", "state": "open", "reason": null, "stretch": 1.000, "remarks": {}}'
    drives = (
        '[{"drive": "feeder", "address": 11, "family": "8200vector", "state": "offline",'
        ' "reason": "no answer", "remarks": {"watchdog": "C1923 is 0"}}]'
    )
    daemon.answers["GET /v1/line"] = (200, line)
    daemon.answers["GET /v1/drives"] = (200, drives)
    ran = run("status")
    assert (ran.status, ran.out) == (
        0,
        "line\thall-3\topen\t\nfeeder\t11\t8200vector\toffline\tno answer; C1923 is 0\t\t\t\n",
    )
    both = run("status", "--json").out
    assert both == f'{{"line": {line}, "drives": {drives}}}\n'


@pytest.mark.parametrize("terminal", [False, True])
def test_status_begins_with_a_line_that_is_lost(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    daemon.answers["GET /v1/line"] = (
        200,
        '{"line": "hall-3", "state": "lost", "reason": "/dev/ttyS9: no such device", '
        '"stretch": 1.000, "remarks": {}}',
    )
    daemon.answers["GET /v1/drives"] = (
        200,
        '{"drives": [{"drive": "feeder", "state": "offline", '
        '"reason": "line lost: /dev/ttyS9: no such device", "remarks": {"x": "y"}}]}',
    )
    if terminal:
        monkeypatch.setattr(status, "on_terminal", lambda: True)
    first, drive = run("status").out.splitlines()
    assert "\toffline\t" in drive
    assert "line lost; y" in drive, "why the line is lost is said once"
    assert first == (
        "line hall-3: lost, /dev/ttyS9: no such device"
        if terminal
        else "line\thall-3\tlost\t/dev/ttyS9: no such device"
    )


def moving(name: str, **motion: object) -> dict[str, object]:
    known: dict[str, object] = {
        "doing": "running",
        "stops": [],
        "speed": None,
        "setpoint": None,
        "zero": None,
    }
    return {
        "drive": name, "address": 11, "family": "820x", "state": "online", "reason": None,
        "remarks": {}, "motion": {**known, "age_s": 1.0, "stale": False, **motion},
    }  # fmt: skip


def speed(value: float, unit: str | None, *, stale: bool = False, age_s: float = 1.0) -> object:
    return {"code": "C0050", "value": value, "unit": unit, "age_s": age_s, "stale": stale}


def stop_shown(name: str, text: str) -> dict[str, object]:
    return {"name": name, "text": text, "shown_by": ["C0135 reads H0008"]}


OVERVIEW = [
    moving("runs", speed=speed(35.4, "Hz"), setpoint=speed(40, "Hz", stale=True, age_s=180.0)),
    moving("trips", doing="stopped", stops=[stop_shown("trip", "trip OH (50): too hot")]),
    moving("ramps", doing="stopping", stops=[stop_shown("quick-stop", "quick stop")], zero=False),
    moving("old", doing="stopped", stops=[stop_shown("inhibited", "inhibited")], stale=True,
           age_s=12.0, zero=True),
]  # fmt: skip


def test_status_says_of_each_drive_whether_it_runs_how_fast_and_what_stops_it(
    run: Run, daemon: DaemonStub
) -> None:
    daemon.answers["GET /v1/line"] = (200, '{"line": "l", "state": "open", "remarks": {}}')
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": OVERVIEW}))
    rows = [line.split("\t") for line in run("status").out.splitlines()[1:]]
    assert [row[5:] for row in rows] == [
        ["running", "35.4 Hz", "40 Hz, 3 min ago"],
        ["stopped: trip OH (50)", "", ""],
        ["stopping: quick stop", "not 0", ""],
        ["stopped: inhibited, as known 12.0 s ago", "0", ""],
    ]


def test_a_tripped_drive_is_red_and_not_green(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows: list[list[str]] = []
    monkeypatch.setattr(status, "on_terminal", lambda: True)
    monkeypatch.setattr(status, "show_rows", lambda _headings, shown: rows.extend(shown))
    daemon.answers["GET /v1/line"] = (200, '{"line": "l", "state": "open", "remarks": {}}')
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": OVERVIEW}))
    run("status")
    assert [(mark(row[3]), mark(row[4])) for row in rows] == [
        ("green", ""), ("", "red"), ("green", ""), ("green", "yellow"),
    ]  # fmt: skip


def test_status_of_a_drive_lists_its_values(run: Run, daemon: DaemonStub) -> None:
    document = (
        '{"drive": "feeder", "address": 11, "family": "8200vector", "state": "online",'
        f' "reason": null, "remarks": {{}}, "values": [{READING}]}}'
    )
    daemon.answers["GET /v1/drives/feeder"] = (200, document)
    ran = run("status", "feeder")
    assert ran.out == "C0046\tfrequency setpoint\t50.10\tHz\tgood\t0.4 s\t\n"


def test_words_are_shown_by_their_digits_and_what_was_read_once_without_alarm(
    run: Run, daemon: DaemonStub
) -> None:
    word = READING.replace(
        '50.10, "raw": "50.10", "format": "VD"', '8, "raw": "H0008", "format": "VH"'
    )
    once = READING.replace('"good", "reason": null', '"stale", "reason": "{}"').replace(
        "0.4", "130.0"
    )
    reason = "read 130.0 s ago, not read cyclically"
    values = ", ".join((word, once.replace("{}", reason), once.replace("{}", "drive offline")))
    daemon.answers["GET /v1/drives/feeder"] = (200, f'{{"drive": "feeder", "values": [{values}]}}')
    rows = [line.split("\t")[2:] for line in run("status", "feeder").out.splitlines()]
    assert rows == [
        ["H0008", "Hz", "good", "0.4 s", ""],
        ["50.10", "Hz", "once", "2 min", ""],
        ["50.10", "Hz", "stale", "2 min", "drive offline"],
    ]
    daemon.answers["GET /v1/drives/feeder/codes/C0046?fresh=true"] = (200, word)
    assert run("read", "feeder", "C0046").out == "feeder\tC0046\tH0008\tHz\tgood\t\n"
    written = WRITTEN.replace(READING, word)
    daemon.answers["PUT /v1/drives/feeder/codes/C0046"] = (200, written)
    assert run("write", "feeder", "C0046", "H0008").out.split("\t")[3] == "H0008 Hz"


def test_a_daemon_that_ends_before_it_answers_is_not_reachable(
    run: Run, daemon: DaemonStub
) -> None:
    daemon.answers["PUT /v1/drives/feeder/codes/C0046"] = (200, None)
    ran = run("write", "feeder", "C0046", "5")
    assert ran.status == 3
    assert "may have happened" in ran.err


def test_something_else_behind_the_socket_is_told_apart(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/line"] = (200, "<html>")
    ran = run("status")
    assert ran.status == 3
    assert "is not lecombus" in ran.err


def test_on_a_terminal_a_code_of_an_smvector_is_named_as_at_its_keypad(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading = READING.replace("C0046", "C1411")
    document = f'{{"drive": "fan", "address": 3, "family": "smvector", "values": [{reading}]}}'
    daemon.answers["GET /v1/drives/fan"] = (200, document)
    daemon.answers["GET /v1/drives/fan/codes/C1411?fresh=true"] = (200, reading)
    assert run("status", "fan").out.startswith("C1411\t")
    document = document[:-1] + ', "identity": {"C1502": "1"}}'
    daemon.answers["GET /v1/drives/fan"] = (200, document)
    monkeypatch.setattr(status, "on_terminal", lambda: True)
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    shown = run("status", "fan").out
    assert "P411" in shown
    assert "it says of itself: P502 1" in shown
    assert " P411 (" in run("read", "fan", "p411").out
    assert " C1411 (" in run("read", "fan", "C1411").out


@pytest.mark.parametrize("words", [["write", "fan"], ["group", "fans"]])
def test_a_write_names_the_code_as_its_user_does(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    written = WRITTEN.replace("C0046", "C1425")
    daemon.answers["PUT /v1/drives/fan/codes/C1425"] = (200, written)
    daemon.answers["PUT /v1/groups/fans/codes/C1425"] = (200, f'{{"members": [{written}]}}')
    assert run(*words, "P425", "3000").out.split("\t")[1] == "C1425"
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    assert run(*words, "p425", "3000").out.split("\t")[1] == "P425"
    assert run(*words, "C1425", "3000").out.split("\t")[1] == "C1425"
