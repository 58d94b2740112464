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
from lecombus.parameters.codes import HIGHEST_CODE, HIGHEST_SUBCODE, Code
from lecombus.parameters.values import USUAL_DECIMALS, DecimalLimits

__all__ = ["AddressForm", "ParameterRules", "forms_of", "register_rules", "rules_of"]


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
