"""`lecombus why` against a daemon reduced to its answers."""

from __future__ import annotations

import json

import pytest

from cli.conftest import Run
from cli.daemon_stub import DaemonStub
from lecombus.cli import status
from support.golden import Golden

pytestmark = pytest.mark.clock

DOCUMENT = {
    "drive": "feeder", "family": "8200vector", "state": "online", "reason": None,
    "since": "2026-11-21T10:15:02.113Z", "answer": "trip OH (50): heat sink too hot",
    "findings": [
        {"name": "trip", "weight": "reason", "text": "trip OH (50): heat sink too hot",
         "remedy": "let it cool", "shown_by": "C0150 reads H0870", "age_s": None, "stale": False},
        {"name": "quick-stop-by-line", "weight": "reason", "text": "quick stop",
         "remedy": "release it", "shown_by": "C0135 reads H0008", "age_s": 75.2, "stale": True},
        {"name": "note", "weight": "note", "text": "good", "remedy": None, "shown_by": None,
         "age_s": None, "stale": False},
    ],
    "states": ["fault"], "output": None,
    "history": [{"code": "C0161", "number": 50, "keypad": "OH", "kind": "trip",
                 "meaning": "heat sink too hot", "age_s": 1.0, "stale": False}],
    "history_known": True,
}  # fmt: skip


def test_in_a_pipe_answer_findings_and_history_are_rows(
    run: Run, daemon: DaemonStub, golden: Golden
) -> None:
    path = "GET /v1/drives/feeder/why?lang=en&fresh=true"
    daemon.answers[path] = (200, json.dumps(DOCUMENT))
    ran = run("why", "feeder")
    assert (ran.status, ran.err) == (0, "")
    rows = [line.split("\t")[0] for line in ran.out.splitlines()]
    assert (rows[0], rows[2], rows[-1]) == ("answer", "reason", "history")
    golden(ran.out)


def test_stored_reads_nothing_and_json_is_the_daemons_own(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/drives/feeder/why?lang=de"] = (200, json.dumps(DOCUMENT))
    ran = run("why", "feeder", "--stored", "--lang", "de", "--json")
    assert json.loads(ran.out) == DOCUMENT


def test_a_person_gets_sentences(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr(status, "on_terminal", lambda: True)
    daemon.answers["GET /v1/drives/feeder/why?lang=de&fresh=true"] = (200, json.dumps(DOCUMENT))
    ran = run("why", "feeder", "--lang", "de")
    golden(ran.out)


def test_on_a_terminal_the_fault_memory_is_named_as_at_the_keypad(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = {"code": "C1500", "number": 10, "keypad": "F.IL"}
    document = {**DOCUMENT, "family": "smvector", "findings": [], "history": [entry]}
    daemon.answers["GET /v1/drives/feeder/why?lang=en&fresh=true"] = (200, json.dumps(document))
    assert "history\tC1500\t" in run("why", "feeder").out
    monkeypatch.setattr(status, "on_terminal", lambda: True)
    monkeypatch.setattr("lecombus.cli.document_rows.on_terminal", lambda: True)
    assert "  P500  10 F.IL\n" in run("why", "feeder").out


def test_an_empty_and_an_unread_memory_are_told_apart(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "on_terminal", lambda: True)
    for known, text in ((True, "is empty"), (False, "has not been read")):
        document = {**DOCUMENT, "findings": [], "history": [], "history_known": known}
        path = "GET /v1/drives/feeder/why?lang=en&fresh=true"
        daemon.answers[path] = (200, json.dumps(document))
        assert text in run("why", "feeder").out
