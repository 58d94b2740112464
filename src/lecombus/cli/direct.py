"""One read through a port opened by `lecombus read --port`, without daemon and roster."""

from __future__ import annotations

import time

import anyio.to_thread

from lecombus.api.decimal_json import encode
from lecombus.cli.document_rows import Document
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.own_line import own_line
from lecombus.drives import family
from lecombus.errors import ExchangeError, NoReplyError
from lecombus.fieldbus.costs import LineTiming
from lecombus.fieldbus.station import Station
from lecombus.line.loop import run
from lecombus.line.no_answers import END_IT, others_at, shared, unheard_remedy
from lecombus.line.port import PortSettings
from lecombus.parameters import Code, Value
from lecombus.readings import Quality, Reading
from lecombus.schedule import Priority

__all__ = ["read_directly"]

ADAPTER_LATENCY_S = 0.05
"""What a device server adds; an adapter adds less, and longer time-outs cost nothing here."""
RETRIES = 2
"""As a roster has it by default."""


def read_directly(
    port: str, baud: int, address: int, family_name: str, code: Code
) -> tuple[str, Document]:
    """Read one code.

    Args:
        port: Device path or `socket://HOST:PORT`.
        baud: 1200..19200 bit/s.
        address: 1..99, not ending in 0.
        family_name: Whose answer times and value names to go by.
        code: What to read.

    Returns:
        The reading, as a JSON text and as a document.

    Raises:
        LecombusError: The port cannot be opened, or the drive did not give a value.
        CommandError: Another program reads the port, or nothing is heard.
    """
    described = family(family_name)
    station = Station("drive", address, described, described.forms)
    value = run(_read, PortSettings(port, baud), station, code)
    info = described.info(code)
    meaning = info.meaning(value) if info is not None else None
    reading = Reading(
        drive=str(address),
        code=code,
        name=info.name if info else "",
        unit=info.unit if info else None,
        format=value.format.name,
        value=value,
        quality=Quality.GOOD,
        reason=None,
        time_s=time.time(),
        age_s=0.0,
        text=str(meaning) if meaning is not None else None,
    )
    document = reading.as_json()
    return encode(document), document


async def _read(settings: PortSettings, station: Station, code: Code) -> Value:
    timing = LineTiming(settings.baud, adapter_latency_s=ADAPTER_LATENCY_S)
    async with own_line(settings, timing, retries=RETRIES) as line:
        line.schedule.add_drive(station.name)
        try:
            return await line.requests.read(station, code, Priority.INTERACTIVE)
        except ExchangeError as exc:
            others = await anyio.to_thread.run_sync(others_at, settings.url)
            if others:
                what = f"{exc}; {shared(settings.url, others)}"
                raise CommandError(Exit.FAILED, Problem(what, END_IT, "port-shared")) from exc
            if isinstance(exc, NoReplyError) and not line.bytes_heard:
                what = f"no drive answers at address {station.address}: not one byte came back"
                remedy = f"{unheard_remedy(settings.url, settings.baud)}, and its address"
                raise CommandError(Exit.FAILED, Problem(what, remedy, "no-answer")) from exc
            raise
