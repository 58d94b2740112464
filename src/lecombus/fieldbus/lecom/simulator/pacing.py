"""The thread that carries a simulated line's bytes between a file descriptor and time.

Strategy: one thread per end waits in `select` until the next byte is due or the host has sent
something, the earlier of them. Due times are absolute, computed by the line, so lateness of one
wake-up never adds to the next; `select` takes microseconds, and the thread asks the kernel for a
timer slack of 1 us. What is due together is written together.

Threading: the thread holds `lock` while it touches the line; so must anyone else who looks at the
line or its drives while the end is open. `close` ends the thread and waits for it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import threading
import time
from abc import ABC, abstractmethod
from typing import Final, Self

from .line import SimLine

__all__ = ["PacedEnd"]

_PR_SET_TIMERSLACK: Final = 29
_CHUNK: Final = 4096
_LOOK_AGAIN_S: Final = 0.005
"""How soon to poll a descriptor again whose other side is closed."""


class PacedEnd(ABC):
    """A line behind a file descriptor, served by a thread.

    Args:
        line: The line; one end has it for itself.

    Attributes:
        lock: To be held while looking at the line from another thread.
    """

    def __init__(self, line: SimLine) -> None:
        self.line = line
        self.lock = threading.RLock()
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        self._closing = False
        self._turned = threading.Condition(self.lock)
        self._turns = 0
        self._thread = threading.Thread(target=self._serve, name="lecombus-sim", daemon=True)

    # What an end says

    @abstractmethod
    def _descriptor(self) -> int | None:
        """The descriptor to read and write now, or None; called with the lock held."""

    @abstractmethod
    def _gone(self) -> bool:
        """The descriptor has ended; whether to look at the same one again a little later."""

    def _host_baud(self) -> int | None:
        """What the host has set its end to, bit/s; None where that is not known."""
        return None

    def _listener(self) -> int | None:
        """A further descriptor that wakes the thread, such as a listening socket."""
        return None

    def _connect(self) -> None:
        """The further descriptor is readable; only an end that has one is called."""
        raise NotImplementedError

    # For everyone

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """End the thread and release everything; harmless when repeated."""
        if self._closing:
            return
        self._closing = True
        self._wake()
        self._thread.join()
        self._release()
        os.close(self._wake_read)
        os.close(self._wake_write)

    @abstractmethod
    def _release(self) -> None:
        """Close what the end has opened; the thread has ended."""

    def _start(self) -> None:
        self._thread.start()

    def _wake(self) -> None:
        os.write(self._wake_write, b"!")

    def _settle(self) -> None:
        """Wait until the thread has let go of descriptors that were closed under it.

        A descriptor closed by one thread lives on while another waits for it in `select`: the host
        would see the hang-up only later. Not to be called with the lock held.
        """
        with self._turned:
            before = self._turns
            self._wake()
            self._turned.wait_for(lambda: self._turns > before or not self._thread.is_alive(), 5.0)

    # The thread

    def _serve(self) -> None:
        _sharpen_timers()
        idle_until_s = 0.0
        while not self._closing:
            with self.lock:
                descriptor = self._descriptor()
                listener = self._listener()
                due_s = self.line.next_event_s()
            now_s = time.monotonic()
            waiting = [self._wake_read]
            if descriptor is not None and now_s >= idle_until_s:
                waiting.append(descriptor)
            elif descriptor is not None:
                due_s = idle_until_s if due_s is None else min(due_s, idle_until_s)
            if listener is not None:
                waiting.append(listener)
            ready = _wait(waiting, None if due_s is None else max(0.0, due_s - now_s))
            if self._wake_read in ready:
                _drain(self._wake_read)
            with self._turned:
                self._turns += 1
                self._turned.notify_all()
                if listener is not None and listener in ready:
                    self._connect()
                if not self._exchange(descriptor, descriptor in ready):
                    idle_until_s = time.monotonic() + _LOOK_AGAIN_S

    def _exchange(self, descriptor: int | None, readable: bool) -> bool:
        """Move bytes both ways; False when the descriptor should be left alone for a while."""
        if descriptor is None or descriptor != self._descriptor():
            self.line.poll(time.monotonic())
            return True
        alive = True
        if readable:
            data = _read(descriptor)
            if data:
                self.line.host_baud = self._host_baud() or self.line.baud
                self.line.receive(data, time.monotonic())
            elif data is not None:
                alive = not self._gone()
        out = self.line.poll(time.monotonic())
        if out and alive:
            _write(descriptor, out)
        return alive


def _wait(descriptors: list[int], timeout_s: float | None) -> list[int]:
    try:
        return select.select(descriptors, [], [], timeout_s)[0]
    except OSError:
        # A descriptor was closed by unplug() between our look and the call.
        return []


def _drain(descriptor: int) -> None:
    try:
        os.read(descriptor, _CHUNK)
    except BlockingIOError:
        return


def _read(descriptor: int) -> bytes | None:
    """Read what is there; empty when the other side is gone, None when there is nothing yet."""
    try:
        return os.read(descriptor, _CHUNK)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def _write(descriptor: int, data: bytes) -> None:
    """Write what fits; the rest is lost, as on a wire that nobody reads."""
    with contextlib.suppress(OSError):
        os.write(descriptor, data)


def _sharpen_timers() -> None:
    """Ask for wake-ups within 1 us instead of 50; only Linux knows it, and it may be refused."""
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_TIMERSLACK, 1000, 0, 0, 0)
