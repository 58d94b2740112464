"""What LECOM can carry of codes and values."""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters.codes import ParameterRules

__all__ = ["RULES"]

RULES: Final = ParameterRules("lecom", {form.value: form for form in Form})
