"""`lecombus events` against a daemon reduced to its answers."""

from __future__ import annotations

import json
from typing import Any

import pytest

from cli.conftest import Run, SetZone
from cli.daemon_stub import DaemonStub
from lecombus.cli import document_rows, events, screen

pytestmark = pytest.mark.clock

TIME = "2026-11-23T10:15:02.113Z"
VALUE = {
    "drive": "feeder", "code": "C0046", "subcode": 0, "name": "frequency setpoint", "value": 50.10,
    "raw": "50.10", "format": "VD", "unit": "Hz", "quality": "good", "reason": None, "time": TIME,
    "age_s": 0.0, "text": None,
}  # fmt: skip
FAULT = {"kind": "trip", "number": 50, "keypad": "OH", "meaning": "heat sink too hot"}
BY = {"who": "tcp", "token": "panel", "client": "10.0.0.5:4711"}
EVENTS: list[tuple[str, dict[str, Any], str]] = [
    ("value", VALUE, "C0046 frequency setpoint 50.1 Hz"),
    ("value", VALUE | {"quality": "bad", "reason": "no answer in time"},
     "C0046 frequency setpoint 50.1 Hz [bad: no answer in time]"),
    ("state", {"drive": "feeder", "state": "offline", "reason": "no answer", "states": None},
     "offline: no answer"),
    ("state", {"drive": "feeder", "state": "online", "reason": None,
               "states": ["enabled", "output_frequency_0"]},
     "online (enabled, output frequency 0)"),
    ("state", {"drive": "feeder", "state": None, "reason": "taken out of the roster"},
     "taken out of the roster"),
    ("trip", {"drive": "feeder", "active": True, "fault": FAULT},
     "trip OH (50): heat sink too hot"),
    ("trip", {"drive": "feeder", "active": False, "fault": FAULT},
     "trip OH (50): heat sink too hot: gone"),
    ("trip", {"drive": "feeder", "active": True, "fault": {"kind": "warning"}}, "warning"),
    ("remark", {"drive": None, "subject": "reload", "text": "refused"}, "reload: refused"),
    ("remark", {"drive": "feeder", "subject": "swap", "text": None}, "swap: ended"),
    ("write", {"drive": "feeder", "what": "write", "outcome": "done", "code": "C0046",
               "value": "20", "by": BY}, "write C0046 20: done, by panel"),
    ("write", {"drive": "all", "what": "stop", "outcome": "unknown", "action": "inhibit",
               "reason": "belt does not answer", "by": {"who": "socket", "process": "ui"}},
     "stop inhibit: unknown, by ui: belt does not answer"),
    ("write", {"what": "kept-back", "count": 7}, "7 more were not shown"),
    ("lease", {"what": "ended", "lease": "ui", "number": "7", "end": "lapsed",
               "drives": ["feeder", "belt"]}, "ended ui (7) feeder, belt: lapsed"),
    ("lease", {"what": "unlatched", "drives": ["feeder"]}, "unlatched feeder"),
    ("line", {"line": "hall", "state": "lost", "reason": "unplugged"}, "lost: unplugged"),
    ("line", {"journal": "72:aed4115c"}, "the journal ends at row 72:aed4115c"),
    ("gap", {"missed": 12, "reason": "r"}, "12 events are missing: r; `lecombus status` shows "
     "what is known"),
    ("gap", {"missed": 1, "reason": "r"}, "1 event is missing: r; `lecombus status` shows "
     "what is known"),
    ("gap", {"missed": None, "reason": "r"}, "some events are missing: r; `lecombus status` shows "
     "what is known"),
    ("novel", {"x": 1}, f'{{"time": "{TIME}", "x": 1}}'),
]  # fmt: skip


def frames(*found: tuple[str, dict[str, Any]], first: int = 1) -> str:
    rows = ["retry: 2000\n\n: \nid: r-0\n\n"]
    for number, (kind, data) in enumerate(found, first):
        rows.append(f"id: r-{number}\nevent: {kind}\ndata: {json.dumps(data)}\n\n")
    return "".join(rows)


@pytest.mark.parametrize(("kind", "data", "said"), EVENTS)
def test_an_event_is_one_line_in_words(
    kind: str, data: dict[str, Any], said: str, run: Run, daemon: DaemonStub
) -> None:
    data = {"time": TIME, **data}
    last = ("line", {"time": TIME, "state": "open", "reason": None})
    daemon.answers["GET /v1/events"] = (200, frames((kind, data), last))
    ran = run("events", "--count", "1" if kind == "gap" else "2")
    assert (ran.status, ran.err) == (0, "")
    row = "\t".join((TIME, kind, data.get("drive") or "", said))
    assert ran.out == f"{row}\n{TIME}\tline\t\topen\n"


def test_on_a_terminal_it_has_columns_and_local_time(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, set_zone: SetZone
) -> None:
    set_zone("UTC")
    monkeypatch.setattr(events, "on_terminal", lambda: True)
    monkeypatch.setattr(screen, "on_terminal", lambda: True)
    hostile = VALUE | {"drive": "fee\x1b[2Jder", "name": "bell\x07"}
    daemon.answers["GET /v1/events"] = (200, frames(("value", hostile)))
    ran = run("events", "--count", "1")
    assert ran.out.startswith("10:15:02  value   fee\\x1b[2Jder  C0046 bell\\x07 50.1 Hz")


def test_on_a_terminal_a_code_of_an_smvector_is_named_as_at_its_keypad(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[tuple[str, dict[str, Any]]] = [
        ("value", VALUE | {"drive": "fan", "code": "C1410", "subcode": 1}),
        ("write", {"drive": "fan", "what": "write", "outcome": "done", "code": "C1425",
                   "value": "20", "by": BY}),
        ("value", VALUE),
    ]  # fmt: skip
    daemon.answers["GET /v1/events"] = (200, frames(*found))
    assert "C1410/1 frequency" in run("events", "--count", "3").out
    drives = [{"drive": "fan", "address": 1, "family": "smvector", "state": "online"}]
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": drives}))
    for module in (events, screen, document_rows):
        monkeypatch.setattr(module, "on_terminal", lambda: True)
    ran = run("events", "--count", "3").out
    assert "P410/1 frequency" in ran
    assert "write P425 20: done" in ran
    assert "C0046 frequency" in ran
    del daemon.answers["GET /v1/drives"]
    assert "C1410/1 frequency" in run("events", "--count", "3").out


def test_json_keeps_numbers_as_the_daemon_wrote_them(run: Run, daemon: DaemonStub) -> None:
    text = frames(("value", VALUE)).replace("50.1,", "50.10,")
    daemon.answers["GET /v1/events"] = (200, text)
    ran = run("events", "--json", "--count", "1")
    (row,) = ran.out.splitlines()
    assert '"value": 50.10, "raw": "50.10"' in row
    found = json.loads(row)
    assert (found["id"], found["event"], found["data"]["drive"]) == ("r-1", "value", "feeder")


def test_drives_and_kinds_are_asked_for(run: Run, daemon: DaemonStub) -> None:
    asked = "GET /v1/events?drive=feeder%2Cbelt&kind=trip%2Cline"
    daemon.answers[asked] = (200, frames(("line", {"state": "open"})))
    ran = run("events", "--drive", "feeder", "--drive", "belt", "--kind", "trip", "--kind", "line",
              "--count", "1")  # fmt: skip
    assert (ran.status, [what for what, _ in daemon.asked]) == (0, [asked])


def test_an_answer_that_ends_is_asked_for_again(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/events"] = (200, frames(("line", {"state": "open"})))
    ran = run("events", "--count", "2")
    assert (ran.status, len(ran.out.splitlines()), len(daemon.asked)) == (0, 2, 2)


@pytest.mark.parametrize(
    ("words", "status", "kind"),
    [
        (["--drive", "x"], 2, "no-such-drive"),
        (["--kind", "value"], 4, "not-permitted"),
    ],
)
def test_a_refusal_ends_it(
    words: list[str], status: int, kind: str, run: Run, daemon: DaemonStub
) -> None:
    http = 404 if status == 2 else 403
    query = "drive=x" if status == 2 else "kind=value"
    problem = {"type": f"urn:lecombus:problem:{kind}", "status": http, "detail": "no", "title": ""}
    daemon.answers[f"GET /v1/events?{query}"] = (http, json.dumps(problem))
    ran = run("events", *words)
    assert (ran.status, ran.out) == (status, "")


def test_a_daemon_that_is_not_there_is_status_3(run: Run) -> None:
    ran = run("events", "--socket", "/nowhere.sock")
    assert (ran.status, ran.out) == (3, "")
