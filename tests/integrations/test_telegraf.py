"""The inputs for Telegraf, over what a real bridge publishes.

Telegraf itself cannot be had from Debian or a package registry. So its file is read, its topics are
those of a real broker, and its XPath expressions are evaluated over a document as its parser makes
one from JSON.
"""

from __future__ import annotations

import json
import tomllib
from datetime import datetime
from typing import Any

import httpx2
import pytest
from lxml import etree

from integrations.conftest import DEPLOY, ROOT, Site

pytestmark = [pytest.mark.real, pytest.mark.timeout(90)]

PLUGINS = tomllib.loads((DEPLOY / "telegraf" / "lecombus.conf").read_text())["inputs"]
VALUES, STATES, LINES = PLUGINS["mqtt_consumer"]
SLASH = "-slash-"
"""In names of elements for the `/` of a code with a subcode, which XML has not."""


def tags_of(plugin: dict[str, Any], topic: str) -> dict[str, str]:
    """The tags that a topic gives."""
    (parsing,) = plugin["topic_parsing"]
    assert [parsing["topic"]] == plugin["topics"]
    names, levels = parsing["tags"].split("/"), topic.split("/")
    assert len(names) == len(levels) == len(parsing["topic"].split("/"))
    return {name: level for name, level in zip(names, levels, strict=True) if name != "_"}


def tree_of(document: dict[str, Any]) -> etree._Element:
    """JSON as XPath sees it in Telegraf: an element for each key, null as the text `<nil>`."""

    def grow(parent: etree._Element, found: Any) -> None:
        if isinstance(found, dict):
            for key, value in found.items():
                grow(etree.SubElement(parent, key.replace("/", SLASH)), value)
        elif not isinstance(found, list):
            parent.text = "<nil>" if found is None else str(found)

    root = etree.Element("document")
    grow(root, document)
    return root


def metrics_of(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The metrics of a document, by code."""
    (wanted,) = VALUES["xpath"]
    root = tree_of(document)

    def ask(node: etree._Element, query: str) -> Any:
        found = root.xpath(f"/document{query}") if query.startswith("/") else node.xpath(query)
        if isinstance(found, list):
            return found[0].text if found else None
        return found

    found = {}
    for node in root.xpath(f"/document{wanted['metric_selection']}"):
        tags = {name: ask(node, query) for name, query in wanted["tags"].items()}
        fields = {name: ask(node, query) for name, query in wanted["fields"].items()}
        code = tags["code"].replace(SLASH, "/")
        found[code] = {**tags, **fields, "time": ask(node, wanted["timestamp"])}
    return found


def heard(site: Site, plugin: dict[str, Any]) -> list[tuple[str, str]]:
    """What its one topic has had so far."""
    (topic,) = plugin["topics"]
    return site.heard(topic, "Telegraf")


def test_each_topic_is_one_that_the_bridge_publishes(site: Site) -> None:
    for plugin in (VALUES, STATES, LINES):
        for name, _ in heard(site, plugin):
            assert tags_of(plugin, name)["line"] == "hall-3"
    of_drives = [name for name, _ in heard(site, VALUES)]
    assert {tags_of(VALUES, name)["drive"] for name in of_drives} == {"feeder", "belt"}
    assert ("lecombus/hall-3/state", "online") in heard(site, LINES)
    assert (f"{ROOT}/feeder/state", "online") in heard(site, STATES)


@pytest.mark.parametrize("drive", ["feeder", "belt"])
def test_each_good_number_is_a_metric_with_its_unit_and_time(site: Site, drive: str) -> None:
    document = site.document(drive)
    metrics = metrics_of(document)
    good = {
        code: value for code, value in document["values"].items()
        if value["quality"] == "good" and isinstance(value["value"], int | float)
    }  # fmt: skip
    assert {"C0050", "C0150"} <= good.keys()
    assert metrics.keys() == good.keys()
    for code, metric in metrics.items():
        assert metric["value"] == good[code]["value"]
        assert metric["unit"] == good[code]["unit"]
        assert metric["family"] == document["family"]
        # Go's RFC 3339, which takes fractions of a second.
        assert datetime.fromisoformat(metric["time"].replace("Z", "+00:00")).year > 2000
    assert VALUES["xpath"][0]["timestamp_format"] == "2006-01-02T15:04:05Z07:00"


def test_what_is_not_good_or_no_number_is_no_metric(site: Site) -> None:
    document = site.document("feeder")
    values = document["values"]
    sample = {**values["C0050"], "unit": "Hz"}
    wanted = {"C0011": -3.5, "C0039/1": 12, "C0012": 0}
    strange = {"C0200": "82S8212V_30000", "C0201": "1999-03-17", "C1811": None, "C1810": ""}
    document["values"] = {
        "C0150": {**values["C0150"], "quality": "stale"},
        "C0068": {**values["C0150"], "quality": "bad"},
        **{code: {**sample, "value": value} for code, value in {**wanted, **strange}.items()},
    }
    assert {code: one["value"] for code, one in metrics_of(document).items()} == wanted
    document["values"] = {}
    assert metrics_of(document) == {}
    assert VALUES["xpath_allow_empty_selection"] is True


def test_nothing_waits_at_the_broker_for_telegraf() -> None:
    for plugin in (VALUES, STATES, LINES):
        assert plugin["qos"] == 0
        assert not plugin.get("persistent_session", False)


def test_the_metrics_are_where_it_looks(site: Site) -> None:
    (scraped,) = PLUGINS["prometheus"]
    path = httpx2.URL(scraped["urls"][0]).path
    page = site.daemon.client.get(path).text
    assert 'lecombus_drive_up{line="hall-3",drive="feeder"} 1' in page
    assert json.dumps(scraped["metric_version"]) == "2"
