"""What is valid in a roster but makes one wonder: said by `check`, never a reason to refuse.

Each rule is one function that yields sentences; the sentence says what will happen, then what
could be done. Numbers come from the same cost model as time-outs and the schedule.

What must not live here: rules that refuse (see `checks`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from lecombus.config.borders import is_network_port
from lecombus.config.durations import format_duration
from lecombus.config.models import DriveEntry, LineEntry, Roster
from lecombus.config.timing import line_timing
from lecombus.drives import LineTiming, WriteClass, family, read_cost
from lecombus.protocol.addressing import Code, Form

__all__ = ["counted", "cyclic_load", "find_warnings"]

_LATE_ANSWER_SAFE_S: Final = 0.5
"""Longest processing time of the 2102 module. Source: EDB2102EN 3.5 (C1920..C1923, 500 ms)."""
_UNSTABLE: Final = ("/dev/ttyUSB", "/dev/ttyACM")


def counted(drives: Sequence[DriveEntry]) -> str:
    """Return `1 drive` or `31 drives`."""
    return "1 drive" if len(drives) == 1 else f"{len(drives)} drives"


def find_warnings(roster: Roster) -> list[str]:
    """Return everything in a roster that is valid but suspicious, the line first."""
    timing = line_timing(roster.line)
    found = list(_line(roster.line))
    found.extend(_load(roster, timing))
    found.extend(_feeding(roster, timing))
    found.extend(_unwatched(roster))
    found.extend(_leases(roster))
    for drive in roster.drives:
        found.extend(_watchdog(drive))
        found.extend(_writable(drive))
    return found


def _line(line: LineEntry) -> Iterator[str]:
    if line.port.startswith(_UNSTABLE):
        yield (
            f"port {line.port} may be another adapter after a restart: use its name under "
            "/dev/serial/by-id/"
        )
    if line.direction == "rts":
        yield (
            "direction rts: the 1 ms in which drives expect the line free cannot be promised; an "
            "adapter that switches by itself is better"
        )
    if line.direction != "adapter" and line.medium != "rs485":
        yield f"direction {line.direction}: {line.medium} has no transceiver to switch"
    if line.medium == "fibre" and line.echo == "no":
        yield "echo no: a fibre ring returns every telegram to the host; auto or yes is right"
    if line.parity == "port" and not is_network_port(line.port):
        yield "parity port is meant for device servers that frame 7E1; line is right elsewhere"
    if line.late_answer_s < _LATE_ANSWER_SAFE_S:
        yield (
            f"late_answer {format_duration(line.late_answer_s)}: a 2102 module may take 500ms, and "
            "its answer could then be taken for another drive's"
        )
    if line.stall_s == 0:
        yield "stall 0: an adapter that hangs without an error is never reopened"


def _reading_s(drive: DriveEntry, code: Code, timing: LineTiming) -> tuple[float, float]:
    """Return the usual and the longest line time of one read, turnaround included."""
    form = next((form for form in drive.forms if code.knows(form)), Form.EXTENDED)
    cost = read_cost(timing, family(drive.family), code, form, drive.answer_time_s)
    return cost.expected_s + timing.turnaround_s, cost.worst_s + timing.turnaround_s


def cyclic_load(roster: Roster) -> float:
    """Return the share of the line that the cyclic reads ask for; above 1 they are stretched."""
    timing = line_timing(roster.line)
    return sum(
        _reading_s(drive, entry.code, timing)[0] / entry.every_s
        for drive in roster.drives
        for entry in drive.cyclic
    )


def _load(roster: Roster, timing: LineTiming) -> Iterator[str]:
    load = cyclic_load(roster)
    if load > 1:
        yield (
            f"the cyclic reads ask for {load:.0%} of the line at {timing.baud} baud: all periods "
            f"are stretched by {load:.2f} or more; read less often, or raise the baud rate"
        )


def _feeding(roster: Roster, timing: LineTiming) -> Iterator[str]:
    """Warn of watchdogs that act when one answer is lost while the others wait to be fed."""
    watched = [drive for drive in roster.drives if drive.watchdog is not None
               and drive.watchdog.action != "none"]  # fmt: skip
    if not watched:
        return
    times = [_reading_s(drive, family(drive.family).feed_code, timing) for drive in watched]
    round_s = sum(usual for usual, _ in times)
    need_s = round_s + max(worst for _, worst in times)
    for drive in watched:
        assert drive.watchdog is not None
        time_s = drive.watchdog.time_s
        if time_s < round_s:
            yield (
                f"{drive.name}: a watchdog of {format_duration(time_s)} cannot be fed: one read "
                f"of each watched drive ({len(watched)}) takes {round_s * 1000:.0f}ms at "
                f"{timing.baud} baud"
            )
        elif time_s < need_s:
            yield (
                f"{drive.name}: a watchdog of {format_duration(time_s)} may act when one answer is "
                f"lost; {need_s:.1f}s would outlast that"
            )


def _unwatched(roster: Roster) -> Iterator[str]:
    names = [drive.name for drive in roster.drives
             if drive.watchdog is None and family(drive.family).watchdog is not None]  # fmt: skip
    if names:
        shown = ", ".join(names[:6]) + (" .." if len(names) > 6 else "")
        yield (
            f"no watchdog is looked after in {len(names)} of {counted(roster.drives)} "
            f"({shown}): they run on if the line is cut, or stop if theirs is set in the drive"
        )


def _leases(roster: Roster) -> Iterator[str]:
    """Say loudly that a lease which was asked for protects nobody yet."""
    required = [drive for drive in roster.drives if drive.lease.required]
    if required:
        yield (
            f"a lease is required for {len(required)} of {counted(roster.drives)}, but this "
            "version does not enforce it: whoever reaches the API may move them"
        )


def _watchdog(drive: DriveEntry) -> Iterator[str]:
    traits = family(drive.family).watchdog
    if drive.watchdog is None or traits is None:
        return
    if drive.watchdog.action == "none":
        yield f"{drive.name}: watchdog action none means that nothing stops the drive"
    if traits.volatile and not drive.watchdog.configure:
        yield (
            f"{drive.name}: a 2102 module forgets its watchdog at power-off; without configure: "
            "true it is only reported then"
        )


def _writable(drive: DriveEntry) -> Iterator[str]:
    of = family(drive.family)
    for code in sorted(drive.writable - of.writable):
        info = of.info(code)
        if info is None:
            continue
        if not info.writable:
            yield f"{drive.name}: {code} ({info.name}) is writable here, read only in its manual"
        elif info.write_class is WriteClass.SAVE:
            yield f"{drive.name}: each write of {code} ({info.name}) wears the drive's memory"
        elif info.write_class is WriteClass.ADDRESS:
            yield f"{drive.name}: after a write of {code} ({info.name}) the drive answers elsewhere"
    if drive.lease.required and drive.lease.on_lapse == "hold":
        yield f"{drive.name}: on_lapse hold lets the drive run on, and shows as a permanent alarm"
