"""A plain stop, answered before routing and validation.

FastAPI takes about a millisecond from a request's bytes to the operation: routes are tried one by
one, dependencies solved, a model validated. A stop must not wait for that. So `PlainStops` stands
outermost and takes the stops that are as plain as can be: `POST /v1/stop` without a query and
without an `Idempotency-Key`, with a body of exactly `action` and `target` that says both rightly.

Slashes too many before or behind the path of any stop are dropped here, for the router knows none.
Whatever is the least bit different, mistakes included, is handed on with the body as it came, so
that there is one place that judges bodies; what is answered here is made by the same functions, and
the tests hold both ways to the same answers.

What must not live here: what a stop is (operations), how a body is judged (`bodies`).
"""

from __future__ import annotations

from typing import Final

from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from lecombus.api.answers import group_response
from lecombus.api.bodies import TARGET_LIMIT
from lecombus.api.exact import NotJsonError, decode
from lecombus.api.problems import problem_of
from lecombus.api.seam import OperationsPort
from lecombus.drives import StopAction
from lecombus.errors import LecombusError

__all__ = ["PlainStops", "is_stop", "is_stop_verb"]

STOP_PATH: Final = "/v1/stop"

VERB_ENDS: Final = ("/verbs/inhibit", "/verbs/quick-stop")
"""How the path of a stop ends that is a verb."""

STOP_ENDS: Final = (STOP_PATH, *VERB_ENDS)
"""How the path of a stop ends."""

PIECES_LIMIT: Final = 4
"""A plain stop comes in one piece or two; who sends it in more may wait a millisecond longer."""

PLAIN_BYTES: Final = 1024
"""Both keys with the longest target; a longer body is read once, by the long way."""

KEYS: Final = frozenset(("action", "target"))
ACTIONS: Final = {action.value: action for action in StopAction}


class PlainStops:
    """Answers plain stops, and hands everything else on.

    Args:
        app: The application behind.
        ops: What stops.
    """

    def __init__(self, app: ASGIApp, ops: OperationsPort) -> None:
        self._app = app
        self._ops = ops

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Stop, or hand the request on."""
        if scope["type"] == "http" and is_stop(scope["path"]):
            scope = {**scope, "path": f"/{scope['path'].strip('/')}"}
        if scope["type"] != "http" or scope["path"] != STOP_PATH or not is_plain(scope):
            await self._app(scope, receive, send)
            return
        messages = await whole_body(receive)
        wanted = plain_stop(messages)
        if wanted is None:
            await self._app(scope, replayed(messages, receive), send)
            return
        response = await self._answer(*wanted)
        await response(scope, receive, send)

    async def _answer(self, action: StopAction, target: str) -> Response:
        try:
            return group_response(await self._ops.stop(action, target))
        except LecombusError as exc:
            return problem_of(exc).shortened().response()


def is_stop(path: str) -> bool:
    """Whether what is asked for is a stop, which waits for nobody and is never refused."""
    return path.rstrip("/").endswith(STOP_ENDS)


def is_stop_verb(path: str) -> bool:
    """Whether what is asked for is a stop whose body nobody reads."""
    return path.rstrip("/").endswith(VERB_ENDS)


def is_plain(scope: Scope) -> bool:
    """Whether a request says nothing that only the application understands."""
    if scope["method"] != "POST" or scope["query_string"]:
        return False
    return all(name != b"idempotency-key" for name, _ in scope["headers"])


async def whole_body(receive: Receive) -> list[Message]:
    """Take a body, but no more of it than a plain stop can have."""
    messages: list[Message] = []
    while len(messages) < PIECES_LIMIT:
        messages.append(await receive())
        if not messages[-1].get("more_body", False):
            break
    return messages


def plain_stop(messages: list[Message]) -> tuple[StopAction, str] | None:
    """Return what a body says; None if anything about it is not plain."""
    if messages[-1]["type"] != "http.request" or messages[-1].get("more_body", False):
        return None
    body = b"".join(message.get("body", b"") for message in messages)
    try:
        given = decode(body) if len(body) <= PLAIN_BYTES else None
    except NotJsonError:
        return None
    if not isinstance(given, dict) or given.keys() != KEYS:
        return None
    action, target = given["action"], given["target"]
    if not isinstance(action, str) or not isinstance(target, str) or action not in ACTIONS:
        return None
    return (ACTIONS[action], target) if 0 < len(target) <= TARGET_LIMIT else None


def replayed(taken: list[Message], receive: Receive) -> Receive:
    """Give the messages that were taken again, then those that follow them."""
    waiting = iter(taken)

    async def again() -> Message:
        message = next(waiting, None)
        return await receive() if message is None else message

    return again
