"""Who is let in over TCP without tokens: reads only, and only for programs of this machine.

`ReadOnlyAccess` stands before the TCP server where the roster has no `api.tokens` (with them,
`token_access` does). It lets only reads through.

`site_problem` is asked in both cases. It refuses hosts that are not this machine, so that no web
page can reach the drives through a browser (DNS rebinding). What a browser sends for a page of
another origin is refused too, by its `Origin` and `Sec-Fetch-Site`: such a page could not read the
answer, but could send request after request. A request must have one valid host (RFC 9112, 3.2).
After a refusal the connection ends.

Over the Unix socket the host is not checked: only programs reach it, they use different names for
it, and a stop must not be refused for its host. But a browser behind a proxy can reach it, so a
page of another origin is refused there too, also its stop (`OwnPagesAccess`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from starlette.types import ASGIApp, Receive, Scope, Send

from lecombus.api.answers import ProblemDocument
from lecombus.api.decimal_json import short
from lecombus.api.read_routes import ADDRESSES_PATH
from lecombus.operations.actions import ACTOR
from lecombus.roster import is_loopback
from lecombus.tokens import grants

__all__ = ["CLOSE", "OwnPagesAccess", "ReadOnlyAccess", "site_problem"]

HOST: Final = re.compile(r"(?:\[([0-9a-f:.]+)\]|([^\[\]:]+))(?::[0-9]{0,5})?")

RIGHT_HOST: Final = "ask for localhost or 127.0.0.1"

OWN_SITES: Final = ("none", "same-origin")
"""What `Sec-Fetch-Site` says where a person typed the address, or a page of this server asks."""

BY: Final = b"lecombus-by"
"""For whom a program at the Unix socket asks, such as a bridge: for the log and the journal."""

BY_RIGHT: Final = re.compile(rb"[A-Za-z0-9][A-Za-z0-9 ._:/-]{0,59}")

CLOSE: Final = {"Connection": "close"}

CROSS_SITE: Final = ProblemDocument(
    "cross-site",
    "a web page of another origin asks",
    remedy="open the address itself, or ask from a program",
    headers=CLOSE,
)

LOCAL_READS: Final = grants.granted([grants.Scope.READ])


class ReadOnlyAccess:
    """Lets reads through that name this machine as their host.

    Args:
        app: The application behind.
        host: The host the server is bound to, allowed besides the names of loopback.
    """

    def __init__(self, app: ASGIApp, host: str) -> None:
        self._app = app
        self._host = host.strip("[]").lower()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer with what is wrong with it."""
        problem = self._objection(scope) if scope["type"] == "http" else None
        if problem is None:
            ACTOR.set(replace(ACTOR.get(), grant=LOCAL_READS))
            await self._app(scope, receive, send)
        else:
            await replace(problem, headers=CLOSE).response()(scope, receive, send)

    def _objection(self, scope: Scope) -> ProblemDocument | None:
        problem = site_problem(scope, self._is_here, RIGHT_HOST)
        if problem is not None:
            return problem
        if scope["method"] not in ("GET", "HEAD"):
            return ProblemDocument(
                "read-only",
                f"{short(scope['method'])} is not answered over TCP",
                remedy="use the Unix socket: only who may open it may write and stop",
            )
        if scope["path"].startswith(ADDRESSES_PATH):
            return ProblemDocument(
                "not-permitted",
                "addresses of unknown drives are not asked over TCP",
                remedy="use the Unix socket",
            )
        return None

    def _is_here(self, name: str, scope: Scope) -> bool:
        return name == self._host or is_loopback(name)


def site_problem(
    scope: Scope, is_ours: Callable[[str, Scope], bool], right: str
) -> ProblemDocument | None:
    """Return why the host or the origin of a request is refused; None: they are right.

    Args:
        scope: The request.
        is_ours: Whether requests may name a host.
        right: What to name instead.
    """
    hosts = [value.decode("latin-1") for name, value in scope["headers"] if name == b"host"]
    name = host_name(hosts[0].strip().lower()) if len(hosts) == 1 else ""
    if not name:
        what = f"the request names {short(', '.join(hosts)) or 'no host'}, where one host belongs"
        return ProblemDocument("bad-host", what, remedy=right)
    if not is_ours(name, scope):
        what = f"host {short(hosts[0])} is not this machine"
        return ProblemDocument("foreign-host", what, remedy=right)
    if is_cross_site(scope, scope["scheme"]):
        return CROSS_SITE
    return None


class OwnPagesAccess:
    """Refuses what a browser asks for a page of another origin; notes for whom a program asks.

    Args:
        app: The application behind.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] == "http" and is_cross_site(scope, "http", "https"):
            await CROSS_SITE.response()(scope, receive, send)
            return
        if scope["type"] == "http":
            by = [value for name, value in scope["headers"] if name == BY]
            if len(by) == 1 and BY_RIGHT.fullmatch(by[0]):
                ACTOR.set(replace(ACTOR.get(), client=by[0].decode()))
        await self._app(scope, receive, send)


def is_cross_site(scope: Scope, *schemes: str) -> bool:
    """Return whether a browser asks for a page that is not of this server.

    Args:
        scope: The request.
        schemes: How a page of this server may have come to the browser.
    """
    headers = [(name, value.decode("latin-1").strip().lower()) for name, value in scope["headers"]]
    own = {f"{scheme}://{value}" for name, value in headers if name == b"host"
           for scheme in schemes}  # fmt: skip
    return any(
        (name == b"origin" and value not in own)
        or (name == b"sec-fetch-site" and value not in OWN_SITES)
        for name, value in headers
    )


def host_name(host: str) -> str:
    """Return the host of a `Host` header without its port; empty if it is not one host."""
    match = HOST.fullmatch(host)
    return "" if match is None else match[1] or match[2]
