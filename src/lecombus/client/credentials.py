"""What a client shows at a URL, and what it trusts: token, certificate authorities, certificate.

A token is sent to nothing but https, or http of this machine, and is read only from a file that
other users cannot read.
"""

from __future__ import annotations

import ipaddress
import ssl
import stat
from pathlib import Path

import httpx2

from lecombus.client.errors import NotPermittedError, UnreachableError

__all__ = ["headers_for", "trusted"]


def headers_for(url: str, token_file: str | Path | None) -> dict[str, str]:
    """Return the headers that carry a token; none over a Unix socket, or without a file.

    Raises:
        NotPermittedError: The token would go through a network as it is, or its file may not be
            read, or other users may read it.
        UnreachableError: The file cannot be read, or holds no token.
    """
    if not url or token_file is None:
        return {}
    if not url.startswith("https:") and not is_here(url):
        problem = f"a token is not sent to {url}, where anyone on the way could read it"
        raise NotPermittedError(problem, "write https://, or ask by a tunnel such as ssh -L")
    return {"authorization": f"Bearer {token_of(token_file)}"}


def is_here(url: str) -> bool:
    """Return whether a URL names this machine."""
    host = httpx2.URL(url).host
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def token_of(file: str | Path) -> str:
    """Return the token that a file holds.

    Raises:
        NotPermittedError: It may not be read, or other users may read it.
        UnreachableError: It cannot be read, or holds none.
    """
    path = Path(file)
    try:
        mode = path.stat().st_mode
        text = path.read_text(encoding="ascii").strip()
    except PermissionError as exc:
        raise NotPermittedError(f"{file} may not be read", "look at its owner and mode") from exc
    except (OSError, ValueError) as exc:
        raise UnreachableError(f"{file} holds no token: {exc}", "name the token's file") from exc
    if stat.S_ISREG(mode) and mode & 0o007:
        problem = f"every user of this machine may read {file}, or write it"
        raise NotPermittedError(problem, f"chmod 0600 {file}, and make a new token")
    if not text or len(text.split()) != 1:
        raise UnreachableError(f"{file} holds no token", "write the token into it, and no more")
    return text


def trusted(
    url: str, ca: str | Path | None, certificate: str | Path | None = None
) -> ssl.SSLContext:
    """Return what TLS trusts and shows; without https nothing, which is loaded in no time.

    Args:
        url: The daemon's address.
        ca: The certificates that sign the daemon's; None: the system's.
        certificate: The client's certificate and key; None: it shows none.

    Raises:
        NotPermittedError: A file may not be read.
        UnreachableError: A file holds no certificates, or no key.
    """
    if not url.startswith("https:"):
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    file, what = ca, "certificates"
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        if certificate is not None:
            file, what = certificate, "certificate with its key"
            context.load_cert_chain(certificate)
    except PermissionError as exc:
        raise NotPermittedError(f"{file} may not be read", "look at its owner and mode") from exc
    except OSError as exc:
        raise UnreachableError(f"{file} holds no {what}: {exc}", "name a PEM file") from exc
    return context
