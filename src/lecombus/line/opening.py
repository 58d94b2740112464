"""Which port implementation opens a URL.

Strategy: a table from scheme to opener; what has no scheme is a device path. The daemon adds
`sim:` by giving its own opener. `url_mistake` says what is wrong with a URL before anything is
opened, so that a roster with a wrong one is refused instead of tried again and again.

`rfc2217://` is refused on purpose, see `RFC2217_REFUSAL`: the line's settings never change while
it runs, so a device server set to them once needs no remote control, and Telnet escaping would
sit in every telegram for nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

from lecombus.fieldbus.port import Port, PortOpener, PortSettings, Receiver

from ..errors import LineLostError
from .serial_port import open_serial
from .tcp_port import host_and_port, open_tcp

__all__ = ["RFC2217_REFUSAL", "open_port", "url_mistake"]

RFC2217_REFUSAL = (
    "rfc2217:// is not supported: use socket://HOST:PORT, and have the device server pass raw "
    "bytes at 8 data bits, no parity, 1 stop bit"
)
"""Why not, and what to use instead; `config.endpoint_types` gives the lines to write."""


async def open_port(settings: PortSettings, receiver: Receiver) -> Port:
    """Open the port that a URL names.

    Args:
        settings: Its URL and how to open it.
        receiver: Gets the bytes and the loss.

    Raises:
        LineLostError: It cannot be opened; the message says why and what to do.
    """
    mistake = url_mistake(settings.url)
    if mistake is not None:
        raise LineLostError(mistake, line=settings.line)
    return await _OPENERS.get(_scheme(settings.url), open_serial)(settings, receiver)


def url_mistake(url: str) -> str | None:
    """Say what is wrong with a port's URL and what would be right.

    Returns:
        The mistake; None if there is none that shows without opening it.
    """
    scheme = _scheme(url)
    if scheme == "rfc2217":
        return f"{url}: {RFC2217_REFUSAL}"
    if scheme == "socket":
        try:
            host_and_port(url)
        except ValueError as exc:
            return f"{url}: {exc}"
    elif scheme or not url.startswith("/"):
        right = "a device path such as /dev/serial/by-id/.., or socket://HOST:PORT"
        return f"{url!r} is not a port: use {right}"
    return None


def _scheme(url: str) -> str:
    """Return the part before the first colon in lower case; empty for a path."""
    scheme, colon, _ = url.partition(":")
    return scheme.lower() if colon and scheme.isalnum() else ""


_OPENERS: Mapping[str, PortOpener] = {"socket": open_tcp}
