"""The documentation names what there is: every roster key, command, metric and problem, no more."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lecombus.api.problems import STATUS_BY_KIND
from lecombus.cli.entry import COMMANDS
from lecombus.config import roster_json_schema
from lecombus.drives import FAMILY_NAMES, family
from lecombus.protocol.addressing import Code
from support.site_host import Plant, roster_of, until, with_plant

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
API = (ROOT / "docs" / "api.md").read_text()
OPERATIONS = (ROOT / "docs" / "operations.md").read_text()


def rows(text: str, heading: str) -> list[list[str]]:
    """Return the cells of the first table after a heading, without its first two lines."""
    after = text.partition(f"\n{heading}\n")[2]
    table = re.search(r"(?:^\|.*\n)+", after, re.MULTILINE)
    assert table is not None, heading
    lines = table[0].replace("\\|", "/").splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def quoted(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def keys(piece: dict[str, Any], path: str = "") -> Iterator[str]:
    """Yield the path of every key of a roster that holds a value, as the README writes it."""
    inside = dict(piece.get("properties", {}))
    if isinstance(piece.get("additionalProperties"), dict):
        inside["NAME"] = piece["additionalProperties"]
    for name, below in inside.items():
        yield from keys(below, f"{path}.{name}".lstrip("."))
    if "properties" in piece.get("items", {}):
        yield from keys(piece["items"], f"{path}[]")
    elif not inside:
        yield path


def test_the_readme_has_every_key_of_a_roster_and_no_other() -> None:
    told = {key for cells in rows(README, "## The roster") for key in quoted(cells[0])}
    there = set(keys(roster_json_schema()))
    covers = {key: {one for one in there if f"{one}.".startswith(f"{key}.")} for key in told}
    assert [key for key, found in covers.items() if not found] == []
    assert there - set().union(*covers.values()) == set()


def test_the_readme_has_every_default_of_the_line() -> None:
    line = roster_json_schema()["properties"]["line"]["properties"]
    for cells in rows(README, "## The roster"):
        name = quoted(cells[0])[0].removeprefix("line.")
        if name in line and "default" in line[name]:
            assert cells[1] == str(line[name]["default"]).lower(), name


def test_the_readme_names_setpoints_that_may_be_written() -> None:
    told = {name: cells[-1] for cells in rows(README, "## What is supported")
            for name in quoted(cells[0])}  # fmt: skip
    assert sorted(told) == sorted(FAMILY_NAMES)
    for name, text in told.items():
        named = re.findall(r"(C\d{4})(?: or (C\d{4}))? in ", text)
        codes = {Code.parse(code) for pair in named for code in pair if code}
        readable = {Code.parse(code) for code in re.findall(r"(C\d{4}) is read only", text)}
        assert codes == {
            code for code in family(name).writable
            if (info := family(name).info(code)) is not None
            and ("setpoint" in info.name or "speed command" in info.name)
        }  # fmt: skip
        assert readable.isdisjoint(family(name).writable)
        assert (Code(46) in readable) == (name in ("93xx", "smvector"))


def test_the_readme_has_every_command_in_the_order_of_the_help() -> None:
    named = [quoted(cells[0])[0].split()[1] for cells in rows(README, "## Commands")]
    assert named == list(COMMANDS)


def test_metrics_are_those_that_are_served() -> None:
    text = (
        README.partition("\nMetrics, all prefixed")[2]
        .partition("What they mean")[0]
        .partition(":")[2]
    )
    told = {f"lecombus_{name}" for name in quoted(text)}
    explained = {
        name for cells in rows(OPERATIONS, "## Metrics") for name in quoted(cells[0])
        if name.startswith("lecombus_")
    }  # fmt: skip
    alerts = (ROOT / "deploy" / "prometheus" / "lecombus.rules.yml").read_text()

    async def test(plant: Plant) -> None:
        await plant.online()
        plant.line["a"].trip(50)
        fault = plant.site.store.drive
        await until(lambda: (one := fault("a").fault) is not None and one.number == 50)
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        served = set(re.findall(r"^# TYPE (lecombus_\w+)", page, re.MULTILINE))
        assert told == served
        assert explained == served
        assert set(re.findall(r"lecombus_[a-z_]+", alerts)) <= {
            name + suffix for name in served for suffix in ("", "_bucket", "_sum", "_count")
        }

    watched = ", watchdog: {time: 2s, action: inhibit, configure: true}"
    with_plant(test, roster_of([("a", 11, "8200vector")], drive=watched))


def test_the_words_of_problems_stand_beside_their_status() -> None:
    told = {
        word: cells[0]
        for cells in rows(API, "## When something is wrong")
        for word in re.findall(r"`([a-z-]+)`", cells[1])
    }
    assert told.keys() == STATUS_BY_KIND.keys()
    for word, (status, _) in STATUS_BY_KIND.items():
        assert str(status) in told[word], word


def test_every_problem_that_an_operation_names_has_a_status() -> None:
    named = {
        kind
        for path in (ROOT / "src" / "lecombus" / "operations").glob("*.py")
        for kind in re.findall(r'kind(?:, remedy)? ?= ?"([a-z-]+)"', path.read_text())
    }
    assert "no-such-drive" in named
    assert named <= STATUS_BY_KIND.keys()
