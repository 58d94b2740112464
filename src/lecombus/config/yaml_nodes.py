"""From YAML text to nodes with places, safely for any text.

Nodes keep the text of a scalar and not the value that YAML makes of it: `no` as a boolean, `011` as
9, `11:30` as 690 and `1.20` as 1.2 are guesses. What was meant depends on the key, and only the
reader of that key knows.

PyYAML's C parser gives events (the Python parser gives the same ones where libyaml is missing), and
a loop builds nodes from them with its own stack. There is no recursion and no Python object is
constructed from the text, so neither depth nor a tag can do harm. Aliases share their node, and
every node counts its nodes with all aliases written out: an alias bomb is refused when this count
passes a limit, before the nodes are read.

A mistake in YAML itself ends the reading, since all that follows may be its consequence. Duplicate
keys, tags and odd keys are noted and the reading goes on. Anchors, aliases and merge keys (`<<`)
are supported, since full rosters repeat themselves.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Final

import yaml

from lecombus.config.mistakes import Mistakes, Position, RosterError, Spot, shown

__all__ = [
    "DEEPEST",
    "HEAVIEST",
    "PARSER",
    "ListNode",
    "MappingNode",
    "Node",
    "Scalar",
    "compose",
    "kind_of",
    "say_yaml_error",
]

_NULLS = frozenset({"", "~", "null", "Null", "NULL"})


@dataclass(slots=True, eq=False)
class Scalar:
    """A single value.

    Args:
        line: From 1.
        column: From 1.
        text: As written, without quotes.
        plain: Whether it was written without quotes.
    """

    line: int
    column: int
    text: str
    plain: bool
    weight: int = 1

    @property
    def is_empty(self) -> bool:
        """Whether there is a key but nothing (or YAML's null) behind it."""
        return self.plain and self.text in _NULLS


@dataclass(slots=True, eq=False)
class ListNode:
    """A sequence; `weight` counts its nodes with every alias written out."""

    line: int
    column: int
    items: list[Node] = field(default_factory=list)
    weight: int = 1


@dataclass(slots=True, eq=False)
class MappingNode:
    """A mapping: for each key its own node and its value; `weight` as in `ListNode`."""

    line: int
    column: int
    items: dict[str, tuple[Scalar, Node]] = field(default_factory=dict)
    weight: int = 1


Node = Scalar | ListNode | MappingNode


def kind_of(node: Node) -> str:
    """Name what a node is, in plain words."""
    if isinstance(node, Scalar):
        return "empty" if node.is_empty else "a single value"
    return "a list" if isinstance(node, ListNode) else "a mapping (`key: value`)"


PARSER: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The YAML parser in use: libyaml's where PyYAML was built with it, six times as fast."""
DEEPEST: Final = 20
"""Deepest nesting read; a roster needs 5."""
HEAVIEST: Final = 50_000
"""Most nodes with all aliases written out; 90 drives with 20 cyclic codes each are about 15,000."""

_MERGE: Final = "<<"
_HARMLESS_TAG: Final = "tag:yaml.org,2002:"
_UNPRINTABLE: Final = yaml.reader.Reader.NON_PRINTABLE


@dataclass(slots=True)
class _Open:
    """A collection being read: its node, its anchor, the key that waits for its value."""

    node: ListNode | MappingNode
    anchor: str | None
    key: Scalar | None = None
    merges: list[Node] = field(default_factory=list)


def compose(text: str, mistakes: Mistakes, *, parser: Any = PARSER) -> Node | None:
    """Read YAML.

    Args:
        text: The whole file.
        mistakes: Takes what is wrong but does not end the reading.
        parser: PyYAML's loader class that gives the events.

    Returns:
        The root, or None for a text that holds no document.

    Raises:
        RosterError: It is not YAML, nests too deep, or grows too large by its aliases.
    """
    _refuse_unprintable(text, mistakes)
    events = parser(text)
    try:
        return _Composer(mistakes).run(events)
    except yaml.MarkedYAMLError as exc:
        mark = exc.problem_mark or exc.context_mark
        spot = Spot(mark.line + 1, mark.column + 1) if mark else Spot()
        written = text.split("\n")[spot.line - 1 : spot.line]
        raise mistakes.fatal(spot, *say_yaml_error(exc, "".join(written))) from exc
    finally:
        events.dispose()


def _refuse_unprintable(text: str, mistakes: Mistakes) -> None:
    """Say where a character stands that YAML allows nowhere: its parsers give no line for it."""
    match = _UNPRINTABLE.search(text)
    if match is None:
        return
    before = text[: match.start()]
    spot = Spot(before.count("\n") + 1, match.start() - (before.rfind("\n") + 1) + 1)
    what = f"the character U+{ord(match.group()):04X} cannot stand in a YAML file"
    raise mistakes.fatal(spot, what, "remove it")


class _Composer:
    """Builds nodes from events."""

    def __init__(self, mistakes: Mistakes) -> None:
        self._mistakes = mistakes
        self._stack: list[_Open] = []
        self._anchors: dict[str, Node] = {}
        self._root: Node | None = None

    def run(self, events: Any) -> Node | None:
        """Take every event; see `compose`."""
        while events.check_event():
            event = events.get_event()
            spot = Spot(event.start_mark.line + 1, event.start_mark.column + 1)
            if isinstance(event, yaml.ScalarEvent):
                self._check_tag(event, spot)
                plain = not event.style  # None from the Python parser, "" from libyaml's
                self._finish(Scalar(spot.line, spot.column, event.value, plain), event.anchor)
            elif isinstance(event, yaml.MappingStartEvent):
                self._open(MappingNode(spot.line, spot.column), event, spot)
            elif isinstance(event, yaml.SequenceStartEvent):
                self._open(ListNode(spot.line, spot.column), event, spot)
            elif isinstance(event, yaml.CollectionEndEvent):
                self._close()
            elif isinstance(event, yaml.AliasEvent):
                self._put(self._aliased(event.anchor, spot), spot)
            elif isinstance(event, yaml.DocumentStartEvent) and self._root is not None:
                what = "a second document begins here"
                raise self._fatal(spot, what, "remove the `---` before it: a file is one roster")
        return self._root

    def _fatal(self, spot: Position, what: str, right: str) -> RosterError:
        return self._mistakes.fatal(spot, what, right)

    def _check_tag(self, event: Any, spot: Position) -> None:
        tag = event.tag
        if tag is not None and tag != "!" and not tag.startswith(_HARMLESS_TAG):
            self._mistakes.note(spot, f"the tag {shown(tag)} means nothing here", "remove it")
        elif tag is not None and tag.startswith(f"{_HARMLESS_TAG}python"):
            self._mistakes.note(spot, f"the tag {shown(tag)} is refused", "remove it")

    def _open(self, node: ListNode | MappingNode, event: Any, spot: Position) -> None:
        self._check_tag(event, spot)
        if len(self._stack) >= DEEPEST:
            what = f"lists and mappings nest more than {DEEPEST} deep here"
            raise self._fatal(spot, what, "a roster never needs that; look for a stray bracket")
        self._stack.append(_Open(node, event.anchor))

    def _close(self) -> None:
        top = self._stack.pop()
        if isinstance(top.node, MappingNode):
            self._merge(top.node, top.merges)
        self._finish(top.node, top.anchor)

    def _finish(self, node: Node, anchor: str | None) -> None:
        if anchor is not None:
            self._anchors[anchor] = node
        self._put(node, node)

    def _aliased(self, anchor: str | None, spot: Position) -> Node:
        assert anchor is not None, "a parser gives every alias a name"
        if any(entry.anchor == anchor for entry in self._stack):
            what = f"the alias `*{anchor}` refers to what it stands in"
            raise self._fatal(spot, what, "write the entry out")
        try:
            return self._anchors[anchor]
        except KeyError:
            what = f"the alias `*{anchor}` refers to nothing"
            right = f"write the anchor `&{anchor}` before it, or quote a value that begins with *"
            raise self._fatal(spot, what, right) from None

    def _put(self, node: Node, spot: Position) -> None:
        """Place a finished node where it belongs: root, list item, key, or value."""
        if not self._stack:
            self._root = node
            return
        top = self._stack[-1]
        top.node.weight += node.weight
        if top.node.weight > HEAVIEST:
            what = f"this has more than {HEAVIEST} entries, aliases written out"
            raise self._fatal(spot, what, "a roster never needs that")
        if isinstance(top.node, ListNode):
            top.node.items.append(node)
        elif top.key is None:
            top.key = self._as_key(node, spot)
        else:
            key, top.key = top.key, None
            self._set(top, key, node)

    def _as_key(self, node: Node, spot: Position) -> Scalar:
        if isinstance(node, Scalar):
            # An aliased key is one text at two places; mistakes belong where it is used.
            return Scalar(spot.line, spot.column, node.text, node.plain)
        raise self._fatal(spot, "a list or mapping cannot be a key", "write `key: value`")

    def _set(self, top: _Open, key: Scalar, node: Node) -> None:
        assert isinstance(top.node, MappingNode)
        if key.plain and key.text == _MERGE:
            top.merges.append(node)
            return
        earlier = top.node.items.get(key.text)
        if earlier is None:
            top.node.items[key.text] = (key, node)
            return
        what = f"the key {shown(key.text)} stands twice (first in line {earlier[0].line})"
        self._mistakes.note(key, what, "keep one of the two")

    def _merge(self, into: MappingNode, merges: list[Node]) -> None:
        """Bring in the keys of `<<`; a key written out goes before a merged one."""
        for source in merges:
            for node in source.items if isinstance(source, ListNode) else [source]:
                if not isinstance(node, MappingNode):
                    right = "give an alias of a mapping, such as `<<: *defaults`"
                    self._mistakes.note(node, "`<<` is given what is not a mapping", right)
                    continue
                for text, pair in node.items.items():
                    into.items.setdefault(text, pair)


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
     "begin it on its own line"),
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
