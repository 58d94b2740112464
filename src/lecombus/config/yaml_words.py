"""PyYAML's complaints in words that help a person at a cabinet.

The C and the Python parser word the same complaint differently; the table knows pieces of both.
A complaint that no row knows is passed on as it is, with the advice that is right most often.
"""

from __future__ import annotations

import re
from typing import Final

import yaml

__all__ = ["say_yaml_error"]

_ROWS: Final[tuple[tuple[str, str, str], ...]] = (
    ("'\\t'", "a tab stands where YAML wants spaces", "indent with spaces"),
    ("cannot start any token", "a character stands here that cannot begin a value",
     "quote the value"),
    ("mapping values are not allowed", "a `:` stands where no key can be",
     "align the key with its neighbours, or quote a text that contains `: `"),
    ("expected ':'", "a key without `:`", "write `key: value`"),
    ("unexpected end of stream", "a quote or bracket is still open at the end of the file",
     "close it"),
    ("unexpected document", "a quote is still open here", "close it"),
    ("expected the node content", "a value is missing or begins with an unusable character",
     "give the value, in quotes if it begins with a special character"),
    ("expected node content", "a value is missing or begins with an unusable character",
     "give the value, in quotes if it begins with a special character"),
    ("expected <block end>", "this line does not fit the lines above",
     "check its indent, and that every list item begins with `- `"),
    ("expected '-' indicator", "this line does not fit the list above",
     "check its indent, and that every list item begins with `- `"),
    ("expected key", "this line does not fit the mapping above",
     "check its indent, and that every key ends in `:`"),
    ("document start", "this does not belong to what stands before it",
     "check its indent, and quote a value that begins with a special character"),
    ("directive", "a line begins with %", "remove the line, or quote the value"),
    ("expected alphabetic or numeric", "a character stands here that cannot begin a value",
     "quote the value"),
    ("',' or '}'", "a `{` is not closed", "separate by `,` and close with `}`"),
    ("',' or ']'", "a `[` is not closed", "separate by `,` and close with `]`"),
    ("block sequence entries are not allowed", "a list cannot begin here",
     "begin it on a line of its own"),
    ("undefined tag handle", "a tag stands here", "quote a value that begins with `!`"),
)  # fmt: skip


_ENDS_IN_COLON: Final = re.compile(r"(?:- )?\s*([\w-]+):\s+([^\s'\"]+:)\s*(?:#.*)?")
"""Such as `port: sim:`, which is a fine value to a person and a second key to YAML."""


def say_yaml_error(error: yaml.MarkedYAMLError, written: str) -> tuple[str, str]:
    """Return what is wrong and what would be right for a complaint of PyYAML.

    Args:
        error: The complaint.
        written: The line it is about.
    """
    problem = error.problem or "the text cannot be read"
    value = _ENDS_IN_COLON.fullmatch(written.strip())
    if value is not None and "mapping values are not allowed" in problem:
        what = "not valid YAML: a value that ends in `:` needs quotes"
        return what, f'write {value[1]}: "{value[2]}"'
    indent = written[: len(written) - len(written.lstrip())]
    if "cannot start any token" in problem and "\t" in indent:
        problem = "'\\t'"  # libyaml does not say which character it is
    for piece, what, right in _ROWS:
        if piece in problem:
            return f"not valid YAML: {what}", right
    return f"not valid YAML: {problem}", "check indent, quotes and colons of this line"
