"""What two rosters of one line differ in, by drive and by key, as a reload reports it.

Pure: two rosters go in, names of drives, groups and keys come out. Keys are named as in the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from pydantic import BaseModel

from lecombus.config.building import RENAMED
from lecombus.config.masking import COMMAND_KEYS, MASK
from lecombus.config.mistakes import Mistakes, Position, Spot
from lecombus.config.yaml_nodes import MappingNode
from lecombus.parameters import Json
from lecombus.roster import Roster

__all__ = [
    "FIXED",
    "RosterChanges",
    "check_restart",
    "roster_changes",
    "roster_values",
    "value_changes",
]

FIXED: Final = ("line", "api", "journal", "state")
"""The parts of a roster that only a restart changes."""

_WITHOUT_KEY: Final = ("owned", "slow")
"""Fields that no key gives; nor does one give the `file` of the roster itself."""

_KEY_OF: Final[Mapping[str, str]] = {field: key for key, field in RENAMED.items()}


@dataclass(frozen=True, slots=True)
class RosterChanges:
    """What a new roster changed; drives in its order, those removed in the order of the old one.

    Args:
        file: The new roster's file.
        drives: How many drives it has.
        added: Drives that are new.
        removed: Drives that are gone.
        changed: Drives that are described otherwise, each with the keys that differ.
        groups: Groups that are new, gone, have other members or are sent to otherwise.
        keys: Other keys of the roster that differ, such as `on_shutdown`.
    """

    file: str
    drives: int
    added: tuple[str, ...]
    removed: tuple[str, ...]
    changed: Mapping[str, tuple[str, ...]]
    groups: tuple[str, ...]
    keys: tuple[str, ...]

    def __str__(self) -> str:
        """Write it for the log: `added=c,d removed=none changed=a`."""
        parts = {"added": self.added, "removed": self.removed, "changed": tuple(self.changed)}
        return " ".join(f"{key}={','.join(names) or 'none'}" for key, names in parts.items())

    def as_json(self) -> dict[str, Json]:
        """Return the JSON form."""
        changed: list[Json] = [
            {"drive": name, "keys": list(keys)} for name, keys in self.changed.items()
        ]
        return {
            "outcome": "done",
            "file": self.file,
            "drives": self.drives,
            "added": list(self.added),
            "removed": list(self.removed),
            "changed": changed,
            "groups": list(self.groups),
            "keys": list(self.keys),
        }


def roster_changes(old: Roster, new: Roster) -> RosterChanges:
    """Compare two rosters of one line."""
    before = {entry.name: entry for entry in old.drives}
    after = {entry.name: entry for entry in new.drives}
    pairs = {name: (before[name], entry) for name, entry in after.items() if name in before}
    differing = {name: tuple(differing_keys(*pair)) for name, pair in pairs.items()}
    own = [key for key in differing_keys(old, new) if key not in ("drives", "groups")]
    return RosterChanges(
        file=new.file,
        drives=len(new.drives),
        added=tuple(name for name in after if name not in before),
        removed=tuple(name for name in before if name not in after),
        changed={name: keys for name, keys in differing.items() if keys},
        groups=tuple(
            name for name in dict.fromkeys((*new.groups, *old.groups))
            if groups_differ(old, new, name)
        ),
        keys=tuple(own),
    )  # fmt: skip


def roster_values(roster: Roster) -> dict[str, str]:
    """Return every value of a roster as text, by its path, such as `drives.feeder.address`."""
    found: dict[str, str] = {}
    drives = {entry.name: entry for entry in roster.drives}
    for key, value in parts_of(roster).items():
        flatten(key, drives if key == "drives" else value, found)
    return found


def parts_of(model: BaseModel) -> dict[str, Any]:
    """Return the values of a model by their keys."""
    return {_KEY_OF.get(field, field): getattr(model, field) for field in fields_with_key(model)}


def fields_with_key(model: BaseModel) -> Iterator[str]:
    """Yield the fields of a model that a key of the file gives."""
    of_roster = isinstance(model, Roster)
    for field in type(model).model_fields:
        if field not in _WITHOUT_KEY and not (of_roster and field == "file"):
            yield field


def flatten(path: str, value: Any, found: dict[str, str]) -> None:
    """Add the values in a value by their paths."""
    if isinstance(value, BaseModel):
        value = parts_of(value)
    if isinstance(value, Mapping):
        for key, part in value.items():
            flatten(f"{path}.{key}", part, found)
    elif isinstance(value, (frozenset, tuple)):
        texts = [text_of(item) for item in value]
        found[path] = ", ".join(texts if isinstance(value, tuple) else sorted(texts))
    elif value is not None:
        found[path] = str(value)


def text_of(item: Any) -> str:
    """Return an item of a list as text."""
    if isinstance(item, BaseModel):
        return " ".join(f"{key}={value}" for key, value in parts_of(item).items())
    return str(item)


def value_changes(old: Mapping[str, str], new: Mapping[str, str]) -> dict[str, str]:
    """Return what differs between two rosters' values, by path: `2.0 -> 3.0`.

    Of a command only the program is given: its words may hold a password.
    """
    paths = dict.fromkeys((*new, *old))
    return {
        path: f"{given(old, path)} -> {given(new, path)}"
        for path in paths
        if old.get(path) != new.get(path)
    }


def given(values: Mapping[str, str], path: str) -> str:
    """Return a value as it is shown to people."""
    value = values.get(path, "none")
    if path.rpartition(".")[2] not in COMMAND_KEYS:
        return value
    program, comma, _ = value.partition(", ")
    return f"{program}{comma}{comma and MASK}"


def groups_differ(old: Roster, new: Roster, name: str) -> bool:
    """Whether a group differs; `all` has every drive, so only how it is sent to counts."""
    was, now = old.groups.get(name), new.groups.get(name)
    if name != "all" or was is None or now is None:
        return was != now
    return (was.multicast_address, was.multicast) != (now.multicast_address, now.multicast)


def differing_keys(old: BaseModel, new: BaseModel) -> Iterator[str]:
    """Yield the keys by which two entries of one kind differ."""
    for field in fields_with_key(new):
        if getattr(old, field) != getattr(new, field):
            yield _KEY_OF.get(field, field)


def check_restart(node: MappingNode, new: Roster, running: Roster, mistakes: Mistakes) -> None:
    """Note the keys that only a restart changes, each at its place.

    Args:
        node: The new roster's file.
        new: What it says.
        running: The roster in use.
        mistakes: Where the keys are noted.
    """
    for part in FIXED:
        was, now = getattr(running, part), getattr(new, part)
        if was == now:
            continue
        both = isinstance(was, BaseModel) and isinstance(now, BaseModel)
        keys = (list(differing_keys(was, now)) if both else []) or [""]
        for key in keys:
            what = f"`{part}{key and '.'}{key}` cannot change while lecombus runs"
            right = "restart lecombus, or put the old value back"
            mistakes.note(place_of(node, part, key), what, right)


def place_of(node: MappingNode, part: str, key: str) -> Position:
    """Return where a key stands; without it, where the part stands, or the file begins."""
    if part not in node.items:
        return Spot()
    name, value = node.items[part]
    if isinstance(value, MappingNode) and key in value.items:
        return value.items[key][0]
    return name
