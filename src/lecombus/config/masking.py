"""Rosters and other texts without their secrets, for people who are sent them.

A roster names files that hold secrets, and need not hold any itself; but a person may have written
a password where no key takes one, into a comment, or into the words of a command. So the text of a
roster is given without comments, without the words of commands, and with `***` in place of every
value whose key sounds like a secret. What was masked there is masked wherever it stands in other
texts too, such as a mistake that quotes it.

Strategy: the tokens of the YAML scanner say where values stand, also in a roster that has mistakes.
Of a text that is no YAML nothing is given.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any, Final

import yaml

from lecombus.drives import FAMILY_NAMES, family
from lecombus.errors import CodeValueError
from lecombus.parameters import Code

__all__ = ["COMMAND_KEYS", "MASK", "Masked", "Masker", "mask_roster"]

MASK: Final = "***"

SECRET_KEY: Final = re.compile(
    r"pass(wor[dt]|wd|phrase)?$|pwd$|(^|_)pw$|kennwort|secret|token|credential|api_?key|^key$|^pin$"
    r"|^auth", re.IGNORECASE,
)  # fmt: skip
SECRET_FILE: Final = "password_file"
COMMAND_KEYS: Final = frozenset({"command"})
"""Their words may hold anything; the program alone, their first word, is kept."""

MISSPELT: Final = 0.8
"""So much alike are a key and a mistyped one, by difflib: `comand`, and not `command_time`."""

COMMAND_PATHS: Final = tuple(f".{key}" for key in COMMAND_KEYS)
"""How their paths end in rows of the journal that say what changed in a roster."""

SHORTEST: Final = 4
"""Characters of a secret that is masked wherever it stands; shorter ones stand everywhere."""

PATTERNS: Final = (
    re.compile(r"lcb_[A-Za-z0-9_-]+"),
    re.compile(r"(?<=Bearer )\S+", re.IGNORECASE),
    re.compile(r"(?<=://)[^/\s@]+(?=@)"),
    re.compile(r"\b\d{10,}-[0-9a-f]{16,}\b"),
    re.compile(r"-----BEGIN [A-Z ]*KEY-----.*?(-----END [A-Z ]*KEY-----|\Z)", re.DOTALL),
)  # fmt: skip
"""Tokens of the HTTP API, passwords in URLs, tokens of leases, private keys."""


@dataclass(frozen=True, slots=True)
class Masked:
    """A roster without secrets.

    Args:
        text: What is left of it.
        secrets: The values that were masked.
        files: The files of passwords that it names.
    """

    text: str
    secrets: frozenset[str]
    files: tuple[str, ...] = ()


@dataclass(slots=True)
class Masker:
    """Masks secrets in texts and documents.

    Args:
        secrets: Values to mask wherever they stand.
    """

    secrets: set[str] = field(default_factory=set)

    def text(self, text: str) -> str:
        """Return a text without secrets."""
        for secret in sorted(self.secrets, key=len, reverse=True):
            if len(secret) >= SHORTEST:
                text = text.replace(secret, MASK)
        for pattern in PATTERNS:
            text = pattern.sub(MASK, text)
        return "".join(
            mask_sample(line) if 'code="' in line else line for line in text.splitlines(True)
        )

    def document(self, found: Any) -> Any:
        """Return a JSON document without values of drives' passwords and words of commands."""
        if isinstance(found, list):
            return [self.document(one) for one in found]
        if not isinstance(found, dict):
            return self.text(found) if isinstance(found, str) else found
        hides = is_password(found.get("code"))
        return {
            key: MASK
            if is_password(key)
            or key.endswith(COMMAND_PATHS)
            or (hides and key in ("value", "raw", "text", "old", "reading"))
            else self.document(one)
            for key, one in found.items()
        }


def mask_roster(text: str) -> Masked | None:
    """Return a roster without its secrets; None: it is no YAML, so they cannot be found."""
    text = text.removeprefix("\ufeff")
    try:
        tokens = list(yaml.scan(text, yaml.SafeLoader))
        for _ in yaml.parse(text, yaml.SafeLoader):
            pass  # the scanner alone takes what has no meaning, such as a bracket too many
    except yaml.YAMLError:
        return None
    scalars = [one for one in tokens if isinstance(one, yaml.ScalarToken)]
    spans = [(one.start_mark.index, one.end_mark.index) for one in scalars]
    secrets, words = list(secret_values(tokens)), list(command_words(tokens))
    masked = {(one.start_mark.index, one.end_mark.index) for one in (*secrets, *words)}
    parts = (part.strip() for one in secrets for part in (one.value, *one.value.splitlines()))
    files = (one.value for key, values in values_by_key(tokens) for one in values
             if key.endswith(SECRET_FILE))  # fmt: skip
    left = without_comments(text, spans, masked)
    return Masked(left, frozenset(filter(None, parts)), tuple(files))


def values_by_key(tokens: list[Any]) -> Iterator[tuple[str, list[Any]]]:
    """Give each key with the scalars of its value."""
    for place, token in enumerate(tokens):
        if not isinstance(token, yaml.KeyToken) or place + 1 == len(tokens):
            continue
        key = tokens[place + 1]
        if not isinstance(key, yaml.ScalarToken):
            continue
        yield key.value, list(values_behind(tokens, place + 2))


def secret_values(tokens: list[Any]) -> Iterator[Any]:
    """Give the scalars that are, or are in, the value of a key that sounds like a secret.

    A path is none. What stands for the file of a password and is not a path may be the password.
    """
    for key, values in values_by_key(tokens):
        if is_password(key):
            yield from values
        elif SECRET_KEY.search(re.sub("[-_]file$", "", key)):
            yield from (one for one in values if not one.value.startswith("/"))


def command_words(tokens: list[Any]) -> Iterator[Any]:
    """Give the words of commands, without the programs."""
    for key, values in values_by_key(tokens):
        if get_close_matches(key.lower(), COMMAND_KEYS, cutoff=MISSPELT):
            yield from values[1:]


STARTS: Final = (
    yaml.BlockMappingStartToken, yaml.BlockSequenceStartToken, yaml.FlowMappingStartToken,
    yaml.FlowSequenceStartToken,
)  # fmt: skip
ENDS: Final = (yaml.BlockEndToken, yaml.FlowMappingEndToken, yaml.FlowSequenceEndToken)


def values_behind(tokens: list[Any], place: int) -> Iterator[Any]:
    """Give every scalar of the value that begins behind a key."""
    if place == len(tokens) or not isinstance(tokens[place], yaml.ValueToken):
        return
    depth = 0
    for token in tokens[place + 1 :]:
        if depth == 0 and isinstance(token, (yaml.KeyToken, *ENDS, yaml.FlowEntryToken)):
            return
        if isinstance(token, STARTS):
            depth += 1
        elif isinstance(token, ENDS):
            depth -= 1
        elif isinstance(token, yaml.ScalarToken):
            yield token
            if depth == 0:
                return
        if depth == 0 and isinstance(token, ENDS):
            return


def without_comments(
    text: str, spans: Iterable[tuple[int, int]], masked: Collection[tuple[int, int]]
) -> str:
    """Return the text of a YAML file without its comments, and with some values masked.

    Args:
        text: The text.
        spans: Where its scalars stand.
        masked: Those of them that are masked.
    """
    parts: list[str] = []
    at = 0
    for begin, end in sorted(spans):
        parts.append(COMMENT.sub("", text[at:begin]))
        behind = text[begin:end]
        last = "\n" if behind.endswith("\n") else ""
        parts.append(f'"{MASK}"{last}' if (begin, end) in masked else behind)
        at = end
    parts.append(COMMENT.sub("", text[at:]))
    return "".join(parts)


COMMENT: Final = re.compile(r"#[^\n]*")
"""Between scalars a `#` begins a comment."""


def mask_sample(line: str) -> str:
    """Return a line of the metrics page without the value of a password."""
    code = re.search(r'\bcode="([^"]*)"', line)
    if code is None or not is_password(code[1]):
        return line
    head, brace, _ = line.rpartition("}")
    return f"{head}{brace} {MASK}\n" if brace else f"{MASK}\n"


def is_password(text: object) -> bool:
    """Whether a text is the name of a code that holds a password."""
    if not isinstance(text, str) or text[:1] not in ("C", "P", "c", "p"):
        return False
    try:
        code = Code.parse(text)
    except CodeValueError:
        return False
    return any(family(name).is_secret(code) for name in FAMILY_NAMES)
