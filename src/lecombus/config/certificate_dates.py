"""Until when the certificates of `api.tls` are valid, read from their files.

The ssl module gives dates only of certificates that it has verified. So the date is taken from the
certificate itself (RFC 5280, 4.1), whose first fields are always the same.
"""

from __future__ import annotations

import re
import ssl
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from lecombus.roster import TlsEntry

__all__ = ["EXPIRY_WARNING_S", "expiries_of", "expiry_text"]

EXPIRY_WARNING_S: Final = 30 * 86400.0
"""How long before the end it is said."""

PEM: Final = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)

VERSION: Final = 0xA0
UTC_TIME: Final = 0x17
"""A time whose year has two digits: 50 to 99 are 1950 to 1999."""


def expiries_of(entry: TlsEntry) -> Mapping[str, float]:
    """Return until when the certificates are valid, by the roster's key, in Unix seconds.

    Of a file with several certificates the first that expires counts.

    Raises:
        OSError: A file cannot be read.
        ValueError: It holds no certificate, or one that cannot be read.
    """
    files = {"certificate": entry.certificate, "client_ca": entry.client_ca}
    return {key: expiry_of(Path(file)) for key, file in files.items() if file is not None}


def expiry_text(expires_s: float, now_s: float) -> str:
    """Say that a certificate has expired or soon will; empty: there is time.

    Args:
        expires_s: Until when it is valid, Unix seconds.
        now_s: The time of day, Unix seconds.
    """
    left_s = expires_s - now_s
    if left_s > EXPIRY_WARNING_S:
        return ""
    day = datetime.fromtimestamp(expires_s, UTC).date().isoformat()
    if left_s <= 0:
        return f"it expired on {day}"
    days = int(left_s // 86400)
    return f"it expires on {day}, in {days} {'day' if days == 1 else 'days'}"


def expiry_of(path: Path) -> float:
    """Return when the first certificate of a file expires, Unix seconds."""
    found = PEM.findall(path.read_text(encoding="latin-1"))
    if not found:
        raise ValueError(f"{path} holds no certificate")
    return min(not_after(ssl.PEM_cert_to_DER_cert(text)) for text in found)


def not_after(certificate: bytes) -> float:
    """Return until when a certificate is valid, Unix seconds.

    Raises:
        ValueError: It is not a certificate.
    """
    try:
        at = content(certificate, content(certificate, 0)[1])[1]
        if certificate[at] == VERSION:
            at = content(certificate, at)[2]
        for _ in ("serial number", "signature algorithm", "issuer"):
            at = content(certificate, at)[2]
        _, begin, _ = content(certificate, at)
        kind, first, last = content(certificate, content(certificate, begin)[2])
    except IndexError:
        raise ValueError("a certificate is incomplete") from None
    text = certificate[first:last].decode("ascii")
    if kind == UTC_TIME:
        text = ("19" if text >= "5" else "20") + text
    return datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC).timestamp()


def content(data: bytes, at: int) -> tuple[int, int, int]:
    """Return the kind of an element (DER), where its content begins, and where it ends."""
    kind, length, at = data[at], data[at + 1], at + 2
    if length & 0x80:
        count = length & 0x7F
        length, at = int.from_bytes(data[at : at + count], "big"), at + count
    return kind, at, at + length
