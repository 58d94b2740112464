"""Types that hold other types: mappings with known keys, mappings by name, lists.

A container reads all of its parts even if some are wrong, and returns what is usable with its nodes
(`Fields`, `Item`), so that later checks can give places. A mistyped key is read as the key
that was probably meant (the roster is refused anyway): its value is checked too, and there is no
second mistake for the missing key.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lecombus.config.mistakes import Mistakes, nearest, shown
from lecombus.config.scalar_types import UNUSABLE, ScalarType, Unusable, ValueType
from lecombus.config.yaml_nodes import ListNode, MappingNode, Node, Scalar, kind_of

__all__ = ["Fields", "Item", "Items", "Key", "ListOf", "NamedEntries", "ShortTable", "Table"]


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a mapping.

    Args:
        name: As written in the roster.
        type: What it holds.
        doc: What it is for, for editors; one or two sentences.
        required: Whether it must be there.
        default: What holds without it, in the roster's own words; None where there is no one
            answer.
    """

    name: str
    type: ValueType
    doc: str
    required: bool = False
    default: object = None


@dataclass(slots=True)
class Fields:
    """The parts of a mapping that could be read.

    Args:
        node: The mapping, or the single value that stands for it.
        values: The usable values by key.
        nodes: Where the value of each key stands, usable or not.
    """

    node: Node
    values: dict[str, Any] = field(default_factory=dict)
    nodes: dict[str, Node] = field(default_factory=dict)

    def get(self, key: str, default: Any = None) -> Any:
        """Return a usable value, or `default`."""
        return self.values.get(key, default)

    def place(self, key: str) -> Node:
        """Return where the value of a key stands, or the mapping if it has none."""
        return self.nodes.get(key, self.node)


@dataclass(slots=True)
class Item:
    """One usable value of a list, with its node."""

    node: Node
    value: Any


@dataclass(slots=True)
class Items:
    """The parts of a list that could be read.

    Args:
        items: The usable values.
        complete: Whether that is all of them.
    """

    items: list[Item]
    complete: bool = True

    def __iter__(self) -> Iterator[Item]:
        """Give the usable values in order."""
        return iter(self.items)


class Table:
    """A mapping with known keys.

    Args:
        title: What it is, such as "drive"; used in mistakes and in the schema.
        keys: Its keys.
        doc: What it is for, for editors.
    """

    def __init__(self, title: str, keys: Sequence[Key], doc: str = "") -> None:
        self.title = title
        self._a_title = f"{'an' if title[0] in 'aeiou' or title == 'mqtt' else 'a'} {title}"
        self.keys = {key.name: key for key in keys}
        self.doc = doc
        self.expects = self._expected()
        self.schema = self._schema()

    def with_types(self, types: Mapping[str, ValueType], without: Collection[str] = ()) -> Table:
        """Return a table with other types for some of its keys, and without some of them."""
        keys = [
            replace(key, type=types.get(name, key.type))
            for name, key in self.keys.items()
            if name not in without
        ]
        return Table(self.title, keys, self.doc)

    def _expected(self) -> str:
        required = [key.name for key in self.keys.values() if key.required]
        if not required:
            return f"a mapping with keys such as {next(iter(self.keys))}"
        *most, last = required
        return f"a mapping with {', '.join(most)} and {last}" if most else f"a mapping with {last}"

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Fields | Unusable:
        """Return what is usable, mistakes noted; `UNUSABLE` if it is something else."""
        if not isinstance(node, MappingNode):
            mistakes.note(node, f"{label} is {kind_of(node)}", f"give {self.expects}")
            return UNUSABLE
        entry = Fields(node)
        for text, (at, value) in node.items.items():
            name = text if text in self.keys else self._meant(at, node, entry, mistakes)
            if name is None:
                continue
            entry.nodes[name] = value
            read = self.keys[name].type.read(value, f"`{name}`", mistakes)
            if read is not UNUSABLE:
                entry.values[name] = read
        for key in self.keys.values():
            if key.required and key.name not in entry.nodes:
                what = f"the {self.title} has no `{key.name}`"
                mistakes.note(node, what, f"give {key.type.expects}")
        return entry

    def _meant(
        self, at: Scalar, node: MappingNode, entry: Fields, mistakes: Mistakes
    ) -> str | None:
        """Note an unknown key; return the key it was meant to be, where that is missing."""
        meant = nearest(at.text, self.keys)
        listed = f"the keys of {self._a_title} are {', '.join(self.keys)}"
        right = listed if meant is None else f"did you mean `{meant}`?"
        mistakes.note(at, f"{self._a_title} has no key {shown(at.text)}", right)
        taken = meant in node.items or meant in entry.nodes
        return None if taken else meant

    def _schema(self) -> dict[str, Any]:
        properties = {
            key.name: {
                **key.type.schema, "description": key.doc,
                **({} if key.default is None else {"default": key.default}),
            }
            for key in self.keys.values()
        }  # fmt: skip
        found: dict[str, Any] = {
            "type": "object", "properties": properties, "additionalProperties": False
        }  # fmt: skip
        if required := [key.name for key in self.keys.values() if key.required]:
            found["required"] = required
        return {**found, "description": self.doc} if self.doc else found


class ShortTable(Table):
    """A mapping that may also be written as the value of one of its keys.

    Args:
        title: As for `Table`.
        keys: Its keys; the first one is the one that may stand for all.
        doc: What it is for, for editors.
    """

    def __init__(self, title: str, keys: Sequence[Key], doc: str = "") -> None:
        super().__init__(title, keys, doc)
        self._one = keys[0]
        self.expects = f"{self._one.type.expects}, or a mapping with {', '.join(self.keys)}"
        schema = dict(self.schema)
        doc_of = {"description": schema.pop("description")} if doc else {}
        self.schema = {"anyOf": [self._one.type.schema, schema], **doc_of}

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Fields | Unusable:
        """Return what is usable, mistakes noted; `UNUSABLE` if it is something else."""
        if isinstance(node, MappingNode):
            return super().read(node, label, mistakes)
        read = self._one.type.read(node, label, mistakes)
        return UNUSABLE if read is UNUSABLE else Fields(node, {self._one.name: read})


class NamedEntries:
    """A mapping from names to values of one type, such as the groups.

    Args:
        name: What a name must look like.
        of: What each name holds.
        special: What a few names hold instead.
    """

    def __init__(
        self,
        name: ScalarType,
        of: ValueType,
        *,
        special: Mapping[str, ValueType] | None = None,
    ) -> None:
        self.name = name
        self.of = of
        self.special = special or {}
        self.expects = f"a mapping from {name.expects} to {of.expects}"
        names = {key: value for key, value in name.schema.items() if key != "type"}
        self.schema: dict[str, Any] = {
            "type": "object", "propertyNames": names, "additionalProperties": of.schema
        }  # fmt: skip
        if self.special:
            self.schema["properties"] = {text: one.schema for text, one in self.special.items()}

    def read(
        self, node: Node, label: str, mistakes: Mistakes
    ) -> list[tuple[Scalar, Any]] | Unusable:
        """Return the usable entries with the nodes of their names, mistakes noted."""
        if not isinstance(node, MappingNode):
            mistakes.note(node, f"{label} is {kind_of(node)}", f"give {self.expects}")
            return UNUSABLE
        found = []
        for text, (at, value) in node.items.items():
            self.name.read(at, "the name", mistakes)
            read = self.special.get(text, self.of).read(value, shown(text), mistakes)
            if read is not UNUSABLE:
                found.append((at, read))
        return found


class ListOf:
    """A list of values of one type.

    Args:
        of: What each item is.
        item: What an item is called in a mistake, such as "code".
        least: Fewest items.
    """

    def __init__(self, of: ValueType, item: str, least: int = 0) -> None:
        self.of = of
        self._item = item
        self._least = least
        self.expects = f"a list, each item {of.expects}"
        self.schema: dict[str, Any] = {"type": "array", "items": of.schema}
        if least:
            self.schema["minItems"] = least

    def read(self, node: Node, label: str, mistakes: Mistakes) -> Items | Unusable:
        """Return what is usable, mistakes noted; `UNUSABLE` if it is something else."""
        if not isinstance(node, ListNode):
            right = f"give {self.expects}"
            if isinstance(node, Scalar) and not node.is_empty and isinstance(
                self.of, ScalarType
            ):  # fmt: skip
                right = f"put it in brackets: [{node.text[:40]}]"
            mistakes.note(node, f"{label} is {kind_of(node)}", right)
            return UNUSABLE
        if len(node.items) < self._least:
            mistakes.note(node, f"{label} is an empty list", f"give {self.expects}")
            return UNUSABLE
        read = [Item(item, self.of.read(item, self._item, mistakes)) for item in node.items]
        usable = [item for item in read if item.value is not UNUSABLE]
        return Items(usable, len(usable) == len(read))
