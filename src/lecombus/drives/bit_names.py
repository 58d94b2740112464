"""What bits and fields of words are called in German, from `bit-names.yaml`.

The name that a family's file gives a bit is a word for programs and stays the same in every
language; the German names stand once for all families. A name that the file does not have, such as
one of an extension, is its own German.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Final

from .field_types import Words
from .yaml_models import FILE_TABLE, Document

__all__ = ["german_name", "load_bit_names"]

FILE: Final = "bit-names.yaml"


@dataclass(frozen=True)
class _BitNamesFile:
    __pydantic_config__ = FILE_TABLE

    names: dict[Words, Words]


def german_name(name: str) -> str:
    """Return what a bit or field is called in German.

    Args:
        name: As in a family's file, such as `pulse_inhibit`.
    """
    return _packaged().get(name, name)


@cache
def _packaged() -> Mapping[str, str]:
    path = resources.files(__package__) / "families" / FILE
    return load_bit_names(path.read_text(encoding="utf-8"))


def load_bit_names(text: str) -> dict[str, str]:
    """Read the file.

    Raises:
        DescriptionError: It says something that cannot be.
    """
    return Document(text, f"families/{FILE}").read(_BitNamesFile).names
