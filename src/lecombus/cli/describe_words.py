"""What `describe` says around the manuals' texts, in German; English is what stands in its code.

What must not live here: names and meanings of codes and bits, which are data (`drives`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from lecombus.drives import Language

__all__ = ["GERMAN", "Say", "words_in"]

Say = Callable[[str], str]
"""Gives an English word in the language asked for."""

GERMAN: Final[Mapping[str, str]] = {
    "code": "Code",
    "name": "Name",
    "format": "Format",
    "hexadecimal digits": "Hexadezimalziffern",
    "unit": "Einheit",
    "values": "Werte",
    "value": "Wert",
    "default": "Werkseinstellung",
    "access": "Zugriff",
    "kept": "Speicherort",
    "parameter set": "Parametersatz",
    "subcodes": "Subcodes",
    "source": "Quelle",
    "bit": "Bit",
    "bits": "Bits",
    "to": "bis",
    "read": "lesen",
    "write": "schreiben",
    "while inhibited": "bei Reglersperre",
    "edge": "Flanke",
    "step": "Schritt",
    "save": "Speichern",
    "address": "Adresse",
    "reset": "Rücksetzen",
    "stored": "dauerhaft",
    "module": "im Modul",
    "volatile": "flüchtig",
    "reserved": "reserviert",
    "free: its meaning is set in the drive": "frei: die Bedeutung wird im Antrieb eingestellt",
}


def words_in(language: Language) -> Say:
    """Return what gives words in a language."""
    return GERMAN.__getitem__ if language is Language.DE else str
