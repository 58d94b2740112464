"""What bits and fields of words are called in German, from `bit-names.yaml`.

Strategy: the name that a family's file gives a bit is a word for programs and stays the same in
every language; what people read in German stands once for all families. A name that the file does
not have, such as one of an extension, is its own German.

What must not live here: what a bit means (`words`, `commands`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Final

from .document import Origin, read_document

__all__ = ["german_name", "load_bit_names"]

FILE: Final = "bit-names.yaml"


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
    document = read_document(text, Origin(f"families/{FILE}", ""))
    found: dict[str, str] = {}
    for key, value in document.take("names").table().pairs():
        found[key.text()] = value.text()
    document.done()
    return found
