"""HTTP for one line: `create_app` makes the application, `serve` listens with it.

Read `app` first (routes), then `answers` (answers and problem documents) and `server` (where it
listens). It calls `Operations`, and reads `Store` and `Metrics`.
"""

from __future__ import annotations

from lecombus.api.app import create_app
from lecombus.api.event_readers import EventReaders
from lecombus.api.server import Doors, Served, serve
from lecombus.api.service_routes import Check
from lecombus.api.tls import TlsContexts, TlsFileError
from lecombus.api.token_watch import TokenWatch

__all__ = [
    "Check",
    "Doors",
    "EventReaders",
    "Served",
    "TlsContexts",
    "TlsFileError",
    "TokenWatch",
    "create_app",
    "serve",
]
