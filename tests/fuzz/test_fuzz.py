"""The short form of `make fuzz`: what was found before, and mutations of it.

And each target notices a fault that is planted in what it feeds.
"""

from __future__ import annotations

import importlib
import random
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from typing import Any

import pytest

from fuzz import corpus, targets
from fuzz.targets import TARGETS
from lecombus.fieldbus.lecom.protocol.telegrams import AckAnswer
from lecombus.fieldbus.loop_interface import ResultKind
from lecombus.saved_state import State

MUTATIONS = 150
SLOW = {"roster": 12, "simulator": 40, "calls": 60, "tokens": 40}
"""Targets that take longer, and so many mutations of them."""


def mutated(data: bytes, words: tuple[bytes, ...], draw: random.Random) -> bytes:
    """Change some bytes as a fuzzer does, without looking at what is reached."""
    changed = bytearray(data)
    for _ in range(draw.randint(1, 4)):
        at = draw.randint(0, len(changed))
        match draw.randint(0, 4):
            case 0 if at < len(changed):
                changed[at] ^= 1 << draw.randint(0, 7)
            case 1:
                changed[at : at + draw.randint(1, 8)] = b""
            case 2:
                changed[at:at] = draw.choice(words) if words else draw.randbytes(3)
            case 3:
                changed[at:at] = changed[: draw.randint(0, 40)]
            case _:
                changed[at:at] = draw.randbytes(draw.randint(1, 4))
    return bytes(changed[: targets.LONGEST])


@pytest.mark.parametrize("name", TARGETS)
def test_nothing_escapes(name: str) -> None:
    target, inputs, draw = TARGETS[name], corpus.kept(name), random.Random(f"{name}")
    assert inputs, "there is nothing to begin with"
    for data in (b"", *inputs):
        target.check(data)
    for _ in range(SLOW.get(name, MUTATIONS)):
        target.check(mutated(draw.choice(inputs), target.words, draw))


def _another(real: Any) -> Callable[..., Any]:
    def result(self: Any, kind: ResultKind, now_s: float, *more: Any) -> Any:
        return replace(real(self, kind, now_s, *more), kind=ResultKind.ANSWERED)

    return result


def _raising(error: type[Exception]) -> Callable[[Any], Callable[..., Any]]:
    def planted(real: Any) -> Callable[..., Any]:
        def call(*given: Any, **more: Any) -> Any:
            real(*given, **more)
            raise error("planted")

        return call

    return planted


def _lossy(real: Any) -> Callable[..., str]:
    return lambda given: real(given).replace("35.4", "35.5")


def _without_writes(real: Any) -> Callable[[State], str]:
    return lambda state: real(state).replace('"writes"', '"written"')


ACK = AckAnswer()
PROTOCOL = "lecombus.fieldbus.lecom"
PLANTED: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "answers": (f"{PROTOCOL}.protocol.parser._whole", lambda _: lambda data, parity: ACK),
    "exchange": (f"{PROTOCOL}.protocol.exchange.Exchange._result", _another),
    "telegrams": ("fuzz.targets.RequestReceiver.feed", lambda _: lambda self, byte: None),
    "simulator": (f"{PROTOCOL}.simulator.receiver.RequestReceiver.feed", _raising(ValueError)),
    "values": ("fuzz.targets.Value.decimal", lambda real: lambda given: real(Decimal(given) + 1)),
    "roster": ("fuzz.targets.parse_roster", _raising(KeyError)),
    "backup": ("fuzz.targets.write_backup", _lossy),
    "bodies": ("fuzz.targets.encode", _lossy),
    "calls": ("support.api_line.FakeOperations.write", lambda _: None),
    "mqtt": ("lecombus.bridges.mqtt.command_bodies.object_of", _raising(KeyError)),
    "state": ("fuzz.targets.State.text", _without_writes),
    "tokens": ("fuzz.targets.write_tokens", lambda _: lambda path, tokens: path.write_text("{}")),
}


@pytest.mark.parametrize("name", TARGETS)
def test_a_planted_fault_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    place, planted = PLANTED[name]
    owner, _, attribute = place.rpartition(".")
    real = getattr(_owner(owner), attribute)
    monkeypatch.setattr(place, planted(real))
    noticed = 0
    for data in corpus.kept(name):
        try:
            TARGETS[name].check(data)
        except Exception:  # noqa: BLE001 - what it is depends on what was planted
            noticed += 1
    assert noticed > 0


def _owner(path: str) -> Any:
    """Return a module, or a class in one, by its path."""
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        above, _, name = path.rpartition(".")
        return getattr(_owner(above), name)
