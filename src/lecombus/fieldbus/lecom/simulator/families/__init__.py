"""The simulated families by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ..model import Model
from .f82xx import Drive820X, Drive821X, Drive822X, Drive824X, Vector8200
from .f93xx import Drive93XX
from .generic import Generic
from .smvector import SMVector

__all__ = ["MODELS"]

MODELS: Final[Mapping[str, Callable[[], Model]]] = {
    model.family: model
    for model in (
        *(Drive820X, Drive821X, Drive822X, Drive824X, Vector8200),
        *(Drive93XX, SMVector, Generic),
    )
}
"""Makes a drive of a family."""
