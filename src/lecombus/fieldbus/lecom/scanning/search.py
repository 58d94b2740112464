"""In which order addresses and baud rates are asked, and what is made of what comes back.

Theory of operation. A drive is there if anything answers at its address: a value or "no such
code". Nothing else distinguishes an address without a drive from one whose answer is late, so:

* successive addresses are asked for different codes (`PROBES`). An answer repeats its code, and no
  code comes round again within half a second: a late answer can never make a drive of an address
  that has none. `exchanges.late_answers` keeps the same rule, should the line be slower still.
* when more was heard than an answer, the addresses asked last are suspects: each is asked again,
  alone and patiently. The line is then called disturbed, and every silent address asked twice.
* which codes: C0248, C0249, C0046 and C0040 exist in every drive described, and no roster's status
  set reads them. So a scan through a daemon delays none of the daemon's reads behind a late answer.

With several baud rates the addresses that are most likely are asked at each first: the line's rate
is then known within seconds, and the whole sweep begins with it.

Before the first question the line is listened to: a line has one master, and another one that is
there already must not be disturbed.

Source: EDB2102EN 8.3 (answers repeat the code), 8.3.5 (time monitoring).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from lecombus.errors import LineError
from lecombus.fieldbus.lecom.protocol.host_parser import RequestParser
from lecombus.fieldbus.lecom.protocol.telegrams import ReadRequest, WriteRequest
from lecombus.parameters import Code

from .asking import AddressAccess, Heard, HeardKind, Question
from .identifying import FoundDrive, Unclear, identify

__all__ = ["ForeignTalkError", "Scan", "ScanPlan"]

PROBES = (Code(248), Code(249), Code(46), Code(40))
LIKELY = (1, 11, 2, 12, 21, 3)
"""A single drive ex works is at 1; lines are numbered from 1 or from the first decade."""
SUSPECTS = len(PROBES)
"""So many addresses were asked while a late answer may have been under way."""
LISTEN_S = 1.0
"""A master asks something several times a second."""
STRAY_BYTES = 2
"""So many bytes may come out of an adapter that was just opened."""
SAMPLES = 32


class ForeignTalkError(LineError):
    """Another master speaks on the line: a scan would disturb it."""


@dataclass(frozen=True, slots=True)
class ScanPlan:
    """What is to be searched.

    Args:
        addresses: 1..99, none ending in 0, in the order they are asked.
        bauds: Baud rates in the order they are tried.
        thorough: Ask every silent address twice, and go through all baud rates even when drives
            were found at one.
        listen_s: How long to listen first, seconds; 0 where a daemon has the line already.
    """

    addresses: tuple[int, ...]
    bauds: tuple[int, ...]
    thorough: bool = False
    listen_s: float = LISTEN_S


class Scan:
    """One search, and what it has found so far.

    Args:
        plan: What is to be searched.

    Attributes:
        found: The drives, in the order they were found.
        unclear: Addresses from which something came, and never a whole answer.
        samples: What was heard and no answer: address asked and bytes.
        baud: The baud rate of the moment, bit/s.
        address: The address asked last.
        looks: How many addresses have been asked.
        looks_left: How many will be, should nothing more be found or heard.
    """

    _access: AddressAccess

    def __init__(self, plan: ScanPlan) -> None:
        self.plan = plan
        self.found: list[FoundDrive] = []
        self.unclear: list[Unclear] = []
        self.samples: deque[tuple[int, bytes]] = deque(maxlen=SAMPLES)
        self.baud = plan.bauds[0]
        self.address = 0
        self.looks = 0
        self.looks_left = len(plan.addresses) * len(plan.bauds)
        self._probe = 0
        self._recent: deque[int] = deque(maxlen=SUSPECTS)
        self._disturbances = 0

    async def run(self, access: AddressAccess) -> None:
        """Search on a line.

        Raises:
            ForeignTalkError: Another master speaks on the line.
        """
        self._access = access
        if self.plan.listen_s:
            await self._listen()
        order = self.plan.bauds
        if len(order) > 1:
            order = await self._order()
        for place, baud in enumerate(order):
            self.looks_left = len(self.plan.addresses) * (len(order) - place)
            await self._sweep(baud)
            if self.found and not self.plan.thorough:
                break
        self.looks_left = 0

    async def _listen(self) -> None:
        heard = await self._access.listen(self.baud, self.plan.listen_s)
        self._disturbances = heard.disturbances
        self._note(heard, address=0)
        if len(heard.received) > STRAY_BYTES:
            shown = heard.received[:12].hex(" ").upper()
            raise ForeignTalkError(
                f"bytes arrive though nothing was asked ({shown}): another master speaks on this "
                "line, at this baud rate or another, or the line is open and picks up noise; end "
                "the other master (a line has one), or check bias and termination"
            )

    # ---- baud rates -------------------------------------------------------------------------

    async def _order(self) -> tuple[int, ...]:
        """Find the line's rate by the likely addresses, and put it first."""
        bauds = self.plan.bauds
        for baud in bauds:
            self.baud = baud
            for address in (one for one in LIKELY if one in self.plan.addresses):
                heard = await self._ask(address)
                if heard.is_answer:
                    return (baud, *(other for other in bauds if other != baud))
        return bauds

    async def _sweep(self, baud: int) -> None:
        """Ask every address at one baud rate."""
        self.baud = baud
        silent, suspects = await self._pass(self.plan.addresses)
        disturbed = bool(suspects)
        if self.plan.thorough or disturbed:
            self.looks_left += len(silent)
            silent, more = await self._pass(silent)
            suspects = [*suspects, *more]
        known = {one.address for one in self.found if one.baud == baud}
        for address in dict.fromkeys(suspects):
            if address not in known:
                await self._look_patiently(address)

    async def _pass(self, addresses: Iterable[int]) -> tuple[list[int], list[int]]:
        """Ask addresses once; returns the silent ones, and those that may have answered late."""
        silent: list[int] = []
        suspects: list[int] = []
        for address in addresses:
            heard = await self._ask(address)
            self.looks_left -= 1
            if self._was_disturbed(heard):
                suspects.extend(self._recent)
            if heard.is_answer:
                self.found.append(await identify(self._access, self.baud, address))
                if not self.plan.thorough:  # the line's rate is known: the others are left alone
                    self.looks_left %= len(self.plan.addresses)
            else:
                silent.append(address)
        return silent, suspects

    # ---- one address ------------------------------------------------------------------------

    async def _ask(self, address: int, *, patient: bool = False) -> Heard:
        code = PROBES[self._probe]
        self._probe = (self._probe + 1) % len(PROBES)
        self.address = address
        self._recent.append(address)
        heard = await self._access.ask(Question(self.baud, address, code, patient=patient))
        self.looks += 1
        self._note(heard, address)
        return heard

    async def _look_patiently(self, address: int) -> None:
        """Ask a suspect alone: it may be slow, or what it says may be damaged now and then."""
        unclear = b""
        for patient in (False, True, True):
            heard = await self._ask(address, patient=patient)
            if heard.is_answer:
                self.found.append(await identify(self._access, self.baud, address, patient=patient))
                return
            if heard.kind is HeardKind.GARBLED:
                unclear = heard.received
        if unclear:
            self.unclear.append(Unclear(address, self.baud, unclear))

    # ---- what else is heard -----------------------------------------------------------------

    def _was_disturbed(self, heard: Heard) -> bool:
        """Whether more was heard than an answer, now or since the question before."""
        more = heard.disturbances > self._disturbances
        self._disturbances = heard.disturbances
        return more or heard.kind in (HeardKind.GARBLED, HeardKind.ECHO)

    def _note(self, heard: Heard, address: int) -> None:
        """Keep what was no answer, and end if it is another master's question."""
        if not heard.received:
            return
        self.samples.append((address, heard.received))
        other = _question_in(heard.received)
        if other is not None and other not in self._recent:
            raise ForeignTalkError(
                f"another master speaks on this line: it asks for address {other}; end it first, "
                "a line has one master"
            )


def _question_in(received: bytes) -> int | None:
    """Give the address of a whole question among bytes, of any parity."""
    parser = RequestParser()
    for event in parser.feed(bytes(byte & 0x7F for byte in received)):
        if isinstance(event, ReadRequest | WriteRequest):
            return event.address
    return None
