"""Codes whose write makes a drive answer at another address or baud rate.

They are known by number, for every family. LECOM devices of any maker have their address in C0009
and their baud rate in C0125; for a device that is not described that is the safe guess. An SMVector
has them in P410 and P411 (C1410, C1411), and its P403 resets both to their defaults. C0248 and
C0249 change which code a later telegram in standard addressing reaches. They count only where a
family describes them: in another device they are codes like any other.

Source: EDB2102EN 5, 8.2 (C0009, C0125, C0248, C0249); CMVLC401A 4.1 (P403), 4.2 (P410, P411).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from lecombus.drives.family import Family
from lecombus.parameters import Code

__all__ = ["address_code", "baud_code", "baud_numbers", "moves_drive", "shifting_codes"]

LECOM_ADDRESS: Final = Code(9)
SMV_ADDRESS: Final = Code(1410)
ADDRESSES: Final = frozenset({LECOM_ADDRESS, SMV_ADDRESS})
LECOM_BAUD: Final = Code(125)
SMV_BAUD: Final = Code(1411)
BAUDS: Final = frozenset({LECOM_BAUD, SMV_BAUD})
GUESSED_NUMBERS: Final = {9600: 0, 4800: 1, 2400: 2, 1200: 3, 19200: 4}
"""What C0125 means in a 2102 module, and the best guess for a device of which nothing is known."""
MODULE_RESET: Final = Code(1403)
CODE_BANK: Final = Code(249)
SHIFTING: Final = (CODE_BANK, Code(248))


def moves_drive(family: Family, code: Code) -> str | None:
    """Return how a drive goes away when a code is written; None: it stays.

    Args:
        family: What is known of the drive.
        code: The code.

    Returns:
        Words to stand behind "C0009 of feeder", and None for a code that moves nothing.
    """
    if code in ADDRESSES:
        return "is its address"
    if code in BAUDS:
        return "is its baud rate, which all drives of a line share"
    if code == MODULE_RESET and (family.info(SMV_ADDRESS) is not None or not family.codes):
        return "puts its address and baud rate back to their defaults"
    return None


def shifting_codes(family: Family) -> tuple[Code, ...]:
    """Return the codes that move what later telegrams in standard addressing reach.

    Source: EDB2102EN 8.2 (C0248, C0249).
    """
    return SHIFTING if family.info(CODE_BANK) is not None else ()


def address_code(family: Family) -> Code:
    """Return the code that holds a drive's own address."""
    return SMV_ADDRESS if family.info(SMV_ADDRESS) is not None else LECOM_ADDRESS


def baud_code(family: Family) -> Code:
    """Return the code that holds a drive's baud rate."""
    return SMV_BAUD if family.info(SMV_BAUD) is not None else LECOM_BAUD


def baud_numbers(family: Family) -> Mapping[int, int]:
    """Return the number of each baud rate that a drive knows, by bit/s.

    Of a device that is not described a 2102 module's numbers are guessed.

    Source: EDB2102EN 8.2 (C0125); CMVLC401A 4.2 (P411).
    """
    info = family.info(baud_code(family))
    if info is None:
        return GUESSED_NUMBERS
    return {int(text.en.split()[0]): number for number, text in info.selection.items()}
