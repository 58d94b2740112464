"""What differs between two records, and what of it is meant.

A record is text: a section begins with `=== NAME`, its rows follow. A difference is a row that one
side has and the other has not; it is meant when a row of `meant.yaml` fits it.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path

import yaml

MEANT = Path(__file__).parent / "meant.yaml"
SHOWN = 40
"""So many differing rows of a part are printed; the file has all."""
LONGEST = 300
ROWS = 4
"""Rows shown before and behind the place where two runs part."""


@dataclass
class Meant:
    """A difference that is meant.

    Args:
        part: In which part; `all` for every one.
        pattern: Searched in `SECTION: -ROW` or `SECTION: +ROW`.
        reason: Why it is meant.
    """

    part: str
    pattern: str
    reason: str
    used: bool = False


@dataclass
class Differences:
    """What differs in a part.

    Args:
        rows: `SECTION: -ROW` for what only the base has, `SECTION: +ROW` for the checkout.
        meant: How many more rows differ as meant.
    """

    rows: list[str] = field(default_factory=list)
    meant: int = 0

    @property
    def sections(self) -> list[str]:
        """The sections that differ, each once, in their order."""
        return list(dict.fromkeys(row.partition("\t")[0] for row in self.rows))


def read_meant(path: Path = MEANT) -> list[Meant]:
    """Read what is meant to differ."""
    return [Meant(**row) for row in yaml.safe_load(path.read_text()) or []]


def differences(part: str, base: str, now: str, meant: list[Meant]) -> Differences:
    """Compare two records of a part."""
    before, after = sections(base), sections(now)
    found = Differences()
    for name in list(dict.fromkeys([*before, *after])):
        if before.get(name) == after.get(name):
            continue
        for row in _changed(before.get(name, []), after.get(name, [])):
            text = f"{name}: {row}"
            rules = [one for one in meant if one.part in (part, "all")]
            fits = [one for one in rules if re.search(one.pattern, text)]
            for one in fits:
                one.used = True
            if fits:
                found.meant += 1
            else:
                found.rows.append(f"{name}\t{row}")
    return found


def sections(record: str) -> dict[str, list[str]]:
    """Split a record; a name that comes again gets a number."""
    found: dict[str, list[str]] = {}
    rows: list[str] = []
    for row in record.splitlines():
        if row.startswith("=== "):
            name, number = row[4:], 2
            while name in found:
                name, number = f"{row[4:]} #{number}", number + 1
            rows = found[name] = []
        else:
            rows.append(row)
    return found


def _changed(before: list[str], after: list[str]) -> list[str]:
    if not before:
        return ["+(the whole section)"]
    if not after:
        return ["-(the whole section)"]
    diff = difflib.unified_diff(before, after, n=0, lineterm="")
    return [row for row in diff if row[:3] not in ("---", "+++") and row[:2] != "@@"]


def shown(found: Differences) -> str:
    """Return the first differing rows for people, by section."""
    lines, last = [], ""
    for text in found.rows[:SHOWN]:
        name, _, row = text.partition("\t")
        if name != last:
            lines.append(f"  {name[:LONGEST]}")
            last = name
        lines.append(f"    {row[:LONGEST]}")
    if len(found.rows) > SHOWN:
        lines.append(f"  .. and {len(found.rows) - SHOWN} rows more")
    return "\n".join(lines)


def beginning(before: list[str], after: list[str]) -> str:
    """Return where two runs part, with the rows before and behind: all that follows is shifted."""
    both = zip(before, after, strict=False)
    shortest = min(len(before), len(after))
    number = next((n for n, (one, two) in enumerate(both) if one != two), shortest)
    rows = [f"      {row}" for row in before[max(0, number - ROWS) : number]]
    rows += [f"    - {row}" for row in before[number : number + ROWS]]
    rows += [f"    + {row}" for row in after[number : number + ROWS]]
    return "\n".join([f"  begins to differ in row {number + 1}:", *rows])


def beginnings(base: str, now: str, names: list[str]) -> str:
    """Return where sections of two records part."""
    before, after = sections(base), sections(now)
    texts = (f"  {name}\n{beginning(before.get(name, []), after.get(name, []))}" for name in names)
    return "\n".join(texts)
