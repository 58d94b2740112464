"""Reading a data file so that every complaint can name its line.

Strategy: PyYAML composes the nodes (the C parser where it is built in) and this module turns them
into plain values on demand. `Item` is one value with its place, `Table` a mapping whose keys must
all be taken: a key that nobody took is a misspelling and is refused with its place, and a key
that stands twice is refused at once, which YAML itself would swallow.

Nothing here knows what a family is. Durations, codes and formats are read in `sections`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import yaml

from lecombus.errors import DescriptionError

__all__ = ["Item", "Origin", "Table", "read_document"]

LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

DEEPEST = 20
"""Deepest nesting read; no file here needs more than 8."""

TRUE = frozenset({"true", "yes", "on"})


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a value came from: the data file and the family that is being read."""

    file: str
    family: str


class Item:
    """One value of a data file with its place."""

    __slots__ = ("_node", "_origin")

    def __init__(self, node: yaml.Node, origin: Origin) -> None:
        self._node = node
        self._origin = origin

    def fail(self, message: str, *, code: str = "") -> NoReturn:
        """Refuse this value.

        Raises:
            DescriptionError: Always, with file, line and column.
        """
        mark = self._node.start_mark
        raise DescriptionError(
            message,
            file=self._origin.file,
            where=f"{mark.line + 1}:{mark.column + 1}",
            drive_type=self._origin.family,
            code=code,
        )

    @property
    def place(self) -> str:
        """Where it stands: `FILE:LINE:COLUMN`."""
        mark = self._node.start_mark
        return f"{self._origin.file}:{mark.line + 1}:{mark.column + 1}"

    def text(self) -> str:
        """Give a text that says something."""
        if not isinstance(self._node, yaml.ScalarNode) or not self._node.value.strip():
            self.fail("a text is right here")
        text = str(self._node.value)
        if not text.isprintable():
            self.fail("a control character stands in this text: it would steer a terminal")
        return text

    def integer(self, low: int, high: int) -> int:
        """Give a whole number from `low` to `high`."""
        right = f"a whole number from {low} to {high} is right here"
        if not isinstance(self._node, yaml.ScalarNode) or not self._node.tag.endswith(":int"):
            self.fail(right)
        try:
            number = int(self._node.value, 0)
        except ValueError:  # YAML also takes 010 and 1:30 for whole numbers; we do not
            self.fail(right)
        if not low <= number <= high:
            self.fail(f"{self._node.value}: {right}")
        return number

    def flag(self) -> bool:
        """Give a yes or no."""
        if not isinstance(self._node, yaml.ScalarNode) or not self._node.tag.endswith(":bool"):
            self.fail("true or false is right here")
        return self._node.value.lower() in TRUE

    def items(self) -> list[Item]:
        """Give the members of a list."""
        if not isinstance(self._node, yaml.SequenceNode):
            self.fail("a list is right here")
        return [Item(node, self._origin) for node in self._node.value]

    def is_text(self) -> bool:
        """Say whether this is a single value rather than a list or a table."""
        return isinstance(self._node, yaml.ScalarNode)

    def table(self) -> Table:
        """Give a mapping."""
        if not isinstance(self._node, yaml.MappingNode):
            self.fail("a table of keys and values is right here")
        return Table(self._node, self._origin)


class Table(Item):
    """A mapping of a data file: keys are taken one by one, and `done` refuses the rest."""

    __slots__ = ("_entries", "_seen")

    def __init__(self, node: yaml.MappingNode, origin: Origin) -> None:
        super().__init__(node, origin)
        self._entries: dict[str, tuple[Item, Item]] = {}
        self._seen: set[str] = set()
        for key_node, value_node in node.value:
            key = Item(key_node, origin)
            name = key.text()
            if name in self._entries:
                key.fail(f"{name} stands here twice")
            self._entries[name] = (key, Item(value_node, origin))

    def get(self, key: str) -> Item | None:
        """Take a key that may be missing."""
        self._seen.add(key)
        entry = self._entries.get(key)
        return entry[1] if entry else None

    def take(self, key: str) -> Item:
        """Take a key that must be there."""
        item = self.get(key)
        if item is None:
            self.fail(f"{key} is missing")
        return item

    def pairs(self) -> Iterator[tuple[Item, Item]]:
        """Take all keys with their values."""
        self._seen.update(self._entries)
        yield from self._entries.values()

    def done(self) -> None:
        """Refuse every key that was not taken."""
        for name, (key, _) in self._entries.items():
            if name not in self._seen:
                key.fail(f"{name} is not known here; {', '.join(sorted(self._seen))} are")


def _refuse_deep(text: str, origin: Origin) -> None:
    """Refuse a text that nests deeper than any of these files: the composer recurses, in C too.

    Raises:
        DescriptionError: It does.
    """
    depth = 0
    for event in yaml.parse(text, Loader=LOADER):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            mark = event.start_mark
            raise DescriptionError(
                f"lists and tables nest more than {DEEPEST} deep here",
                file=origin.file,
                where=f"{mark.line + 1}:{mark.column + 1}" if mark else "",
                drive_type=origin.family,
            )


def read_document(text: str, origin: Origin, *, foreign: bool = False) -> Table:
    """Compose a data file.

    Args:
        text: The file's content.
        origin: Its name and the family being read, for complaints.
        foreign: It is none of our own: its depth is looked at first.

    Raises:
        DescriptionError: It is no YAML, nests too deep, or is not a table.
    """
    try:
        if foreign:
            _refuse_deep(text, origin)
        node = yaml.compose(text, Loader=LOADER)
    except yaml.YAMLError as exc:
        mark = getattr(exc, "problem_mark", None)
        raise DescriptionError(
            f"this is no YAML: {getattr(exc, 'problem', None) or exc}",
            file=origin.file,
            where=f"{mark.line + 1}:{mark.column + 1}" if mark else "",
            drive_type=origin.family,
        ) from exc
    if node is None:
        raise DescriptionError("the file is empty", file=origin.file, drive_type=origin.family)
    return Item(node, origin).table()
