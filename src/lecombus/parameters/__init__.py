"""Parameters of drives: codes and values, exact, without a word of any line protocol.

What must not live here: how a code or a value stands in a telegram (`protocol`), what it means
(`drives`).
"""

from __future__ import annotations

from lecombus.parameters.codes import (
    HIGHEST_CODE,
    HIGHEST_SUBCODE,
    AddressForm,
    Code,
    ParameterRules,
    rules_of,
)
from lecombus.parameters.values import (
    HEX_DIGITS,
    HIGHEST_DECIMAL,
    HIGHEST_VALUE_CHARS,
    LOWEST_DECIMAL,
    SENDABLE_STRING_CHARS,
    DecimalLimits,
    Format,
    Json,
    Value,
    ValueFormatError,
)

__all__ = [
    "HEX_DIGITS",
    "HIGHEST_CODE",
    "HIGHEST_DECIMAL",
    "HIGHEST_SUBCODE",
    "HIGHEST_VALUE_CHARS",
    "LOWEST_DECIMAL",
    "SENDABLE_STRING_CHARS",
    "AddressForm",
    "Code",
    "DecimalLimits",
    "Format",
    "Json",
    "ParameterRules",
    "Value",
    "ValueFormatError",
    "rules_of",
]
