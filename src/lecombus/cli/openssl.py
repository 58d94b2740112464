"""The daemon does without OpenSSL: it speaks no TLS, and the library takes 5 MB of its memory.

asyncio, anyio and uvicorn import `ssl` whether TLS is used or not. asyncio works without it, as in
a Python that was built without OpenSSL, and so does `hashlib`. The others read three names of it,
and whoever reads a fourth gets the real module.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

__all__ = ["leave_out_openssl"]


class _NoContext:
    """Stands for `ssl.SSLContext` in annotations and comparisons."""


class _Postponed(ModuleType):
    """Stands for `ssl` until more is read of it than what libraries read when they are imported."""

    def __init__(self) -> None:
        super().__init__("ssl")
        self.CERT_NONE = 0
        self.PROTOCOL_TLS_SERVER = 17
        self.SSLContext: type = _NoContext

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked by what inspects modules
            raise AttributeError(name)
        if sys.modules.get("ssl") is self:
            del sys.modules["ssl"]
        real = import_module("ssl")
        self.__dict__.update(vars(real))
        return getattr(real, name)


def leave_out_openssl() -> None:
    """Postpone loading OpenSSL until it is used; call it before anything imports asyncio."""
    if "ssl" in sys.modules or "_hashlib" in sys.modules:
        return
    sys.modules["ssl"] = sys.modules["_hashlib"] = None  # type: ignore[assignment] # "there is none"
    try:
        for name in ("asyncio", "hashlib", "hmac"):
            import_module(name)
    finally:
        del sys.modules["_hashlib"]
        sys.modules["ssl"] = _Postponed()
