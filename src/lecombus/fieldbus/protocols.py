"""What a line protocol gives to all other rooms, and how it is found by its name.

A protocol of this package is found by its name: `FIELDBUS` of `lecombus.fieldbus.NAME.fieldbus`,
loaded when it is asked for. Others call `register`.
"""

from __future__ import annotations

import importlib
from typing import Protocol

from lecombus.errors import ConfigError
from lecombus.fieldbus.costs import ExchangeCosts
from lecombus.parameters.rules import ParameterRules, register_rules

__all__ = ["Fieldbus", "find", "register"]


class Fieldbus(Protocol):
    """A line protocol.

    Attributes:
        name: The roster's word for it, `line.protocol`.
        rules: What it can carry of codes and values.
        bauds: The baud rates that it knows, bit/s, from the lowest.
        bits_per_char: Bits of a character, start, parity and stop bits included.
        costs: What its exchanges cost.
    """

    name: str
    rules: ParameterRules
    bauds: tuple[int, ...]
    bits_per_char: int
    costs: ExchangeCosts


_KNOWN: dict[str, Fieldbus] = {}


def register(fieldbus: Fieldbus) -> None:
    """Make a protocol known that is not part of this package."""
    _KNOWN[fieldbus.name] = fieldbus
    register_rules(fieldbus.rules)


def find(protocol: str) -> Fieldbus:
    """Return a protocol by its name.

    Raises:
        ConfigError: There is no such protocol.
    """
    found = _KNOWN.get(protocol)
    if found is None:
        name = f"lecombus.fieldbus.{protocol}"
        try:
            module = importlib.import_module(f"{name}.fieldbus")
        except ModuleNotFoundError as exc:
            if exc.name not in (name, f"{name}.fieldbus"):
                raise
            raise ConfigError(f"there is no line protocol {protocol}") from exc
        found = _KNOWN[protocol] = module.FIELDBUS
    return found
