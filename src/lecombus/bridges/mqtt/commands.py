"""Commands that come from the broker: which are carried out, how, and what is answered.

Strategy: a command becomes one HTTP request, so that it has the rules and outcomes of HTTP. What
makes it safe over a broker is decided before that:

- A command that is retained, or that may be older than its time allows, is not carried out. The
  broker counts down the time that a command waits there. `Pulse` bounds the time on the way from
  the broker: what comes after an acknowledged message left the broker after the bridge had sent
  that message. So commands count as old that were left in the socket while the bridge did not run.
  The age is calculated when a command comes, because a later pulse proves nothing about a command
  that waits here. With QoS 2 that is before its handshake, which a later pulse may overtake.
- Each command is carried out once. A repetition (the same topic, response topic and correlation
  data) gets the answer of the first, or `unknown` if the bridge was started in between. One with
  another payload is refused, as over HTTP. The keys that the daemon keeps are not enough: it has
  those of the last 1000 requests of all clients. Without correlation data a command must be sent
  with QoS 2 or 0: with QoS 1 a sender may send it twice, and the bridge could not distinguish that
  from two commands.
- These rules do not hold for a stop. It is carried out whenever it comes, unless it is retained: a
  retained stop would come again at each connection. It waits for no other command (`StopLanes`).
- Commands for one drive are carried out in the order in which they came. Each counts as asked for
  when it came, so a command that waits here when the drive is stopped is not carried out.
- Drives that need a lease take only stops (ADR 86).
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Final
from uuid import uuid4

import anyio
import anyio.to_thread
from anyio.abc import TaskGroup

from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.command_bodies import (
    CommandRefusedError,
    body_of,
    busy,
    expired,
    expiry_of,
)
from lecombus.bridges.mqtt.retained import Message, json_bytes
from lecombus.bridges.mqtt.seen_commands import SeenCommands
from lecombus.bridges.mqtt.stop_lanes import StopLanes
from lecombus.bridges.mqtt.topics import CommandTopic, Topics
from lecombus.client import Line, NotPermittedError, ProblemError, UnreachableError, connect
from lecombus.client.connection import BY, KEY, AnswerLostError, Json
from lecombus.client.documents import Answer
from lecombus.client.requests import code_text, expires_document, path_of

__all__ = ["CommandRefusedError", "Commands", "Pulse"]

STOPS: Final = ("quick-stop", "inhibit")
VERBS: Final = (*STOPS, "enable", "set-speed", "reset-fault")

PULSE_EVERY_S: Final = 1.0

USUAL_DELAY_S: Final = 2.5
"""Up to this a delay on the way from the broker is not counted: it is only how well it is known."""

PROOFS_KEPT: Final = 120
"""Of the pulse; a message that came before them may be of any age."""

WAITING_MOST: Final = 100
"""Commands for one drive; and all answers that wait to be sent."""

ANSWER_STANDS_S: Final = 60

LOGGED_IN_MINUTE: Final = 20

logger = logging.getLogger(__name__)

Connect = Callable[[str], AbstractAsyncContextManager[Line]]


def slept_s() -> float:
    """Return how long this computer has slept, seconds; the clock of the event loop stood then."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()


class Pulse:
    """How late a message from the broker may be."""

    def __init__(self) -> None:
        self._slept_before_s = slept_s()
        self._proofs: deque[tuple[float, float]] = deque(maxlen=PROOFS_KEPT)

    def proven(self, sent_s: float, at_s: float) -> None:
        """Take that the broker has acknowledged a message of the bridge.

        Args:
            sent_s: When that was sent, by `now_s`.
            at_s: When the acknowledgement came, or later, by the time of the event loop.
        """
        self._proofs.append((at_s, sent_s))

    def lost(self) -> None:
        """The connection is lost: its acknowledgements say nothing of the next one."""
        self._proofs.clear()

    def now_s(self) -> float:
        """Return the time, which goes on while the computer sleeps, seconds."""
        return self._with_sleep_s(anyio.current_time())

    def _with_sleep_s(self, at_s: float) -> float:
        return at_s + slept_s() - self._slept_before_s

    def sent_s(self, came_s: float) -> float:
        """Return since when a message that comes now may have been under way, by `now_s`.

        A delay of up to `USUAL_DELAY_S` is not counted, nor what was proven after the message came.

        Args:
            came_s: The time of the event loop, of which anyio knows nothing outside of a task.
        """
        came_later_s = self._with_sleep_s(came_s)  # by a sleep since then, which no proof is after
        known = (sent_s for at_s, sent_s in reversed(self._proofs) if at_s <= came_s)
        proven_s = next(known, -inf)
        return came_later_s if came_later_s - proven_s <= USUAL_DELAY_S else proven_s


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """What a command asks of the daemon.

    Args:
        method: The HTTP method.
        path: The path.
        document: The body.
        key: Its `Idempotency-Key`.
        asked_s: When it counts as asked for, by `Pulse.now_s`.
        until_s: After this it is not carried out.
    """

    method: str
    path: str
    document: dict[str, Json]
    key: str
    asked_s: float
    until_s: float


class Commands:
    """Takes commands and has them carried out.

    Args:
        topics: Of the line.
        socket: Of the daemon.
        control: Whether more is carried out than stops.
        home_assistant: The first levels of its topics, where no answer may go.
        seen: Which commands came before.
        pulse: How late messages are.
        answer: Sends an answer.
        is_drive: Whether a drive has this name; otherwise it is a group's.
        connect_to: Connects to the daemon.

    Attributes:
        counts: How many commands ended, by outcome.
    """

    def __init__(
        self,
        topics: Topics,
        socket: str,
        *,
        control: bool,
        home_assistant: str | None,
        seen: SeenCommands,
        pulse: Pulse,
        answer: Callable[[Message], Awaitable[None]],
        is_drive: Callable[[str], bool],
        connect_to: Connect = connect,
    ) -> None:
        self._topics = topics
        self._socket = socket
        self._control = control
        self._home_assistant = home_assistant
        self._seen = seen
        self._pulse = pulse
        self._answer = answer
        self._is_drive = is_drive
        self._connect = connect_to
        self._inbox: deque[Incoming] = deque()
        self._came = anyio.Event()
        self._waiting: dict[str, deque[tuple[Incoming, CommandTopic]]] = {}
        self._stops = StopLanes()
        self._logged: deque[float] = deque()
        self._answering = 0
        self.counts: dict[str, int] = {}

    def take(self, incoming: Incoming) -> None:
        """Take a message, outside of any task."""
        if self._topics.command(incoming.topic) is not None:
            self._inbox.append(replace(incoming, came_s=self._pulse.sent_s(incoming.came_s)))
            self._came.set()

    async def run(self) -> None:
        """Carry out what comes, until cancelled."""
        async with anyio.create_task_group() as tasks:
            while True:
                self._came = anyio.Event()
                while self._inbox:
                    self._begin(tasks, self._inbox.popleft())
                await self._came.wait()

    def _begin(self, tasks: TaskGroup, incoming: Incoming) -> None:
        """Begin with a command, or let it wait behind others for the same drive."""
        topic = self._topics.command(incoming.topic)
        assert topic is not None
        if topic.what == "do" and topic.name in STOPS and not incoming.is_retained:
            self._begin_stop(tasks, incoming, topic)
            return
        waiting = self._waiting.get(topic.target)
        room = len(self._waiting) if waiting is None else len(waiting)
        if room >= WAITING_MOST:
            tasks.start_soon(self._end, incoming, topic, busy().document)
        elif waiting is None:
            self._waiting[topic.target] = deque([(incoming, topic)])
            tasks.start_soon(self._one_after_the_other, topic.target)
        else:
            waiting.append((incoming, topic))

    def _begin_stop(self, tasks: TaskGroup, incoming: Incoming, topic: CommandTopic) -> None:
        lane, is_there = (topic.target, topic.name), topic.target == "all"
        if not (is_there or self._is_drive(topic.target) or self._stops.has_room(lane)):
            tasks.start_soon(self._end, incoming, topic, busy().document)
        elif self._stops.take(lane, incoming):
            tasks.start_soon(self._carry_out_stops, tasks, incoming, topic)

    async def _carry_out_stops(
        self, tasks: TaskGroup, incoming: Incoming, topic: CommandTopic
    ) -> None:
        """Carry out a stop, then as one those that came meanwhile."""
        stops = [incoming]
        while stops:
            document = await self._outcome(stops[0], topic)
            for one in stops:
                tasks.start_soon(self._end, one, topic, document)
            stops = self._stops.ended((topic.target, topic.name))

    async def _one_after_the_other(self, target: str) -> None:
        waiting = self._waiting[target]
        try:
            while waiting:
                await self._carry_out(*waiting[0])
                waiting.popleft()
        finally:
            del self._waiting[target]

    async def _carry_out(self, incoming: Incoming, topic: CommandTopic) -> None:
        """Carry out a command, and answer with its outcome."""
        said = said_of(topic, incoming.payload)
        document = self._answer_before(incoming, said)
        if document is None:
            document = await self._outcome(incoming, topic)
            if incoming.correlation is not None:
                self._seen.ended(key_of(incoming), said, document)
        await self._end(incoming, topic, document)

    async def _outcome(self, incoming: Incoming, topic: CommandTopic) -> dict[str, Any]:
        """Carry out a command, and return how it ended."""
        try:
            return await self._ask(await self._request(incoming, topic))
        except CommandRefusedError as exc:
            return exc.document

    def _answer_before(self, incoming: Incoming, said: str) -> dict[str, Any] | None:
        """Return the answer of a command that came before; None: it is new, or a stop."""
        key = key_of(incoming)
        if incoming.correlation is None or key not in self._seen:
            return None
        if self._seen.said_else(key, said):
            # The first one's outcome would be taken for that of this one, which is not sent.
            return CommandRefusedError(
                "key-reused", "its correlation data was used for another command before",
                "give each command correlation data of its own",
            ).document  # fmt: skip
        known = self._seen.outcome(key)
        if known is not None:
            return {**known, "repeated": True}
        reason = (
            "this command came before, and how it ended is not known any more; nothing was sent"
        )
        return {"outcome": "unknown", "kind": "repeated", "reason": reason, "repeated": True,
                "remedy": "look at the drive; give a new command new correlation data"}  # fmt: skip

    # -- what is asked ---------------------------------------------------------------------------

    async def _request(self, incoming: Incoming, topic: CommandTopic) -> CommandRequest:
        """Return what a command asks of the daemon, and keep that it came.

        Raises:
            CommandRefusedError: It is not carried out.
        """
        if incoming.is_retained:
            raise CommandRefusedError(
                "retained", "a retained command is never carried out: it would come again",
                "send it without the retain flag, and remove the one that stands at the broker",
            )  # fmt: skip
        if topic.what == "do" and topic.name not in VERBS:
            raise CommandRefusedError(
                "no-verb", f"there is no verb {topic.name[:60]}", ", ".join(VERBS)
            )
        if topic.what == "do" and topic.name in STOPS:
            return self._stop(incoming, topic)
        if not self._control:
            raise CommandRefusedError(
                "not-permitted", "the MQTT bridge of this line carries out stops only",
                "write `control: true` under `mqtt` of the roster",
            )  # fmt: skip
        if incoming.qos == 1 and incoming.correlation is None:
            raise CommandRefusedError(
                "no-key", "with QoS 1 a command may come twice, and this one has nothing that "
                "would show it", "send it with QoS 2, or give it correlation data of its own",
            )  # fmt: skip
        document = body_of(topic, incoming.payload)
        expires_s = expiry_of(incoming, document)
        asked_s = incoming.came_s
        if (late_s := self._pulse.now_s() - asked_s) >= expires_s:
            raise expired(f"it may have been on its way, or waited here, for {late_s:.1f} s")
        path = self._path(topic)
        key = key_of(incoming)
        if incoming.correlation is not None:
            await self._note(key)
        return CommandRequest(
            "PUT" if topic.what == "set" else "POST", path,
            {**document, **expires_document(expires_s)}, key, asked_s, asked_s + expires_s,
        )  # fmt: skip

    async def _note(self, key: str) -> None:
        """Keep that a command came.

        Raises:
            CommandRefusedError: It cannot be kept.
        """
        try:
            if self._seen.is_kept:
                await anyio.to_thread.run_sync(self._seen.note, key)
            else:
                self._seen.note(key)
        except OSError as exc:
            raise CommandRefusedError(
                "not-kept", f"it cannot be kept that this command came: {exc}",
                "look at the disk, or send it with QoS 2 and without correlation data",
            ) from exc  # fmt: skip

    def _path(self, topic: CommandTopic) -> str:
        """Return the path of what a command asks for.

        Raises:
            CommandRefusedError: Nothing can have this name.
        """
        is_group = topic.what == "set" and not self._is_drive(topic.target)
        try:
            path = path_of("group" if is_group else "drive", topic.target)
        except ProblemError as exc:
            raise CommandRefusedError("no-such-drive", exc.problem, exc.remedy) from exc
        if topic.what == "set":
            return f"{path}/codes/{code_of(topic.name)}"
        return f"{path}/verbs/{topic.name}"

    def _stop(self, incoming: Incoming, topic: CommandTopic) -> CommandRequest:
        """Return a stop, whatever else the message says."""
        document: dict[str, Json] = {"action": topic.name, "target": topic.target}
        return CommandRequest("POST", "/v1/stop", document, uuid4().hex, incoming.came_s, inf)

    async def _ask(self, request: CommandRequest) -> dict[str, Any]:
        """Have it carried out.

        Raises:
            CommandRefusedError: It is not carried out.
        """
        now_s = self._pulse.now_s()
        if now_s >= request.until_s:
            raise expired("it waited for others for this drive")
        asked_ago_s = 0.0 if request.until_s == inf else max(0.001, now_s - request.asked_s)
        headers = {KEY: request.key, BY: "mqtt"}
        try:
            async with self._connect(self._socket) as line:
                answer = await line.connection.act(
                    request.method, request.path, request.document, headers, asked_ago_s=asked_ago_s
                )
        except AnswerLostError as exc:
            remedy = "it may have happened: look at the drive before you repeat it"
            return {"outcome": "unknown", "kind": "answer-lost", "reason": exc.problem,
                    "remedy": remedy}  # fmt: skip
        except (UnreachableError, NotPermittedError) as exc:
            raise CommandRefusedError("daemon-away", exc.problem, exc.remedy) from exc
        return document_of(answer)

    # -- what is answered ------------------------------------------------------------------------

    async def _end(self, incoming: Incoming, topic: CommandTopic, document: dict[str, Any]) -> None:
        outcome = str(document["outcome"])
        self.counts[outcome] = self.counts.get(outcome, 0) + 1
        if outcome not in ("done", "verified"):
            self._log(topic, document)
        if not self._topics.may_answer(incoming.response_topic, self._home_assistant):
            return
        if self._answering >= WAITING_MOST:
            return  # the broker does not take them; they would pile up without end
        said = {"target": topic.target, topic.what: topic.name, **document}
        self._answering += 1
        try:
            await self._answer(
                Message(
                    incoming.response_topic, json_bytes(said), 1, is_retained=False,
                    expiry_s=ANSWER_STANDS_S, properties=(("outcome", outcome),),
                    content_type="application/json", response=incoming.correlation,
                )
            )  # fmt: skip
        finally:
            self._answering -= 1

    def _log(self, topic: CommandTopic, document: dict[str, Any]) -> None:
        """Log a command that was not carried out; not without end."""
        now_s = anyio.current_time()
        while self._logged and self._logged[0] < now_s - 60:
            self._logged.popleft()
        if len(self._logged) >= LOGGED_IN_MINUTE:
            return
        self._logged.append(now_s)
        reason = str(document.get("reason") or document.get("detail") or "")
        logger.warning(
            "event=mqtt-command target=%s command=%s outcome=%s reason=%s",
            ascii_of(topic.target), ascii_of(f"{topic.what}/{topic.name}"), document["outcome"],
            reason[:200],
        )  # fmt: skip


def ascii_of(text: str) -> str:
    """Return a part of a topic for the log, in which a client may have written anything."""
    return json.dumps(text[:60])[1:-1]


def key_of(incoming: Incoming) -> str:
    """Return the key of a command: of its own, or the same whenever the same command comes."""
    if incoming.correlation is None:
        return uuid4().hex
    parts = (incoming.topic.encode(), incoming.response_topic.encode(), incoming.correlation)
    digest = hashlib.sha256(b"\0".join(len(part).to_bytes(4, "big") + part for part in parts))
    return f"mqtt-{digest.hexdigest()[:40]}"


def said_of(topic: CommandTopic, payload: bytes) -> str:
    """Return what a command says, the same for each way to write it; its time does not count."""
    try:
        document = body_of(topic, payload)
    except CommandRefusedError:
        return hashlib.sha256(payload).hexdigest()
    document.pop("expires", None)
    return hashlib.sha256(repr(sorted(document.items())).encode()).hexdigest()


def code_of(name: str) -> str:
    """Return a code as it stands in a path.

    Raises:
        CommandRefusedError: It is none.
    """
    try:
        return code_text(name)
    except ValueError as exc:
        raise CommandRefusedError("no-such-code", str(exc)) from exc


def document_of(answer: Answer) -> dict[str, Any]:
    """Return what the daemon answers, with an outcome in any case."""
    found = dict(answer.data) if isinstance(answer.data, dict) else {}
    if not found.get("outcome"):
        found["outcome"] = "unknown" if answer.status in (500, 502, 504) else "refused"
    if found.get("type"):
        found["kind"] = str(found["type"]).rpartition(":")[2]
        found.setdefault("reason", found.get("detail"))
    found.pop("type", None)
    return found
