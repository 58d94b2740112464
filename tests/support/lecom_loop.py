"""The LECOM exchange loop of a worker, whose state only tests look at."""

from __future__ import annotations

from lecombus.fieldbus.lecom.exchanges.exchange_loop import LecomExchangeLoop
from lecombus.line.worker import LineWorker

__all__ = ["lecom_loop"]


def lecom_loop(worker: LineWorker) -> LecomExchangeLoop:
    """Return it."""
    loop = worker.exchange_loop
    assert isinstance(loop, LecomExchangeLoop)
    return loop
