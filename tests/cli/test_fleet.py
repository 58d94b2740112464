"""`lecombus fleet` without a broker: which is meant, how lines are shown, what is refused."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from lecombus.cli import fleet_stop, main
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.fleet import Changes, names_in
from lecombus.cli.fleet_broker import OPTIONS, BrokerOptions, broker_of
from lecombus.cli.fleet_screen import FleetScreen, drives_text, headline, left_out, rows_of
from lecombus.cli.fleet_stop import say_if_not_confirmed, show_stops, stops_json
from lecombus.fleet.lines import FleetLines, LineView
from lecombus.fleet.stopping import StopResult, result_of

pytestmark = pytest.mark.clock

ROSTER = """\
line: {name: hall-3, port: 'sim:'}
drives: [{name: feeder, address: 11, family: 8200vector}]
"""


def given(**more: Any) -> dict[str, Any]:
    return {**dict.fromkeys(OPTIONS), "topics": (), **more}


@pytest.mark.parametrize(
    ("url", "host", "port", "tls", "username"),
    [
        ("mqtt://broker.example", "broker.example", 1883, False, None),
        ("mqtts://broker.example", "broker.example", 8883, True, None),
        ("mqtt://fleet@10.0.0.7:1884/", "10.0.0.7", 1884, False, "fleet"),
        ("mqtts://[fe80::1]:9000", "fe80::1", 9000, True, None),
    ],
)
def test_a_url_names_a_broker(
    url: str, host: str, port: int, tls: bool, username: str | None
) -> None:
    entry = broker_of(given(url=url)).entry
    assert (entry.host, entry.port, entry.tls, entry.username) == (host, port, tls, username)


@pytest.mark.parametrize(
    "url",
    ["broker.example", "http://a", "mqtt://", "mqtt://a:b:c", "mqtt://a:99999", "mqtt://a/topic",
     "mqtt://a?b", "mqtt://user:secret@a"],
)  # fmt: skip
def test_what_is_no_url_of_a_broker_is_refused(url: str) -> None:
    with pytest.raises(CommandError) as raised:
        broker_of(given(url=url))
    assert raised.value.status is Exit.USAGE
    assert "mqtt://" in str(raised.value) or "--password-file" in str(raised.value)
    assert "secret@" not in str(raised.value)


def test_a_roster_names_a_broker_and_options_count_more(tmp_path: Path) -> None:
    roster = tmp_path / "roster.yaml"
    roster.write_text(ROSTER + "mqtt: {host: b.example, username: hall-3, topics: plant/x}\n")
    found = broker_of(given(roster=roster))
    assert (found.where, found.prefixes, found.entry.tls) == ("b.example:8883", ("plant/x",), True)
    found = broker_of(given(roster=roster, username="fleet", topics=("a", "b/c", "a")))
    assert (found.entry.username, found.prefixes) == ("fleet", ("a", "b/c"))
    with pytest.raises(CommandError, match="both given"):
        broker_of(given(roster=roster, url="mqtt://a"))
    roster.write_text(ROSTER)
    with pytest.raises(CommandError, match="no key `mqtt`"):
        broker_of(given(roster=roster))


def test_the_environment_names_a_broker_where_nothing_else_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(CommandError, match="no broker is given"):
        broker_of(given())
    monkeypatch.setenv("LECOMBUS_BROKER", "mqtt://other.example")
    assert broker_of(given()).entry.host == "other.example"
    assert broker_of(given(url="mqtt://a")).entry.host == "a"


def test_a_stop_goes_to_the_broker_of_the_command_line_and_not_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("LECOMBUS_BROKER", "mqtt://other.example")
    assert main(["fleet", "--broker", "mqtt://127.0.0.1:1", "stop", "hall-3"]) == 3
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        "no drive has confirmed the quick stop: motors may still turn, use the emergency stop "
        "circuit"
    )
    assert second.startswith("the broker 127.0.0.1:1: ")


def test_json_is_printed_also_where_it_is_asked_for_before_the_stop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lecombus.cli.fleet_stop.send", lambda *_given, **_named: [])
    words = ["--broker", "mqtt://127.0.0.1:1", "stop", "hall-3"]
    for given in (["--json", *words], [*words, "--json"]):
        main(["fleet", *given])
        assert json.loads(capsys.readouterr().out)["stops"] == []


@pytest.mark.parametrize("topics", ["", "/", "a/", "/a", "a/+", "#"])
def test_topics_that_are_none_are_refused(topics: str) -> None:
    with pytest.raises(CommandError, match="not the beginning of a topic"):
        broker_of(given(url="mqtt://a", topics=(topics,)))


@pytest.mark.parametrize(
    "words",
    [
        [], ["hall-3", "--all"], ["+"], ["#"], ["a/b"], [""], ["hall 3"], ["lecombus/+"],
        ["hall-3", "--target", ""], ["hall-3", "--target", "a/do/enable"],
        ["hall-3", "--target", "+"],
    ],
)  # fmt: skip
def test_a_stop_that_could_mean_something_else_is_refused_before_it_is_sent(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fleet", "stop", "--broker", "mqtt://127.0.0.1:1", *words]) == 2
    said = capsys.readouterr().err
    assert "motors may still turn" in said
    assert "no line was asked to stop" in said


def test_a_name_under_several_topics_must_say_which(capsys: pytest.CaptureFixture[str]) -> None:
    more = ["--topics", "a", "--topics", "b", "--broker", "mqtt://127.0.0.1:1"]
    assert main(["fleet", "stop", "hall-3", *more]) == 2
    assert "write a/hall-3" in capsys.readouterr().err
    assert main(["fleet", "stop", "b/hall-3", *more]) == 3


# ---- how lines are shown ------------------------------------------------------------------------


def line(name: str, *needs: tuple[str, str], word: str = "online") -> tuple[str, bytes, bytes]:
    said = {
        "bridge": "a", "state": word, "stands_s": 30, "drives": {"offline": 1, "online": 4},
        "attention": [{"kind": kind, "drive": drive or None, "text": f"why {kind}", "for_s": 60}
                      for kind, drive in needs],
    }  # fmt: skip
    return name, word.encode(), json.dumps(said).encode()


def fleet(*wanted: tuple[str, bytes, bytes]) -> FleetLines:
    lines = FleetLines(("lecombus",))
    lines.began()
    for name, state, summary in wanted:
        lines.take(f"lecombus/{name}/state", state, 100.0, is_retained=False)
        lines.take(f"lecombus/{name}/summary", summary, 100.0, is_retained=False, expiry_s=30)
    lines.settled()
    return lines


def views(*wanted: tuple[str, bytes, bytes], now_s: float = 101.0) -> list[LineView]:
    return fleet(*wanted).views(now_s)


def test_a_line_has_a_row_for_each_kind_of_need() -> None:
    needs = [("drive-offline", f"d{at}") for at in range(5)] + [("remark", "")]
    (view,) = views(line("a", *needs))
    drives = "4 online, 1 offline"
    assert rows_of(view) == [
        ("a", "drive offline", "d0, d1, d2 and 2 more", "why drive-offline", "61.0 s", drives,
         "1.0 s"),
        ("a", "remark", "", "why remark", "61.0 s", drives, "1.0 s"),
    ]  # fmt: skip
    (view,) = views(line("a"))
    assert rows_of(view) == [("a", "ok", "", "", "", drives, "1.0 s")]
    assert drives_text({"unknown": 3, "online": 0}) == "3 unknown"


def test_control_characters_of_others_do_not_reach_the_terminal() -> None:
    (view,) = views(line("a", ("trip\x1b[2J", "d\x1b]0;x\x07")))
    assert all(cell.isprintable() for row in rows_of(view) for cell in row)


def test_the_first_sentence_says_what_matters() -> None:
    lines = fleet(line("a"), line("b", ("trip", "d1")))
    assert headline("b:1883", lines, lines.views(101.0)) == (
        "1 of 2 lines needs attention", "bold red"
    )  # fmt: skip
    lines = fleet(line("a"))
    assert headline("b:1883", lines, lines.views(101.0)) == ("the one line is ok", "")
    lines.lost("Connection refused", 101.0)
    text, _ = headline("b:1883", lines, lines.views(101.0))
    assert text == "the broker b:1883 is away (Connection refused): nothing is known of 1 line"
    text, style = headline("b:1883", fleet(), [])
    assert (text, style) == ("b:1883 shows no line under lecombus", "bold red")


@pytest.mark.parametrize(("columns", "rows"), [(120, 12), (80, 24), (40, 8), (20, 5)])
def test_the_table_fits_the_terminal_and_shows_the_worst(columns: int, rows: int) -> None:
    lines = fleet(*(line(f"l{at:02}", ("trip", "d1")) for at in range(30)),
                  *(line(f"m{at:02}") for at in range(70)), line("z", word="lost"))  # fmt: skip
    screen = FleetScreen("b:1883")
    console = Console(file=io.StringIO(), width=columns, height=rows, force_terminal=True)
    found = lines.views(101.0)
    with console.capture() as drawn:
        console.print(screen._drawn(lines, found, columns, rows))
    said = drawn.get().splitlines()
    body = [row for row in said if "line lost" in row or row.startswith("z ")]
    assert body
    assert len([row for row in said if row.startswith(("l", "m", "z"))]) <= rows
    if columns >= 80:
        assert len(said) <= rows
        assert "that need attention, 70 more lines ok" in said[-2]


def test_what_has_no_room_is_counted() -> None:
    found = views(line("a", ("trip", "x")), line("b"), line("c"))
    assert left_out(found) == "1 more line that needs attention, 2 more lines ok"
    assert left_out(found[1:]) == "2 more lines ok"


def test_only_changes_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    broker = BrokerOptions(broker_of(given(url="mqtt://b")).entry, ("lecombus",))
    lines = fleet(line("a"), line("b"))
    changes = Changes(broker, as_json=True)

    def printed(now_s: float) -> list[tuple[str, Any]]:
        changes.show(lines, lines.views(now_s))
        said = [json.loads(row) for row in capsys.readouterr().out.splitlines()]
        return [(one.get("line") or one["kind"], one.get("status", one.get("connected")))
                for one in said]  # fmt: skip

    assert printed(101.0) == [("broker", True), ("a", "ok"), ("b", "ok")]
    assert printed(110.0) == []
    assert printed(131.0) == [("a", "no-news"), ("b", "no-news")]
    lines.lost("gone", 132.0)
    assert printed(132.0) == [("broker", False), ("a", "unknown"), ("b", "unknown")]
    lines.lost("refused", 134.0)
    assert printed(134.0) == [("broker", False)]
    lines.began()
    lines.take("lecombus/a/state", b"", 135.0, is_retained=False)
    lines.settled()
    assert printed(136.0) == [("broker", True), ("b", "no-news"), ("a", "removed")]
    text = Changes(broker, as_json=False)
    text.show(lines, lines.views(137.0))
    first, second = capsys.readouterr().out.splitlines()
    assert first.split("\t")[1:] == ["broker b:1883", "connected"]
    assert second.split("\t")[1:3] == ["b", "no news"]


def test_names_of_lines_are_read_one_a_line(tmp_path: Path) -> None:
    file = tmp_path / "lines"
    file.write_text("# all lines\nhall-1\n\n  hall-2  # the new one\n")
    assert names_in(file) == {"hall-1", "hall-2"}


def test_a_file_of_names_that_is_no_text_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "lines"
    file.write_bytes(b"hall-1\n\xff\n")
    words = ["fleet", "--once", "--broker", "mqtt://127.0.0.1:1", "--expect", str(file)]
    assert main(words) == Exit.USAGE
    assert f"{file} is not text in UTF-8" in capsys.readouterr().err


# ---- how stops are shown ------------------------------------------------------------------------

ANSWER = (
    '{"outcome": "%s", "members": [{"drive": "feeder", "code": "C0135", "outcome": "verified"},'
    ' {"drive": "belt", "code": "C0135", "outcome": "%s", "reason": "no answer"}], "age_s": 0.100}'
)


def test_a_line_of_which_one_drive_is_in_doubt_is_not_stopped(
    capsys: pytest.CaptureFixture[str],
) -> None:
    good = result_of("lecombus/a", (ANSWER % ("verified", "verified")).encode())
    # Whatever the whole says: each drive counts.
    bad = result_of("lecombus/b", (ANSWER % ("verified", "unknown")).encode())
    say_if_not_confirmed([good, bad], "quick-stop")
    show_stops([good, bad])
    said = capsys.readouterr()
    assert said.err.startswith("1 of 2 lines did not confirm the quick stop of every drive")
    assert [row.split("\t")[:4] for row in said.out.splitlines()] == [
        ["a", "feeder", "C0135", "verified"], ["a", "belt", "C0135", "verified"],
        ["b", "feeder", "C0135", "verified"], ["b", "belt", "C0135", "unknown"],
    ]  # fmt: skip
    say_if_not_confirmed([good], "quick-stop")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("more", [[], ["--json"]])
def test_a_stop_that_is_not_confirmed_is_said_on_standard_error(
    more: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = result_of("lecombus/b", (ANSWER % ("verified", "unknown")).encode())
    monkeypatch.setattr(fleet_stop, "send", lambda *args, **named: [bad])
    assert main(["fleet", "--broker", "mqtt://127.0.0.1:1", "stop", "b", *more]) == Exit.FAILED
    said = capsys.readouterr()
    assert said.err.startswith("1 of 1 line did not confirm the quick stop of every drive")
    assert '"stops": [' in said.out or not more


def test_answers_are_printed_as_they_came() -> None:
    text = ANSWER % ("verified", "verified")
    results = [result_of("lecombus/a", text.encode()), StopResult("lecombus/b", "unknown", "x")]
    said = stops_json(results, "all", "inhibit")
    assert '"age_s": 0.100' in said
    document = json.loads(said)
    assert [(one["line"], one["outcome"]) for one in document["stops"]] == [
        ("a", "verified"), ("b", "unknown"),
    ]  # fmt: skip
    assert document["stops"][1]["answer"] is None


@pytest.mark.parametrize(
    "payload",
    [b"", b"yes", b"[]", b"3", b"null", b"{}", b'{"outcome": 1}', b"\xff", b'{"outcome": NaN}',
     b"[" * 9000, b'{"outcome": "verified"'],
)  # fmt: skip
def test_an_answer_that_cannot_be_read_proves_nothing(payload: bytes) -> None:
    result = result_of("lecombus/a", payload)
    assert (result.outcome, result.kind, result.is_done) == ("unknown", "bad-answer", False)
    assert "not known whether it was carried out" in result.reason
    json.loads(stops_json([result], "all", "quick-stop"))
