"""HTTP for one line: `create_app` makes the application, `serve` listens with it.

Read `app` first (routes), then `problems` (what failures look like) and `server` (where it
listens). `operations_protocol` has what this room asks of `operations`; it also reads
`Store` and `Metrics`, and uses `operations.requests` and `operations.actions`.
"""

from __future__ import annotations

from lecombus.api.app import Check, create_app
from lecombus.api.operations_protocol import OperationsProtocol
from lecombus.api.server import Served, serve

__all__ = ["Check", "OperationsProtocol", "Served", "create_app", "serve"]
