"""Who is let in over TCP by tokens, before anything of a request is routed.

Each request carries its token (`Authorization: Bearer lcb_..`). Without a valid one the answer is
401 and the connection ends. Clients that send wrong ones again and again are answered 429 then;
this counts by address and never refuses a valid token, so no client can lock out another. What a
token allows is asked behind the router (`scopes`).

A request whose body is still coming when its token is revoked or expires is not carried out, and
an answer that is being sent ends there.
"""

from __future__ import annotations

import ipaddress
import logging
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lecombus.api.access import CLOSE, site_problem
from lecombus.api.answers import ProblemDocument, RefusedRequestError
from lecombus.api.limits import SparseLog
from lecombus.api.token_watch import TokenWatch
from lecombus.operations.actions import ACTOR
from lecombus.roster import is_loopback
from lecombus.tokens import grants
from lecombus.tokens.token_file import TokenEntry

__all__ = ["FailureCount", "TokenAccess"]

logger = logging.getLogger(__name__)

CHALLENGE: Final = {"WWW-Authenticate": 'Bearer realm="lecombus"', **CLOSE}
WRONG: Final = {
    "WWW-Authenticate": 'Bearer realm="lecombus", error="invalid_token"', **CLOSE
}  # fmt: skip

NO_TOKEN: Final = ProblemDocument(
    "no-token",
    "a bearer token is needed here",
    remedy="send `Authorization: Bearer lcb_..`; the commands take it by --token-file",
    headers=CHALLENGE,
)
BAD_TOKEN: Final = ProblemDocument(
    "bad-token",
    "the token is not valid: mistyped, revoked or expired",
    remedy="`lecombus token list` shows what is valid; `lecombus token new` makes one",
    headers=WRONG,
)
TWO_TOKENS: Final = ProblemDocument(
    "doubled-header",
    "header Authorization stands more than once: it is not clear which token to use",
    remedy="send the header once",
    headers=CLOSE,
)

FAILURES: Final = 10
"""Wrong tokens in a row that one address is answered 401 for."""

FAILURE_GAP_S: Final = 6.0
"""After this time one more is."""

ADDRESSES_LIMIT: Final = 1024


class FailureCount:
    """Counts wrong tokens by the address that they came from.

    Args:
        clock: A monotonic clock, seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._free_at_s: dict[str, float] = {}  # when an address has no failures left over
        self._log = SparseLog(logger, "token-refused", clock)

    def note(self, client: str) -> float:
        """Count one; return for how long this address has been answered enough, seconds.

        Args:
            client: The client's address.
        """
        now_s, key = self._clock(), network_of(client)
        free_at_s = max(self._free_at_s.pop(key, now_s), now_s) + FAILURE_GAP_S
        left_s = free_at_s - now_s - FAILURES * FAILURE_GAP_S
        self._free_at_s[key] = free_at_s - max(left_s, 0.0)
        if len(self._free_at_s) > ADDRESSES_LIMIT:
            del self._free_at_s[next(iter(self._free_at_s))]
        self._log.log(client=client)
        return max(left_s, 0.0)


def network_of(client: str) -> str:
    """Return what is counted as one client: an IPv4 address, or the /64 of an IPv6 address."""
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return client
    if isinstance(address, ipaddress.IPv6Address):
        mapped = address.ipv4_mapped
        if mapped is not None:
            return str(mapped)
        return str(ipaddress.IPv6Network((address, 64), strict=False))
    return str(address)


@dataclass(frozen=True, slots=True)
class AllowedHosts:
    """The hosts that requests may name.

    Args:
        bound: The host that the server is bound to.
        names: Further names (`api.hosts`).
    """

    bound: str
    names: Collection[str] = ()

    def takes(self, name: str, scope: Scope) -> bool:
        """Return whether a request may name this host: by the address it was sent to, always."""
        server = scope.get("server") or ("",)
        own = str(server[0]).removeprefix("::ffff:")
        return is_loopback(name) or name in self.names or name in (self.bound, own)

    @property
    def remedy(self) -> str:
        """What a request should name instead."""
        names = ", ".join(sorted(self.names)) or "the address itself"
        return f"ask for {names}; `api.hosts` in the roster lists the names"


class TokenEndedError(Exception):
    """Ends an answer whose token is not valid any more."""


class TokenAccess:
    """Lets requests through that carry a valid token.

    Args:
        readers: The application for tokens that only read.
        writers: The application for tokens that write or control.
        tokens: The valid tokens.
        hosts: What requests may name as their host.
        failures: Counts wrong tokens.
    """

    def __init__(
        self,
        readers: ASGIApp,
        writers: ASGIApp,
        tokens: TokenWatch,
        hosts: AllowedHosts,
        failures: FailureCount,
    ) -> None:
        self._readers = readers
        self._writers = writers
        self._tokens = tokens
        self._hosts = hosts
        self._failures = failures

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer with what is wrong with it."""
        found = self._judge(scope)
        if isinstance(found, ProblemDocument):
            await found.response()(scope, receive, send)
            return
        grant = found.grant
        ACTOR.set(replace(ACTOR.get(), token=found.name, grant=grant))
        writes = grant.scopes & {grants.Scope.WRITE, grants.Scope.CONTROL}
        await self._answer(self._writers if writes else self._readers, found, scope, receive, send)

    def token_of(self, scope: Scope) -> TokenEntry | None:
        """Return the valid token of a request; counts no failure."""
        sent = secrets_of(scope)
        return self._tokens.find(sent[0]) if len(sent) == 1 else None

    def _judge(self, scope: Scope) -> TokenEntry | ProblemDocument:
        problem = site_problem(scope, self._hosts.takes, self._hosts.remedy)
        if problem is not None:
            return replace(problem, headers=CLOSE)
        sent = secrets_of(scope)
        if len(sent) > 1:
            return TWO_TOKENS
        found = self._tokens.find(sent[0]) if sent else None
        if found is not None:
            return found
        wait_s = self._failures.note(str((scope.get("client") or ("?",))[0]))
        if wait_s > 0.0:
            return ProblemDocument(
                "too-many-failures",
                "too many requests without a valid token came from this address",
                remedy="a request with a valid token is still answered",
                headers={"Retry-After": str(math.ceil(wait_s)), **CLOSE},
            )
        return BAD_TOKEN if sent else NO_TOKEN

    async def _answer(
        self, app: ASGIApp, entry: TokenEntry, scope: Scope, receive: Receive, send: Send
    ) -> None:
        async def receive_while_valid() -> Message:
            message = await receive()
            if message["type"] == "http.request" and not self._tokens.holds(entry):
                raise RefusedRequestError(BAD_TOKEN)
            return message

        async def send_while_valid(message: Message) -> None:
            if message.get("more_body") and not self._tokens.holds(entry):
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                raise TokenEndedError
            await send(message)

        try:
            await app(scope, receive_while_valid, send_while_valid)
        except TokenEndedError:
            return
        except BaseExceptionGroup as group:  # raised again if it holds anything else
            if group.split(TokenEndedError)[1] is not None:
                raise


def secrets_of(scope: Scope) -> list[str]:
    """Return what the `Authorization` headers of a request carry as tokens."""
    found = []
    for name, value in scope["headers"]:
        if name == b"authorization":
            scheme, _, secret = value.decode("latin-1").strip().partition(" ")
            found.append(secret.strip() if scheme.lower() == "bearer" else "")
    return found
