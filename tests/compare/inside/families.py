"""Writes every loaded family field by field; runs on its own commit's source.

    python -m compare.inside.families OUTPUT --families smvector,93xx

No name of a class is written. A field has its name of the commit that brought this file: a field
that is renamed gets a row in `CALLED`, a field that is split or moved is put together in `facts`.
So both commits write the same rows as long as a family means the same.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal
from enum import Enum
from pathlib import Path
from typing import Any

from lecombus.drives import FAMILY_NAMES, Family, family
from lecombus.parameters import Code, Value

CALLED: dict[str, str] = {}
"""New name of a field: its name in the rows."""


def facts(one: Family, *, inside: bool = False) -> dict[str, Any]:
    """Return what a family means, by names that stay.

    Args:
        one: The family.
        inside: It is a variant of another, which names all of them.
    """
    found = _fields(one)
    found["faults"] = one.fault_table
    found["variants"] = sorted(one.variants) if inside else one.variants
    found["shortened_code"] = one.shortened_code
    found["times"] = {
        str(info.code): [
            (one.answer_time_s(info.code, write=write), one.longest_answer_time_s(
                info.code, write=write), one.patience_s(info.code, write=write))
            for write in (False, True)
        ]
        for info in one.described()
    }  # fmt: skip
    return found


def rows(name: str, value: Any) -> Iterator[str]:
    """Write a value, one row for each of its leaves."""
    if isinstance(value, Enum):
        yield from rows(name, value.value)
    elif isinstance(value, Code):
        yield f"{name} = {value}"
    elif isinstance(value, Value):
        yield f"{name} = {value.raw}"
    elif isinstance(value, Family):
        yield from rows(name, facts(value, inside=".variants." in name))
    elif dataclasses.is_dataclass(value) or hasattr(type(value), "model_fields"):
        yield from rows(name, _fields(value))
    elif isinstance(value, Mapping):
        for key, one in sorted(value.items(), key=lambda item: _key(item[0])):
            yield from rows(f"{name}.{_key(key)}", one)
        yield f"{name} has {len(value)}"
    elif isinstance(value, set | frozenset):
        yield f"{name} = {sorted(_key(one) for one in value)}"
    elif isinstance(value, bytes):
        yield f"{name} = {value.hex()}"
    elif isinstance(value, Iterable) and not isinstance(value, str):
        parts = list(value)
        for number, one in enumerate(parts):
            yield from rows(f"{name}.{number}", one)
        yield f"{name} has {len(parts)}"
    elif value is None or isinstance(value, str | int | float | bool | Decimal):
        yield f"{name} = {value!s}"
    else:
        raise TypeError(f"{name}: a {type(value).__name__} has no row")


def _key(key: Any) -> str:
    return str(key.value) if isinstance(key, Enum) else str(key)


def _fields(value: Any) -> dict[str, Any]:
    names = getattr(type(value), "model_fields", None)
    if names is None:
        names = [one.name for one in dataclasses.fields(value)]
    return {CALLED.get(name, name): getattr(value, name) for name in names if name[0] != "_"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--families", default=",".join(FAMILY_NAMES))
    asked = parser.parse_args()
    with asked.output.open("w") as file:
        for name in asked.families.split(","):
            file.write(f"=== {name}\n")
            file.writelines(f"{row}\n" for row in rows("family", family(name)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
