"""Opening a serial device: raw, exclusive, with low latency, and with errors that say what to do.

Here live the settings of the device and everything pyserial is used for.

Strategy:

* The device runs 8N1 and bit 7 carries even parity, made and checked elsewhere. With
  7E1 or 8E1 a character with wrong parity arrives as NUL. A pseudo terminal frames nothing and is
  always set to 8N1.
* Raw: no flow control, no translation, no stripping, because a BCC may be any control character.
* The settings are applied exactly once (see `Device`). VMIN is 1, so that a read of nothing can
  only mean that the device hung up.
* Exclusive: `flock` keeps out programs that lock too, TIOCEXCL those that do not, and who has it
  open already is found and named.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import stat
import termios
from pathlib import Path

import serial
from serial.rs485 import RS485Settings

from lecombus.fieldbus.port import Framing, PortSettings

from . import devices

__all__ = ["Device", "open_device", "reason"]

_log = logging.getLogger(__name__)

_RTS_WARNING = (
    "line=%s event=rts-switched port=%s reason=direction: rts switches the transceiver from a "
    "program; a drive may answer after 1 ms already, which no program can promise to meet: an "
    "adapter that switches by itself (direction: adapter) or the kernel's driver (direction: "
    "kernel) is safe"
)


class Device(serial.Serial):
    """An open serial device, configured exactly once.

    pyserial configures the port again whenever a time-out is assigned, as `SerialTransport` does.
    That is traffic on a USB adapter for nothing, and fails with EINVAL on a device that ignores a
    setting; so only the configuration at opening is let through, and completed.
    """

    def _reconfigure_port(self, force_update: bool = False) -> None:
        if force_update:
            super()._reconfigure_port(force_update=True)  # type: ignore[misc]
            self._complete()

    def _complete(self) -> None:
        """Set what pyserial leaves as it was, and see that the framing was taken.

        Raises:
            termios.error: The device does not frame parity, which some drivers do not say.
        """
        assert self.fd is not None
        iflag, oflag, cflag, lflag, ispeed, ospeed, cc = termios.tcgetattr(self.fd)
        even = self.parity == serial.PARITY_EVEN
        size = termios.CS7 if self.bytesize == serial.SEVENBITS else termios.CS8
        if even and (cflag & termios.CSIZE != size or not cflag & termios.PARENB):
            raise termios.error(errno.EINVAL, "even parity was not taken")
        iflag &= ~(termios.BRKINT | termios.IGNPAR)
        if even:
            iflag |= termios.INPCK
        cflag &= ~termios.HUPCL  # closing must not switch off an adapter fed from DTR or RTS
        cc[termios.VMIN] = 1
        attributes = [iflag, oflag, cflag, lflag, ispeed, ospeed, cc]
        termios.tcsetattr(self.fd, termios.TCSANOW, attributes)


def open_device(settings: PortSettings) -> Device:
    """Open and configure a serial device; blocks for as long as the driver takes over it.

    Args:
        settings: With the device's path as `url`.

    Raises:
        LineLostError: It cannot be opened or used as asked; the message says what to do.
    """
    pseudo = devices.is_pseudo(settings.url)
    device = _configured(settings, "8N1" if pseudo else settings.framing)
    try:
        device.open()
        if settings.direction == "rts":
            device.rts = False  # opening ignores a device without RTS, this does not
    except (OSError, ValueError, termios.error) as exc:
        device.close()
        raise settings.error(_why_not_open(settings, exc)) from exc
    if not pseudo:
        _claim(device, settings)
    _remark(device, settings)
    return device


def _configured(settings: PortSettings, framing: Framing) -> Device:
    device = Device(
        baudrate=settings.baud,
        bytesize=serial.SEVENBITS if framing == "7E1" else serial.EIGHTBITS,
        parity=serial.PARITY_NONE if framing == "8N1" else serial.PARITY_EVEN,
        timeout=0,
        write_timeout=0,
        exclusive=True,
    )
    if settings.direction != "adapter":
        device.rts = False  # receiving; only an adapter may take its supply from RTS
    if settings.direction == "kernel":
        device.rs485_mode = RS485Settings()
    device.port = settings.url
    return device


def _claim(device: Device, settings: PortSettings) -> None:
    """Shut out others, and refuse a device that a program which locks nothing has open.

    A pseudo terminal is left out: a simulator holds the other end of its own device open, and
    would keep the device locked after a crash of the daemon.
    """
    others = devices.holders(settings.url)
    others.pop(os.getpid(), None)
    if others:
        device.close()
        raise settings.error(_in_use(others))
    with contextlib.suppress(OSError):
        fcntl.ioctl(device.fileno(), termios.TIOCEXCL)


def _remark(device: Device, settings: PortSettings) -> None:
    """Log what is worth knowing about the device; once for every time it is opened."""
    line, path = settings.line, settings.url
    try:
        device.set_low_latency_mode(True)
    except (OSError, ValueError) as exc:
        _log.info("line=%s event=no-low-latency port=%s reason=%s", line, path, exc)
    if settings.direction == "rts":
        _log.warning(_RTS_WARNING, line, path)
    stable = devices.stable_name(path)
    if stable is not None and devices.real_path(path) == path:
        text = "it may be another adapter after replugging: use %s"
        _log.warning("line=%s event=unstable-name port=%s reason=" + text, line, path, stable)


def _why_not_open(settings: PortSettings, exc: Exception) -> str:
    """Return why a device cannot be opened and what to do about it."""
    path, code = settings.url, _number(exc)
    if code == errno.ENOENT:
        now = ", ".join(devices.connected()) or "none"
        return f"no such device; is the adapter plugged in? connected now: {now}"
    if code in (errno.EACCES, errno.EPERM):
        return f"permission denied; {_who_may(path)}"
    if code in (errno.EBUSY, errno.EAGAIN):
        return _in_use(devices.holders(path))
    if settings.framing != "8N1" and code == errno.EINVAL and isinstance(exc, termios.error):
        remedy = "; parity `line` needs no such device" if settings.framing == "7E1" else ""
        return f"the device does not frame {settings.framing}{remedy}"
    if settings.direction == "rts" and code in (errno.ENOTTY, errno.EINVAL):
        return "the device has no RTS line; direction `adapter` needs none"
    if "RS485" in str(exc):
        return (
            "the driver cannot switch an RS-485 transceiver (direction `kernel`); use an "
            "adapter that switches by itself and direction `adapter`, or direction `rts`"
        )
    return f"cannot be used as a serial port: {reason(exc)}"


def _in_use(holders: dict[int, str]) -> str:
    who = ", ".join(holders.values()) or "another user's process"
    return f"in use by {who}; stop that first, or let it use another port"


def _who_may(path: str) -> str:
    """Say who may open a device that this user may not."""
    group, mode = "dialout", stat.S_IRGRP | stat.S_IWGRP
    with contextlib.suppress(OSError, KeyError):
        mode = Path(path).stat().st_mode
        group = Path(path).group()
    if mode & stat.S_IRGRP and mode & stat.S_IWGRP:
        return f"the user needs to be in group {group} (usermod -aG)"
    return "only its owner may open it: give its group the right to (chmod g+rw), or ask as root"


def reason(exc: Exception) -> str:
    """Return an error's text without its number, for any library that raised it."""
    number = _number(exc)
    return str(exc) if number is None else os.strerror(number)


def _number(exc: Exception) -> int | None:
    """Return an error's errno: `termios.error` is no OSError and has it among its arguments."""
    number = exc.args[0] if exc.args else None
    return number if isinstance(number, int) else None
