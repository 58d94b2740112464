"""The names of topics, and what a command's topic asks for. Pure."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Final, Literal

__all__ = ["CommandTopic", "Topics"]

USUAL_PREFIX: Final = "lecombus"


@dataclass(frozen=True, slots=True)
class CommandTopic:
    """What the topic of a command says.

    Args:
        target: A drive or a group.
        what: `set` (a code) or `do` (a verb).
        name: The code, such as `C0046` or `C0039/1`; or the verb.
    """

    target: str
    what: Literal["set", "do"]
    name: str


class Topics:
    """The topics of one line.

    Plain values and JSON have separate topics, so that a wildcard for one of them does not match
    the other.

    Args:
        prefix: The first levels, such as `lecombus`.
        line: The line's name.
    """

    def __init__(self, prefix: str, line: str) -> None:
        self.prefix = prefix
        self.root = f"{prefix}/{line}"
        self._line = line

    @property
    def digest(self) -> str:
        """Eight digits that distinguish this line from one with the same name and other levels."""
        return hashlib.sha256(self.root.encode()).hexdigest()[:8]

    @property
    def client(self) -> str:
        """The line's client identifier; a broker accepts each identifier only once."""
        name = f"lecombus-{self._line}"
        return name if self.prefix == USUAL_PREFIX else f"{name}-{self.digest}"

    def device(self, drive: str) -> str:
        """A drive's name where it has one level; letters, digits, `_` and `-` only."""
        name = f"lecombus_{self._line.replace('.', '-')}_{drive}"
        is_clear = self.prefix == USUAL_PREFIX and not set("._") & set(self._line)
        return name if is_clear else f"{name}_{self.digest}"

    @property
    def line_state(self) -> str:
        """Whether line, daemon and bridge are there; the broker sets it when the bridge is lost."""
        return f"{self.root}/state"

    @property
    def summary(self) -> str:
        """The line in one message, for those who follow many."""
        return f"{self.root}/summary"

    @property
    def line_event(self) -> str:
        """What happens to the line."""
        return f"{self.root}/event"

    @property
    def pulse(self) -> str:
        """What shows the bridge that messages come without delay."""
        return f"{self.root}/pulse"

    def drive_state(self, drive: str) -> str:
        """`online`, `degraded`, `offline`, `starting` or `unknown`."""
        return f"{self.root}/{drive}/state"

    def value(self, drive: str, code: str) -> str:
        """A plain value."""
        return f"{self.root}/{drive}/value/{code}"

    def json(self, drive: str) -> str:
        """All of a drive."""
        return f"{self.root}/{drive}/json"

    def event(self, drive: str) -> str:
        """What happens to a drive or a group; empty: to the line."""
        return f"{self.root}/{drive}/event" if drive else self.line_event

    def set(self, target: str, code: str) -> str:
        """Where a code is written."""
        return f"{self.root}/{target}/set/{code}"

    def do(self, target: str, verb: str) -> str:
        """Where a verb is asked for."""
        return f"{self.root}/{target}/do/{verb}"

    @property
    def command_filters(self) -> tuple[str, ...]:
        """What to subscribe to for commands."""
        return (f"{self.root}/+/set/+", f"{self.root}/+/set/+/+", f"{self.root}/+/do/+")

    def command(self, topic: str) -> CommandTopic | None:
        """Return what the topic of a command asks for; None: it is none."""
        if not topic.startswith(f"{self.root}/"):
            return None
        target, *rest = topic.removeprefix(f"{self.root}/").split("/")
        if len(rest) in (2, 3) and rest[0] == "set":
            return CommandTopic(target, "set", "/".join(rest[1:]))
        if len(rest) == 2 and rest[0] == "do":
            return CommandTopic(target, "do", rest[1])
        return None

    def may_answer(self, topic: str, home_assistant: str | None) -> bool:
        """Whether an answer may go to a response topic.

        Not into topics of lecombus or of Home Assistant's discovery: there an answer could be
        taken for a command or for a device, in the name of the bridge.
        """
        if not topic or "+" in topic or "#" in topic or topic.startswith("$"):
            return False
        reserved = [self.prefix] + ([home_assistant] if home_assistant else [])
        return not any(topic == one or topic.startswith(f"{one}/") for one in reserved)
