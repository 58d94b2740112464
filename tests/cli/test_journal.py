"""`lecombus journal` against a daemon reduced to its answers."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import pytest

from cli.conftest import Run, SetZone
from cli.daemon_stub import DaemonStub
from lecombus.cli import document_rows, journal
from lecombus.cli.journal import no_formula
from support.golden import Golden

pytestmark = pytest.mark.clock

HEAD = "5:" + "ab" * 32


def row(number: int, what: str, outcome: str | None = None, **more: Any) -> dict[str, Any]:
    fixed = {
        "number": number, "time": f"2026-11-23T03:07:{number % 60:02}.250Z", "what": what,
        "drive": None, "asked": None, "outcome": outcome, "ended": False, "fields": {},
        "hash": "ab" * 32,
    }  # fmt: skip
    return {**fixed, **more}


WRITE = {"code": "C0046", "value": "=20", "old": "10", "who": "socket", "uid": "1000", "pid": "7"}
ROWS = [
    row(1, "start", fields={"version": "1", "port": 'a "b" c'}),
    row(2, "write", "asked", drive="feeder", ended=True, fields=WRITE),
    row(3, "write", "done", drive="feeder", asked=2, fields=WRITE | {"reason": "it says so"}),
    row(4, "stop", "asked", drive="all", fields={"action": "inhibit", "who": "lecombus"}),
    row(5, "trip", drive="fee\x1b[31mder", fields={"fault": "trip OH (50)"}),
]
LAST = "GET /v1/journal?last=true&limit=200"


def page(
    rows: list[dict[str, Any]], behind: int | None = None, head: str = HEAD
) -> tuple[int, str]:
    return 200, json.dumps({"rows": rows, "next": behind, "head": head, "trouble": ""})


@pytest.fixture(autouse=True)
def berlin(set_zone: SetZone) -> None:
    set_zone("Europe/Berlin")


def test_on_a_terminal_a_code_of_an_smvector_is_named_as_at_its_keypad(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = [
        row(1, "write", "done", drive=name, fields=WRITE | {"code": "C1425"})
        for name in ("fan", "feeder")
    ]
    daemon.answers[LAST] = page(written)
    drives = [{"drive": "fan", "family": "smvector"}, {"drive": "feeder", "family": "820x"}]
    daemon.answers["GET /v1/drives"] = (200, json.dumps({"drives": drives}))
    assert run("journal").out.count("code=C1425") == 2
    for module in (journal, document_rows):
        monkeypatch.setattr(module, "on_terminal", lambda: True)
    of_fan, of_feeder = [line for line in run("journal").out.splitlines() if "code=" in line]
    assert "code=P425" in of_fan
    assert "code=C1425" in of_feeder
    del daemon.answers["GET /v1/drives"]
    assert run("journal").out.count("code=C1425") == 2, "the rows are shown all the same"


def test_each_operation_is_one_line_by_its_end_or_as_asked(
    run: Run, daemon: DaemonStub, golden: Golden
) -> None:
    daemon.answers[LAST] = page(ROWS)
    ran = run("journal")
    assert (ran.status, ran.err) == (0, "")
    lines = [line.split("\t") for line in ran.out.splitlines()]
    assert [line[1:4] for line in lines] == [
        ["start", "", ""], ["write", "feeder", "done"], ["stop", "all", "asked"],
        ["trip", "fee\\x1b[31mder", ""],
    ]  # fmt: skip
    assert lines[0][0] == "2026-11-23 04:07:01.250"
    golden(ran.out)


@pytest.mark.parametrize(
    ("zone", "time_there"),
    [("America/New_York", "2026-11-22 22:07:01.250"), ("UTC", "2026-11-23 03:07:01.250")],
)
def test_the_time_is_the_local_one_without_its_zone(
    run: Run, daemon: DaemonStub, set_zone: SetZone, zone: str, time_there: str
) -> None:
    set_zone(zone)
    daemon.answers[LAST] = page(ROWS[:1])
    assert run("journal").out.partition("\t")[0] == time_there


def test_json_is_every_row_as_it_came(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/journal?last=true&limit=2&drive=feeder"] = page(ROWS)
    ran = run("journal", "--json", "--last", "2", "--drive", "feeder")
    assert [json.loads(line) for line in ran.out.splitlines()] == ROWS


def operations(first: int, last: int) -> list[dict[str, Any]]:
    """Operations, each with a row that asks and a row that ends it, by the number of the latter."""
    return [
        row(number - 1 + at, "write", outcome, ended=not at, asked=number - 1 if at else None,
            time="2026-11-23T03:07:00.250Z")
        for number in range(first, last + 1, 2)
        for at, outcome in ((0, "asked"), (1, "done"))
    ]  # fmt: skip


def test_last_counts_the_lines_that_are_printed(run: Run, daemon: DaemonStub) -> None:
    daemon.answers["GET /v1/journal?last=true&limit=10"] = page(operations(92, 100))
    assert len(run("journal", "--last", "5").out.splitlines()) == 5
    plain = [row(number, "trip") for number in range(11, 21)]
    daemon.answers["GET /v1/journal?last=true&limit=10"] = page(plain)
    assert [line[17:19] for line in run("journal", "--last", "5").out.splitlines()] == [
        "16", "17", "18", "19", "20"
    ]  # fmt: skip
    daemon.answers["GET /v1/journal?last=true&limit=10"] = page(operations(2, 4))
    assert len(run("journal", "--last", "5").out.splitlines()) == 2


def test_more_lines_than_one_page_holds_are_asked_for_in_several(
    run: Run, daemon: DaemonStub
) -> None:
    daemon.answers["GET /v1/journal?last=true&limit=500"] = page(operations(602, 1100))
    daemon.answers["GET /v1/journal?after=100&limit=500"] = page(operations(102, 600))
    ran = run("journal", "--last", "300", "--csv")
    numbers = [int(one["number"]) for one in csv.DictReader(io.StringIO(ran.out))]
    assert numbers == list(range(502, 1101, 2))


def test_a_wrong_unit_is_said_with_the_right_one(run: Run) -> None:
    ran = run("journal", "--since", "2m")
    assert ran.status == 2
    assert "write min for minutes" in ran.err


@pytest.mark.parametrize(("text", "cell"), [
    ("=1+1", "'=1+1"), ("@SUM(A1)", "'@SUM(A1)"), ("-2+cmd|'x'!A0", "'-2+cmd|'x'!A0"),
    ("+1+1", "'+1+1"), ("-5", "-5"), ("+0.5", "+0.5"), ("-12.50", "-12.50"), ("H0008", "H0008"),
    ("-", "'-"),
])  # fmt: skip
def test_no_cell_is_a_formula_and_numbers_stay_numbers(text: str, cell: str) -> None:
    assert no_formula(text) == cell


def test_csv_has_the_fields_in_columns_and_no_formula(run: Run, daemon: DaemonStub) -> None:
    daemon.answers[LAST] = page(ROWS)
    read = list(csv.DictReader(io.StringIO(run("journal", "--csv").out)))
    assert [one["number"] for one in read] == ["1", "3", "4", "5"]
    assert (read[1]["value"], read[1]["old"], read[1]["reason"]) == ("'=20", "10", "it says so")
    assert read[3]["more"] == 'fault="trip OH (50)"'


@pytest.mark.parametrize("as_json", [False, True])
def test_rows_of_a_drive_are_found_however_many_of_others_came_since(
    run: Run, daemon: DaemonStub, as_json: bool
) -> None:
    of, head = "&drive=feeder", "45000:" + "0" * 64
    limit = 2 if as_json else 4
    daemon.answers[f"GET /v1/journal?last=true&limit={limit}{of}"] = page([], head=head)
    daemon.answers["GET /v1/journal?after=0&limit=1"] = page([row(4001, "cut")], 4001, head)
    daemon.answers[f"GET /v1/journal?after=5499&limit=500{of}"] = page(
        [row(7000, "trip", drive="feeder")], 25499, head
    )
    daemon.answers[f"GET /v1/journal?after=4000&limit=500{of}"] = page(
        [row(4500, "trip", drive="feeder"), row(7000, "trip", drive="feeder")], 24000, head
    )
    ran = run("journal", "--last", "2", "--drive", "feeder", *(["--json"] if as_json else []))
    assert (ran.status, ran.err, len(ran.out.splitlines())) == (0, "", 2)
    if as_json:
        assert [json.loads(line)["number"] for line in ran.out.splitlines()] == [4500, 7000]


def test_since_goes_through_all_pages(run: Run, daemon: DaemonStub) -> None:
    since = "2026-11-23T03%3A00%3A00.000%2B00%3A00"
    daemon.answers[f"GET /v1/journal?since={since}&limit=500"] = page(ROWS[:2], behind=2)
    daemon.answers[f"GET /v1/journal?after=2&limit=500&since={since}"] = page(ROWS[2:])
    ran = run("journal", "--json", "--since", "2026-11-23 04:00")
    assert [json.loads(line)["number"] for line in ran.out.splitlines()] == [1, 2, 3, 4, 5]


def test_follow_asks_behind_the_newest_row(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def sleep(for_s: float) -> None:
        asked.append(for_s)
        if len(asked) > 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("lecombus.cli.journal.time.sleep", sleep)
    daemon.answers["GET /v1/journal?last=true&limit=2"] = page(ROWS[1:3], head="3:" + "0" * 64)
    daemon.answers["GET /v1/journal?after=3&limit=500"] = page(ROWS[3:])
    daemon.answers["GET /v1/journal?after=5&limit=500"] = page([])
    ran = run("journal", "--follow", "--last", "1")
    assert [line.split("\t")[1] for line in ran.out.splitlines()] == ["write", "stop", "trip"]


GROUPS = {"groups": [{"group": "all", "members": ["feeder", "belt"]}]}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("feder", "did you mean feeder?"),
        ("x7", "they are: all, belt, feeder"),
        ("belt", ""),
        ("all", ""),
    ],
)
@pytest.mark.parametrize("form", ["", "--csv", "--json"])
def test_a_name_without_rows_that_the_roster_does_not_have_is_said(
    run: Run, daemon: DaemonStub, name: str, said: str, form: str
) -> None:
    daemon.answers["GET /v1/groups"] = (200, json.dumps(GROUPS))
    since = "since=2026-11-23T00%3A00%3A00.000%2B00%3A00"
    daemon.answers[f"GET /v1/journal?{since}&limit=500&drive={name}"] = page([])
    words = [form] if form else []
    ran = run("journal", "--since", "2026-11-23 01:00", "--drive", name, *words)
    assert ran.status == 0
    assert said in ran.err
    assert bool(ran.err) == bool(said)


def test_a_name_that_is_no_more_in_the_roster_is_right_where_it_has_rows(
    run: Run, daemon: DaemonStub
) -> None:
    since = "since=2026-11-23T00%3A00%3A00.000%2B00%3A00"
    daemon.answers[f"GET /v1/journal?{since}&limit=500&drive=former"] = page(ROWS[1:3])
    ran = run("journal", "--since", "2026-11-23 01:00", "--drive", "former")
    assert (ran.status, ran.err) == (0, "")
    assert len(ran.out.splitlines()) == 1


@pytest.mark.parametrize("number", ["0", "501", "1e2", "5.5", "ten"])
def test_a_count_that_is_none_is_told_with_its_bounds(run: Run, number: str) -> None:
    ran = run("journal", "--last", number)
    assert ran.status == 2
    assert f"{number} is not a whole number from 1 to 500" in ran.err


@pytest.mark.parametrize(
    "words",
    [
        ("--since", "yesterday"),
        ("--since", "8h", "--last", "5"),
        ("--csv", "--json"),
        ("--since", "99999999h"),
        ("--since", "999999999h"),
    ],
    ids=" ".join,
)
def test_what_is_wrong_is_said(run: Run, daemon: DaemonStub, words: tuple[str, ...]) -> None:
    ran = run("journal", *words)
    assert (ran.status, ran.out) == (2, "")
    assert daemon.asked == []


def test_a_day_that_is_none_in_utc_is_no_time(
    run: Run, daemon: DaemonStub, set_zone: SetZone
) -> None:
    set_zone("America/New_York")
    ran = run("journal", "--since", "9999-12-31 23:59")
    assert (ran.status, ran.out, daemon.asked) == (2, "", [])
    assert "9999-12-31 23:59 is no time" in ran.err


def test_verify_says_whether_it_is_whole(run: Run, daemon: DaemonStub) -> None:
    found = {"whole": True, "rows": 5, "first": 1, "last": 5, "head": HEAD, "problem": None}
    daemon.answers["GET /v1/journal/verify"] = (200, json.dumps(found))
    ran = run("journal", "verify")
    assert (ran.status, ran.out) == (0, f"whole: 5 rows, 1 to 5\nhead {HEAD}\n")
    found |= {"whole": False, "problem": "row 6 was changed"}
    told = HEAD.replace(":", "%3A")
    daemon.answers[f"GET /v1/journal/verify?head={told}"] = (200, json.dumps(found))
    ran = run("journal", "verify", "--head", HEAD)
    assert ran.status == 1
    assert ran.out.startswith("not whole: row 6 was changed\nright up to there: 5 rows, 1 to 5\n")
    assert json.loads(run("journal", "verify", "--json", "--head", HEAD).out) == found


def test_verify_asks_the_daemon_that_is_named_before_it(
    run: Run, daemon: DaemonStub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LECOMBUS_SOCKET", f"{daemon.path}-of-another-line")
    found = {"whole": True, "rows": 5, "first": 1, "last": 5, "head": HEAD, "problem": None}
    daemon.answers["GET /v1/journal/verify"] = (200, json.dumps(found))
    ran = run("journal", "--socket", str(daemon.path), "--json", "verify")
    assert (ran.status, json.loads(ran.out)) == (0, found)
    ran = run("journal", "--socket", "/none", "verify", "--socket", str(daemon.path))
    assert (ran.status, ran.out.splitlines()[0]) == (0, "whole: 5 rows, 1 to 5")
    assert run("journal", "--url", "http://127.0.0.1:9", "verify").status == 3


@pytest.mark.parametrize(
    "words", [("--last", "5"), ("--since", "8h"), ("--csv",), ("--follow",), ("--drive", "a")],
    ids=" ".join,
)  # fmt: skip
def test_verify_takes_no_choice_of_rows(
    run: Run, daemon: DaemonStub, words: tuple[str, ...]
) -> None:
    ran = run("journal", *words, "verify")
    assert (ran.status, daemon.asked) == (2, [])
    assert "leave out the options before it" in ran.err
