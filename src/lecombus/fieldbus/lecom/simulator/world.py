"""Lines made from plain descriptions: what the command line and tests start from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lecombus.fieldbus.lecom.simulator.drive import Overrides, SimDrive
from lecombus.fieldbus.lecom.simulator.faults import Faults, parse_faults
from lecombus.fieldbus.lecom.simulator.line import SimLine

__all__ = ["build"]


def build(
    drives: Sequence[tuple[str, int, str]],
    *,
    baud: int = 9600,
    seed: int = 0,
    faults: Faults | str = "",
    parity: bool = True,
    paced: bool = True,
    spread: float = 0.0,
    think_scale: float = 1.0,
    overrides: Mapping[str, Overrides] | None = None,
    log_size: int = 1_000,
    word_as_written: bool = False,
    digit_of: str = "lecom",
) -> SimLine:
    """Build a line.

    Args:
        drives: Name, address and family of each.
        baud: 1200..19200 bit/s.
        seed: Where all chance starts from.
        faults: Faults, or their short text (see `parse_faults`).
        parity: Whether bytes carry even parity in bit 7.
        paced: Whether characters take their time.
        spread: How much faster than the manual's time an answer may come, 0..1.
        think_scale: Factor on processing times.
        overrides: Values to start with, by the drive's name (see `SimDrive`).
        log_size: How many requests each drive remembers.
        word_as_written: C0135 of the drives reads what was last written to it (see `SimDrive`).
        digit_of: Which number C0068 of an SMVector shows the tens digit of (see `SMVector`).

    Raises:
        ValueError: A family, an address or a fault is unknown.
    """
    presets = overrides or {}
    line = SimLine(
        [
            SimDrive(
                address,
                family,
                name,
                presets.get(name),
                spread=spread,
                log_size=log_size,
                word_as_written=word_as_written,
                digit_of=digit_of,
            )
            for name, address, family in drives
        ],
        baud=baud,
        faults=parse_faults(faults) if isinstance(faults, str) else faults,
        seed=seed,
        parity=parity,
        paced=paced,
        think_scale=think_scale,
    )
    by_address = {drive.address: drive for drive in line.drives}
    for address, number, stays in line.faults.trips:
        if address not in by_address:
            there = ", ".join(map(str, by_address))
            raise ValueError(f"fault 'trip': no drive has the address {address}: one of {there}")
        by_address[address].trip(number, stays=stays)
    return line
