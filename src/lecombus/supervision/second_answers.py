"""Remarks about answers that nobody asked for: two drives at one address, or every answer twice.

What must not live here: counting them (`line.duplicates`), and what a stop makes of them
(`line.read_back_proof`).
"""

from __future__ import annotations

from typing import Final

from lecombus.drive_runtime import LineDrives
from lecombus.fieldbus.lecom.exchanges.duplicates import Found
from lecombus.store import Store

__all__ = ["SecondAnswers"]

REMARK: Final = "second-answers"

LEAST: Final = 3
"""Fewer than this within a minute are not worth a remark."""

PART: Final = 2 / 3
"""Of those that can be told, so many came behind the same drive's own answer."""


class SecondAnswers:
    """Keeps the remarks.

    Args:
        store: Where remarks stand.
    """

    def __init__(self, store: Store) -> None:
        self._store = store

    def look(self, found: Found, drives: LineDrives) -> None:
        """Say what has come within the last minute; about once a second.

        Args:
            found: How many came, and behind whose answers.
            drives: The drives.
        """
        count, alone = found
        told = sum(alone.values())
        suspects = [drive.name for drive in drives
                    if alone.get(drive.name, 0) >= LEAST
                    and alone[drive.name] >= PART * told]  # fmt: skip
        for drive in drives:
            text, name, address = None, drive.name, drive.entry.address
            if name in suspects:
                text = (
                    f"two drives at address {address}? second answers came after its own, "
                    f"{alone[name]} in the last minute: give one of the two another address"
                )
            self._store.note(name, REMARK, text)
        text = None
        if count >= LEAST and not suspects:
            text = (
                f"{count} answers came in the last minute that nobody asked for: two drives at one "
                "address, an adapter or device server that delivers twice, or another master; "
                "until they end a stop takes more readings to be shown"
            )
        self._store.note_line(REMARK, text)
