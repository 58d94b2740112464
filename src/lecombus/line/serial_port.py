"""The serial end of the port seam: a device file read and written by the event loop.

This is the only module that knows pyserial-asyncio, which had its last release in 2021, so little
of it is relied on: `SerialTransport` registers the descriptor with the loop and holds what the
device would not take; reading, writing, closing and the report of a loss are made here, which
also makes reading and writing one system call each.

Strategy: a loss is reported from the loop, once, after the descriptor is closed. The device is
opened so that a read of nothing (`b""`) can only mean that it hung up. Closing drops what was not
sent: the kernel would otherwise wait up to 30 s for a stalled adapter.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios

import anyio.to_thread
import serial
from serial_asyncio import SerialTransport

from lecombus.fieldbus.port import PortSettings, Receiver

from ..errors import LineLostError
from . import devices
from .serial_device import open_device, reason

__all__ = ["PseudoPort", "RtsSerialPort", "SerialPort", "open_serial"]

_READ_SIZE = 4096
"""The size of the kernel's tty buffer: one read takes all there is."""

_STUCK_S = 2.0
"""How much longer than its wire time a telegram may take to leave, seconds."""

_CHARACTER_BITS = {"8N1": 10, "7E1": 10, "8E1": 11}
"""With start bit, parity and stop bit."""

_RTS_POLL_S = 0.0005
"""How often to look whether the last character left, once it should have, seconds."""


class SerialPort(SerialTransport):
    """An open serial device behind the port seam; made by `open_serial`.

    Args:
        loop: The loop that reads and writes.
        device: The device, open and configured; the port owns it from here on.
        receiver: Gets the bytes and the loss.
        settings: What it was opened with.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        device: serial.Serial,
        receiver: Receiver,
        settings: PortSettings,
    ) -> None:
        self._fd = device.fileno()
        self._receiver = receiver
        self._settings = settings
        self._silent = False
        self._stuck: asyncio.TimerHandle | None = None
        self._real = devices.real_path(settings.url)
        self.carries_parity = settings.framing == "8N1"
        super().__init__(loop, asyncio.BaseProtocol(), device)

    def write(self, data: bytes) -> None:  # type: ignore[override]
        """Hand all of `data` to the device.

        What the device does not take immediately follows as soon as it does; if that takes much
        longer than the wire would, the port is lost.
        """
        if self._closing:
            raise self._settings.error("the port is closed")
        if self._write_buffer:
            self._write_buffer.append(data)
            return
        try:
            taken = os.write(self._fd, data)
        except BlockingIOError:
            taken = 0
        except OSError as exc:
            raise self._lose(f"writing failed: {reason(exc)}") from exc
        if taken != len(data):
            self._write_buffer.append(data[taken:])
            self._ensure_writer()
            limit_s = _STUCK_S + self._wire_time_s(data)
            self._stuck = self._loop.call_later(limit_s, self._give_up)

    def discard_input(self) -> None:
        """Drop every byte the kernel holds that was not passed on yet."""
        if self._closing:
            return
        with contextlib.suppress(termios.error):  # hung up: the reader is about to find out
            termios.tcflush(self._fd, termios.TCIFLUSH)

    def look(self) -> None:
        """Read what the kernel holds and pass it on."""
        if not self._closing:
            self._read_ready()

    def abort(self) -> None:
        """Close immediately and drop what was not sent."""
        self._silent = True
        self._shut()

    def close(self) -> None:
        """Close like `abort`: nothing half sent is worth waiting for."""
        self.abort()

    def describe(self) -> str:
        """Say which device this is, such as `/dev/serial/by-id/x -> /dev/ttyUSB0, 9600 8N1`."""
        url = self._settings.url
        where = url if self._real == url else f"{url} -> {self._real}"
        return f"{where}, {self._settings.baud} {self._settings.framing}"

    def _read_ready(self) -> None:
        try:
            data = os.read(self._fd, _READ_SIZE)
        except BlockingIOError:
            return
        except OSError as exc:
            self._lose(f"reading failed: {reason(exc)}")
            return
        if data:
            self._receiver.received(data)
        else:
            self._lose("the device hung up; it was probably unplugged")

    def _write_ready(self) -> None:
        data = b"".join(self._write_buffer)
        try:
            taken = os.write(self._fd, data)
        except BlockingIOError:
            return
        except OSError as exc:
            self._lose(f"writing failed: {reason(exc)}")
            return
        self._write_buffer[:] = [data[taken:]] if taken < len(data) else []
        if not self._write_buffer:
            self._remove_writer()
            self._forget_stuck()

    def _give_up(self) -> None:
        self._lose("the device takes no more bytes; replug the adapter if this repeats")

    def _lose(self, why: str) -> LineLostError:
        """Close, and report the loss from the loop; only the first call has an effect."""
        error = self._settings.error(why)
        if not self._closing:
            self._loop.call_soon(self._report_loss, error)
            self._shut()
        return error

    def _report_loss(self, error: LineLostError) -> None:
        if not self._silent:
            self._silent = True
            self._receiver.lost(error)

    def _shut(self) -> None:
        if self._closing:
            return
        self._closing = True
        self._remove_reader()
        self._remove_writer()
        self._forget_stuck()
        self._write_buffer.clear()
        with contextlib.suppress(termios.error):  # the device may be gone already
            termios.tcflush(self._fd, termios.TCOFLUSH)
        self._serial.close()

    def _forget_stuck(self) -> None:
        if self._stuck is not None:
            self._stuck.cancel()
            self._stuck = None

    def _wire_time_s(self, data: bytes) -> float:
        return len(data) * _CHARACTER_BITS[self._settings.framing] / self._settings.baud


class PseudoPort(SerialPort):
    """A pseudo terminal: what is written reaches the other end only when this core lets go.

    The kernel hands the bytes over in a separate work item, queued on the core that wrote them.
    A real device has its bytes when `write` returns. See docs/adr/0017-letting-go-of-a-pty.md.
    """

    def write(self, data: bytes) -> None:  # type: ignore[override]
        """Hand over `data` and let the kernel pass it on immediately."""
        super().write(data)
        os.sched_yield()


class RtsSerialPort(SerialPort):
    """A serial device whose RTS line switches an RS-485 transceiver: on while sending.

    The loop goes on while a telegram leaves; RTS falls when the kernel's buffer is empty, not
    before the wire time is over, and after the adapter's own buffer has drained.
    """

    _falls: asyncio.TimerHandle | None = None

    def write(self, data: bytes) -> None:  # type: ignore[override]
        """Switch to sending, hand over `data`, and switch back when it left."""
        self._forget_fall()
        self._raise_rts()
        super().write(data)
        due_s = self._loop.time() + self._wire_time_s(data)
        self._falls = self._loop.call_at(due_s, self._fall, due_s + _STUCK_S)

    def _fall(self, give_up_at_s: float) -> None:
        try:
            if self._serial.out_waiting or self._write_buffer:
                self._look_again(give_up_at_s)
                return
            termios.tcdrain(self._fd)  # the adapter's own buffer: short, its wire time is over
            self._serial.rts = False
        except (OSError, termios.error) as exc:
            self._lose(f"switching RTS failed: {reason(exc)}")

    def _look_again(self, give_up_at_s: float) -> None:
        if self._loop.time() > give_up_at_s:
            self._give_up()
        else:
            self._falls = self._loop.call_later(_RTS_POLL_S, self._fall, give_up_at_s)

    def _raise_rts(self) -> None:
        if self._closing:
            return
        try:
            self._serial.rts = True
        except OSError as exc:
            raise self._lose(f"switching RTS failed: {reason(exc)}") from exc

    def _shut(self) -> None:
        self._forget_fall()
        super()._shut()

    def _forget_fall(self) -> None:
        if self._falls is not None:
            self._falls.cancel()
            self._falls = None


async def open_serial(settings: PortSettings, receiver: Receiver) -> SerialPort:
    """Open a serial device.

    The device is opened in a thread, since some drivers take a second over it.

    Args:
        settings: With the device's path as `url`.
        receiver: Gets the bytes and the loss.

    Raises:
        LineLostError: It cannot be opened; the message says why and what to do.
    """
    device = await anyio.to_thread.run_sync(open_device, settings)
    return port_class(settings)(asyncio.get_running_loop(), device, receiver, settings)


def port_class(settings: PortSettings) -> type[SerialPort]:
    """Choose the class of port for a device."""
    if settings.direction == "rts":
        return RtsSerialPort
    return PseudoPort if devices.is_pseudo(settings.url) else SerialPort
