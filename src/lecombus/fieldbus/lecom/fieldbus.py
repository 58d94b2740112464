"""LECOM-A/B as a line protocol among others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from lecombus.drives import FAMILY_NAMES, Family, read_family_file
from lecombus.fieldbus.costs import ExchangeCosts, LineTiming
from lecombus.fieldbus.lecom import address_codes
from lecombus.fieldbus.lecom.exchanges.exchange_loop import LecomExchangeLoop
from lecombus.fieldbus.lecom.parameter_rules import RULES
from lecombus.fieldbus.lecom.protocol.addressing import (
    Form,
    group_reach,
    is_drive_address,
    multicast_address,
)
from lecombus.fieldbus.lecom.protocol.controls import BAUDS, BITS_PER_CHAR
from lecombus.fieldbus.lecom.request_maker import LecomRequestMaker
from lecombus.fieldbus.lecom.telegram_costs import RosterCosts
from lecombus.fieldbus.loop_interface import (
    ExchangeLoop,
    LateWakes,
    Observer,
    OpenConnection,
    WorkerOptions,
)
from lecombus.fieldbus.port import Framing, Parity, PortOpener
from lecombus.fieldbus.protocols import Fieldbus
from lecombus.parameters import AddressForm, Code, ParameterRules
from lecombus.roster import Roster
from lecombus.schedule import Outcome, Priority, Schedule

__all__ = ["FIELDBUS", "Lecom"]


ADDRESS_RIGHT: Final = "1..99 without 10, 20 .. 90 are right"


class Lecom:
    """See `Fieldbus`."""

    name = RULES.protocol
    rules: ParameterRules = RULES
    bauds: tuple[int, ...] = BAUDS
    addresses = "1 to 99, and not 10, 20 .. 90, which are groups that nobody answers for"
    bits_per_char = BITS_PER_CHAR
    costs: ExchangeCosts = RosterCosts()
    families: tuple[str, ...] = FAMILY_NAMES
    unused_keys: frozenset[str] = frozenset()
    lowest_address = 1
    highest_address = 99
    address_schema: Mapping[str, Any] = {"not": {"multipleOf": 10}}
    most_drives: Mapping[str, int] = {"rs232": 1, "rs485": 31, "fibre": 52}
    """Source: EDB2102EN 4.4.1 to 4.4.3, CMVLC401A 3.3.2."""
    most_with_repeaters = 90
    """Source: CMVLC401A 3.3.2."""

    def read_family_file(self, name: str) -> str:
        """Return the text of a data file of `drives/families/`."""
        return read_family_file(name)

    def wrong_address(self, address: int) -> tuple[str, str] | None:
        """Say what is wrong with an address that ends in 0 or is not 1..99.

        Source: EDB2102EN 8.3.1 and 8.3.4 (addresses ending in 0 are reserved for BROADCAST).
        """
        if is_drive_address(address):
            return None
        if 0 <= address <= 99:
            reach = "all drives" if address == 0 else f"the group {address + 1}..{address + 9}"
            return f"ends in 0 and so reaches {reach}", ADDRESS_RIGHT
        return "is out of range", ADDRESS_RIGHT

    def uncarried(self, code: Code) -> tuple[str, str]:
        """Say that standard addressing cannot carry it."""
        return (
            f"{code} needs extended addressing, which this drive does not have",
            "codes 0 to 6229 without subcode would be right, or addressing: both",
        )

    def group_reach(self, address: int) -> Sequence[int]:
        """Return the addresses of a decade, or of all drives."""
        return group_reach(address)

    def is_address(self, address: int) -> bool:
        """Return whether it is 1..99 and does not end in 0."""
        return is_drive_address(address)

    def multicast_address(self, members: frozenset[int], drives: frozenset[int]) -> int | None:
        """Return 10, 20 .. 90 for a decade, 0 for all drives, None if nothing reaches just them."""
        return multicast_address(members, drives)

    def address_code(self, family: Family) -> Code:
        """Return the code that holds a drive's own address."""
        return address_codes.address_code(family)

    def moves_drive(self, family: Family, code: Code) -> str | None:
        """Return how a drive goes away when a code is written; None: it stays."""
        return address_codes.moves_drive(family, code)

    def shifting_codes(self, family: Family) -> tuple[Code, ...]:
        """Return C0249 and C0248, where the family has them."""
        return address_codes.shifting_codes(family)

    def unshifted(self, forms: tuple[AddressForm, ...]) -> tuple[AddressForm, ...]:
        """Return extended addressing, which code bank and input selection do not touch."""
        return tuple(form for form in forms if form is Form.EXTENDED)

    def framing(self, parity: Parity) -> Framing:
        """Return 8N1 where parity is made here in bit 7, 7E1 where the port makes it."""
        return "8N1" if parity == "line" else "7E1"

    def exchange_loop(
        self,
        schedule: Schedule,
        timing: LineTiming,
        options: WorkerOptions,
        connection: OpenConnection,
        line: str,
        observer: Observer,
        lateness: LateWakes,
    ) -> LecomExchangeLoop:
        """Make the loop that runs exchanges on the line's port."""
        return LecomExchangeLoop(schedule, timing, options, connection, line, observer, lateness)

    def request_maker(
        self,
        timing: LineTiming,
        retries: int,
        count: Callable[[Priority, Outcome], None],
        loop: ExchangeLoop,
    ) -> LecomRequestMaker:
        """Make what makes requests; it shares what the loop knows of second answers."""
        assert isinstance(loop, LecomExchangeLoop)
        return LecomRequestMaker(timing, retries, count, loop.duplicates)

    def simulator(self, roster: Roster) -> PortOpener:
        """Give what opens the port `sim:`; loaded here, for a real line does without."""
        from lecombus.fieldbus.lecom.simulator.line import build
        from lecombus.fieldbus.lecom.simulator.memory import MemoryEnd

        drives = [(entry.name, entry.address, entry.family) for entry in roster.drives]
        return MemoryEnd(build(drives, baud=roster.line.baud)).open


FIELDBUS: Final[Fieldbus] = Lecom()
