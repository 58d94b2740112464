"""What is valid in a roster but probably not intended: shown by `check`, never a reason to refuse.

Each rule is one function that yields sentences; a sentence says what will happen, then what could
be done. Numbers come from the cost model that time-outs and the schedule use. What is true of
single drives is yielded with the drive's name, and shown once for all drives of which it is true.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter
from typing import Final

from lecombus.capacity.exchange_costs import (
    Times,
    line_timing,
    read_times,
    stop_attempt_s,
    watched_s,
    with_slow_adapter,
)
from lecombus.capacity.watchdog_demand import LONGEST_S, demand_of, least_time_s, smallest
from lecombus.capacity.watchdog_feasibility import rounded_up
from lecombus.capacity.work_ahead import feeds_of
from lecombus.config.certificate_dates import expiries_of, expiry_text
from lecombus.drives import Verb, WriteClass, family
from lecombus.durations import format_duration
from lecombus.fieldbus.costs import LineTiming
from lecombus.parameters import Code
from lecombus.roster import (
    ApiEntry,
    DriveEntry,
    LineEntry,
    MqttEntry,
    Roster,
    is_loopback,
    is_network_port,
)
from lecombus.schedule.watchdog_deadline import HARD_PART
from lecombus.schedule.watchdog_set import WatchdogSet

__all__ = ["counted", "cyclic_load", "find_warnings", "lost_stops"]

_LATE_ANSWER_SAFE_S: Final = 0.5
"""Longest processing time of the 2102 module. Source: EDB2102EN 3.5 (C1920..C1923, 500 ms)."""
_first = itemgetter(0)
_WRITING: Final = (Verb.ENABLE, Verb.RESET_FAULT, Verb.SET_SPEED)
_UNSTABLE: Final = ("/dev/ttyUSB", "/dev/ttyACM")


def counted(drives: Sequence[DriveEntry]) -> str:
    """Return `1 drive` or `31 drives`."""
    return "1 drive" if len(drives) == 1 else f"{len(drives)} drives"


def find_warnings(roster: Roster) -> list[str]:
    """Return all warnings of a roster, those of the line first."""
    timing = line_timing(roster.line)
    found = list(_line(roster.line))
    found.extend(_load(roster, timing))
    found.extend(_gathered(_feeding(roster)))
    found.extend(_gathered(lost_stops(roster, timing)))
    found.extend(_slow_codes(roster, timing))
    found.extend(_adapter(roster, timing))
    found.extend(_unwatched(roster))
    found.extend(_gathered(text for drive in roster.drives for text in _leases(drive)))
    found.extend(_access(roster.api))
    found.extend(_certificates(roster.api))
    found.extend(_mqtt(roster.mqtt))
    found.extend(_groups(roster))
    found.extend(_gathered(text for drive in roster.drives for text in _watchdog(drive)))
    found.extend(_gathered(text for drive in roster.drives for text in _faults_unseen(drive)))
    found.extend(_gathered(text for drive in roster.drives for text in _writable(drive)))
    found.extend(_gathered(text for drive in roster.drives for text in _verbs(drive)))
    return found


def _gathered(found: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield the warnings of drives, each once for all drives that it is true of.

    Args:
        found: Names of drives, and the warning of each.
    """
    drives: dict[str, list[str]] = {}
    for name, text in found:
        drives.setdefault(text, []).append(name)
    for text, names in drives.items():
        first = names[0] if len(names) == 1 else f"{len(names)} drives ({', '.join(names)})"
        yield f"{first}: {text}"


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


def cyclic_load(roster: Roster) -> float:
    """Return the share of the line that the cyclic reads ask for; above 1 they are stretched."""
    timing = line_timing(roster.line)
    return sum(
        read_times(drive, entry.code, timing).usual_s / entry.every_s
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


def _feeding(roster: Roster) -> Iterator[tuple[str, str]]:
    """Warn of watchdogs that act when one more answer is lost than `line.tolerate`."""
    demand = demand_of(roster)
    lost = demand.tolerate + 1
    if demand.overload(lost=lost) is None:
        return
    least_s = least_time_s(demand, lost=lost)
    for drive in demand.drives:
        time_s = watched_s(drive)
        if time_s is not None and (least_s is None or time_s < least_s):
            outlast = "" if least_s is None else f"; {rounded_up(least_s)} would outlast that"
            text = f"a watchdog of {format_duration(time_s)} may act when {_lost(lost)} lost"
            yield drive.name, text + outlast


def lost_stops(roster: Roster, timing: LineTiming) -> Iterator[tuple[str, str]]:
    """Warn of watchdogs that act when several of the lost answers are those of its own stop.

    The first telegram of a stop waits for nothing, and for each of the others no more is kept than
    for a lost feed. The warning gives the least number of these that is too many.
    """
    demand = demand_of(roster, timing)
    tolerate = demand.tolerate
    for drive in demand.drives if tolerate > 1 else ():
        time_s, failed_s = watched_s(drive) or 0.0, stop_attempt_s(drive, timing)
        left_s = (1.0 - HARD_PART) * time_s + demand.behind_s()
        for lost in range(2, tolerate + 1):
            if lost * failed_s + (tolerate - lost) * demand.lost_s > left_s:
                yield (
                    drive.name,
                    f"its watchdog may act when {_lost(lost)} lost that are all of one stop of "
                    f"this drive: each holds the line for {format_duration(round(failed_s, 3))}; "
                    "it is being stopped",
                )
                break


def _lost(count: int) -> str:
    return "an answer is" if count == 1 else f"{('two', 'three', 'four')[count - 2]} answers are"


def _adapter(roster: Roster, timing: LineTiming) -> Iterator[str]:
    """Warn of watchdogs that are held only while the adapter adds less than it may."""
    demand = demand_of(roster, with_slow_adapter(timing))
    if demand.holds():
        return
    least_s = least_time_s(demand)
    raised = "" if least_s is None else f"{rounded_up(least_s)} would outlast that, or "
    yield (
        f"watchdogs act if the adapter adds its {format_duration(timing.adapter_latency_s)} to "
        f"every answer: {raised}give the adapter_latency that yours really has"
    )


def _slow_codes(roster: Roster, timing: LineTiming) -> Iterator[str]:
    """Warn of watchdogs whose own codes take longer to read than the others can go unfed.

    The schedule begins nothing that could make a feed late, so it never begins such a read: the
    watchdog would stay as it is in the drive, and only a remark on the drive would show it.
    """
    feeds = feeds_of(roster, timing)
    if not feeds.by_drive:
        return
    room_s = feeds.most_s("")[0]
    slow: list[tuple[float, DriveEntry, Code]] = []
    for drive in roster.drives:
        traits = family(drive.family).watchdog
        if drive.watchdog is not None and traits is not None:
            times = read_times(drive, traits.action_code, timing)
            needs_s = feeds.least_room_s(times.usual_s, times.worst_s)
            if needs_s > room_s:
                slow.append((needs_s, drive, traits.action_code))
    if slow:
        needs_s, drive, code = max(slow, key=_first)
        times = read_times(drive, code, timing)
        held = f"may hold the line for {needs_s:.2f} s"
        if needs_s > times.worst_s:
            held = f"takes {needs_s:.2f} s with a stop behind it and a lost answer"
        left = f"{room_s:.2f} s is left" if room_s > 0 else "no time is left"
        which = "watchdog" if len(slow) == 1 else "watchdogs"
        fed = "the others are" if len(feeds.by_drive) > 1 else "it is"
        least_s = _least_beside_s(feeds, times)
        longer = f"a watchdog time of at least {_up(least_s)} s, " if least_s is not None else ""
        spoken = family(drive.family).spoken(code)
        yield (
            f"the {which} of {counted([drive for _, drive, _ in slow])} "
            f"({', '.join(drive.name for _, drive, _ in slow)}) can be neither checked nor set "
            f"while {fed} fed: reading {spoken} {held} and {left}; {longer}a higher baud rate or "
            "fewer drives on the line would do"
        )


def _least_beside_s(feeds: WatchdogSet, times: Times) -> float | None:
    """Return the least watchdog time beside which an exchange is begun, seconds; None: none.

    Times below are taken to be raised to it.
    """
    before_s = {name: feed.time_s for name, feed in feeds.by_drive.items()}

    def begins(time_s: float) -> bool:
        for name, feed in feeds.by_drive.items():
            feed.time_s = max(before_s[name], time_s)
        feeds.changed()
        return feeds.least_room_s(times.usual_s, times.worst_s) <= feeds.most_s("")[0]

    return smallest(begins, min(before_s.values()), LONGEST_S)


def _up(seconds: float) -> str:
    """Write a time rounded up to tenths: rounded down it would not do."""
    return f"{math.ceil(round(seconds * 10, 6)) / 10:.1f}"


def _unwatched(roster: Roster) -> Iterator[str]:
    names = [drive.name for drive in roster.drives
             if drive.watchdog is None and family(drive.family).watchdog is not None]  # fmt: skip
    if names:
        shown = ", ".join(names[:6]) + (" .." if len(names) > 6 else "")
        they = "they run on if the line is cut, or stop if theirs is set in the drive"
        if len(names) == 1:
            they = "it runs on if the line is cut, or stops if its own is set in the drive"
        yield (
            f"no watchdog is looked after in {len(names)} of {counted(roster.drives)} "
            f"({shown}): {they}"
        )


def _leases(drive: DriveEntry) -> Iterator[tuple[str, str]]:
    """Warn of what the end of a lease cannot do, or does besides."""
    lease, watchdog = drive.lease, drive.watchdog  # also of one that clients need not take
    if lease.on_lapse == "hold":
        yield drive.name, "on_lapse hold lets the drive run on, and shows as a permanent alarm"
    elif (
        lease.on_lapse == "silence"
        and watchdog is not None
        and watchdog.action != "quick-stop"
        and drive.stop_fallback == "none"
    ):
        yield (
            drive.name,
            f"on_lapse silence ends in {watchdog.action} by its watchdog, which stop_fallback none "
            "does not change",
        )
    elif lease.on_lapse == "inhibit" and drive.stop_fallback == "none":
        yield (
            drive.name,
            "on_lapse inhibit lets the motor coast, which stop_fallback none does not change: "
            "quick-stop keeps the load",
        )


def _access(api: ApiEntry) -> Iterator[str]:
    """Warn of keys that only TCP uses, and of an address that every network reaches."""
    given = {"tokens": api.tokens, "tls": api.tls, "hosts": api.hosts}
    unused = [f"api.{key}" for key, value in given.items() if value]
    if api.http is None:
        if unused:
            yield f"{', '.join(unused)}: without api.http there is no TCP server to use it"
    elif api.http.host in ("0.0.0.0", "::"):
        yield (
            f"api.http {api.http} listens in every network that this machine is in; one address "
            "of it may be enough"
        )


def _certificates(api: ApiEntry) -> Iterator[str]:
    """Warn of certificates that soon expire, where their files can be read here."""
    if api.tls is None:
        return
    with contextlib.suppress(OSError, ValueError):  # they may be on another machine
        for key, expires_s in expiries_of(api.tls).items():
            if text := expiry_text(expires_s, time.time()):
                yield f"api.tls.{key} {getattr(api.tls, key)}: {text}"


def _mqtt(mqtt: MqttEntry | None) -> Iterator[str]:
    """Warn of a broker on the network that is spoken to in plain text."""
    if mqtt is None or mqtt.tls or is_loopback(mqtt.host):
        return
    what = "the password and " if mqtt.password_file else ""
    yield f"mqtt.tls false: everyone on the way reads {what}what is sent, and can change it"
    if mqtt.control:
        yield "mqtt.control without TLS: everyone on the way can start motors"


def _groups(roster: Roster) -> Iterator[str]:
    for name, group in roster.groups.items():
        if group.multicast and group.multicast_address is None:
            yield (
                f"group {name}: multicast does nothing, because no telegram reaches exactly these "
                "drives; give it all drives of one decade, or remove multicast"
            )


def _watchdog(drive: DriveEntry) -> Iterator[tuple[str, str]]:
    traits = family(drive.family).watchdog
    if drive.watchdog is None or traits is None:
        return
    if drive.watchdog.action == "none":
        yield drive.name, "watchdog action none means that nothing stops the drive"
    if traits.volatile and not drive.watchdog.configure:
        yield (
            drive.name,
            "a 2102 module forgets its watchdog at power-off; without configure: true it is only "
            "reported then",
        )


def _faults_unseen(drive: DriveEntry) -> Iterator[tuple[str, str]]:
    """Warn of cyclic reads of its own that leave out what shows a trip; `[]` is meant so."""
    of = family(drive.family)
    telling = [code for code in of.words if of.active_fault(code, 0) is not None]
    if drive.cyclic and telling and not any(entry.code in telling for entry in drive.cyclic):
        yield (
            drive.name,
            f"`cyclic` leaves out {' and '.join(map(of.spoken, telling))}, as it replaces the "
            "family's reads: a trip is not noticed, no alert or message says it; add "
            f"{{code: {telling[0]}, every: 1s}}",
        )


def _writable(drive: DriveEntry) -> Iterator[tuple[str, str]]:
    of = family(drive.family)
    for code in sorted(drive.writable - of.writable):
        info = of.info(code)
        if info is None:
            continue
        named = f"{of.spoken(code)} ({info.name})"
        if not info.writable:
            yield drive.name, f"{named} is writable here, read only in its manual"
        elif info.write_class is WriteClass.SAVE:
            yield drive.name, f"each write of {named} wears the drive's memory"
        elif info.write_class is WriteClass.ADDRESS:
            yield drive.name, f"{named} is never written like other codes"


def _verbs(drive: DriveEntry) -> Iterator[tuple[str, str]]:
    """Warn of a list that takes verbs away, as one that was meant to add a code does."""
    rules = family(drive.family).verbs
    if rules is None:
        return
    if not drive.writable:
        yield (
            drive.name,
            f"no code may be written, so {', '.join(_WRITING)} are refused; stops are sent all the "
            "same",
        )
        return
    missing = {verb: rules.not_writable(verb, drive.writable) for verb in _WRITING}
    without = [
        f"{verb} ({(' or ' if verb is Verb.SET_SPEED else ', ').join(map(str, codes))})"
        for verb, codes in missing.items() if codes
    ]  # fmt: skip
    if without:
        yield (
            drive.name,
            f"`writable` leaves out what these need: {'; '.join(without)}; to add codes to the "
            "family's list, write `also_writable` instead",
        )
