"""Texts for people, in English and German.

Data files give every text in both languages.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = ["NOTHING", "Language", "Text"]


class Language(StrEnum):
    """A language that texts can be asked for in."""

    EN = "en"
    DE = "de"


@dataclass(frozen=True, slots=True)
class Text:
    """One text in both languages.

    Args:
        en: English.
        de: German.
    """

    en: str
    de: str

    def __str__(self) -> str:
        """Return the English text: logs and errors are in English."""
        return self.en

    def in_language(self, language: Language) -> str:
        """Return the text in a language."""
        return self.de if language is Language.DE else self.en


NOTHING: Final = Text("", "")
