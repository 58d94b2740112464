"""The HTTP face of one line: `create_app` makes the application, `serve` listens with it.

Read `app` first (routes), then `problems` (what failures look like) and `server` (where it
listens). `operations_protocol` is all that this room asks of the rest of the daemon.
"""

from __future__ import annotations

from lecombus.api.app import Check, create_app
from lecombus.api.operations_protocol import OperationsProtocol
from lecombus.api.server import Served, serve

__all__ = ["Check", "OperationsProtocol", "Served", "create_app", "serve"]
