"""The roster's JSON Schema for editors, made from the same table as the reading.

`python -m lecombus.config > config/roster.schema.json` writes the file that is shipped; a
test holds it to be current. An editor with a YAML language server uses it by a roster's first line
`# yaml-language-server: $schema=PATH/roster.schema.json`.

The schema is a help while typing: it knows keys, words and forms. Rules between keys, ranges of
durations and everything that follows from a drive's family are only known to `lecombus check`.
"""

from __future__ import annotations

import json
from typing import Any

from lecombus.config.keys import ROSTER

__all__ = ["roster_json_schema", "schema_text"]

_ID = "https://json-schema.org/draft/2020-12/schema"


def roster_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a roster."""
    return {"$schema": _ID, "title": "lecombus roster", **ROSTER.schema()}


def schema_text() -> str:
    """Return the schema as it is shipped in `config/roster.schema.json`."""
    return json.dumps(roster_json_schema(), indent=2, ensure_ascii=False) + "\n"
