"""The two ways in which a scan reaches a line: a port of its own, or a running daemon.

Both carry out the same steps, one after the other, and tell `watch` after each.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any

import anyio

from lecombus.cli.client import Daemon
from lecombus.cli.own_line import OwnLine, own_line
from lecombus.config import LineEntry, line_timing
from lecombus.line.port import PortSettings
from lecombus.operations.address_reads import read_address
from lecombus.protocol.values import Value
from lecombus.scanning import Ask, Heard, HeardKind, Listen, Scan
from lecombus.schedule import Priority

__all__ = ["echo_of", "scan_by_daemon", "scan_own_port"]

Watch = Callable[[], None]
Steps = Generator[Ask | Listen, Heard, None]


class Ears:
    """What was heard in all, over every opening of the port."""

    def __init__(self) -> None:
        self.bytes_heard = 0


def echo_of(scan: Scan, ears: Ears) -> bool:
    """Whether all that was heard was our own voice; to be asked where nothing else was."""
    return ears.bytes_heard > 0 and not scan.samples


async def scan_own_port(scan: Scan, line: LineEntry, ears: Ears, watch: Watch) -> None:
    """Scan on a port of our own, opened anew for every baud rate.

    Args:
        scan: The search.
        line: Port, parity and direction; its baud rate is the scan's business.
        ears: Told how much was heard.
        watch: Called after every step.

    Raises:
        LineError: The port cannot be used, or somebody else speaks on the line.
    """
    steps = scan.steps()
    step: Ask | Listen | None = next(steps)
    while step is not None:
        at = line.model_copy(update={"baud": step.baud})
        settings = PortSettings(at.port, at.baud, at.direction, at.parity, at.name)
        async with own_line(settings, line_timing(at), retries=0) as own:
            try:
                step = await _at_one_rate(own, steps, step, watch)
            finally:
                ears.bytes_heard += own.bytes_heard


async def _at_one_rate(
    own: OwnLine, steps: Steps, step: Ask | Listen, watch: Watch
) -> Ask | Listen | None:
    """Carry out steps as long as they are for this baud rate; returns the first that is not."""
    baud = step.baud
    while step.baud == baud:
        heard = await _hear(own, step)
        try:
            step = steps.send(heard)
        except StopIteration:
            return None
        finally:
            watch()
    return step


async def _hear(own: OwnLine, step: Ask | Listen) -> Heard:
    if isinstance(step, Listen):
        await anyio.sleep(step.for_s)
        heard = Heard(HeardKind.SILENCE, disturbances=own.disturbances)
    else:
        heard = await read_address(
            own.requests,
            step.address,
            step.code,
            form=step.form,
            family_name=step.family,
            patient=step.patient,
            priority=Priority.INTERACTIVE,
            disturbances=lambda: own.disturbances,
        )
    return replace(heard, received=own.take_strays() + heard.received)


def scan_by_daemon(scan: Scan, daemon: Daemon, watch: Watch) -> None:
    """Scan through a running daemon, which asks in its background class.

    Raises:
        CommandError: The daemon cannot be reached, or does not ask.
    """
    steps = scan.steps()
    step = next(steps)
    while True:
        heard = Heard(HeardKind.SILENCE)
        if isinstance(step, Ask):
            heard = _asked(daemon, step)
        try:
            step = steps.send(heard)
        except StopIteration:
            return
        finally:
            watch()


def _asked(daemon: Daemon, ask: Ask) -> Heard:
    path = f"/v1/line/addresses/{ask.address}/codes/{ask.code}"
    answer: dict[str, Any] = daemon.get(
        path,
        addressing=ask.form.value,
        family=ask.family,
        patient="true" if ask.patient else "false",
    ).data
    raw = answer.get("raw")
    return Heard(
        HeardKind(answer["heard"]),
        None if raw is None else Value.parse(str(raw)),
        bytes.fromhex(answer.get("received") or ""),
        int(answer.get("disturbances") or 0),
    )
