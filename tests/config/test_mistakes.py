"""Each mistake a roster can have: its place, what is wrong, and what would be right."""

from __future__ import annotations

import pytest

from config.rosters import GOOD, drive_with, line_with, only, parsed, roster_with, said

BAUDS = "1200, 2400, 4800, 9600 or 19200 would be right"
FAMILIES = "820x, 821x, 822x, 824x, 8200vector, 93xx, smvector or generic would be right"


def test_the_roster_the_tests_start_from_is_right() -> None:
    assert [drive.name for drive in parsed(GOOD).drives] == ["feeder", "belt"]


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("baud: 9601", f"4:9: `baud` `9601` is unknown, did you mean 9600? {BAUDS}"),
        ("baud: 115200", f"4:9: `baud` `115200` is unknown, {BAUDS}"),
        ("baud: fast", "4:9: `baud` `fast` is no whole number, give 1200, 2400, 4800, 9600 or "
         "19200"),
        ("baud: [9600]", "4:9: `baud` is a list, give 1200, 2400, 4800, 9600 or 19200"),
        ("baud:", "4:8: `baud` is empty, give 1200, 2400, 4800, 9600 or 19200"),
        ("medium: rs458", "4:11: `medium` `rs458` is unknown, did you mean `rs485`? rs485, rs232 "
         "or fibre would be right"),
        ("direction: auto", "4:14: `direction` `auto` is unknown, adapter, kernel or rts would be "
         "right"),
        ("echo: maybe", "4:9: `echo` `maybe` is unknown, auto, yes or no would be right"),
        ("parity: even", "4:11: `parity` `even` is unknown, line or port would be right"),
        ("repeaters: 1", "4:14: `repeaters` `1` is neither yes nor no, true or false would be "
         "right"),
        ("turnaround: 2", "4:15: `turnaround` `2` has no unit, write 2ms, 2s, 2min or 2h"),
        ("turnaround: 2s", "4:15: `turnaround` `2s` is too long, 0s to 1s would be right"),
        ("turnaround: -2ms", "4:15: `turnaround` `-2ms` is negative, write 2ms"),
        ("retries: 11", "4:12: `retries` `11` is out of range, 0 to 10 would be right"),
        ("retries: 2.0", "4:12: `retries` `2.0` is no whole number, give a whole number, 0 to 10"),
        ("late_answer: 1min", "4:16: `late_answer` `1min` is too long, 10ms to 10s would be right"),
        ("adapter_latency: 16", "4:20: `adapter_latency` `16` has no unit, write 16ms, 16s, 16min "
         "or 16h"),
        ("absent_share: 0.1", "4:17: `absent_share` `0.1` has no percent sign, write 10%"),
        ("absent_share: 80%", "4:17: `absent_share` `80%` is out of range, 1% to 50% would be "
         "right"),
        ("stall: 10ms", "4:10: `stall` `10ms` is too short, 1s to 1h would be right, or 0 for "
         "never"),
        ("bauds: 9600", "4:3: a line has no key `bauds`, did you mean `baud`?"),
        ("repeaters: true\n  medium: fibre", "4:14: medium fibre has no repeaters, remove the key, "
         "or write medium: rs485"),
    ],
)  # fmt: skip
def test_a_wrong_key_of_the_line(written: str, expected: str) -> None:
    assert only(line_with(written)) == expected


def test_an_unknown_key_that_resembles_none_is_told_all_of_them() -> None:
    words = only(line_with("colour: red"))
    assert words.startswith("4:3: a line has no key `colour`, the keys of a line are name, port, ")


@pytest.mark.parametrize(
    ("port", "expected"),
    [
        ("''", "`port` `` is no port, give a device path, socket://HOST:PORT "
         "or sim:"),
        ("sockt://h:1", "`port` `sockt://h:1` has the unknown scheme `sockt`, did you mean "
         "`socket`?"),
        ("http://h:1", "`port` `http://h:1` has the unknown scheme `http`, socket or sim "
         "would be right"),
        ("socket://host", "`port` `socket://host` is not a host with a port, write "
         "socket://HOST:PORT, such as socket://192.0.2.7:4001"),
        ("socket:host:1", "`port` `socket:host:1` has no host, write socket://HOST:PORT, such as "
         "socket://192.0.2.7:4001"),
        ("socket://h:70000", "`port` `socket://h:70000` is not a host with a port, write "
         "socket://HOST:PORT, such as socket://192.0.2.7:4001"),
        ("socket://h:0", "`port` `socket://h:0` has the port number 0, write socket://HOST:PORT, "
         "such as socket://192.0.2.7:4001"),
        ("ttyUSB0", "`port` `ttyUSB0` is no whole path, write /dev/ttyUSB0"),
        ("simm", "`port` `simm` is no port, did you mean `sim:`?"),
        ("/dev/serial/", "`port` `/dev/serial/` is a directory, name the device in it, such as "
         "/dev/serial/NAME"),
    ],
)  # fmt: skip
def test_a_wrong_port(port: str, expected: str) -> None:
    assert only(GOOD.replace("/dev/serial/by-id/usb-1", port)) == f"3:9: {expected}"


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
def test_a_device_server_switches_its_transceiver_itself(direction: str) -> None:
    text = line_with(f"direction: {direction}").replace("/dev/serial/by-id/usb-1", "socket://h:1")
    assert only(text) == (
        f"4:14: direction {direction} cannot work on `socket://h:1`, a device server switches its "
        "transceiver itself: write adapter"
    )


@pytest.mark.parametrize("name", ["hall 3", "../etc", ".x", "-x", "a/b", "Ä", "x" * 65, "''"])
def test_a_line_name_must_be_usable_in_file_names(name: str) -> None:
    assert only(GOOD.replace("hall-3", name)).startswith("2:9: `name` `")


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("10", "ends in 0 and so reaches the group 11..19, 1..99 without 10, 20 .. 90 are right"),
        ("0", "ends in 0 and so reaches all drives, 1..99 without 10, 20 .. 90 are right"),
        ("100", "is out of range, 1..99 without 10, 20 .. 90 are right"),
        ("-1", "is out of range, 1..99 without 10, 20 .. 90 are right"),
        ("013", "begins with 0, which some YAML readers take for octal, write 13"),
        (
            "010",
            "begins with 0, which some YAML readers take for octal, 1..99 without 10, 20 .. 90 "
            "are right",
        ),
        (
            "0113",
            "begins with 0, which some YAML readers take for octal, 1..99 without 10, 20 .. 90 "
            "are right",
        ),
        ("11:30", "is no whole number, give a whole number, 1 to 99"),
        ("0x0B", "is no whole number, give a whole number, 1 to 99"),
        ("1_1", "is no whole number, give a whole number, 1 to 99"),
        ("eleven", "is no whole number, give a whole number, 1 to 99"),
        ("9" * 5000, None),
    ],
)
def test_a_wrong_address(address: str, expected: str | None) -> None:
    words = only(GOOD.replace("12", address))
    assert words.startswith("9:14: `address` `")
    if expected is not None:
        assert words == f"9:14: `address` `{address}` {expected}"


def test_a_double_address_names_the_other_drive_and_a_free_address() -> None:
    assert only(GOOD.replace("12", "11")) == (
        "9:14: address 11 is that of drive `feeder` in line 6 already, every drive needs its own; "
        "12 is free"
    )


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("feeder", "a drive named `feeder` stands in line 5 already, every drive needs its own "
         "name"),
        ("all", "`name` `all` is taken, `all` is the group of all drives"),
        ("Belt 2", "`name` `Belt 2` is not usable as a drive name, use a-z, 0-9, _ and -, "
         "beginning with a letter or digit, such as belt-2"),
        ("-", None),
        ("[a]", "`name` is a list, give a drive name such as feeder-2"),
    ],
)  # fmt: skip
def test_a_wrong_drive_name(name: str, expected: str | None) -> None:
    words = said(GOOD.replace("belt", name))
    if expected is None:
        assert words == ["8:11: not valid YAML: a list cannot begin here, begin it on its own line"]
    else:
        assert words == [f"8:11: {expected}"]


@pytest.mark.parametrize(
    ("line", "count", "expected"),
    [
        ("medium: rs232", 2, "there are 2 drives, but rs232 takes 1, keep one drive, or write "
         "medium: rs485"),
        ("medium: rs485", 32, "there are 32 drives, but rs485 takes 31, split them over two lines, "
         "or write repeaters: true for 90"),
        ("medium: fibre", 53, "there are 53 drives, but fibre takes 52, remove drives or split "
         "them over two lines"),
    ],
)  # fmt: skip
def test_a_medium_takes_so_many_drives(line: str, count: int, expected: str) -> None:
    addresses = [number for number in range(1, 100) if number % 10]

    def roster(drives: int, *more: str) -> str:
        head = line_with(line, *more).split("  - name")[0]
        return head + "".join(
            f"  - {{name: d{n}, address: {addresses[n]}, family: generic}}\n" for n in range(drives)
        )

    assert only(roster(count)) == f"{count + 5}:5: {expected}"
    assert len(parsed(roster(count - 1)).drives) == count - 1
    if "rs485" in line:
        assert len(parsed(roster(90, "repeaters: true")).drives) == 90


@pytest.mark.parametrize(
    ("family", "expected"),
    [
        ("8200vektor", f"did you mean `8200vector`? {FAMILIES}"),
        ("8200Vector", f"did you mean `8200vector`? {FAMILIES}"),
        ("siemens", FAMILIES),
    ],
)
def test_an_unknown_family(family: str, expected: str) -> None:
    text = GOOD.replace("smvector", family)
    assert only(text) == f"10:13: `family` `{family}` is unknown, {expected}"


@pytest.mark.parametrize(
    ("written", "family", "expected"),
    [
        ("{time: 2, action: trip}", "smvector",
         ["8:22: `time` `2` has no unit, write 2ms, 2s, 2min or 2h"]),
        ("{time: 66s, action: none}", "smvector",
         ["8:22: a watchdog time of 66s is out of range for family smvector, 1ms to 65s would be "
          "right"]),
        ("{time: 49ms, action: none}", "8200vector",
         ["8:22: a watchdog time of 49ms is out of range for family 8200vector, 50ms to 65.535s "
          "would be right"]),
        ("{time: 50.5ms, action: none}", "8200vector",
         ["8:22: a watchdog time of 50.5ms is no whole number of milliseconds, write 50ms"]),
        ("{time: 2s, action: trip}", "8200vector",
         ["8:34: the watchdog of family 8200vector has no action `trip`, none, inhibit or "
          "quick-stop would be right"]),
        ("{time: 2s, action: quickstop}", "smvector",
         ["8:34: the watchdog of family smvector has no action `quickstop`, did you mean "
          "`quick-stop`? none, inhibit, quick-stop or trip would be right"]),
        ("{time: 2s}", "smvector",
         ["8:15: the watchdog has no `action`, give none, inhibit, quick-stop or trip"]),
        ("{action: none, config: true}", "smvector",
         ["8:15: the watchdog has no `time`, give a duration such as 500ms or 2s",
          "8:30: a watchdog has no key `config`, did you mean `configure`?"]),
        ("{time: 2s, action: none, configure: true}", "generic",
         ["8:15: no watchdog is known for family generic, remove the key"]),
        ("2s", "smvector", ["8:15: `watchdog` is a single value, give a mapping with time and "
                            "action"]),
    ],
)  # fmt: skip
def test_a_wrong_watchdog(written: str, family: str, expected: list[str]) -> None:
    assert said(drive_with(f"watchdog: {written}", family=family)) == expected


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("C99999", "is out of range, codes run from 0 to 65535"),
        ("C0039/256", "has a subcode out of range, subcodes run from 0 to 255"),
        ("P1000", "is no SMVector parameter, P0 to P999 would be right"),
        ("C12x", "is no code, write it like C0150, C150, 150, C0039/1 (code/subcode) or P425"),
        ("C" + "9" * 40, "is out of range, codes run from 0 to 65535"),
    ],
)
def test_a_wrong_code(code: str, expected: str) -> None:
    assert only(drive_with(f"writable: [{code}]")) == f"8:16: the code `{code}` {expected}"
    text = drive_with(f"cyclic: [{{every: 1s, code: {code}}}]")
    assert only(text) == f"8:32: `code` `{code}` {expected}"


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("cyclic: [{code: 1, every: 0s}]", "8:31: `every` `0s` is too short, 10ms to 24h would be "
         "right"),
        ("cyclic: [{code: 1, every: 5ms}]", "8:31: `every` `5ms` is too short, 10ms to 24h would "
         "be right"),
        ("cyclic: [{code: C46, every: 1s}, {code: 46, every: 2s}]", "8:45: C0046 is read "
         "cyclically already (line 8), keep one of the two"),
        ("cyclic: C0150", "8:13: `cyclic` is a single value, give a list, each item a mapping with "
         "code and every"),
        ("cyclic: [C0150]", "8:14: the cyclic read is a single value, give a mapping with code and "
         "every"),
        ("cyclic: {code: C1, every: 1s}", "8:13: `cyclic` is a mapping (`key: value`), give a "
         "list, each item a mapping with code and every"),
        ("writable: C0046", "8:15: `writable` is a single value, put it in brackets: [C0046]"),
        ("writable: [C46, C0046]", "8:21: C0046 is writable already (line 8), keep one of the "
         "two"),
        ("also_writable: [C0009]", "8:21: C0009 is its address and is never written like other "
         "codes, remove it: `lecombus readdress` changes an address, with allow_address_change"),
        ("also_writable: [C46, C0046]", "8:26: C0046 is writable already (line 8), keep one of the "
         "two"),
        ("writable: [C0009]", "8:16: C0009 is its address and is never written like other "
         "codes, remove it: `lecombus readdress` changes an address, with allow_address_change"),
        ("writable: [C39/1]\n    addressing: standard", "8:16: C0039/1 needs extended addressing, "
         "which this drive does not have, codes 0 to 6229 without subcode would be right, or "
         "addressing: both"),
        ("addressing: extended", "8:17: `addressing` `extended` is unknown, both or standard would "
         "be right"),
        ("answer_time: 0s", "8:18: `answer_time` `0s` is too short, 1ms to 10s would be right"),
        ("adress: 12", "8:5: a drive has no key `adress`, did you mean `address`?"),
        ("lease: {on_lapse: stop}", "8:23: `on_lapse` `stop` is unknown, quick-stop, "
         "inhibit, silence or hold would be right"),
    ],
)  # fmt: skip
def test_a_wrong_key_of_a_drive(written: str, expected: str) -> None:
    assert only(drive_with(written)) == expected


def test_codes_that_move_a_drive_away_are_writable_when_asked_for_in_words() -> None:
    roster = parsed(drive_with("writable: [C0009, C0125]", "allow_address_change: true"))
    assert [str(code) for code in sorted(roster.drives[0].writable)] == ["C0009", "C0125"]


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("groups: {g: {members: [bel]}}", "11:24: the group `g` has the member `bel`, which is no "
         "drive, did you mean `belt`?"),
        ("groups: {g: {members: [xyz]}}", "11:24: the group `g` has the member `xyz`, which is no "
         "drive, the drives are belt or feeder"),
        ("groups: {g: {members: []}}", "11:23: `members` is an empty list, give a list, each item "
         "a drive's name"),
        ("groups: {g: {members: [belt, belt]}}", "11:30: `belt` is a member of `g` twice, keep one "
         "of the two"),
        ("groups: {g: {}}", "11:13: the group has no `members`, give a list, each item a drive's "
         "name"),
        ("groups: {belt: {members: [belt]}}", "11:10: `belt` is also a drive (line 8), give the "
         "group another name"),
        ("groups: {all: {members: [belt]}}", "11:16: a group of all drives has no key `members`, "
         "the keys of a group of all drives are multicast"),
        ("groups: {g: {members: [belt], multicast: 1}}", "11:42: `multicast` `1` is neither yes "
         "nor no, true or false would be right"),
        ("groups: {A: {members: [belt]}}", "11:10: the name `A` is not usable as a group name, use "
         "a-z, 0-9, _ and -, beginning with a letter or digit, such as a"),
        ("groups: [belt]", "11:9: `groups` is a list, give a mapping from a group name such as "
         "feeder-2 to a mapping with members"),
        ("groups: {g: [belt]}", "11:13: `g` is a list, give a mapping with members"),
        ("on_shutdown: stop", "11:14: `on_shutdown` `stop` is unknown, nothing, quick-stop or "
         "inhibit would be right"),
        ("api: {http: 0.0.0.0:9740}", "11:13: `http` `0.0.0.0:9740` is not local: api.http must be "
         "a loopback address, write 127.0.0.1:9740; from outside use a tunnel, such as ssh -L"),
        ("api: {http: 9740}", "11:13: `http` `9740` is not HOST:PORT, write it like 127.0.0.1:9740 "
         "or [::1]:9740"),
        ("api: {http: 'localhost:99999'}", "11:13: `http` `localhost:99999` has a port number out "
         "of range, 1 to 65535 would be right"),
        ("api: {socket: run/x.sock}", "11:15: `socket` `run/x.sock` is no absolute path, write it "
         "from /, such as /run/lecombus/hall-3.sock"),
        ("api: {tokens: /etc/}", "11:15: `tokens` `/etc/` is a directory, name a file, such as "
         "/etc/lecombus/tokens"),
        ("mqtt: {port: 1}", "11:7: the mqtt has no `host`, give a host name or address"),
        ("mqtt: {host: 'a:1'}", "11:14: `host` `a:1` has a port in it, give the port by the key "
         "`port`"),
        ("journal: x.sqlite", "11:10: `journal` `x.sqlite` is no absolute path, write it from /, "
         "such as /var/lib/lecombus/hall-3.sqlite"),
        ("lease: yes", "11:8: `lease` is a single value, give a mapping with keys such as "
         "required"),
        ("lease: {time: 1ms}", "11:15: `time` `1ms` is too short, 100ms to 1h would be right"),
        ("on-shutdown: nothing", "11:1: a roster has no key `on-shutdown`, did you mean "
         "`on_shutdown`?"),
        ("line: {}", "11:1: the key `line` stands twice (first in line 1), keep one of the two"),
    ],
)  # fmt: skip
def test_a_wrong_key_of_the_roster(written: str, expected: str) -> None:
    assert only(roster_with(written)) == expected


def test_a_socket_path_longer_than_the_system_takes() -> None:
    assert "at most 107 are possible" in only(roster_with(f"api: {{socket: /{'é' * 54}}}"))
    assert parsed(roster_with(f"api: {{socket: /{'x' * 106}}}")).api.socket


@pytest.mark.parametrize("action", ["quick-stop", "inhibit"])
def test_what_no_description_can_stop_is_not_stopped_at_the_end(action: str) -> None:
    text = roster_with(f"on_shutdown: {action}").replace("smvector", "generic")
    assert only(text) == (
        f"11:14: on_shutdown is {action}, but family generic of drive `belt` (line 8) knows no "
        f"{action}, write `nothing`"
    )


@pytest.mark.parametrize(
    "lease",
    ["lease: {required: true}", "lease: {on_lapse: inhibit}"],
)
def test_a_lapse_needs_a_stop_the_family_knows(lease: str) -> None:
    assert "but family generic knows no " in only(drive_with(lease, family="generic"))
    top = roster_with("lease: {required: true}").replace("smvector", "generic")
    assert "on_lapse is quick-stop, but family generic knows no quick-stop" in only(top)
    silence = drive_with("lease: {required: true, on_lapse: silence}", family="generic")
    assert parsed(silence).drives[0].lease.on_lapse == "silence"


def test_missing_keys_are_asked_for_with_what_to_give() -> None:
    assert said("line: {}\ndrives: [{}]\n") == [
        "1:7: the line has no `name`, give a line name such as hall-3",
        "1:7: the line has no `port`, give a device path, socket://HOST:PORT or sim:",
        "2:10: the drive has no `address`, give a whole number, 1 to 99",
        f"2:10: the drive has no `family`, give {FAMILIES.removesuffix(' would be right')}",
        "2:10: the drive has no `name`, give a drive name such as feeder-2",
    ]
    assert [words.split(",")[0] for words in said("lease: {}\n")] == [
        "1:1: the roster has no `drives`", "1:1: the roster has no `line`"
    ]  # fmt: skip


@pytest.mark.parametrize("drives", ["[]", "{}", "", "feeder"])
def test_a_line_needs_drives(drives: str) -> None:
    assert only(f"line: {{name: a, port: sim}}\ndrives: {drives}\n").startswith("2:")


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


def test_behind_an_unknown_family_everything_else_is_checked_too() -> None:
    told = said(drive_with(
        "watchdog: {time: 66s, action: quick-stopp}", "writable: [C0999999]", "cyclic: [x]",
        "answer_time: 2", family="8200vektor",
    ))  # fmt: skip
    assert [one.partition(" ")[0] for one in told] == ["7:13:", "8:22:", "8:35:", "9:16:", "10:14:",
                                                       "11:18:"]  # fmt: skip
    assert told[1] == (
        "8:22: a watchdog time of 66s is out of range for every family, 1ms to 65.535s would be "
        "right"
    )
    assert told[2] == (
        "8:35: no family's watchdog has an action `quick-stopp`, did you mean `quick-stop`? none, "
        "inhibit, quick-stop or trip would be right"
    )


def test_behind_an_unknown_family_what_one_family_can_do_passes() -> None:
    told = only(drive_with("watchdog: {time: 20ms, action: trip}", family="8200vektor"))
    assert told.startswith("7:13: `family`")
    _, second = said(drive_with("watchdog: {time: 0.0205s, action: trip}", family="8200vektor"))
    assert "is no whole number of milliseconds" in second


@pytest.mark.parametrize(("key", "article"), [("api", "an"), ("mqtt", "an"), ("lease", "a")])
def test_an_unknown_key_is_told_with_the_right_article(key: str, article: str) -> None:
    told = said(
        roster_with(f"{key}: {{zzzzzz: 1, host: h}}" if key == "mqtt" else f"{key}: {{zzzzzz: 1}}")
    )
    assert f"{article} {key} has no key `zzzzzz`, the keys of {article} {key} are " in told[0]
