"""The schema for editors is current, takes the examples, and sees what it can see."""

from __future__ import annotations

import json
import runpy
from typing import Any

import pytest
import yaml

from config.rosters import CONFIG, GOOD, drive_with, line_with, parsed, roster_with
from config.schema_validator import matches
from lecombus.config import load_roster, roster_json_schema
from lecombus.config.container_types import ListOf, NamedEntries, ShortTable, Table
from lecombus.config.keys import roster_table
from lecombus.config.scalar_types import ValueType

EXAMPLES = ["small.yaml", "full.yaml"]


class Yaml12Loader(yaml.SafeLoader):
    """Reads yes, no, on and off as text, as the YAML 1.2 of editors does."""


Yaml12Loader.yaml_implicit_resolvers = {
    letter: [(tag, pattern) for tag, pattern in rows if letter in "tTfF" or "bool" not in tag]
    for letter, rows in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def test_the_shipped_schema_is_what_the_documented_command_writes() -> None:
    command = runpy.run_path(str(CONFIG.parent / "scripts" / "schema"))
    shipped = CONFIG / "roster.schema.json"
    assert command["FILE"] == shipped
    assert command["text"]() == shipped.read_text()
    assert json.loads(shipped.read_text()) == roster_json_schema()


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("loader", [yaml.SafeLoader, Yaml12Loader])
def test_an_example_is_right_for_editors_and_for_us(name: str, loader: Any) -> None:
    text = (CONFIG / name).read_text()
    assert load_roster(CONFIG / name).drives
    assert matches(roster_json_schema(), yaml.load(text, Loader=loader))


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_tells_editors_where_its_schema_is(name: str) -> None:
    first = (CONFIG / name).read_text().splitlines()[0]
    assert first == "# yaml-language-server: $schema=./roster.schema.json"


def keys_of(value_type: ValueType, path: str = "") -> set[str]:
    if isinstance(value_type, Table):
        return {found for key in value_type.keys.values()
                for found in keys_of(key.type, f"{path}.{key.name}")} | {path}  # fmt: skip
    if isinstance(value_type, ListOf | NamedEntries):
        return keys_of(value_type.of, path)
    return {path}


def keys_in(value: Any, value_type: ValueType, path: str = "") -> set[str]:
    if isinstance(value_type, Table):
        if isinstance(value_type, ShortTable) and not isinstance(value, dict):
            value = {next(iter(value_type.keys)): value}
        return {found for name, item in value.items()
                for found in keys_in(item, value_type.keys[name].type, f"{path}.{name}")
                } | {path}  # fmt: skip
    if isinstance(value_type, ListOf):
        return set().union(*(keys_in(item, value_type.of, path) for item in value))
    if isinstance(value_type, NamedEntries):
        return set().union(*(keys_in(item, value_type.of, path) for item in value.values()))
    return {path}


def test_the_full_example_shows_every_key() -> None:
    value = yaml.safe_load((CONFIG / "full.yaml").read_text())
    assert keys_of(roster_table("lecom")) == keys_in(value, roster_table("lecom"))


def test_every_key_is_explained() -> None:
    def explained(schema: dict[str, Any]) -> None:
        for name, piece in schema.get("properties", {}).items():
            assert piece["description"].endswith("."), name
            explained(piece)
            explained(piece.get("items", {}))

    explained(roster_json_schema())


RIGHT = [
    GOOD, line_with("echo: no"), line_with("stall: 0", "retries: 0", "absent_share: 25%"),
    line_with("echo: auto", "repeaters: yes", "turnaround: 0"),
    drive_with("writable: [46, C135, P425, C39/1]", "accept_software: [1.20]"),
    roster_with("groups: {all: {multicast: yes}, b: {members: [belt], multicast: no}}"),
    roster_with("groups: {a-b: {members: [belt]}}", "api: {http: '[::1]:80'}"),
    GOOD.replace("/dev/serial/by-id/usb-1", "sim"),
    GOOD.replace("/dev/serial/by-id/usb-1", "socket://192.0.2.7:4001"),
]  # fmt: skip
WRONG = [
    line_with("baud: 9601"), line_with("bauds: 9600"), line_with("turnaround: 2"),
    GOOD.replace("11", "10"), GOOD.replace("11", "100"), GOOD.replace("smvector", "smvektor"),
    GOOD.replace("feeder", "all"), GOOD.replace("feeder", "Feeder"), drive_with("writable: [C1x]"),
    drive_with("cyclic: [{code: C1}]"), drive_with("watchdog: {time: 2s}"),
    roster_with("groups: {g: {members: []}}"), roster_with("groups: {all: {members: [belt]}}"),
    roster_with("api: {http: 'example.com:80'}"), roster_with("journal: x"),
    "line: {name: a, port: sim}\n", "line: {name: a}\ndrives: []\n",
]  # fmt: skip


@pytest.mark.parametrize("loader", [yaml.SafeLoader, Yaml12Loader])
@pytest.mark.parametrize("text", RIGHT)
def test_what_is_right_is_not_marked_by_an_editor(text: str, loader: Any) -> None:
    assert parsed(text).drives
    assert matches(roster_json_schema(), yaml.load(text, Loader=loader))


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_by_itself_is_marked_by_an_editor(text: str) -> None:
    assert not matches(roster_json_schema(), yaml.safe_load(text))
