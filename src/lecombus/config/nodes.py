"""What a YAML text is made of, each piece with its place.

Nodes keep the text of a scalar and never the value YAML would make of it: `no` as a boolean, `011`
as 9, `11:30` as 690 and `1.20` as 1.2 are YAML's idea of what a person meant, and what was meant
depends on the key, which only the reader of that key knows.

What must not live here: reading YAML, and any meaning of keys and values.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["ListNode", "MappingNode", "Node", "Scalar", "kind_of"]

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
