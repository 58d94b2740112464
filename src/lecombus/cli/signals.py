"""Signals that end the work of a command as Ctrl-C does, so that its report still comes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from lecombus.cli.screen import forget_terminal

__all__ = ["Handler", "at_signals", "ended_as_by_ctrl_c", "ending_signals"]

_LIKE_CTRL_C: Final = (signal.SIGTERM, signal.SIGHUP)
"""What ends the work as Ctrl-C does; the second comes when the terminal is gone."""

Handler = Callable[[int, FrameType | None], None]


def ending_signals() -> list[signal.Signals]:
    """Return the signals that end the work, without those that are ignored, as under `nohup`."""
    return [one for one in _LIKE_CTRL_C if signal.getsignal(one) is not signal.SIG_IGN]


@contextmanager
def at_signals(handler: Handler) -> Iterator[None]:
    """Handle what ends a program, but for Ctrl-C, while the block runs."""
    before = {number: signal.signal(number, handler) for number in ending_signals()}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block as Ctrl-C does: by `KeyboardInterrupt`."""
    with at_signals(_interrupt):
        yield


def _interrupt(number: int, frame: FrameType | None) -> None:
    forget_terminal()
    ctrl_c = signal.getsignal(signal.SIGINT)
    if callable(ctrl_c):  # asyncio's own while a loop runs: it cancels the main task
        ctrl_c(signal.SIGINT, frame)
    else:  # Ctrl-C is ignored, as in the background of a shell
        raise KeyboardInterrupt
