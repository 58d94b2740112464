"""Which broker a command of the fleet means, and how it is spoken with.

The options are the roster's keys under `mqtt`; a password is never a word of the command line.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import click

from lecombus.cli.bridge_commands import extra
from lecombus.cli.exits import CommandError, Exit

if TYPE_CHECKING:
    from lecombus.fleet.lines import FleetLines
    from lecombus.roster import MqttEntry

__all__ = [
    "CONNECT_WITHIN_S",
    "BrokerOptions",
    "broker_of",
    "broker_options",
    "read_once",
    "run_with_broker",
]

PORTS: Final = {"mqtt": 1883, "mqtts": 8883}

CONNECT_WITHIN_S: Final = 5.0
QUIET_S: Final = 0.5
"""When no further line came for so long, all that stands at the broker is there."""


@dataclass(frozen=True, slots=True)
class BrokerOptions:
    """Which broker a command means.

    Args:
        entry: The broker.
        prefixes: The first levels of the topics of lines.
    """

    entry: MqttEntry
    prefixes: tuple[str, ...]

    @property
    def where(self) -> str:
        """The broker's address, for people."""
        return f"{self.entry.host}:{self.entry.port}"


Function = Callable[..., Any]

OPTIONS: Final = ("url", "roster", "topics", "username", "password_file", "ca", "certificate",
                  "key")  # fmt: skip


def broker_options(function: Function) -> Function:
    """Give a command the options that name a broker; it gets them as `given`."""

    @wraps(function)
    def command(**words: Any) -> Any:
        given = {name: words.pop(name) for name in OPTIONS}
        return function(given=given, **words)

    for names, what in (
        (("--key", "key"), "The key of --certificate."),
        (("--certificate", "certificate"), "Your own certificate (PEM), where the broker asks."),
        (("--ca", "ca"), "The authorities of its certificate (PEM); default: the system's."),
        (("--password-file", "password_file"), "The file with the password, on its first line."),
    ):
        command = click.option(*names, metavar="FILE", help=what)(command)
    command = click.option("--username", help="Who you are at the broker.")(command)
    command = click.option(
        "--topics", multiple=True, metavar="LEVELS",
        help="The first levels of the lines' topics; may be given several times; default: lecombus",
    )(command)  # fmt: skip
    command = click.option(
        "-c", "--config", "roster", metavar="ROSTER",
        type=click.Path(dir_okay=False, path_type=Path),
        help="Take broker, topics, TLS and user from `mqtt` of this roster.",
    )(command)  # fmt: skip
    return click.option(
        "--broker", "url", metavar="URL",
        help="The broker: mqtt://HOST[:PORT], or mqtts:// with TLS. Default: LECOMBUS_BROKER.",
    )(command)  # fmt: skip


def broker_of(given: Mapping[str, Any]) -> BrokerOptions:
    """Return the broker that a command line means.

    Raises:
        CommandError: It names none, or two, or no URL of a broker.
    """
    from lecombus.roster import MqttEntry

    roster, url = given["roster"], given["url"]
    if roster is None and url is None:
        url = os.environ.get("LECOMBUS_BROKER") or None
    more = {name: given[name] for name in OPTIONS[3:] if given[name] is not None}
    if roster is not None and url is not None:
        problem = "--broker and a roster are both given"
        raise CommandError(Exit.USAGE, problem, "leave one of them out")
    if roster is not None:
        from lecombus.config import load_roster

        found = load_roster(roster).mqtt
        if found is None:
            remedy = "write the broker into it, such as `mqtt: {host: broker.example}`"
            raise CommandError(Exit.USAGE, f"{roster} has no key `mqtt`", remedy)
        entry = found.model_copy(update=more)
    elif url is not None:
        entry = MqttEntry(**address_of(url), **more)
    else:
        remedy = "give --broker mqtt://HOST, or -c ROSTER, or set LECOMBUS_BROKER"
        raise CommandError(Exit.USAGE, "no broker is given", remedy)
    prefixes = tuple(dict.fromkeys(given["topics"])) or (entry.topics,)
    for one in prefixes:
        if not one.strip("/") or set(one) & set("+#\0") or one != one.strip("/"):
            raise CommandError(
                Exit.USAGE,
                f"--topics {one!r} is not the beginning of a topic",
                "such as plant/lecombus",
            )
    return BrokerOptions(entry, prefixes)


def address_of(url: str) -> dict[str, Any]:
    """Return host, port, TLS and user of a broker's URL.

    Raises:
        CommandError: It is none.
    """
    right = "write it like mqtt://broker.example:1883, or mqtts:// with TLS"
    try:
        found = urlsplit(url)
        port = found.port
    except ValueError as exc:
        raise CommandError(Exit.USAGE, f"`{url}` is not a broker's URL: {exc}", right) from exc
    if found.scheme not in PORTS or not found.hostname or found.path.strip("/") or found.query:
        raise CommandError(Exit.USAGE, f"`{url}` is not a broker's URL", right)
    if found.password is not None:
        raise CommandError(
            Exit.USAGE, "a password in the URL can be read by every user of this computer",
            "write it into a file, and name that by --password-file",
        )  # fmt: skip
    user = {} if found.username is None else {"username": found.username}
    address = {"host": found.hostname, "port": port or PORTS[found.scheme]}
    return {**address, "tls": found.scheme == "mqtts", **user}


def read_once(broker: BrokerOptions, lines: FleetLines) -> None:
    """Read what stands at the broker.

    Raises:
        CommandError: It cannot be reached, or does not permit it.
    """
    following = extra("lecombus.fleet.following", "mqtt", "aiomqtt", "paho")
    run_with_broker(
        broker,
        partial(following.follow_once, broker.entry, lines,
                connect_within_s=CONNECT_WITHIN_S, quiet_s=QUIET_S),
    )  # fmt: skip


def run_with_broker(broker: BrokerOptions, work: Callable[[], Any]) -> Any:
    """Run what speaks with the broker.

    Raises:
        CommandError: It cannot be reached, or does not permit it.
    """
    import anyio

    from lecombus.bridges.mqtt.broker import BrokerError

    try:
        return anyio.run(work)
    except BrokerError as exc:
        status = Exit.FORBIDDEN if exc.is_refused else Exit.UNREACHABLE
        raise CommandError(status, f"the broker {broker.where}: {exc}") from exc
