"""From checked values to the models, with everything filled in that follows from something else.

Only called for a roster without mistakes, so every value is there or has a default.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lecombus.config.checks import default_socket, drives_of
from lecombus.config.container_types import Fields, Items
from lecombus.config.keys import ALL
from lecombus.drives import Family, family
from lecombus.fieldbus.protocols import find
from lecombus.parameters import AddressForm, Code, rules_of
from lecombus.parameters.rules import forms_of
from lecombus.roster import (
    ApiEntry,
    CyclicEntry,
    DriveEntry,
    GroupEntry,
    HttpAddress,
    LeaseEntry,
    LineEntry,
    MqttEntry,
    Roster,
    StoredWrites,
    WatchdogEntry,
    group_entry,
)

__all__ = ["STATE_DIR", "build_roster"]

STATE_DIR = Path("/var/lib/lecombus")
"""Where a line keeps its state file unless the roster says another place; the unit makes it."""

_RENAMED = {
    "turnaround": "turnaround_s", "adapter_latency": "adapter_latency_s",
    "late_answer": "late_answer_s", "stall": "stall_s", "time": "time_s", "every": "every_s",
    "answer_time": "answer_time_s",
}  # fmt: skip
_NOT_YET_USED = ("lease", "mqtt", "journal")


def build_roster(roster: Fields, file: str) -> Roster:
    """Return the roster of a file without mistakes."""
    line = LineEntry(**_fields(roster.get("line")))
    lease = _lease(roster.get("lease"), LeaseEntry())
    drives = tuple(_drive(entry, lease) for entry in drives_of(roster))
    others = {key: roster.get(key) for key in ("on_shutdown", "journal") if key in roster.values}
    return Roster(
        file=file, line=line, drives=drives, lease=lease,
        groups=_groups(roster, drives, line.protocol),
        api=_api(roster.get("api"), line.name), mqtt=_mqtt(roster.get("mqtt")),
        state=_state(roster.get("state"), line),
        not_yet_used=_not_yet_used(roster), **others,
    )  # fmt: skip


def _state(given: str | None, line: LineEntry) -> str | None:
    """Return the state file; what simulated drives say is worth nothing after the end."""
    if given is not None or line.port.startswith("sim:"):
        return given
    return str(STATE_DIR / f"{line.name}.json")


def _fields(entry: Fields) -> dict[str, Any]:
    """Return the values of a mapping by the names of the models' fields."""
    return {_RENAMED.get(key, key): value for key, value in entry.values.items()}


def _lease(entry: Fields | None, default: LeaseEntry) -> LeaseEntry:
    return default if entry is None else default.model_copy(update=_fields(entry))


def _drive(entry: Fields, lease: LeaseEntry) -> DriveEntry:
    of = family(entry.get("family"))
    watchdog: Fields | None = entry.get("watchdog")
    cyclic: Items | None = entry.get("cyclic")
    forms = _forms(entry.get("addressing"), of)
    # A family's status set may hold a subcode that a drive with `standard` addressing lacks.
    status = [
        CyclicEntry(code=code, every_s=every_s)
        for code, every_s in of.status
        if any(form.carries(code) for form in forms)
    ]
    writable: Items | None = entry.get("writable")
    simple = {key: entry.get(key) for key in ("name", "address", "family")}
    return DriveEntry(
        **simple,
        forms=forms,
        watchdog=None if watchdog is None else WatchdogEntry(**_fields(watchdog)),
        cyclic=tuple(status if cyclic is None
                     else [CyclicEntry(**_fields(item.value)) for item in cyclic]),
        writable=(of.writable if writable is None else frozenset(item.value for item in writable))
        | frozenset(item.value for item in entry.get("also_writable", ())),
        unchecked=frozenset(item.value for item in entry.get("unchecked", ())),
        restore=entry.get("restore", False),
        answer_time_s=entry.get("answer_time"),
        accept_software=tuple(item.value for item in entry.get("accept_software", ())),
        allow_address_change=entry.get("allow_address_change", False),
        identity={Code.parse(at.text): text for at, text in entry.get("identity", ())},
        stored_writes=_stored_writes(entry.get("stored_writes")),
        lease=_lease(entry.get("lease"), lease),
        stop_fallback=entry.get("stop_fallback", "inhibit"),
    )  # fmt: skip


def _stored_writes(entry: Fields | None) -> StoredWrites:
    return StoredWrites() if entry is None else StoredWrites(**_fields(entry))


def _forms(addressing: str | None, of: Family) -> tuple[AddressForm, ...]:
    """Return the forms that a drive is spoken to in."""
    return of.forms if addressing is None else forms_of(rules_of(of.protocol), addressing)


def _groups(roster: Fields, drives: Sequence[DriveEntry], protocol: str) -> dict[str, GroupEntry]:
    address_of = find(protocol).multicast_address
    addresses = {drive.name: drive.address for drive in drives}
    members = {ALL: tuple(addresses)}
    multicast: set[str] = set()
    for at, group in roster.get("groups", ()):
        if at.text != ALL:
            members[at.text] = tuple(item.value for item in group.get("members"))
        if group.get("multicast", False):
            multicast.add(at.text)
    return {
        name: group_entry(names, addresses, multicast=name in multicast, address_of=address_of)
        for name, names in members.items()
    }


def _api(entry: Fields | None, line: str) -> ApiEntry:
    if entry is None:
        return ApiEntry(socket=default_socket(line))
    http = entry.get("http")
    return ApiEntry(
        socket=entry.get("socket", default_socket(line)),
        http=None if http is None else HttpAddress(host=http[0], port=http[1]),
        tokens=entry.get("tokens"),
    )


def _mqtt(entry: Fields | None) -> MqttEntry | None:
    if entry is None:
        return None
    tls = entry.get("tls", True)
    return MqttEntry(host=entry.get("host"), tls=tls, port=entry.get("port", 8883 if tls else 1883))


def _not_yet_used(roster: Fields) -> tuple[str, ...]:
    """List the keys given that nothing in this version acts on."""
    found = [key for key in _NOT_YET_USED if key in roster.values]
    api = roster.get("api")
    if isinstance(api, Fields) and "tokens" in api.values:
        found.append("api.tokens")
    found.extend(
        f"drives.{drive.get('name')}.lease" for drive in drives_of(roster)
        if "lease" in drive.values
    )  # fmt: skip
    return tuple(found)
