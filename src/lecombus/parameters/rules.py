"""What a line protocol can carry of codes and values; each protocol has one `ParameterRules`.

A protocol of this package is found by its name: `RULES` of `lecombus.fieldbus.NAME.parameters`.
Others call `register`.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from lecombus.errors import ConfigError
from lecombus.parameters.codes import Code

__all__ = ["AddressForm", "ParameterRules", "register_rules", "rules_of"]


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
    """

    protocol: str
    forms: Mapping[str, AddressForm]


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
            module = importlib.import_module(f"{name}.parameters")
        except ModuleNotFoundError as exc:
            if exc.name not in (name, f"{name}.parameters"):
                raise
            raise ConfigError(f"there is no line protocol {protocol}") from exc
        found = _KNOWN[protocol] = module.RULES
    return found
