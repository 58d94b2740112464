"""Inputs kept from one run to the next: `corpus/NAME.txt`, one a line, with Python's escapes."""

from __future__ import annotations

import codecs
from collections.abc import Iterable
from pathlib import Path
from typing import Final

__all__ = ["FOLDER", "MOST_KEPT", "MOST_KEPT_BYTES", "kept", "write"]

FOLDER: Final = Path(__file__).parent / "corpus"
MOST_KEPT: Final = 150
MOST_KEPT_BYTES: Final = 400
"""Longer inputs stay only where they were put by hand, so that the folder stays small."""


def kept(name: str) -> list[bytes]:
    """Return the inputs of a target."""
    file = FOLDER / f"{name}.txt"
    lines = file.read_text("ascii").splitlines() if file.exists() else []
    return [_bytes(line) for line in lines if line]


def write(name: str, inputs: Iterable[bytes]) -> None:
    """Write the inputs of a target, the shortest first."""
    FOLDER.mkdir(exist_ok=True)
    ordered = sorted(set(inputs), key=lambda one: (len(one), one))
    text = "".join(f"{_line(one)}\n" for one in ordered if one)
    (FOLDER / f"{name}.txt").write_text(text, "ascii")


def _line(data: bytes) -> str:
    return codecs.escape_encode(data)[0].decode("ascii")


def _bytes(line: str) -> bytes:
    return codecs.escape_decode(line)[0]
