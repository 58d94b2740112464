"""Each mistake a roster can have: its place, what is wrong, and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest

from config.rosters import GOOD, drive_with, line_with, only, parsed, roster_with, said
from lecombus.line.opening import url_mistake
from support.golden import Golden
from support.rosters import roster_text


def test_the_roster_the_tests_start_from_is_right() -> None:
    assert [drive.name for drive in parsed(GOOD).drives] == ["feeder", "belt"]


@pytest.mark.parametrize(
    ("written", "place"),
    [
        ("baud: 9601", "4:9"),
        ("baud: 115200", "4:9"),
        ("baud: fast", "4:9"),
        ("baud: [9600]", "4:9"),
        ("baud:", "4:8"),
        ("medium: rs458", "4:11"),
        ("direction: auto", "4:14"),
        ("echo: maybe", "4:9"),
        ("parity: even", "4:11"),
        ("repeaters: 1", "4:14"),
        ("turnaround: 2", "4:15"),
        ("turnaround: 2s", "4:15"),
        ("turnaround: -2ms", "4:15"),
        ("retries: 11", "4:12"),
        ("retries: 2.0", "4:12"),
        ("late_answer: 1min", "4:16"),
        ("adapter_latency: 16", "4:20"),
        ("absent_share: 0.1", "4:17"),
        ("absent_share: 80%", "4:17"),
        ("stall: 10ms", "4:10"),
        ("bauds: 9600", "4:3"),
        ("repeaters: true\n  medium: fibre", "4:14"),
    ],
)
def test_a_wrong_key_of_the_line(written: str, place: str, golden: Golden) -> None:
    words = only(line_with(written))
    assert words.startswith(f"{place}: ")
    golden(words)


def test_an_unknown_key_that_resembles_none_is_told_all_of_them() -> None:
    words = only(line_with("colour: red"))
    assert words.startswith("4:3: a line has no key `colour`, the keys of a line are name, port, ")


@pytest.mark.parametrize(
    "port",
    [
        "''",
        "sockt://h:1",
        "http://h:1",
        "socket://host",
        "socket:host:1",
        "socket://h:70000",
        "socket://h:0",
        "ttyUSB0",
        "simm",
        "/dev/serial/",
    ],
)
def test_a_wrong_port(port: str, golden: Golden) -> None:
    words = only(GOOD.replace("/dev/serial/by-id/usb-1", port))
    assert words.startswith("3:9: ")
    golden(words)


@pytest.mark.parametrize(
    ("port", "instead"),
    [
        ("rfc2217://server:4002", ("socket://server:4002 ", "tcp,4002`")),
        ("RFC2217://[::1]:23?timeout=3", ("socket://[::1]:23 ", "tcp,23`")),
        ("rfc2217://server", ("socket://HOST:4001 ", "tcp,4001`")),
    ],
)
def test_a_remote_controlled_port_is_refused_with_the_lines_to_write_instead(
    port: str, instead: tuple[str, str]
) -> None:
    words = only(GOOD.replace("/dev/serial/by-id/usb-1", port))
    assert words.startswith(f"3:9: `port` `{port}` is not supported, write socket://")
    for right in (*instead, "connector: serialdev,/dev/ttyUSB0,BAUDn81,local", "`parity: port`"):
        assert right in words


@pytest.mark.parametrize("direction", ["kernel", "rts"])
def test_a_device_server_switches_its_transceiver_itself(direction: str, golden: Golden) -> None:
    text = line_with(f"direction: {direction}").replace("/dev/serial/by-id/usb-1", "socket://h:1")
    words = only(text)
    assert words.startswith("4:14: ")
    golden(words)


@pytest.mark.parametrize("name", ["hall 3", "../etc", ".x", "-x", "a/b", "Ä", "x" * 65, "''"])
def test_a_line_name_must_be_usable_in_file_names(name: str) -> None:
    assert only(GOOD.replace("hall-3", name)).startswith("2:9: `name` `")


@pytest.mark.parametrize(
    "address",
    ["10", "0", "100", "-1", "013", "010", "0113", "11:30", "0x0B", "1_1", "eleven", "9" * 5000],
)
def test_a_wrong_address(address: str, golden: Golden) -> None:
    words = only(GOOD.replace("12", address))
    assert words.startswith("9:14: `address` `")
    if len(address) < 100:
        golden(words)


def test_a_double_address_names_the_other_drive_and_a_free_address(golden: Golden) -> None:
    words = only(GOOD.replace("12", "11"))
    assert words.startswith("9:14: ")
    golden(words)


@pytest.mark.parametrize("name", ["feeder", "all", "Belt 2", "-", "[a]"])
def test_a_wrong_drive_name(name: str, golden: Golden) -> None:
    words = only(GOOD.replace("belt", name))
    assert words.startswith("8:11: ")
    golden(words)


@pytest.mark.parametrize(
    ("line", "count"), [("medium: rs232", 2), ("medium: rs485", 32), ("medium: fibre", 53)]
)
def test_a_medium_takes_so_many_drives(line: str, count: int, golden: Golden) -> None:
    addresses = [number for number in range(1, 100) if number % 10]

    def roster(drives: int, *more: str) -> str:
        head = line_with(line, *more).split("  - name")[0]
        return head + "".join(
            f"  - {{name: d{n}, address: {addresses[n]}, family: generic}}\n" for n in range(drives)
        )

    words = only(roster(count))
    assert words.startswith(f"{count + 5}:5: ")
    golden(words)
    assert len(parsed(roster(count - 1)).drives) == count - 1
    if "rs485" in line:
        assert len(parsed(roster(90, "repeaters: true")).drives) == 90


@pytest.mark.parametrize("family", ["8200vektor", "8200Vector", "siemens"])
def test_an_unknown_family(family: str, golden: Golden) -> None:
    text = GOOD.replace("smvector", family)
    words = only(text)
    assert words.startswith("10:13: ")
    golden(words)


@pytest.mark.parametrize(
    ("written", "family", "places"),
    [
        ("{time: 2, action: trip}", "smvector", ["8:22"]),
        ("{time: 66s, action: none}", "smvector", ["8:22"]),
        ("{time: 49ms, action: none}", "8200vector", ["8:22"]),
        ("{time: 50.5ms, action: none}", "8200vector", ["8:22"]),
        ("{time: 2s, action: trip}", "8200vector", ["8:34"]),
        ("{time: 2s, action: quickstop}", "smvector", ["8:34"]),
        ("{time: 2s}", "smvector", ["8:15"]),
        ("{action: none, config: true}", "smvector", ["8:15", "8:30"]),
        ("{time: 2s, action: none, configure: true}", "generic", ["8:15"]),
        ("2s", "smvector", ["8:15"]),
    ],
)
def test_a_wrong_watchdog(written: str, family: str, places: list[str], golden: Golden) -> None:
    found = said(drive_with(f"watchdog: {written}", family=family))
    assert [words.split(": ")[0] for words in found] == places
    golden(*found)


@pytest.mark.parametrize("code", ["C99999", "C0039/256", "P1000", "C12x", "C" + "9" * 40])
def test_a_wrong_code(code: str, golden: Golden) -> None:
    writable = only(drive_with(f"writable: [{code}]"))
    cyclic = only(drive_with(f"cyclic: [{{every: 1s, code: {code}}}]"))
    assert writable.startswith("8:16: ")
    assert cyclic.startswith("8:32: ")
    golden(writable, cyclic)


@pytest.mark.parametrize(("code", "family"), [("C0125", "8200vector"), ("P411", "smvector")])
def test_a_baud_rate_that_may_be_written_is_answered_with_rebaud(code: str, family: str) -> None:
    words = only(drive_with(f"also_writable: [{code}]", family=family))
    assert "is its baud rate" in words
    assert "`lecombus rebaud` a baud rate" in words


@pytest.mark.parametrize(
    ("written", "place"),
    [
        ("cyclic: [{code: 1, every: 0s}]", "8:31"),
        ("cyclic: [{code: 1, every: 5ms}]", "8:31"),
        ("cyclic: [{code: C46, every: 1s}, {code: 46, every: 2s}]", "8:45"),
        ("cyclic: C0150", "8:13"),
        ("cyclic: [C0150]", "8:14"),
        ("cyclic: {code: C1, every: 1s}", "8:13"),
        ("writable: C0046", "8:15"),
        ("writable: [C46, C0046]", "8:21"),
        ("also_writable: [C0009]", "8:21"),
        ("also_writable: [C46, C0046]", "8:26"),
        ("writable: [C0009]", "8:16"),
        ("writable: [C39/1]\n    addressing: standard", "8:16"),
        ("addressing: extended", "8:17"),
        ("answer_time: 0s", "8:18"),
        ("adress: 12", "8:5"),
        ("lease: {on_lapse: stop}", "8:23"),
    ],
)
def test_a_wrong_key_of_a_drive(written: str, place: str, golden: Golden) -> None:
    words = only(drive_with(written))
    assert words.startswith(f"{place}: ")
    golden(words)


def test_codes_that_move_a_drive_away_are_writable_when_asked_for_in_words() -> None:
    roster = parsed(drive_with("writable: [C0009, C0125]", "allow_address_change: true"))
    assert [str(code) for code in sorted(roster.drives[0].writable)] == ["C0009", "C0125"]


@pytest.mark.parametrize(
    ("written", "place"),
    [
        ("groups: {g: {members: [bel]}}", "11:24"),
        ("groups: {g: {members: [xyz]}}", "11:24"),
        ("groups: {g: {members: []}}", "11:23"),
        ("groups: {g: {members: [belt, belt]}}", "11:30"),
        ("groups: {g: {}}", "11:13"),
        ("groups: {belt: {members: [belt]}}", "11:10"),
        ("groups: {all: {members: [belt]}}", "11:16"),
        ("groups: {g: {members: [belt], multicast: 1}}", "11:42"),
        ("groups: {A: {members: [belt]}}", "11:10"),
        ("groups: [belt]", "11:9"),
        ("groups: {g: [belt]}", "11:13"),
        ("on_shutdown: stop", "11:14"),
        ("api: {http: 0.0.0.0:9740}", "11:13"),
        ("api: {http: '[::]:80', tokens: /t}", "11:13"),
        ("api: {http: 192.0.2.5:80, tls: {certificate: /c, key: /k}}", "11:13"),
        ("api: {http: example.com:80, tokens: /t, tls: {certificate: /c, key: /k}}", "11:13"),
        ("api: {tls: {certificate: /c}}", "11:12"),
        ("api: {tls: {certificate: c, key: /k}}", "11:26"),
        ("api: {tls: yes}", "11:12"),
        ("api: {hosts: a}", "11:14"),
        ("api: {hosts: ['a b']}", "11:15"),
        ("api: {hosts: ['a:1']}", "11:15"),
        ("api: {hosts: [a..b]}", "11:15"),
        ("api: {socket_group: 'a b'}", "11:21"),
        ("api: {read_only: 1}", "11:18"),
        ("api: {http: 9740}", "11:13"),
        ("api: {http: 'localhost:99999'}", "11:13"),
        ("api: {socket: run/x.sock}", "11:15"),
        ("api: {tokens: /etc/}", "11:15"),
        ("mqtt: {port: 1}", "11:7"),
        ("mqtt: {host: 'a:1'}", "11:14"),
        ("mqtt: {host: h, topics: a//b}", "11:25"),
        ("mqtt: {host: h, topics: 'a/#'}", "11:25"),
        ("mqtt: {host: h, home_assistant: /a}", "11:33"),
        ("mqtt: {host: h, certificate: /c}", "11:30"),
        ("mqtt: {host: h, key: /k}", "11:22"),
        ("mqtt: {host: h, password_file: /p}", "11:32"),
        ("mqtt: {host: h, tls: no, ca: /c}", "11:30"),
        ("mqtt: {host: h, username: ''}", "11:27"),
        ("modbus: {host: 0.0.0.0}", "11:16"),
        ("modbus: {host: '::', allow: []}", "11:16"),
        ("modbus: {host: plc.example}", "11:16"),
        ("modbus: {allow: 192.0.2.7}", "11:17"),
        ("modbus: {allow: [plc]}", "11:18"),
        ("modbus: {allow: [192.0.2.7/24]}", "11:18"),
        ("modbus: {units: []}", "11:17"),
        ("modbus: {units: [256]}", "11:18"),
        ("modbus: {port: 0}", "11:16"),
        ("modbus: {control: maybe}", "11:19"),
        ("modbus: yes", "11:9"),
        ("notify: {}", "11:9"),
        ("notify: {gather: 1s}", "11:9"),
        ("notify: {command: []}", "11:19"),
        ("notify: {command: /bin/true}", "11:19"),
        ("notify: {command: [page]}", "11:20"),
        ("notify: {command: [/bin/page], command_time: 0}", "11:46"),
        ("notify: {command: [/bin/page], events: [trip, stop]}", "11:47"),
        ("notify: {command: [/bin/page], events: [trip, trip]}", "11:47"),
        ("notify: {command: [/bin/page], limit: {burst: 0}}", "11:47"),
        ("notify: {command: [/bin/page], daemon_gone: 0s}", "11:45"),
        ("notify: {mail: {to: [a@b.example]}}", "11:16"),
        ("notify: {mail: {to: [a b@c.example], from: x@y.example}}", "11:22"),
        ("notify: {mail: {to: [a@b.example], from: me}}", "11:42"),
        ("notify: {mail: {to: [a@b.example], from: x@y.example, port: 25}}", "11:61"),
        ("notify: {mail: {to: [a@b.example], from: x@y.example, host: m, user: me}}", "11:70"),
        (
            "notify: {mail: {to: [a@b], from: a@b, host: m, security: none, "
            "user: u, password_file: /p}}",
            "11:58",
        ),
        (
            "notify: {mail: {to: [a@b.example], from: x@y.example, host: m, security: none, "
            "ca: /etc/ca}}",
            "11:84",
        ),
        ("version: 0", "11:10"),
        ("version: one", "11:10"),
        ("version: 2", "11:10"),
        ("version: [2]", "11:10"),
        ("journal: x.sqlite", "11:10"),
        ("journal: [x]", "11:10"),
        ("journal: {max_size: 32MB}", "11:10"),
        ("journal: {file: /j, max_size: 5}", "11:31"),
        ("journal: {file: /j, max_size: 200000GB}", "11:31"),
        ("journal: {file: /j, on_failure: stop}", "11:33"),
        ("lease: yes", "11:8"),
        ("lease: {time: 1ms}", "11:15"),
        ("on-shutdown: nothing", "11:1"),
        ("line: {}", "11:1"),
    ],
)
def test_a_wrong_key_of_the_roster(written: str, place: str, golden: Golden) -> None:
    words = only(roster_with(written))
    assert words.startswith(f"{place}: ")
    golden(words)


def test_a_roster_of_a_newer_form_is_refused_before_its_keys_are_read(golden: Golden) -> None:
    golden(only("version: 3\nmeters: [a]\nline: 5\n" + GOOD))


def test_a_socket_path_longer_than_the_system_takes() -> None:
    assert "at most 107 are possible" in only(roster_with(f"api: {{socket: /{'é' * 54}}}"))
    assert parsed(roster_with(f"api: {{socket: /{'x' * 106}}}")).api.socket


@pytest.mark.parametrize("action", ["quick-stop", "inhibit"])
def test_what_no_description_can_stop_is_not_stopped_at_the_end(
    action: str, golden: Golden
) -> None:
    text = roster_with(f"on_shutdown: {action}").replace("smvector", "generic")
    words = only(text)
    assert words.startswith("11:14: ")
    golden(words)


@pytest.mark.parametrize(
    "lease",
    ["lease: {required: true}", "lease: {on_lapse: inhibit}"],
)
def test_a_lapse_needs_a_stop_the_family_knows(lease: str) -> None:
    assert "but family generic knows no " in only(drive_with(lease, family="generic"))
    top = roster_with("lease: {required: true}").replace("smvector", "generic")
    assert "on_lapse is quick-stop, but family generic knows no quick-stop" in only(top)
    hold = drive_with("lease: {required: true, on_lapse: hold}", family="generic")
    assert parsed(hold).drives[0].lease.on_lapse == "hold"


@pytest.mark.parametrize(
    ("keys", "is_right"),
    [
        ("lease: {required: true, on_lapse: silence}", False),
        ("lease: {required: true, on_lapse: silence}, watchdog: {time: 2s, action: none}", False),
        ("lease: {required: true, on_lapse: silence}, watchdog: {time: 2s, action: inhibit}", True),
        ("lease: {on_lapse: silence}", False),  # a client may take one all the same
        ("lease: {on_lapse: silence}, watchdog: {time: 2s, action: none}", False),
        ("lease: {on_lapse: silence}, watchdog: {time: 2s, action: inhibit}", True),
    ],
)
def test_a_silence_needs_a_watchdog_that_acts(keys: str, *, is_right: bool) -> None:
    text = roster_text([("feeder", 11, "8200vector")], drive=keys)
    if is_right:
        assert parsed(text).drives[0].lease.on_lapse == "silence"
    else:
        assert "nothing stops feeder then: the roster gives it no watchdog" in only(text)


def test_a_silence_by_the_default_of_leases_needs_a_watchdog_that_acts() -> None:
    drives = [("feeder", 11, "8200vector")]
    top = roster_text(drives, sections="lease: {on_lapse: silence}")
    assert "nothing stops feeder then: the roster gives it no watchdog" in only(top)


def test_a_family_without_stop_and_watchdog_is_told_to_hold() -> None:
    for lease in ("lease: {required: true}", "lease: {on_lapse: silence}"):
        text = roster_text([("feeder", 11, "generic")], drive=lease)
        assert only(text).endswith(", write on_lapse: hold")


def test_missing_keys_are_asked_for_with_what_to_give(golden: Golden) -> None:
    found = said("line: {}\ndrives: [{}]\n")
    assert [words.split(": ")[0] for words in found] == ["1:7", "1:7", "2:10", "2:10", "2:10"]
    golden(*found)
    found = said("lease: {}\n")
    assert [words.split(": ")[0] for words in found] == ["1:1", "1:1"]
    golden(*found)  # fmt: skip


@pytest.mark.parametrize(
    ("port", "wrong"),
    [
        ("sim:x", "has something behind `sim:`"),
        ("sim://", "has something behind `sim:`"),
        ("socket://h:4001/", "is not a host with a port"),
        ("socket://h:4001?logging=debug", "is not a host with a port"),
        ("socket://[1]:4001", "is not a host with a port"),
    ],
)
def test_a_port_that_run_could_never_open_is_refused(port: str, wrong: str) -> None:
    assert url_mistake(port) is not None
    assert wrong in only(GOOD.replace("/dev/serial/by-id/usb-1", f"'{port}'"))


@pytest.mark.parametrize("drives", ["[]", "{}", "", "feeder"])
def test_a_line_needs_drives(drives: str) -> None:
    assert only(f"line: {{name: a, port: sim}}\ndrives: {drives}\n").startswith("2:")


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        ("journal: /a/b\nstate: /a//./b", "`state` is the file of `journal.file` too"),
        ("journal: {file: /a/b}\napi: {socket: /a/b}", "`api.socket` is the file of"),
        ("state: /a/b\napi: {tokens: /a/b}", "`api.tokens` is the file of `state` too"),
        ("api: {socket: /a, tls: {certificate: /b, key: /a}}", "`api.tls.key` is the file of"),
        ("journal: /var/lib/lecombus/hall-3.json", "`journal.file` is the file of `state` too"),
        (f"journal: {Path('r.yaml').absolute()}", "`journal.file` is this roster, in whose place"),
        (f"state: {Path('r.yaml').absolute()}", "`state` is this roster, in whose place"),
    ],
)  # fmt: skip
def test_what_lecombus_writes_is_a_file_of_its_own(more: str, wrong: str) -> None:
    assert wrong in only(roster_with(more))


def test_the_file_of_a_state_that_is_not_kept_is_free() -> None:
    more = "journal: /var/lib/lecombus/hall-3.json"
    simulated = roster_with(more).replace("/dev/serial/by-id/usb-1", "sim")
    assert parsed(simulated).state is None
    assert parsed(roster_with(f"{more}\nstate: /s")).state == "/s"


def test_what_is_only_read_may_be_one_file() -> None:
    roster = parsed(roster_with("api: {tls: {certificate: /a, key: /a}}\njournal: /j\nstate: /s"))
    assert roster.api.tls is not None
    assert roster.api.tls.key == "/a"


def test_all_mistakes_come_at_once_in_the_order_of_the_file() -> None:
    text = """\
lnie:
  name: hall 3
  port: /dev/x
  baud: 9601
drives:
  - name: a
    address: 10
    family: smvektor
    watchdog: {time: 2, action: trip, confgure: maybe}
    writable: [C1/999, C5, C5]
  - {name: a, address: 11, family: generic, watchdog: {time: 2s}}
  - {name: b, address: 11, cyclic: [{code: x}]}
groups:
  g: {members: [a, c, c]}
"""
    places = [words.split(": ")[0] for words in said(text)]
    assert places == ["1:1", "2:9", "4:9", "7:14", "8:13", "9:22", "9:39", "9:49", "10:16",
                      "10:28", "11:12", "11:55", "11:55", "12:5", "12:24", "12:37", "12:44",
                      "14:20", "14:23"]  # fmt: skip


def test_a_mistake_by_way_of_an_anchor_is_told_once_where_it_stands() -> None:
    text = GOOD.replace("family: 8200vector", "family: 8200vector\n    cyclic: &c [{code: x}]")
    text = text.replace("family: smvector", "family: smvector\n    cyclic: *c")
    assert [words.split(":")[0:2] for words in said(text)] == [["8", "17"], ["8", "24"]]


def test_a_name_that_is_refused_still_counts_as_a_member() -> None:
    text = roster_with("groups: {g: {members: [Belt]}}").replace("name: belt", "name: Belt")
    assert only(text).startswith("8:11: `name` `Belt` is not usable")


def test_messages_stay_on_one_line_and_short() -> None:
    (words,) = said(GOOD.replace("smvector", '"a\\nb' + "x" * 500 + '"'))
    assert "\n" not in words
    assert len(words) < 300


def test_a_file_full_of_mistakes_is_given_up_in_good_time() -> None:
    members = ", ".join(f"b{number}" for number in range(20_000))
    drives = "".join(f"  - {{name: d{n}, address: 11, family: generic}}\n" for n in range(3000))
    text = f"line: {{name: a, port: sim}}\ndrives:\n{drives}groups: {{g: {{members: [{members}]}}}}"
    found = said(text)
    assert len(found) == 501
    assert found[-1].endswith("after 500 mistakes no more are looked for, correct these first")


def test_behind_an_unknown_family_everything_else_is_checked_too(golden: Golden) -> None:
    told = said(drive_with(
        "watchdog: {time: 66s, action: quick-stopp}", "writable: [C0999999]", "cyclic: [x]",
        "answer_time: 2", family="8200vektor",
    ))  # fmt: skip
    assert [one.partition(" ")[0] for one in told] == ["7:13:", "8:22:", "8:35:", "9:16:", "10:14:",
                                                       "11:18:"]  # fmt: skip
    golden(*told)


def test_behind_an_unknown_family_what_one_family_can_do_passes() -> None:
    told = only(drive_with("watchdog: {time: 20ms, action: trip}", family="8200vektor"))
    assert told.startswith("7:13: `family`")
    _, second = said(drive_with("watchdog: {time: 0.0205s, action: trip}", family="8200vektor"))
    assert "is not a whole number of milliseconds" in second


@pytest.mark.parametrize(("key", "article"), [("api", "an"), ("mqtt", "an"), ("lease", "a")])
def test_an_unknown_key_is_told_with_the_right_article(key: str, article: str) -> None:
    told = said(
        roster_with(f"{key}: {{zzzzzz: 1, host: h}}" if key == "mqtt" else f"{key}: {{zzzzzz: 1}}")
    )
    assert f"{article} {key} has no key `zzzzzz`, the keys of {article} {key} are " in told[0]
