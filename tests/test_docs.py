"""The documentation names what there is: every roster key, command, metric, log event and problem.

And it can be used: the README is short, links lead somewhere, the first roster is right, and every
document is in an index.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lecombus.api.answers import STATUS_BY_KIND
from lecombus.cli.entry import COMMANDS, main
from lecombus.config import roster_json_schema
from lecombus.drives import FAMILY_NAMES, family
from lecombus.journal.journal import JournalFigures
from lecombus.parameters import Code
from support.rosters import roster_text
from support.site_host import Plant, until, with_plant

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text()
API = (DOCS / "api.md").read_text()
ALARMS = (DOCS / "alarms.md").read_text()
COMMANDS_DOC = (DOCS / "commands.md").read_text()
DRIVES = (DOCS / "drives.md").read_text()
ROSTER = (DOCS / "roster.md").read_text()
WRITTEN = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]


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
    """Yield the path of every key of a roster that holds a value, as docs/roster.md writes it."""
    for form in piece.get("anyOf", ()):
        if "properties" in form:
            yield path
            yield from keys(form, path)
            return
    inside = dict(piece.get("properties", {}))
    if isinstance(piece.get("additionalProperties"), dict):
        inside["NAME"] = piece["additionalProperties"]
    for name, below in inside.items():
        yield from keys(below, f"{path}.{name}".lstrip("."))
    if "properties" in piece.get("items", {}):
        yield from keys(piece["items"], f"{path}[]")
    elif not inside:
        yield path


def test_every_key_of_a_roster_and_no_other_is_documented() -> None:
    told = {key for cells in rows(ROSTER, "## All keys") for key in quoted(cells[0])}
    there = set(keys(roster_json_schema()))
    covers = {key: {one for one in there if f"{one}.".startswith(f"{key}.")} for key in told}
    assert [key for key, found in covers.items() if not found] == []
    assert there - set().union(*covers.values()) == set()


def test_every_default_of_the_line_is_documented() -> None:
    line = roster_json_schema()["properties"]["line"]["properties"]
    for cells in rows(ROSTER, "## All keys"):
        name = quoted(cells[0])[0].removeprefix("line.")
        if name in line and "default" in line[name]:
            assert cells[1] == str(line[name]["default"]).lower(), name


def test_the_first_page_names_every_family() -> None:
    named = next(line for line in README.splitlines() if line.startswith("Families: "))
    assert set(quoted(named)) == set(FAMILY_NAMES)


def test_documented_setpoints_may_be_written() -> None:
    told = {name: cells[-1] for cells in rows(DRIVES, "## Families")
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


def test_every_command_is_documented_in_the_order_of_the_help() -> None:
    named = [quoted(cells[0])[0].split()[1] for cells in rows(COMMANDS_DOC, "## All commands")]
    assert named == list(COMMANDS)


def test_metrics_are_those_that_are_served() -> None:
    explained = {
        name for cells in rows(ALARMS, "## Metrics") for name in quoted(cells[0])
        if name.startswith("lecombus_")
    }  # fmt: skip
    alerts = (ROOT / "deploy" / "prometheus" / "lecombus.rules.yml").read_text()
    alerts = re.sub(r"\w+:lecombus_\w+:\w+", "", alerts)  # what the rules record themselves

    async def test(plant: Plant) -> None:
        await plant.online()
        plant.site.supervision.watch.journal = lambda: JournalFigures(1, 1, True, 0, 0)
        plant.site.metrics.certificates = lambda: {"certificate": 0.0}
        plant.line["a"].trip(50)
        fault = plant.site.store.drive
        await until(lambda: (one := fault("a").fault) is not None and one.number == 50)
        page = (await plant.site.metrics.fresh_page(openmetrics=False)).decode()
        served = set(re.findall(r"^# TYPE (lecombus_\w+)", page, re.MULTILINE))
        assert explained == served
        assert set(re.findall(r"lecombus_[a-z_]+", alerts)) <= {
            name + suffix for name in served for suffix in ("", "_bucket", "_sum", "_count")
        }

    watched = "watchdog: {time: 2s, action: inhibit, configure: true}"
    leased = "lease: {required: true}"
    with_plant(test, roster_text([("a", 11, "8200vector")], drive=f"{watched}, {leased}"))


def test_every_log_event_is_documented() -> None:
    sources = [path.read_text() for path in (ROOT / "src" / "lecombus").rglob("*.py")]
    logged = {name for text in sources for name in re.findall(r"\bevent=([a-z-]*[a-z])\b", text)}
    assert {"port-open", "watchdog-missed", "slow-drive"} <= logged
    made = [one for text in sources for one in re.findall(r"(?<!class )\bSparseLog\(([^)]*)", text)]
    sparse = {name for one in made for name in re.findall(r'"([a-z-]+)"', one)}
    assert len(made) == len(sparse) > 0, "the name of an event of SparseLog is a literal"
    logged |= sparse
    explained = {name for cells in rows(ALARMS, "## Log") for name in quoted(cells[0])}
    assert logged - explained == set()


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


def test_the_readme_is_read_in_the_first_hour() -> None:
    assert README.count("\n") <= 200
    first_screen = README.splitlines()[:25]
    for wanted in ("make demo", "make test", "not a safety function"):
        assert any(wanted in line for line in first_screen), wanted


def test_the_first_roster_is_right(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    roster = tmp_path / "bench.yaml"
    roster.write_text(README.partition("<<'END'\n")[2].partition("\nEND\n")[0])
    assert main(["check", "-c", str(roster)]) == 0
    shown = README.partition("$ lecombus check -c bench.yaml\n")[2].partition("```")[0]
    said = " ".join(capsys.readouterr().out.split())
    cyclic = re.findall(r"C\d{4} \d+\w+", shown)
    assert len(cyclic) == 5
    for words in (*cyclic, "8200vector", "reaches every drive at 11 to 19"):
        assert words in said, words


def test_the_refused_roster_of_the_timing_document_is_refused_in_these_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    example = (DOCS / "timing.md").read_text().partition("$ cat two.yaml\n")[2].partition("```")[0]
    roster, _, shown = example.partition("$ lecombus check -c two.yaml\n")
    monkeypatch.chdir(tmp_path)
    Path("two.yaml").write_text(roster)
    assert main(["check", "-c", "two.yaml"]) == 2
    assert capsys.readouterr().err == shown


def anchors(text: str) -> set[str]:
    """Return what GitHub makes of the headings of a document."""
    outside = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ (.*)$", outside, re.MULTILINE)
    }


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = (path.parent / name).resolve() if name else path
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file.read_text()), target


@pytest.mark.parametrize("path", WRITTEN, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_row_of_a_table_has_the_cells_of_its_head(path: Path) -> None:
    """What stands behind the last column of the head is not shown, nor is a row cut in two."""
    outside = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    for table in re.findall(r"(?:^\|.*\n)+.*", outside, re.MULTILINE):
        *lines, behind = table.split("\n")
        assert not behind, behind
        counts = {line: len(re.findall(r"(?<!\\)\|", line)) for line in lines}
        assert set(counts.values()) == {counts[lines[0]]}, counts


@pytest.mark.parametrize("folder", [DOCS, DOCS / "adr"], ids=["docs", "adr"])
def test_every_document_is_in_its_index(folder: Path) -> None:
    named = set(re.findall(r"\]\(([\w-]+\.md)", (folder / "README.md").read_text()))
    assert {path.name for path in folder.glob("*.md")} - {"README.md"} == named - {"README.md"}
