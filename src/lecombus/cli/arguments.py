"""What several commands take: codes, values, durations, rosters, and where the daemon is.

Each converter turns a word into what the rest of lecombus uses, or says what would be right.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from lecombus.durations import (
    LEAST_EXPIRY_S,
    LONGEST_EXPIRY_S,
    DurationError,
    format_duration,
    parse_duration,
)
from lecombus.errors import CodeValueError
from lecombus.parameters import Code

__all__ = [
    "CODE",
    "CODES",
    "DURATION",
    "EXPIRY",
    "NUMBER",
    "VALUE",
    "CommandWithNumbers",
    "DaemonOptions",
    "Given",
    "daemon_options",
    "json_option",
    "roster_option",
    "wait_option",
]

PATIENCE_S = 60.0

Given = int | Decimal | str
"""A value for a request's body: a number, or text for the daemon to judge."""

Function = TypeVar("Function", bound=Callable[..., Any])

MOST_DIGITS = 12
"""No drive takes a number that is longer; one with an exponent may be a megabyte written out."""

MOST_CODES = 2000
"""A whole parameter set; reading it takes some minutes."""

_DECIMAL = re.compile(r"[+-]?([0-9]+\.[0-9]*|\.[0-9]+)", re.ASCII)
_WORD_OR_OCTETS = re.compile(r"(?:[Hh]|0[xX])[0-9A-Fa-f]+|O(?:[0-9A-Fa-f]{2})+", re.ASCII)
_NEGATIVE = re.compile(r"-\.?[0-9]")
_HIDDEN = "\0"
"""Put before a negative number while click looks for options; no word can contain it."""


@dataclass(frozen=True, slots=True)
class DaemonOptions:
    """Which daemon a command asks, and how it prints the answer.

    Args:
        socket: What `--socket` says.
        url: What `--url` says.
        as_json: Print the daemon's document.
    """

    socket: str | None
    url: str | None
    as_json: bool


class CommandWithNumbers(click.Command):
    """A command that takes `-5` for a number, and not for an option.

    Only words that begin like a number are taken so: a misspelt option is still one.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hide negative numbers from click."""
        return super().parse_args(ctx, [_hide(word) for word in args])


def _hide(word: str) -> str:
    return _HIDDEN + word if _NEGATIVE.match(word) else word


class _CodeType(click.ParamType[Code]):
    name = "code"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Code:
        if isinstance(value, Code):
            return value
        try:
            return Code.parse(value.removeprefix(_HIDDEN))
        except CodeValueError as exc:
            self.fail(str(exc), param, ctx)


class _CodesType(click.ParamType[tuple[Code, ...]]):
    name = "codes"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Code, ...]:
        if isinstance(value, tuple):
            return value
        first, dash, last = str(value).partition("-")
        begin = CODE.convert(first, param, ctx)
        if not dash:
            return (begin,)
        of_subcodes = begin.subcode > 0 and last.isdecimal()
        end = CODE.convert(f"{begin.number}/{last}" if of_subcodes else last, param, ctx)
        if of_subcodes:
            codes = [Code(begin.number, n) for n in range(begin.subcode, end.subcode + 1)]
        else:
            codes = [Code(n, begin.subcode) for n in range(begin.number, end.number + 1)]
        if (
            not codes
            or len(codes) > MOST_CODES
            or (begin.subcode != end.subcode and not of_subcodes)
        ):
            right = f"a code, or up to {MOST_CODES} of them such as C0010-C0050 or C0039/1-15"
            self.fail(f"{value} is no range of codes: {right}", param, ctx)
        return tuple(codes)


class _ValueType(click.ParamType[str]):
    """A value as text: whether `0208` is a number or a word is for the daemon to judge."""

    name = "value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        word = str(value).removeprefix(_HIDDEN).strip()
        if re.fullmatch(r"[+-]?[0-9]+", word, re.ASCII):
            return word
        if _DECIMAL.fullmatch(word):
            return f"{Decimal(word):f}"
        if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", word, re.ASCII):
            self.fail(f"{word} has a decimal comma, write {word.replace(',', '.')}", param, ctx)
        if re.fullmatch(r"[+-]?[0-9.]+[eE][+-]?[0-9]+", word, re.ASCII):
            self.fail(f"{word} has an exponent, {_written_out(word)}", param, ctx)
        if not _WORD_OR_OCTETS.fullmatch(word):
            self.fail(
                f"`{word}` is no value, write a number such as 35.4, a word such as H0008, "
                "or octets such as O1A2B",
                param,
                ctx,
            )
        return word if word[:1] == "0" else word.upper()


class _NumberType(click.ParamType[Decimal]):
    """A number, such as that of a speed."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Decimal:
        text = VALUE.convert(value, param, ctx)
        try:
            return Decimal(text)
        except InvalidOperation:
            self.fail(f"`{text}` is no number, write one such as 35.4", param, ctx)


def _written_out(word: str) -> str:
    """Return what to write instead of a number with an exponent."""
    try:
        number = Decimal(word)
    except InvalidOperation:
        number = Decimal("NaN")
    if not number.is_finite() or abs(number.adjusted()) > MOST_DIGITS:
        return "write a number such as 35.4"
    return f"write {number:f}"


class _DurationType(click.ParamType[float]):
    name = "duration"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        if isinstance(value, float):
            return value
        word = value.removeprefix(_HIDDEN)
        try:
            return parse_duration(word)
        except DurationError as exc:
            self.fail(f"{word} {exc}", param, ctx)


class _ExpiryType(_DurationType):
    """How long a request may wait before it is not sent any more."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        seconds = super().convert(value, param, ctx)
        if not LEAST_EXPIRY_S <= seconds <= LONGEST_EXPIRY_S:
            right = f"{format_duration(LEAST_EXPIRY_S)} to {format_duration(LONGEST_EXPIRY_S)}"
            self.fail(f"{value} is out of range, write {right}, such as 2s", param, ctx)
        return seconds


CODE = _CodeType()
CODES = _CodesType()
VALUE = _ValueType()
NUMBER = _NumberType()
DURATION = _DurationType()
EXPIRY = _ExpiryType()


def json_option(function: Function) -> Function:
    """Give a command `--json`."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON.")(function)


def roster_option(function: Function) -> Function:
    """Give a command `-c ROSTER`."""
    return click.option(
        "-c",
        "--config",
        "roster",
        metavar="ROSTER",
        required=True,
        type=click.Path(dir_okay=False, path_type=Path),
        help="The roster: a YAML file that describes the line.",
    )(function)


def wait_option(function: Function) -> Function:
    """Give a command `--wait`: long work outlives a line that is lost."""
    return click.option(
        "--wait",
        "patience_s",
        type=DURATION,
        default=PATIENCE_S,
        help="How long to wait for a line or a drive that is away; default: 1min.",
    )(function)


def daemon_options(function: Callable[..., int]) -> Callable[..., int]:
    """Give a command `--socket`, `--url` and `--json`; it gets them as one, `daemon`."""

    @wraps(function)
    def command(*, socket: str | None, url: str | None, as_json: bool, **given: Any) -> int:
        return function(daemon=DaemonOptions(socket, url, as_json), **given)

    command = json_option(command)
    command = click.option(
        "--url", metavar="URL", help="The daemon's HTTP address, such as http://127.0.0.1:9740."
    )(command)
    return click.option(
        "--socket", metavar="PATH", help="The daemon's socket; default: the only one there is."
    )(command)
