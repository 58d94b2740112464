"""The routes for supervisors and programs: `/metrics`, `/healthz`, `/readyz`, `/openapi.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from lecombus.api.answers import JSON_TYPE, status_response
from lecombus.metrics import OPENMETRICS_TYPE, TEXT_TYPE, Metrics, wants_openmetrics

__all__ = ["Check", "ServiceRoutes"]

Check = Callable[[], tuple[bool, str]]
"""Says whether something is so, and what is or is missing."""


class ServiceRoutes:
    """The routes of the daemon itself.

    Args:
        metrics: The metrics page.
        ready: Whether the line is open and every drive was tried once.
        healthy: Whether the line task makes progress.
        version: lecombus' version.
    """

    def __init__(self, metrics: Metrics, ready: Check, healthy: Check, version: str) -> None:
        self._metrics = metrics
        self._ready = ready
        self._healthy = healthy
        # Read before the line runs: it takes some milliseconds, in which no telegram is sent.
        self._openapi = openapi_text(version)

    def routes(self) -> list[Route]:
        """Return the routes."""
        return [
            Route("/metrics", self.page),
            Route("/healthz", self.healthz),
            Route("/readyz", self.readyz),
            Route("/openapi.json", self.openapi),
        ]

    async def page(self, request: Request) -> Response:
        """The metrics page, in the format that the scraper asks for."""
        openmetrics = wants_openmetrics(", ".join(request.headers.getlist("accept")))
        text = await self._metrics.fresh_page(openmetrics=openmetrics)
        return Response(text, media_type=OPENMETRICS_TYPE if openmetrics else TEXT_TYPE)

    async def healthz(self, request: Request) -> Response:
        """Whether the daemon works: 503 when the line task makes no progress."""
        return status_response("unhealthy", self._healthy())

    async def readyz(self, request: Request) -> Response:
        """Whether the line is open and every drive was tried once."""
        return status_response("not-ready", self._ready())

    async def openapi(self, request: Request) -> Response:
        """The description of this interface."""
        return Response(self._openapi, media_type=JSON_TYPE)


def openapi_text(version: str) -> bytes:
    """Return the OpenAPI document: the carried file (`make openapi`) with the version put in."""
    document = json.loads(Path(__file__).with_name("openapi.json").read_bytes())
    document["info"]["version"] = version
    return json.dumps(document).encode()
