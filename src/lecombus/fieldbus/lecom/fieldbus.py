"""LECOM-A/B as a line protocol among others."""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.costs import ExchangeCosts
from lecombus.fieldbus.lecom.parameters import RULES
from lecombus.fieldbus.lecom.protocol.timing import BAUDS, BITS_PER_CHAR
from lecombus.fieldbus.lecom.roster_costs import RosterCosts
from lecombus.fieldbus.protocols import Fieldbus
from lecombus.parameters import ParameterRules

__all__ = ["FIELDBUS", "Lecom"]


class Lecom:
    """See `Fieldbus`."""

    name = RULES.protocol
    rules: ParameterRules = RULES
    bauds: tuple[int, ...] = BAUDS
    bits_per_char = BITS_PER_CHAR
    costs: ExchangeCosts = RosterCosts()


FIELDBUS: Final[Fieldbus] = Lecom()
