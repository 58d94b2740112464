"""What a reload says that changed: drives, keys of drives, groups, and what needs a restart."""

from __future__ import annotations

import pytest
from pydantic import BaseModel

from lecombus.config import (
    Roster,
    RosterChanges,
    RosterError,
    parse_roster,
    roster_changes,
    roster_values,
    value_changes,
)
from lecombus.config.building import RENAMED
from lecombus.config.changes import FIXED, differing_keys
from lecombus.config.container_types import ListOf, Table
from lecombus.config.keys import roster_table
from lecombus.roster import (
    ApiEntry,
    CyclicEntry,
    DriveEntry,
    JournalEntry,
    LeaseEntry,
    LineEntry,
    MailEntry,
    MessageLimit,
    ModbusEntry,
    MqttEntry,
    NotifyEntry,
    StoredWrites,
    TlsEntry,
    WatchdogEntry,
)

DRIVES = {
    "feeder": "address: 11, family: 8200vector",
    "belt": "address: 12, family: smvector",
    "winder": "address: 21, family: 93xx",
}


def text(drives: dict[str, str], *, line: str = "", sections: str = "") -> str:
    rows = [f"  - {{name: {name}, {keys}}}" for name, keys in drives.items()]
    return "\n".join(["line:", "  name: hall", f"  port: 'sim:'{line}", "drives:", *rows, sections])


def roster(drives: dict[str, str] = DRIVES, *, sections: str = "") -> Roster:
    return parse_roster(text(drives, sections=sections), "hall.yaml")


def compared(drives: dict[str, str] = DRIVES, *, sections: str = "") -> RosterChanges:
    return roster_changes(roster(), roster(drives, sections=sections))


def test_the_same_roster_changed_nothing() -> None:
    assert compared() == RosterChanges("hall.yaml", 3, (), (), {}, (), ())


def test_drives_that_are_new_gone_and_described_otherwise_are_named_with_their_keys() -> None:
    after = {
        "fan": "address: 13, family: smvector",
        "winder": "address: 22, family: 93xx, addressing: standard, answer_time: 30ms, cyclic: []",
        "feeder": DRIVES["feeder"],
    }
    found = compared(after)
    assert (found.added, found.removed) == (("fan",), ("belt",))
    assert found.changed == {"winder": ("address", "addressing", "cyclic", "answer_time")}
    assert str(found) == "added=fan removed=belt changed=winder"
    assert found.as_json()["changed"] == [
        {"drive": "winder", "keys": ["address", "addressing", "cyclic", "answer_time"]}
    ]


@pytest.mark.parametrize(
    ("key", "named"),
    [
        ("watchdog: {time: 2s, action: quick-stop}", "watchdog"),
        ("also_writable: [C0012]", "writable"),
        ("lease: {time: 3s}", "lease"),
        ("stop_fallback: none", "stop_fallback"),
        ("stored_writes: {burst: 2}", "stored_writes"),
    ],
)
def test_a_key_of_a_drive_is_named(key: str, named: str) -> None:
    found = compared(DRIVES | {"feeder": f"{DRIVES['feeder']}, {key}"})
    assert found.changed == {"feeder": (named,)}


def test_a_default_for_all_drives_is_named_with_the_drives_that_have_it() -> None:
    found = compared(sections="lease: {time: 3s}\non_shutdown: inhibit")
    assert found.keys == ("lease", "on_shutdown")
    assert found.changed == dict.fromkeys(DRIVES, ("lease",))


def test_a_group_is_named_when_its_members_or_its_telegram_differ() -> None:
    before = roster(sections="groups: {one: {members: [feeder, belt]}, two: {members: [winder]}}")
    after = roster(
        DRIVES | {"belt": "address: 22, family: smvector"},
        sections="groups: {one: {members: [feeder, belt]}, three: {members: [winder]}}",
    )
    assert before.groups["one"].multicast_address == 10
    assert after.groups["one"].multicast_address is None
    assert roster_changes(before, after).groups == ("one", "three", "two")


def test_the_group_of_all_drives_is_named_only_when_it_is_sent_to_otherwise() -> None:
    fan = DRIVES | {"fan": "address: 31, family: smvector"}
    assert compared(fan).groups == ()
    assert compared(sections="groups: {all: {multicast: true}}").groups == ("all",)


def test_what_only_a_restart_changes_is_a_mistake_at_its_place() -> None:
    running = parse_roster(text(DRIVES, sections="api: {http: 127.0.0.1:9740}"), "hall.yaml")
    after = text(DRIVES, line="\n  baud: 19200", sections="state: /tmp/x.json")
    with pytest.raises(RosterError) as refused:
        parse_roster(after, "hall.yaml", running)
    right = "restart lecombus, or put the old value back"
    assert [str(one) for one in refused.value.mistakes] == [
        f"hall.yaml:1:1: `api.http` cannot change while lecombus runs, {right}",
        f"hall.yaml:4:3: `line.baud` cannot change while lecombus runs, {right}",
        f"hall.yaml:9:1: `state` cannot change while lecombus runs, {right}",
    ]
    parse_roster(after, "hall.yaml")


def test_a_key_that_was_taken_out_has_the_place_of_its_part() -> None:
    running = parse_roster(text(DRIVES, line="\n  retries: 1"), "hall.yaml")
    with pytest.raises(RosterError, match=r"^hall.yaml:1:1: `line.retries` cannot change"):
        parse_roster(text(DRIVES), "hall.yaml", running)


JOURNAL_FIELDS = "journal: {file: /var/a.sqlite, max_size: 64MB}"


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ("journal: /var/a.sqlite", "journal: /var/x.sqlite", "9:1: `journal.file`"),
        (JOURNAL_FIELDS, JOURNAL_FIELDS.replace("a.sq", "x.sq"), "9:11: `journal.file`"),
        (JOURNAL_FIELDS, JOURNAL_FIELDS.replace("64", "65"), "9:32: `journal.max_size`"),
        ("journal: /var/a.sqlite", "journal: {file: /var/a.sqlite, on_failure: go-on}",
         "9:32: `journal.on_failure`"),
        ("journal: /var/a.sqlite", "", "1:1: `journal`"),
        ("", "journal: /var/a.sqlite", "9:1: `journal`"),
        ("", "api: {tokens: /etc/t}", "9:7: `api.tokens`"),
        ("", "api: {read_only: true}", "9:7: `api.read_only`"),
        ("api: {http: 127.0.0.1:1, tls: {certificate: /a, key: /b}}",
         "api: {http: 127.0.0.1:1, tls: {certificate: /c, key: /b}}", "9:26: `api.tls`"),
        ("state: /var/a", "state: /var/b", "9:1: `state`"),
    ],
)  # fmt: skip
def test_every_key_that_needs_a_restart_is_named_beside_others(
    before: str, after: str, named: str
) -> None:
    def of(sections: str, baud: int) -> str:
        return text(DRIVES, line=f"\n  baud: {baud}", sections=sections)

    running = parse_roster(of(before, 9600), "hall.yaml")
    with pytest.raises(RosterError) as alone:
        parse_roster(of(after, 9600), "hall.yaml", running)
    assert [str(one).partition(" cannot")[0] for one in alone.value.mistakes] == [
        f"hall.yaml:{named}"
    ]
    with pytest.raises(RosterError) as beside:
        parse_roster(of(after, 19200), "hall.yaml", running)
    places = {str(one).partition(" cannot")[0] for one in beside.value.mistakes}
    assert places == {f"hall.yaml:{named}", "hall.yaml:4:3: `line.baud`"}


def test_the_file_of_the_journal_is_one_of_the_values_of_a_roster() -> None:
    found = roster_values(roster(sections="journal: /var/a.sqlite"))
    assert found["journal.file"] == "/var/a.sqlite"
    assert "file" not in found


def test_the_words_of_a_command_are_not_said_and_that_they_differ_is() -> None:
    """They may hold a password, and who may read the journal may not read the roster."""
    first, other = (
        roster_values(roster(sections=f"notify: {{command: [/usr/bin/page, --key, {key}]}}"))
        for key in ("hunter2", "hunter3")
    )
    assert value_changes(first, first) == {}
    assert value_changes(first, other) == {
        "notify.command": "/usr/bin/page, *** -> /usr/bin/page, ***"
    }
    added = value_changes(roster_values(roster()), first)
    assert added["notify.command"] == "none -> /usr/bin/page, ***"


def test_other_mistakes_are_listed_with_it_as_far_as_they_are_found_then() -> None:
    running = roster()
    with pytest.raises(RosterError, match="8200x"):
        parse_roster(
            text(DRIVES | {"fan": "address: 31, family: 8200x"}, line="\n  retries: 1"),
            "hall.yaml", running,
        )  # fmt: skip


def part(*path: str) -> Table:
    of: object = roster_table("lecom")
    for name in path:
        assert isinstance(of, Table)
        of = of.keys[name].type
        of = of.of if isinstance(of, ListOf) else of
    assert isinstance(of, Table)
    return of


PARTS: dict[tuple[str, ...], type[BaseModel]] = {
    ("line",): LineEntry, ("api",): ApiEntry, ("api", "tls"): TlsEntry, ("drives",): DriveEntry,
    ("drives", "watchdog"): WatchdogEntry, ("drives", "cyclic"): CyclicEntry,
    ("drives", "lease"): LeaseEntry, ("drives", "stored_writes"): StoredWrites,
    ("mqtt",): MqttEntry, ("modbus",): ModbusEntry, ("journal",): JournalEntry,
    ("notify",): NotifyEntry, ("notify", "mail"): MailEntry, ("notify", "limit"): MessageLimit,
}  # fmt: skip


@pytest.mark.parametrize("path", PARTS, ids=".".join)
def test_every_field_is_named_by_a_key_of_the_file(path: tuple[str, ...]) -> None:
    model = PARTS[path]
    unlike = model.model_construct(None, **dict.fromkeys(model.model_fields))
    like = model.model_construct(None, **dict.fromkeys(model.model_fields, 1))
    assert set(differing_keys(unlike, like)) <= set(part(*path).keys)


def test_every_renamed_key_is_one_and_its_field_has_no_other_key() -> None:
    assert set(RENAMED) <= {key for path in PARTS for key in part(*path).keys}
    assert len(set(RENAMED.values())) == len(RENAMED)


def test_the_sender_of_mail_is_named_by_its_key() -> None:
    """It stood in the journal as `notify.mail.sender`, which no roster takes."""
    first, other = (
        roster_values(roster(sections=f"notify: {{mail: {{to: [a@b.c], from: {sender}}}}}"))
        for sender in ("hall@b.c", "yard@b.c")
    )
    assert value_changes(first, other) == {"notify.mail.from": "hall@b.c -> yard@b.c"}


def test_every_part_that_needs_a_restart_is_a_key() -> None:
    assert set(FIXED) <= set(roster_table("lecom").keys)
