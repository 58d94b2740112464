"""What a drive is, by what it answers: families differ by the codes they have.

Theory of operation. Only what the manuals say is relied on; the text of a software label decides
nothing but between 821X, 822X and 824X, which lecombus describes alike.

========================================= =====================================================
answers extended addressing               no: some other maker's device, `generic`
C1810 (its text names the 2102 module)    a 2102 module; else an SMVector or `generic`
C2011, that is C0011 in parameter set 2   82XX and 8200 vector; 93XX shows its current set only
C4011, that is C0011 in parameter set 3   8200 vector only
C0043, TRIP reset                         all but 820X
C0168/1, fault memory as an array         93XX, where there is no second set
C1400 = 7 and C1410 = its own address     SMVector (P400: LECOM-B; P410)
========================================= =====================================================

What does not fit whole is `generic`, with what was odd about it: a wrong family would read wrong
words and be stopped the wrong way. Everything is asked in extended addressing, which the input
selection C0248 and the code bank C0249 do not redirect.

Sources: EDB2102EN 6.1.1, 6.1.2, 6.1.3 (parameter sets), 6.4 (820X), 8.2; CMVLC401A 4.1, 4.2, 9.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from decimal import Decimal

from lecombus.drives import Family, family
from lecombus.fieldbus.lecom.address_codes import SHIFTING
from lecombus.fieldbus.lecom.protocol.addressing import Form
from lecombus.parameters import Code, Format

from .asking import (
    AddressAccess,
    Heard,
    HeardKind,
    Question,
    read_surely,
)

__all__ = ["FoundDrive", "FoundWatchdog", "Unclear", "identify"]


@dataclass(frozen=True, slots=True)
class FoundWatchdog:
    """How a drive's watchdog is set.

    Args:
        time_s: Its monitoring time, seconds.
        action: The roster's word for what it does.
    """

    time_s: float
    action: str


@dataclass(frozen=True, slots=True)
class FoundDrive:
    """A drive.

    Args:
        address: Where it answered.
        baud: At which baud rate, bit/s.
        family: What it is, in the roster's word; `generic` where that cannot be said for sure.
        certain: Whether its family follows from its answers alone.
        why: What the family follows from, or why it is not known.
        labels: What the drive says of its software and itself, by code.
        watchdog: How its watchdog is set; None where none is known or could be read.
        remarks: What stands to be said about it.
        late: It answered only when waited for longer than its description says.
    """

    address: int
    baud: int
    family: str
    certain: bool
    why: str
    labels: tuple[tuple[Code, str], ...] = ()
    watchdog: FoundWatchdog | None = None
    remarks: tuple[str, ...] = ()
    late: bool = False

    @property
    def name(self) -> str:
        """The name proposed for it."""
        return f"drive-{self.address}"


@dataclass(frozen=True, slots=True)
class Unclear:
    """An address from which something came, and never a whole answer.

    Args:
        address: The address that was asked.
        baud: The baud rate, bit/s.
        received: What came, the first bytes, parity bits included.
    """

    address: int
    baud: int
    received: bytes


MODULE = Code(1810)
OWN_ADDRESS = Code(9)
TRIP_RESET = Code(43)
IN_SET_2 = Code(2011)
IN_SET_3 = Code(4011)
FAULT_ARRAY = Code(168, 1)
SOFTWARE = Code(200)
PROTOCOL = Code(1400)
NETWORK_ADDRESS = Code(1410)
LECOM_B = 7
VERSION = Code(1494)
DRIVE_ID = Code(1502)

LATER_82XX = re.compile(r"82([124])[1-8]")
"""A later 82XX's type in its software label, such as `8221`."""


@dataclass(slots=True)
class DriveQuestions:
    """The questions to one drive, and what it answered.

    Args:
        access: The line.
        baud: Its baud rate, bit/s.
        address: Its address.
        patient: It answers late.
        labels: What it said of itself so far.
        remarks: What stands to be said about it so far.
    """

    access: AddressAccess
    baud: int
    address: int
    patient: bool
    labels: list[tuple[Code, str]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    async def read(self, code: Code, form: Form = Form.EXTENDED, waiting: str = "generic") -> Heard:
        """Read a code; `waiting`: by whose answer times."""
        ask = Question(self.baud, self.address, code, form, waiting, self.patient)
        return await read_surely(self.access, ask)

    async def label(self, code: Code) -> Heard:
        """Read what the drive says of itself, and keep it."""
        heard = await self.read(code)
        self.keep(code, heard)
        return heard

    def keep(self, code: Code, heard: Heard) -> None:
        """Keep what the drive says of itself."""
        if heard.text:
            self.labels.append((code, heard.text))

    def says(self, code: Code) -> str:
        """Return what the drive said of itself; empty where it said nothing."""
        return dict(self.labels).get(code, "")

    def finding(
        self, name: str, why: str, *, certain: bool = True, watchdog: FoundWatchdog | None = None
    ) -> FoundDrive:
        """Say what it is."""
        return FoundDrive(
            self.address,
            self.baud,
            name,
            certain and name != "generic",
            why,
            tuple(self.labels),
            watchdog,
            tuple(self.remarks),
            self.patient,
        )

    def generic(self, why: str) -> FoundDrive:
        """Say that its family is not known."""
        return self.finding("generic", why)


async def identify(
    access: AddressAccess, baud: int, address: int, *, patient: bool = False
) -> FoundDrive:
    """Find out what answers at an address.

    Args:
        access: The line.
        baud: The baud rate, bit/s.
        address: Where something answered.
        patient: It answered late.
    """
    drive = DriveQuestions(access, baud, address, patient)
    own = await drive.read(OWN_ADDRESS)
    if not own.is_answer:
        return await _without_extended_addressing(drive)
    module = await drive.label(MODULE)
    if module.exists is None:
        return drive.generic(f"it answers, but not whole when asked for {MODULE}")
    await _redirection(drive)
    if module.exists:
        return await _behind_a_module(drive, own, module)
    return await _smvector_or_other(drive)


async def _without_extended_addressing(drive: DriveQuestions) -> FoundDrive:
    """Another maker's device; what it says in place of a software label may help people."""
    heard = await drive.read(SOFTWARE, Form.STANDARD)
    if heard.value is not None and heard.value.format is Format.VS:
        drive.keep(SOFTWARE, heard)
    return drive.generic("it answers standard addressing only, as no drive does that is described")


async def _redirection(drive: DriveQuestions) -> None:
    """Remark if standard addressing is redirected in this drive. Source: EDB2102EN 8.2."""
    for code in reversed(SHIFTING):
        heard = await drive.read(code)
        if heard.value is not None and heard.value.number != 0:
            drive.remarks.append(
                f"{code} is {heard.text}: every access by standard addressing reaches another "
                "parameter; switch the module off and on, or let its program set it to 0"
            )


# ---- 2102 fieldbus module -----------------------------------------------------------------------


async def _behind_a_module(drive: DriveQuestions, own: Heard, module: Heard) -> FoundDrive:
    await drive.label(Code(1811))
    software = await drive.label(SOFTWARE)
    await drive.label(Code(201))
    if "2102" not in module.text:
        return drive.generic(f"its fieldbus module calls itself {module.text!r}, which is no 2102")
    if not _is_number(own, drive.address):
        return drive.generic(f"{OWN_ADDRESS} reads {own.text or 'nothing'} at {drive.address}")
    has: dict[Code, bool | None] = {}
    for code in (IN_SET_2, IN_SET_3, TRIP_RESET, FAULT_ARRAY):
        has[code] = (await drive.read(code)).exists
    name, why = _by_codes(has, software.text)
    if name == "generic":
        return drive.generic(why)
    certain = name not in ("821x", "822x", "824x") or LATER_82XX.search(software.text) is not None
    await _setpoint_source(drive, name)
    watchdog = await _watchdog(drive, family(name))
    return drive.finding(name, why, certain=certain, watchdog=watchdog)


def _by_codes(has: dict[Code, bool | None], software: str) -> tuple[str, str]:
    """Name the family behind a 2102 module by the codes it has."""
    second, third = has[IN_SET_2], has[IN_SET_3]
    reset, array = has[TRIP_RESET], has[FAULT_ARRAY]
    if second and third and reset:
        return "8200vector", f"it has more than two parameter sets ({IN_SET_3})"
    if second and third is False and reset is False:
        return "820x", f"it has two parameter sets and no TRIP reset ({TRIP_RESET})"
    if second and third is False and reset:
        return _later_82xx(software)
    if second is False and third is False and reset and array:
        return "93xx", f"it shows one parameter set and an array of faults ({FAULT_ARRAY})"
    words = {True: "has", False: "has no", None: "did not say whether it has"}
    odd = ", ".join(f"{words[there]} {code}" for code, there in has.items())
    return "generic", f"behind its 2102 module is none of the families known: it {odd}"


def _later_82xx(software: str) -> tuple[str, str]:
    """Distinguish 821X, 822X and 824X by the software label; the manual knows no other way."""
    match = LATER_82XX.search(software)
    if match is not None:
        return f"82{match[1]}x", f"its software label names an {match[0]}"
    return (
        "821x",
        "it is an 821X, 822X or 824X: they look alike over the line and are described alike; "
        "correct it by the nameplate",
    )


async def _setpoint_source(drive: DriveQuestions, name: str) -> None:
    """Remark if the drive takes no setpoints over the line as it is set."""
    if name == "93xx":
        heard = await drive.read(Code(5))
        if heard.value is not None and not heard.text.endswith("1"):
            drive.remarks.append(
                f"C0005 is {heard.text}: it takes setpoints over the line only with a C0005 that "
                "ends in 1"
            )
        return
    heard = await drive.read(Code(1))
    if heard.value is not None and heard.value.number != 3:
        drive.remarks.append(
            f"C0001 is {heard.text}: it takes C0046 and C0135 over the line only with C0001 = 3"
        )


# ---- SMVector -----------------------------------------------------------------------------------


async def _smvector_or_other(drive: DriveQuestions) -> FoundDrive:
    protocol = await drive.read(PROTOCOL)
    network = await drive.read(NETWORK_ADDRESS)
    await drive.label(SOFTWARE)
    await drive.label(Code(201))
    if protocol.exists is None or network.exists is None:
        return drive.generic(f"it answers, but not whole when asked for {PROTOCOL}")
    if not _is_number(protocol, LECOM_B) or not _is_number(network, drive.address):
        said = ", ".join(
            f"{code} {'is ' + heard.text if heard.text else 'is not there'}"
            for code, heard in ((PROTOCOL, protocol), (NETWORK_ADDRESS, network))
        )
        return drive.generic(f"it has no 2102 module ({MODULE}) and is no SMVector: {said}")
    smvector = family("smvector")
    await _smvector_labels(drive, smvector)
    watchdog = await _watchdog(drive, smvector)
    why = f"P400 is {LECOM_B} (LECOM-B) and P410 is its address"
    return drive.finding("smvector", why, watchdog=watchdog)


async def _smvector_labels(drive: DriveQuestions, smvector: Family) -> None:
    for code in (VERSION, Code(1099)):
        await drive.label(code)
    kind, described = (await drive.read(DRIVE_ID)), smvector.info(DRIVE_ID)
    if kind.value is not None:
        meaning = described.meaning(kind.value) if described is not None else None
        drive.labels.append((DRIVE_ID, f"{kind.text} ({meaning})" if meaning else kind.text))
    gate, version = smvector.software, drive.says(VERSION)
    if gate is not None and version not in gate.versions:
        drive.remarks.append(
            f"its communication software (P494) is {version or 'unknown'}, not "
            f"{' or '.join(gate.versions)}: nothing is written to it unless the roster accepts that"
        )
    level = await drive.read(Code(1420))
    if level.value is not None and Decimal(level.text) < 2:
        drive.remarks.append(
            f"P420 is {level.text}: it takes setpoints over the line from 2 on, and is enabled "
            "over it from 3 on"
        )


# ---- both ---------------------------------------------------------------------------------------


async def _watchdog(drive: DriveQuestions, of: Family) -> FoundWatchdog | None:
    """Read how the watchdog is set. A 2102 module takes up to 500 ms over it (EDB2102EN 6.3)."""
    traits = of.watchdog
    if traits is None:
        return None
    time = await drive.read(traits.time_code, waiting=of.name)
    action = await drive.read(traits.action_code, waiting=of.name)
    word = next((word for word, one in traits.actions.items() if _is_number(action, one)), None)
    if time.kind is not HeardKind.VALUE or word is None or not time.text.isdecimal():
        drive.remarks.append(
            f"its watchdog could not be read: {traits.time_code} {time.text or time.kind.value}, "
            f"{traits.action_code} {action.text or action.kind.value}"
        )
        return None
    return FoundWatchdog(int(time.text) / 1000.0, word)


def _is_number(heard: Heard, number: int) -> bool:
    """Whether a decimal value is this number."""
    value = heard.value
    return value is not None and value.format is Format.VD and value.number == number
