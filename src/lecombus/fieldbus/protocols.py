"""What a line protocol gives to all other rooms, and how it is found by its name.

A protocol of this package is found by its name: `FIELDBUS` of `lecombus.fieldbus.NAME.fieldbus`,
loaded and registered when it is asked for. Others call `register`. Either way its families come
with it.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, Protocol

from lecombus.drives import Family, add_families, family
from lecombus.errors import ConfigError
from lecombus.fieldbus.costs import ExchangeCosts, LineTiming
from lecombus.fieldbus.loop_interface import (
    ExchangeLoop,
    LateWakes,
    Observer,
    OpenConnection,
    WorkerOptions,
)
from lecombus.fieldbus.port import Framing, Parity, PortOpener
from lecombus.fieldbus.requests import RequestMaker
from lecombus.parameters import AddressForm, Code
from lecombus.parameters.codes import ParameterRules, register_rules
from lecombus.roster import Roster
from lecombus.schedule import Outcome, Priority, Schedule

__all__ = [
    "Fieldbus",
    "family_names",
    "family_of_any_protocol",
    "find",
    "names",
    "protocol_of",
    "register",
]


class Fieldbus(Protocol):
    """A line protocol.

    What has a body here is right for one without multicasts and with one way to address a drive;
    a protocol that inherits need not say it.

    Attributes:
        name: The roster's word for it, `line.protocol`.
        rules: What it can carry of codes and values.
        bauds: The baud rates that it knows, bit/s, from the lowest.
        addresses: The addresses that a single drive can have, in words.
        bits_per_char: Bits of a character, start, parity and stop bits included.
        families: The names of its families; the file of each names the protocol.
        unused_keys: Keys of a roster's `line` and `drives` that mean nothing to it.
        lowest_address: The lowest address of a single drive.
        highest_address: The highest.
        address_schema: What a JSON schema must say of an address besides.
        most_drives: How many drives a line takes, by medium.
        most_with_repeaters: How many with repeaters.
        costs: What its exchanges cost.
    """

    name: str
    rules: ParameterRules
    bauds: tuple[int, ...]
    addresses: str
    bits_per_char: int
    costs: ExchangeCosts
    families: tuple[str, ...]
    lowest_address: int
    highest_address: int
    most_drives: Mapping[str, int]
    most_with_repeaters: int
    unused_keys: frozenset[str] = frozenset()
    address_schema: Mapping[str, Any] = MappingProxyType({})

    def read_family_file(self, name: str) -> str:
        """Return the text of a data file of its families, by its name with `.yaml`.

        Raises:
            OSError: There is no such file.
        """

    def wrong_address(self, address: int) -> tuple[str, str] | None:
        """Return what is wrong with a drive's address and what would be right; None: nothing."""
        if self.is_address(address):
            return None
        return "is out of range", f"{self.addresses} would be right"

    def uncarried(self, code: Code) -> tuple[str, str]:
        """Return what to say of a code that the drive's addressing cannot carry, and the remedy."""
        return f"no telegram can carry {code}", "leave it out"

    def group_reach(self, address: int) -> Sequence[int]:
        """Return the addresses that a multicast to an address reaches."""
        return ()

    def is_address(self, address: int) -> bool:
        """Return whether a single drive can have an address."""
        return self.lowest_address <= address <= self.highest_address

    def multicast_address(self, members: frozenset[int], drives: frozenset[int]) -> int | None:
        """Return the address that reaches exactly these members of a line's drives; None: none."""
        return None

    def address_code(self, family: Family) -> Code | None:
        """Return the code that holds a drive's own address; None: no code does."""
        return None

    def moves_drive(self, family: Family, code: Code) -> str | None:
        """Return how a drive goes away when a code is written; None: it stays.

        Returns:
            Words to stand behind "C0009 of feeder", such as `is its address`.
        """
        return None

    def shifting_codes(self, family: Family) -> tuple[Code, ...]:
        """Return the codes that, if not 0, move what later telegrams of some forms reach."""
        return ()

    def unshifted(self, forms: tuple[AddressForm, ...]) -> tuple[AddressForm, ...]:
        """Return those of some forms that `shifting_codes` do not touch."""
        return forms

    def framing(self, parity: Parity) -> Framing:
        """Return how the port frames characters.

        Args:
            parity: The roster's word on who makes parity.
        """

    def exchange_loop(
        self,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        connection: OpenConnection,
        line: str,
        observer: Observer,
        lateness: LateWakes,
    ) -> ExchangeLoop:
        """Make the loop that runs exchanges on the line's port.

        Args:
            schedule: Gives the next request, and takes how it ended.
            timing: The times of the line.
            options: Turnaround, echo, time-outs of the line.
            connection: The port.
            line: The line's name, for logs.
            observer: Is called for each event on the line.
            lateness: Records how late timers fired.
        """

    def request_maker(
        self,
        timing: LineTiming,
        retries: int,
        count: Callable[[Priority, Outcome], None],
        loop: ExchangeLoop,
    ) -> RequestMaker:
        """Make what makes requests.

        Args:
            timing: The times of the line.
            retries: How often a failed attempt is repeated.
            count: Called at the end of every request.
            loop: The line's loop, which `exchange_loop` made.
        """

    def simulator(self, roster: Roster) -> PortOpener:
        """Give what opens the port `sim:`: the roster's drives, simulated in this process."""


_KNOWN: dict[str, Fieldbus] = {}


PACKAGED: Final = ("lecom",)
"""The protocols of this package."""


def register(fieldbus: Fieldbus) -> None:
    """Make a protocol known, with its rules and families; `find` calls it for those packaged."""
    _KNOWN[fieldbus.name] = fieldbus
    register_rules(fieldbus.rules)
    add_families(fieldbus.families, fieldbus.read_family_file)


def names() -> tuple[str, ...]:
    """Return the names of all protocols."""
    return tuple(dict.fromkeys((*PACKAGED, *_KNOWN)))


def find(protocol: str) -> Fieldbus:
    """Return a protocol by its name.

    Raises:
        ConfigError: There is no such protocol.
    """
    found = _KNOWN.get(protocol)
    if found is None:
        name = f"lecombus.fieldbus.{protocol}"
        try:
            module = importlib.import_module(f"{name}.fieldbus")
        except ModuleNotFoundError as exc:
            if exc.name not in (name, f"{name}.fieldbus"):
                raise
            raise ConfigError(f"there is no line protocol {protocol}") from exc
        found = module.FIELDBUS
        register(found)
    return found


def family_names() -> tuple[str, ...]:
    """Return the names of the families of all protocols; loads each."""
    return tuple(one for name in names() for one in find(name).families)


def family_of_any_protocol(name: str) -> Family:
    """Return a family where no roster was read that says its protocol.

    Raises:
        ConfigError: There is no such family.
        DescriptionError: Its data file is wrong.
    """
    protocol_of(name)  # loads its protocol
    return family(name)


def protocol_of(family_name: str) -> str | None:
    """Return the protocol that a family speaks; None: there is no such family.

    Protocols of this package are loaded only if none of those that were loaded has it.
    """
    asked = dict.fromkeys((*_KNOWN, *names()))
    return next((name for name in asked if family_name in find(name).families), None)
