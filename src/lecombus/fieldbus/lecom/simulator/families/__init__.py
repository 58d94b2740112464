"""The simulated families by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from lecombus.fieldbus.lecom.simulator.families.f82xx import (
    Drive820X,
    Drive821X,
    Drive822X,
    Drive824X,
    Vector8200,
)
from lecombus.fieldbus.lecom.simulator.families.f93xx import Drive93XX
from lecombus.fieldbus.lecom.simulator.families.generic import Generic
from lecombus.fieldbus.lecom.simulator.families.smvector import SMVector
from lecombus.fieldbus.lecom.simulator.model import Model

__all__ = ["MODELS"]

MODELS: Final[Mapping[str, Callable[[], Model]]] = {
    model.family: model
    for model in (
        *(Drive820X, Drive821X, Drive822X, Drive824X, Vector8200),
        *(Drive93XX, SMVector, Generic),
    )
}
"""Makes a drive of a family."""
