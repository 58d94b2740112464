"""What several commands take: codes, values, durations, rosters, and where the daemon is.

Each converter turns a word into what the rest of lecombus uses, or says what would be right.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.core import ParameterSource

from lecombus.cli.exits import CommandError, Exit
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
    "GIVEN_CODE",
    "NUMBER",
    "VALUE",
    "CommandWithNumbers",
    "DaemonOptions",
    "Given",
    "GivenCode",
    "WholeNumber",
    "Word",
    "check_port_options",
    "daemon_options",
    "json_option",
    "roster_option",
    "wait_option",
    "whole_path",
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
        token_file: The file that holds the bearer token, for a URL.
        ca: The file with the certificates that sign the daemon's, for an https URL.
        certificate: The file with the client's certificate and key, for an https URL.
    """

    socket: str | None
    url: str | None
    as_json: bool
    token_file: str | None = None
    ca: str | None = None
    certificate: str | None = None

    def behind(self, above: DaemonOptions) -> DaemonOptions:
        """Return these options, with those that stand before the subcommand where they are absent.

        A daemon that is named here is asked with nothing that was meant for another one.
        """
        if self.socket is None and self.url is None:
            daemon = replace(above, **{key: text for key, text in asdict(self).items() if text})
        else:
            daemon = self
        return replace(daemon, as_json=self.as_json or above.as_json)


class CommandWithNumbers(click.Command):
    """A command that takes `-5` for a number, and not for an option.

    Only words that begin like a number are taken so: a misspelt option is still one.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Hide negative numbers from click."""
        return super().parse_args(ctx, [_hide(word) for word in args])


def _hide(word: str) -> str:
    return _HIDDEN + word if _NEGATIVE.match(word) else word


T = TypeVar("T")


class Word(click.ParamType[T]):
    """What a word on the command line stands for.

    Args:
        name: How help calls it.
        read: Reads the word, or raises `click.BadParameter` with what would be right.
    """

    def __init__(self, name: str, read: Callable[[str], T]) -> None:
        self.name = name
        self._read = read

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> T:
        """Read a word; a default is none."""
        if not isinstance(value, str):
            return cast(T, value)
        try:
            return self._read(value.removeprefix(_HIDDEN))
        except click.BadParameter as exc:
            self.fail(exc.message, param, ctx)


class WholeNumber(click.IntRange):
    """A whole number between two bounds; what is none is told with the bounds."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read a number; a default is one."""
        try:
            return int(super().convert(value, param, ctx))
        except click.BadParameter:
            least = f"of {self.min} or more"
            wanted = least if self.max is None else f"from {self.min} to {self.max}"
            self.fail(f"{value} is not a whole number {wanted}", param, ctx)


def _code(word: str) -> Code:
    try:
        return Code.parse(word)
    except CodeValueError as exc:
        raise click.BadParameter(str(exc)) from exc


@dataclass(frozen=True, slots=True)
class GivenCode:
    """A code, and what its user calls it.

    Args:
        code: The code.
        spoken: Such as P411, where it was given as the keypad names it; empty: by its number.
    """

    code: Code
    spoken: str

    def __str__(self) -> str:
        """Return it for people."""
        return self.spoken or str(self.code)


def _given_code(word: str) -> GivenCode:
    return GivenCode(_code(word), word.upper() if word[:1] in ("p", "P") else "")


def _codes(word: str) -> tuple[Code, ...]:
    first, dash, last = word.partition("-")
    begin = _code(first)
    if not dash:
        return (begin,)
    of_subcodes = begin.subcode > 0 and last.isdecimal()
    end = _code(f"{begin.number}/{last}" if of_subcodes else last)
    if of_subcodes:
        codes = [Code(begin.number, n) for n in range(begin.subcode, end.subcode + 1)]
    else:
        codes = [Code(n, begin.subcode) for n in range(begin.number, end.number + 1)]
    if not codes or len(codes) > MOST_CODES or (begin.subcode != end.subcode and not of_subcodes):
        right = f"a code, or up to {MOST_CODES} of them such as C0010-C0050 or C0039/1-15"
        raise click.BadParameter(f"{word} is not a range of codes: {right}")
    return tuple(codes)


def _value(word: str) -> str:
    """Read a value as text: whether `0208` is a number or a word is for the daemon to judge."""
    word = word.strip()
    if re.fullmatch(r"[+-]?[0-9]+", word, re.ASCII):
        return word
    if _DECIMAL.fullmatch(word):
        return f"{Decimal(word):f}"
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", word, re.ASCII):
        raise click.BadParameter(f"{word} has a decimal comma, write {word.replace(',', '.')}")
    if re.fullmatch(r"[+-]?[0-9.]+[eE][+-]?[0-9]+", word, re.ASCII):
        raise click.BadParameter(f"{word} has an exponent, {_written_out(word)}")
    if not _WORD_OR_OCTETS.fullmatch(word):
        raise click.BadParameter(
            f"`{word}` is not a value, write a number such as 35.4, a word such as H0008, "
            "or octets such as O1A2B"
        )
    return word if word[:1] == "0" else word.upper()


def _number(word: str) -> Decimal:
    text = _value(word)
    try:
        return Decimal(text)
    except InvalidOperation:
        raise click.BadParameter(f"`{text}` is not a number, write one such as 35.4") from None


def _written_out(word: str) -> str:
    """Return what to write instead of a number with an exponent."""
    try:
        number = Decimal(word)
    except InvalidOperation:
        number = Decimal("NaN")
    if not number.is_finite() or abs(number.adjusted()) > MOST_DIGITS:
        return "write a number such as 35.4"
    return f"write {number:f}"


def _duration(word: str) -> float:
    try:
        return parse_duration(word)
    except DurationError as exc:
        raise click.BadParameter(f"{word} {exc}") from exc


def _expiry(word: str) -> float:
    """Read how long a request may wait before it is not sent any more, seconds."""
    seconds = _duration(word)
    if not LEAST_EXPIRY_S <= seconds <= LONGEST_EXPIRY_S:
        right = f"{format_duration(LEAST_EXPIRY_S)} to {format_duration(LONGEST_EXPIRY_S)}"
        raise click.BadParameter(f"{word} is out of range, write {right}, such as 2s")
    return seconds


CODE = Word("code", _code)
GIVEN_CODE = Word("code", _given_code)
CODES = Word("codes", _codes)
VALUE = Word("value", _value)
NUMBER = Word("number", _number)
DURATION = Word("duration", _duration)
EXPIRY = Word("duration", _expiry)


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
    """Give a command `--socket`, `--url`, what they need and `--json`; it gets them as `daemon`."""

    @wraps(function)
    def command(
        *,
        socket: str | None,
        url: str | None,
        as_json: bool,
        token_file: str | None,
        ca: str | None,
        certificate: str | None,
        **given: Any,
    ) -> int:
        for option, text in (("--socket", socket), ("--url", url)):
            if text == "":  # such as a variable that is not set: no other daemon is meant
                raise click.BadParameter("it is empty; name the daemon, or leave it out",
                                         param_hint=f"'{option}'")  # fmt: skip
        daemon = DaemonOptions(socket, url, as_json, token_file, ca, certificate)
        return function(daemon=daemon, **given)

    command = json_option(command)
    command = click.option(
        "--certificate", metavar="FILE", envvar="LECOMBUS_CERTIFICATE",
        help="With an https URL: your certificate and its key, where the daemon asks for one.",
    )(command)  # fmt: skip
    command = click.option(
        "--ca", metavar="FILE", envvar="LECOMBUS_CA",
        help="With an https URL: the certificates to trust; default: the system's.",
    )(command)  # fmt: skip
    command = click.option(
        "--token-file", metavar="FILE", envvar="LECOMBUS_TOKEN_FILE",
        help="With a URL: the file that holds the access token.",
    )(command)  # fmt: skip
    command = click.option(
        "--url", metavar="URL", help="The daemon's HTTP address, such as http://127.0.0.1:9740."
    )(command)
    return click.option(
        "--socket", metavar="PATH", help="The daemon's socket; default: the only one there is."
    )(command)


def check_port_options(
    ctx: click.Context, port: str | None, daemon: DaemonOptions, *, only_with: tuple[str, ...],
    why: str,
) -> None:  # fmt: skip
    """Refuse options that would do nothing: something else would be asked than is meant.

    Args:
        ctx: That of the command.
        port: The port to be opened; None: the daemon is asked.
        daemon: What the command line says of the daemon.
        only_with: The options that need a port.
        why: What is done without one.

    Raises:
        CommandError: There are some.
    """
    if port is not None:
        if daemon.socket or daemon.url:
            problem = "--port and a daemon are both given"
            raise CommandError(Exit.USAGE, problem, "leave one of them out")
        return
    given = [f"--{one}" for one in only_with
             if ctx.get_parameter_source(one) is ParameterSource.COMMANDLINE]  # fmt: skip
    if given:
        what = f"without --port, {', '.join(given)} would do nothing: {why}"
        remedy = "leave it out" if len(given) == 1 else "leave them out"
        raise CommandError(Exit.USAGE, what, remedy)


def whole_path(context: click.Context, parameter: click.Parameter, port: str | None) -> str | None:
    """Let a device be named from the folder in use; a roster wants whole paths."""
    if port == "":  # such as a variable that is not set: no daemon is meant
        raise click.BadParameter("it is empty; name the port, or leave it out")
    if port and ":" not in port and Path(port).exists():
        return str(Path(port).absolute())
    return port
