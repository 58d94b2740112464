"""What stands after STX, the same in both directions: code field, value, ETX.

The rules which character may stand where in a text are here and nowhere else; `parser` (what
drives say) and `host_parser` (what hosts say) feed it one character at a time. The code field's
length is known from its first character, so nothing is ever searched for. The BCC is not part of
the text: it may be any character, and the parsers compare it.

Bounded: a text ends, or has a fault, after a code field, 241 characters and one more.
"""

from __future__ import annotations

from lecombus.fieldbus.lecom.protocol.addressing import field_length, fits_field
from lecombus.fieldbus.lecom.protocol.controls import ETX
from lecombus.fieldbus.lecom.protocol.telegrams import TelegramFault
from lecombus.parameters import HIGHEST_VALUE_CHARS

__all__ = ["TelegramText"]


class TelegramText:
    """The text of the telegram under way.

    Attributes:
        body: Every character after STX so far; with ETX, what the BCC is taken of.
        field_chars: How long the code field is; 0 before its first character.
        ended: ETX has come, so that the next character is the BCC.
    """

    __slots__ = ("body", "ended", "field_chars")

    def __init__(self) -> None:
        self.body = bytearray()
        self.field_chars = 0
        self.ended = False

    def clear(self) -> None:
        """Begin a new text."""
        self.body.clear()
        self.field_chars = 0
        self.ended = False

    def take(self, char: int) -> TelegramFault | None:
        """Take the next character before the BCC; return what is wrong with it."""
        body = self.body
        body.append(char)
        if len(body) == 1:
            self.field_chars = field_length(char)
        if len(body) <= self.field_chars:
            return None if fits_field(body) else TelegramFault.UNEXPECTED
        if char == ETX:
            self.ended = True
            return None
        if not 0x20 <= char < 0x7F:
            return TelegramFault.UNEXPECTED
        return (
            TelegramFault.TOO_LONG if len(body) - self.field_chars > HIGHEST_VALUE_CHARS else None
        )

    def at_value(self) -> bool:
        """Return whether the code field is complete and no value has begun."""
        return len(self.body) == self.field_chars > 0

    @property
    def field(self) -> bytes:
        """The code field."""
        return bytes(self.body[: self.field_chars])

    @property
    def value(self) -> bytes:
        """The text between code field and ETX."""
        return bytes(self.body[self.field_chars : -1])
