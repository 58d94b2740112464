"""The dashboards that ship are those of the code, as Grafana's schema wants them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator  # type: ignore[import-untyped]

from dashboards.boards import BOARDS, FOLDER, text
from dashboards.panels import GREY

SCHEMA = Path(__file__).parent / "schema"
PANEL_KINDS = ("stat", "table", "timeseries", "state-timeline")


def shipped(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / name).read_text())
    return found


ANYTHING = (("MatcherConfig", "options"), ("DynamicConfigValue", "value"))
"""Grafana takes anything here (`_` in its own schema); the JSON made of it says: an object."""


PANELS = [
    pytest.param(panel, id=f"{name} {panel['title']}")
    for name in BOARDS
    for panel in shipped(name)["panels"]
]


@cache
def validator(name: str, definition: str = "") -> Draft7Validator:
    """Return what checks against a schema of Grafana, or one definition of it."""
    schema = json.loads((SCHEMA / f"{name}.jsonschema.json").read_text())
    if name == "dashboard":
        parts = schema["definitions"]
        for part, key in ANYTHING:
            assert parts[part]["properties"][key].pop("type") == "object"
        # "Nulls currently appear here when serializing -Infinity to JSON", says its description.
        parts["Threshold"]["properties"]["value"]["type"] = ["number", "null"]
    if definition:
        schema["$ref"] = f"#/definitions/{definition}"
    return Draft7Validator(schema)


def wrong(checks: Draft7Validator, document: object) -> list[str]:
    return [f"{error.json_path}: {error.message[:200]}" for error in checks.iter_errors(document)]


def test_what_ships_is_what_the_code_makes() -> None:
    """`make dashboards` writes it."""
    assert {path.name for path in FOLDER.glob("*.json")} == set(BOARDS)
    for name, make in BOARDS.items():
        assert (FOLDER / name).read_text() == text(make), f"{name}: run make dashboards"


@pytest.mark.parametrize("name", BOARDS)
def test_a_dashboard_is_as_grafanas_schema_wants_it(name: str) -> None:
    assert wrong(validator("dashboard"), shipped(name)) == []


@pytest.mark.parametrize("panel", PANELS)
def test_a_panel_is_as_the_schema_of_its_kind_wants_it(panel: dict[str, Any]) -> None:
    kind = panel["type"]
    assert kind in PANEL_KINDS
    of = kind.replace("-", "")
    assert wrong(validator(of, "Options"), panel["options"]) == []
    custom = panel["fieldConfig"]["defaults"].get("custom")
    if custom is not None:
        assert wrong(validator(of, "FieldConfig"), custom) == []
    assert panel["targets"]
    for query in panel["targets"]:
        assert wrong(validator("prometheus"), query) == []
        assert query["datasource"] == {"type": "prometheus", "uid": "${datasource}"}


def test_the_check_would_see_a_mistake() -> None:
    document = shipped("lecombus-line.json")
    document["panels"][0]["titel"] = "Port"
    assert wrong(validator("dashboard"), document) != []
    panel = shipped("lecombus-line.json")["panels"][0]
    assert wrong(validator("stat", "Options"), {**panel["options"], "colorMode": "loud"}) != []


@pytest.mark.parametrize("name", BOARDS)
def test_panels_do_not_overlap_and_have_numbers_of_their_own(name: str) -> None:
    panels = shipped(name)["panels"]
    taken = [
        (x, y)
        for panel in panels
        for at in [panel["gridPos"]]
        for x in range(at["x"], at["x"] + at["w"])
        for y in range(at["y"], at["y"] + at["h"])
    ]
    assert len(taken) == len(set(taken))
    assert max(x for x, _ in taken) < 24
    assert len({panel["id"] for panel in panels}) == len(panels)


@pytest.mark.parametrize("panel", PANELS)
def test_what_is_normal_is_grey(panel: dict[str, Any]) -> None:
    """ISA-101: colour is for what a person must look at. Nothing is green."""
    assert "green" not in json.dumps(panel)
    fields = panel["fieldConfig"]
    found = [fields["defaults"]["thresholds"]]
    for override in fields["overrides"]:
        found += [one["value"] for one in override["properties"] if one["id"] == "thresholds"]
    for thresholds in found:
        colours = [step["color"] for step in thresholds["steps"]]
        assert len(colours) == 1 or {GREY, "transparent"} & set(colours)
        assert len(colours) > 1 or colours[0] in (GREY, "transparent")


def test_links_lead_to_dashboards_that_there_are() -> None:
    uids = {shipped(name)["uid"] for name in BOARDS}
    assert uids == {"lecombus-fleet", "lecombus-line", "lecombus-drive"}
    linked = {
        link["url"].split("?")[0].removeprefix("/d/")
        for name in BOARDS
        for panel in shipped(name)["panels"]
        for override in panel["fieldConfig"]["overrides"]
        for one in override["properties"]
        if one["id"] == "links"
        for link in one["value"]
    }
    assert linked == {"lecombus-line", "lecombus-drive"}
