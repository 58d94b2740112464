"""What a right roster becomes: complete, in seconds and codes, with what follows filled in."""

from __future__ import annotations

import time

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.rosters import CONFIG, GOOD, drive_with, line_with, parsed, roster_with
from lecombus.config import LeaseEntry, load_roster
from lecombus.drives import FAMILY_NAMES, family
from lecombus.fieldbus.lecom.protocol.addressing import Form, group_reach, multicast_address
from lecombus.parameters import Code
from lecombus.roster import (
    JournalEntry,
    MailEntry,
    MessageLimit,
    ModbusEntry,
    NotifyEntry,
    TlsEntry,
)

ADDRESSES = [number for number in range(1, 100) if number % 10]


def test_what_is_not_written_has_the_documented_default() -> None:
    roster = parsed(GOOD)
    line = roster.line
    assert (line.baud, line.medium, line.direction, line.echo, line.parity) == (
        9600, "rs485", "adapter", "auto", "line"
    )  # fmt: skip
    assert (line.turnaround_s, line.retries, line.late_answer_s) == (0.002, 2, 0.5)
    assert (line.absent_share, line.stall_s, line.adapter_latency_s) == (0.1, 30.0, None)
    assert (roster.api.socket, roster.api.http) == ("/run/lecombus/hall-3.sock", None)
    assert (roster.on_shutdown, roster.lease) == ("nothing", LeaseEntry())


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_a_drive_takes_over_what_its_family_says(name: str) -> None:
    (drive,) = parsed(drive_with(family=name)).drives
    of = family(name)
    assert [(entry.code, entry.every_s) for entry in drive.cyclic] == list(of.status)
    assert (drive.writable, drive.forms) == (of.writable, of.forms)
    assert (drive.watchdog, drive.answer_time_s) == (None, None)


def test_an_empty_list_means_nothing_rather_than_the_default() -> None:
    (drive,) = parsed(drive_with("cyclic: []", "writable: []")).drives
    assert (drive.cyclic, drive.writable) == ((), frozenset())


@pytest.mark.parametrize("name", FAMILY_NAMES)
def test_also_writable_adds_to_the_list_that_holds(name: str) -> None:
    (drive,) = parsed(drive_with("also_writable: [C0012, C0046]", family=name)).drives
    assert drive.writable == family(name).writable | {Code(12), Code(46)}
    (drive,) = parsed(drive_with("writable: [C0040]", "also_writable: [C0012]", family=name)).drives
    assert drive.writable == {Code(12), Code(40)}


def test_what_is_written_of_a_drive_is_converted() -> None:
    (drive,) = parsed(
        drive_with(
            "watchdog: {time: 1500ms, action: trip, configure: on}",
            "cyclic: [{code: P425, every: 500ms}, {code: 39/1, every: 1min}]",
            "writable: [c46, '135']", "answer_time: 30ms", "accept_software: [1.30, '1.4']",
            family="smvector",
        )
    ).drives  # fmt: skip
    assert drive.watchdog is not None
    assert (drive.watchdog.time_s, drive.watchdog.action, drive.watchdog.configure) == (
        1.5, "trip", True
    )  # fmt: skip
    assert [(entry.code, entry.every_s) for entry in drive.cyclic] == [
        (Code(1425), 0.5), (Code(39, 1), 60.0)
    ]  # fmt: skip
    assert drive.writable == {Code(46), Code(135)}
    assert (drive.answer_time_s, drive.accept_software) == (0.03, ("1.30", "1.4"))


def test_a_drive_without_extended_addressing_reads_only_what_it_can() -> None:
    (drive,) = parsed(drive_with("addressing: standard", family="93xx")).drives
    assert drive.forms == (Form.STANDARD,)
    assert drive.cyclic
    assert all(Form.STANDARD.carries(entry.code) for entry in drive.cyclic)


@pytest.mark.parametrize(
    ("written", "echo"),
    [("yes", "yes"), ("no", "no"), ("No", "no"), ("TRUE", "yes"), ("off", "no"), ("auto", "auto"),
     ("'no'", "no")],
)  # fmt: skip
def test_yes_and_no_mean_what_they_say(written: str, echo: str) -> None:
    assert parsed(line_with(f"echo: {written}")).line.echo == echo


@pytest.mark.parametrize("address", ["11", "'11'", '"11"'])
def test_a_quoted_number_is_a_number(address: str) -> None:
    assert parsed(GOOD.replace("11", address)).drives[0].address == 11


@pytest.mark.parametrize(
    ("written", "port"),
    [("sim", "sim:"), ('"sim:"', "sim:"), ("socket://192.0.2.7:4001", "socket://192.0.2.7:4001"),
     ("socket://[2001:db8::1]:4001", "socket://[2001:db8::1]:4001"), ("/dev/ttyS0", "/dev/ttyS0"),
     ("socket://moxa.local:4001", "socket://moxa.local:4001")],
)  # fmt: skip
def test_ports_of_every_kind(written: str, port: str) -> None:
    assert parsed(GOOD.replace("/dev/serial/by-id/usb-1", written)).line.port == port


@pytest.mark.parametrize(
    ("written", "shown"),
    [("127.0.0.1:9740", "127.0.0.1:9740"), ("localhost:80", "localhost:80"),
     ("'[::1]:9740'", "[::1]:9740"), ("127.1.2.3:1", "127.1.2.3:1")],
)  # fmt: skip
def test_http_on_loopback(written: str, shown: str) -> None:
    assert str(parsed(roster_with(f"api: {{http: {written}}}")).api.http) == shown


@pytest.mark.parametrize("host", ["192.0.2.5", "0.0.0.0", "'[2001:db8::1]:443'"])
def test_http_beyond_this_machine_with_tokens_and_tls(host: str) -> None:
    written = host if host.startswith("'") else f"{host}:443"
    keys = "tokens: /t, tls: {certificate: /c, key: /k, client_ca: /a}, hosts: [Drives.example]"
    api = parsed(roster_with(f"api: {{http: {written}, {keys}, read_only: yes}}")).api
    assert str(api.http) == written.strip("'")
    assert api.tls == TlsEntry(certificate="/c", key="/k", client_ca="/a")
    assert (api.tokens, api.hosts, api.read_only) == ("/t", ("drives.example",), True)


def test_the_tls_of_the_broker_is_yes_or_no() -> None:
    mqtt = parsed(roster_with("mqtt: {host: b, tls: no}")).mqtt
    assert mqtt is not None
    assert not mqtt.tls


def test_modbus_is_local_and_read_only_unless_the_roster_says_more() -> None:
    assert parsed(GOOD).modbus is None
    assert parsed(roster_with("modbus: {}")).modbus == ModbusEntry()
    most = "modbus: {host: '::', port: 1502, units: [7], allow: [192.0.2.7, 2001:db8::/64], "
    assert parsed(roster_with(most + "control: yes}")).modbus == ModbusEntry(
        host="::", port=1502, units=(7,), allow=("192.0.2.7/32", "2001:db8::/64"), control=True
    )


def test_messages_go_by_mail_or_command_with_what_the_roster_says() -> None:
    assert parsed(GOOD).notify is None
    least = "notify: {command: [/bin/page, '3']}"
    assert parsed(roster_with(least)).notify == NotifyEntry(command=("/bin/page", "3"))
    most = """
notify:
  command_time: 2s
  mail: {to: [a@b.example, c@d.example], from: x@y.example, host: m.example, port: 2525,
         security: tls, user: me, password_file: /etc/p, ca: /etc/ca.pem}
  events: [trip, daemon-lost]
  ends: no
  gather: 1s
  limit: {burst: 2, every: 1min}
  daemon_gone: 30s
"""
    assert parsed(roster_with(most)).notify == NotifyEntry(
        command_time_s=2.0,
        mail=MailEntry(
            to=("a@b.example", "c@d.example"), sender="x@y.example", host="m.example", port=2525,
            security="tls", user="me", password_file="/etc/p", ca="/etc/ca.pem",
        ),
        events=("trip", "daemon-lost"), ends=False, gather_s=1.0,
        limit=MessageLimit(burst=2, every_s=60.0), daemon_gone_s=30.0,
    )  # fmt: skip


def test_a_roster_may_say_of_which_form_it_is() -> None:
    assert parsed(GOOD).version == parsed(roster_with("version: 1")).version == 1


def test_stall_may_be_never() -> None:
    assert parsed(line_with("stall: 0")).line.stall_s == 0


def test_a_drive_lease_completes_itself_from_the_default() -> None:
    text = roster_with("lease: {required: true, time: 5s, on_lapse: hold}")
    text = text.replace("family: smvector", "family: smvector\n    lease: {time: 1s}")
    feeder, belt = parsed(text).drives
    assert feeder.lease == LeaseEntry(required=True, time_s=5, on_lapse="hold")
    assert belt.lease == LeaseEntry(required=True, time_s=1, on_lapse="hold")


def test_no_key_is_left_that_does_nothing() -> None:
    text = roster_with(
        "lease: {required: false}", "mqtt: {host: h, tls: no}", "api: {tokens: /t}",
    ).replace("family: smvector", "family: smvector\n    lease: {}")  # fmt: skip
    roster = parsed(text)
    assert roster.mqtt is not None
    assert (roster.mqtt.port, roster.mqtt.tls) == (1883, False)


def test_a_journal_is_named_by_its_file_alone_or_with_more() -> None:
    assert parsed(GOOD).journal is None
    assert parsed(roster_with("journal: /j")).journal == JournalEntry(file="/j")
    more = "journal: {file: /j, max_size: 2GB, on_failure: go-on}"
    assert parsed(roster_with(more)).journal == JournalEntry(
        file="/j", max_size=2_000_000_000, on_failure="go-on"
    )


def test_merge_keys_and_anchors_write_drives_once() -> None:
    text = GOOD.replace("- name: feeder", "- &f\n    name: feeder")
    text = text.split("  - name: belt")[0] + "  - {<<: *f, name: belt, address: 12}\n"
    assert [(drive.name, drive.family) for drive in parsed(text).drives] == [
        ("feeder", "8200vector"), ("belt", "8200vector")
    ]  # fmt: skip


def test_a_roster_cannot_be_changed_afterwards() -> None:
    roster = parsed(GOOD)
    with pytest.raises(pydantic.ValidationError):
        roster.line.baud = 19200


def test_a_drive_is_found_by_name() -> None:
    roster = parsed(GOOD)
    assert roster.drive("belt") is roster.drives[1]
    assert roster.drive("nobody") is None


@pytest.mark.parametrize(
    ("members", "drives", "address"),
    [
        ([11, 12], [11, 12, 21], 10), ([11], [11, 12, 21], None), ([21], [11, 12, 21], 20),
        ([11, 12, 21], [11, 12, 21], 0), ([11, 21], [11, 12, 21], None),
        ([11, 12], [11, 12], 10), ([1, 2], [1, 2], 0), ([1], [1, 11], None),
        ([99], [99, 1], 90),
    ],
)  # fmt: skip
def test_a_group_is_multicast_only_where_it_is_exact(
    members: list[int], drives: list[int], address: int | None
) -> None:
    assert multicast_address(members, drives) == address


@given(st.sets(st.sampled_from(ADDRESSES), min_size=1, max_size=12), st.data())
def test_a_multicast_reaches_exactly_the_members(drives: set[int], data: st.DataObject) -> None:
    members = data.draw(st.sets(st.sampled_from(sorted(drives)), min_size=1))
    address = multicast_address(members, drives)
    exact = [group for group in range(0, 100, 10) if set(group_reach(group)) & drives == members]
    assert (address is None) == (not exact)
    if address is not None:
        assert address == max(exact)


def test_the_group_of_all_drives_always_exists() -> None:
    roster = parsed(roster_with("groups: {b: {members: [belt]}}"))
    assert roster.groups["all"].members == ("feeder", "belt")
    assert roster.groups["all"].multicast_address == 10
    assert roster.groups["b"].multicast_address is None


def test_a_full_line_is_read_without_holding_up_the_daemon() -> None:
    path = CONFIG / "full.yaml"
    assert len(load_roster(path).drives) == 31
    took = []
    for _ in range(5):
        start = time.process_time()
        load_roster(path)
        took.append(time.process_time() - start)
    assert min(took) < 0.060
