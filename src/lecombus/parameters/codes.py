"""What a parameter of a drive is called: code and subcode, and what a protocol can carry of them.

Each line protocol has one `ParameterRules`. A protocol of this package is found by its name:
`RULES` of `lecombus.fieldbus.NAME.parameter_rules`. Others call `register_rules`.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple, Self

from lecombus.errors import CodeValueError, ConfigError
from lecombus.parameters.values import USUAL_DECIMALS, DecimalLimits

__all__ = [
    "HIGHEST_CODE",
    "HIGHEST_SUBCODE",
    "AddressForm",
    "Code",
    "ParameterRules",
    "forms_of",
    "register_rules",
    "rules_of",
]

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


class AddressForm(Enum):
    """A way in which telegrams name a code; the members are those of a protocol."""

    def carries(self, code: Code) -> bool:
        """Return whether this form can name a code at all."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class ParameterRules:
    """What a protocol can carry of codes and values.

    Args:
        protocol: Its name.
        forms: The ways in which its telegrams name a code, by the word for each.
        highest_code: The highest code number, 65535 at most.
        highest_subcode: The highest subcode, 255 at most.
        decimals: Which decimal numbers can be sent.
    """

    protocol: str
    forms: Mapping[str, AddressForm]
    highest_code: int = HIGHEST_CODE
    highest_subcode: int = HIGHEST_SUBCODE
    decimals: DecimalLimits = USUAL_DECIMALS

    def carries(self, code: Code) -> bool:
        """Return whether a telegram can name a code."""
        return code.number <= self.highest_code and code.subcode <= self.highest_subcode


def forms_of(rules: ParameterRules, addressing: str) -> tuple[AddressForm, ...]:
    """Return the forms of the roster's word: one of them, or `both`, all that there are."""
    known = rules.forms
    return tuple(known.values()) if addressing == "both" else (known[addressing],)


_KNOWN: dict[str, ParameterRules] = {}


def register_rules(rules: ParameterRules) -> None:
    """Make the rules of a protocol known."""
    _KNOWN[rules.protocol] = rules


def rules_of(protocol: str) -> ParameterRules:
    """Return the rules of a protocol.

    Raises:
        ConfigError: There is no such protocol.
    """
    found = _KNOWN.get(protocol)
    if found is None:
        name = f"lecombus.fieldbus.{protocol}"
        try:
            module = importlib.import_module(f"{name}.parameter_rules")
        except ModuleNotFoundError as exc:
            if exc.name not in (name, f"{name}.parameter_rules"):
                raise
            raise ConfigError(f"there is no line protocol {protocol}") from exc
        found = _KNOWN[protocol] = module.RULES
    return found
