"""Every key of a roster reaches a field of its model, and what an editor shows is its default."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pydantic import ValidationError

from config.rosters import GOOD, drive_with, line_with, parsed
from lecombus.config import keys
from lecombus.config.container_types import Key, ListOf, Table
from lecombus.config.keys import roster_table
from lecombus.config.scalar_types import YesNo


def table(title: str) -> Table:
    found = roster_table("lecom").keys[title].type
    found = found.of if isinstance(found, ListOf) else found
    assert isinstance(found, Table)
    return found


def defaults(of: Table) -> list[str]:
    return list(_defaults(of))


def _defaults(of: Table) -> Iterator[str]:
    for key in of.keys.values():
        if key.default is not None:
            given = str(key.default).lower() if isinstance(key.default, bool) else key.default
            yield f"{key.name}: {given}"


@pytest.mark.parametrize("line", defaults(table("line")))
def test_a_default_of_the_line_is_what_an_editor_shows(line: str) -> None:
    assert parsed(line_with(line)).line == parsed(GOOD).line


@pytest.mark.parametrize("line", defaults(table("drives")))
def test_a_default_of_a_drive_is_what_an_editor_shows(line: str) -> None:
    assert parsed(drive_with(line)).drives == parsed(drive_with()).drives


@pytest.mark.parametrize("name", ["stored_writes", "lease", "watchdog"])
def test_the_defaults_of_a_part_of_a_drive_are_what_an_editor_shows(name: str) -> None:
    part = table("drives").keys[name].type
    assert isinstance(part, Table)
    shown = defaults(part)
    assert shown
    least = ["time: 2s", "action: inhibit"] if name == "watchdog" else []
    every = [*least, *(one for one in shown if one.split(":")[0] not in "".join(least))]
    spelled = parsed(drive_with(f"{name}: {{{', '.join(every)}}}"))
    assert spelled.drives == parsed(drive_with(f"{name}: {{{', '.join(least)}}}")).drives


@pytest.mark.parametrize(("where", "text"), [
    ("_LINE", line_with("forgotten: yes")),
    ("_DRIVE", drive_with("forgotten: yes")),
    ("_WATCHDOG", drive_with("watchdog: {time: 2s, action: inhibit, forgotten: yes}")),
    ("_STORED_WRITES", drive_with("stored_writes: {forgotten: yes}")),
    ("_LEASE", drive_with("lease: {forgotten: yes}")),
    ("_API", GOOD + "api: {forgotten: yes}\n"),
    ("_MQTT", GOOD + "mqtt: {host: broker, forgotten: yes}\n"),
    ("_MODBUS", GOOD + "modbus: {forgotten: yes}\n"),
    ("_NOTIFY", GOOD + "notify: {command: [/bin/page], forgotten: yes}\n"),
    ("_MAIL", GOOD + "notify: {mail: {to: [a@b.c], from: a@b.c, forgotten: yes}}\n"),
    ("_LIMIT", GOOD + "notify: {command: [/bin/page], limit: {forgotten: yes}}\n"),
    ("_ROSTER", GOOD + "forgotten: yes\n"),
])  # fmt: skip
def test_a_key_without_a_field_is_an_error_and_is_not_dropped(
    monkeypatch: pytest.MonkeyPatch, where: str, text: str
) -> None:
    of: Table = getattr(keys, where)
    more = Key("forgotten", YesNo(), "A key that has no field yet.")
    monkeypatch.setattr(of, "keys", {**of.keys, "forgotten": more})
    roster_table.cache_clear()
    try:
        with pytest.raises(ValidationError, match="forgotten"):
            parsed(text)
    finally:
        roster_table.cache_clear()
