"""What a parameter of a drive is called: code and subcode."""

from __future__ import annotations

import re
from typing import Final, NamedTuple, Self

from lecombus.errors import CodeValueError

__all__ = ["HIGHEST_CODE", "HIGHEST_SUBCODE", "Code"]

HIGHEST_CODE: Final = 65535
HIGHEST_SUBCODE: Final = 255

_PARAMETER_OFFSET: Final = 1000  # SMVector: parameter Pnnn is code 1000 + nnn
_WRITTEN: Final = re.compile(r"(?:[Cc]?(\d{1,5})|[Pp](\d{1,3}))(?:/(\d{1,3}))?", re.ASCII)
_RIGHT: Final = "write C0150, C150, 150, C0039/1 (code/subcode) or P425"


class _Numbers(NamedTuple):
    """What a code is made of."""

    number: int
    subcode: int


class Code(_Numbers):
    """A code number with its subcode.

    A tuple, for codes are the keys of all that stands behind an exchange, and nothing is hashed
    and compared as quickly.

    Args:
        number: 0..65535.
        subcode: 0..255; 0 also where the code has no subcodes.

    Raises:
        CodeValueError: One of them lies outside its range, which no telegram can carry.

    Source: EDB2102EN 8.3.1 "Code number (C1, C2)"; CMVLC401A 5.3.
    """

    __slots__ = ()

    def __new__(cls, number: int, subcode: int = 0) -> Self:
        """Refuse what no telegram can carry."""
        if not 0 <= number <= HIGHEST_CODE:
            raise CodeValueError(
                f"there is no code {number}: codes run from 0 to {HIGHEST_CODE}",
                code=str(number), value=number, low=0, high=HIGHEST_CODE,
            )  # fmt: skip
        if not 0 <= subcode <= HIGHEST_SUBCODE:
            raise CodeValueError(
                f"C{number:04d} cannot have subcode {subcode}: "
                f"subcodes run from 0 to {HIGHEST_SUBCODE}",
                code=f"C{number:04d}", value=subcode, low=0, high=HIGHEST_SUBCODE,
            )  # fmt: skip
        return super().__new__(cls, number, subcode)

    def __str__(self) -> str:
        """Return `C0150`, or `C0039/1` with a subcode."""
        return f"C{self.number:04d}/{self.subcode}" if self.subcode else f"C{self.number:04d}"

    @classmethod
    def parse(cls, text: str) -> Code:
        """Read a code as people write it.

        Args:
            text: `C0150`, `C150`, `150`, `C0039/1`, or `P425` for SMVector parameter 425, which
                is code 1425 (P0..P999).

        Raises:
            CodeValueError: It is none of these, or out of range; the message says what is right.

        Source: CMVLC401A 9 (codes are parameter numbers plus 1000).
        """
        match = _WRITTEN.fullmatch(text)
        if match is None:
            raise CodeValueError(f"{text!r} is not a code: {_RIGHT}", code=text, value=text)
        number, parameter, subcode = match.groups()
        if parameter is not None:
            return cls(_PARAMETER_OFFSET + int(parameter), int(subcode or 0))
        return cls(int(number), int(subcode or 0))
