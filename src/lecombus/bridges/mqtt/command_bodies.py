"""What a command says: its payload as the body of an HTTP request, and its time. Pure."""

from __future__ import annotations

import json
from decimal import Decimal, InvalidOperation
from typing import Any, Final

from lecombus.bridges.mqtt.broker import Incoming
from lecombus.bridges.mqtt.topics import CommandTopic
from lecombus.client.connection import Json
from lecombus.durations import LEAST_EXPIRY_S, LONGEST_EXPIRY_S, parse_duration

__all__ = ["CommandRefusedError", "body_of", "busy", "expired", "expiry_of"]

DIGITS: Final = 40
LARGEST: Final = 10**DIGITS

EXPIRES_S: Final = 5.0
"""How long a command may wait that does not say it."""


class CommandRefusedError(Exception):
    """A command that is not carried out.

    Args:
        kind: A stable word for programs.
        reason: Why.
        remedy: What would be right.
        outcome: `refused` or `expired`.
    """

    def __init__(self, kind: str, reason: str, remedy: str = "", outcome: str = "refused") -> None:
        super().__init__(reason)
        self.document: dict[str, Json] = {
            "outcome": outcome, "kind": kind, "reason": reason, "remedy": remedy or None,
            "sent": False,
        }  # fmt: skip


def busy() -> CommandRefusedError:
    """Return the refusal of one command too many."""
    return CommandRefusedError(
        "busy", "too many commands for this drive wait already", "send fewer"
    )


def expired(reason: str) -> CommandRefusedError:
    """Return the refusal of a command whose time is over."""
    return CommandRefusedError("expired", reason, "send it again if it is still wanted", "expired")


def expiry_of(incoming: Incoming, document: dict[str, Json]) -> float:
    """Return how long a command may wait, seconds; takes its `expires` out of the document.

    Raises:
        CommandRefusedError: `expires` is not a duration, or it is over.
    """
    said_s = EXPIRES_S if incoming.expiry_s is None else float(incoming.expiry_s)
    if (given := document.pop("expires", None)) is not None:
        try:
            own_s = parse_duration(given if isinstance(given, str) else f"{given}s")
        except ValueError as exc:
            raise bad(f"`expires` is not a duration: {str(given)[:60]}") from exc
        said_s = own_s if incoming.expiry_s is None else min(said_s, own_s)
    if said_s < LEAST_EXPIRY_S:
        raise expired("its time was over when it came")
    return min(said_s, LONGEST_EXPIRY_S)


def body_of(topic: CommandTopic, payload: bytes) -> dict[str, Json]:
    """Return what a payload says: a JSON object, or a plain value.

    Raises:
        CommandRefusedError: It says nothing that can be meant.
    """
    try:
        text = payload.decode().strip()
    except UnicodeDecodeError as exc:
        raise bad("the payload is not text in UTF-8") from exc
    if text.startswith("{"):
        return {key: plain(key, value) for key, value in object_of(text).items()}
    if topic.what == "set":
        if not text:
            raise bad("the payload is empty; give the value, such as 35.4")
        return {"value": plain("value", text)}  # as text: digits could be a word or a decimal
    if topic.name == "set-speed":
        number, _, unit = text.partition(" ")
        if not number or not unit.strip():
            raise bad('give number and unit, such as `35.4 Hz`, or {"value": 35.4, "unit": "Hz"}')
        return {"value": plain("value", number_or_text(number)), "unit": unit.strip()}
    if text not in ("", "PRESS"):
        raise bad(f"{topic.name} takes no value: send it with an empty payload")
    return {}


def object_of(text: str) -> dict[str, Json]:
    """Return a JSON object with its decimals exactly; each key once.

    Raises:
        CommandRefusedError: It is none.
    """

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError("a key is there twice")
        return found

    try:
        found: dict[str, Json] = json.loads(
            text, parse_float=decimal_of, parse_constant=refuse_constant, object_pairs_hook=once
        )
    except (ValueError, RecursionError) as exc:
        raise bad(f"the payload is no JSON object: {exc}") from exc
    return found


def plain(key: str, value: Json) -> Json:
    """Return a value that can stand in a request: text, or a number that a drive could have.

    Raises:
        CommandRefusedError: It is a list, an object, no Unicode text, or has very many digits.
    """
    if isinstance(value, str) and (value.isascii() or value.isprintable()):
        return value
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int) and abs(value) < LARGEST:
        return value
    if isinstance(value, Decimal) and abs(value.adjusted()) < DIGITS > len(value.as_tuple().digits):
        return value
    raise bad(f"{ascii(key)[:60]} has a value that no drive takes")


def decimal_of(text: str) -> Decimal:
    """Return a number with a point or exponent; one beyond any decimal is refused."""
    try:
        return Decimal(text)
    except InvalidOperation as exc:
        raise ValueError(f"{text[:60]} is too large or too small for any number") from exc


def refuse_constant(word: str) -> None:
    """Refuse NaN and Infinity, which are no JSON."""
    raise ValueError(f"{word} is not a number")


def number_or_text(text: str) -> Json:
    """Return a number where JSON knows it as one, else text as on the wire, such as `H0008`."""
    try:
        found = json.loads(text, parse_float=decimal_of, parse_constant=refuse_constant)
    except (ValueError, RecursionError):
        return text
    return found if isinstance(found, int | Decimal) and not isinstance(found, bool) else text


def bad(reason: str) -> CommandRefusedError:
    """Return the refusal of a payload."""
    return CommandRefusedError("bad-value", reason)
