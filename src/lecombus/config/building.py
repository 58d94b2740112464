"""From checked values to the models, with everything filled in that follows from something else.

Only called for a roster without mistakes, so every value is there or has a default.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Final

from lecombus.config.checks import default_socket, drives_of
from lecombus.config.container_types import Fields, Item, Items
from lecombus.config.interface_checks import STATE_DIR, usual_state
from lecombus.config.keys import ALL
from lecombus.drives import Family, family
from lecombus.fieldbus.protocols import find
from lecombus.parameters import AddressForm, Code, rules_of
from lecombus.parameters.codes import forms_of
from lecombus.roster import (
    ApiEntry,
    CyclicEntry,
    DriveEntry,
    GroupEntry,
    HttpAddress,
    JournalEntry,
    LeaseEntry,
    LineEntry,
    MailEntry,
    MessageLimit,
    ModbusEntry,
    MqttEntry,
    NotifyEntry,
    Roster,
    StoredWrites,
    TlsEntry,
    WatchdogEntry,
    group_entry,
)

__all__ = ["RENAMED", "STATE_DIR", "build_roster"]

RENAMED: Final[Mapping[str, str]] = {
    "turnaround": "turnaround_s", "adapter_latency": "adapter_latency_s",
    "late_answer": "late_answer_s", "stall": "stall_s", "time": "time_s", "every": "every_s",
    "answer_time": "answer_time_s", "command_time": "command_time_s", "gather": "gather_s",
    "daemon_gone": "daemon_gone_s", "from": "sender",
    "addressing": "forms",
}  # fmt: skip
"""Keys whose field has another name, in every table of a roster that has such a key.

`changes` names the keys by it: no two keys may have a field of one name.
"""
_BUILT = frozenset(
    {"line", "drives", "lease", "groups", "api", "mqtt", "modbus", "notify", "journal", "state"}
)
"""The keys of a roster that `build_roster` makes more of than their value."""
_COMPLETED = frozenset({"addressing", "cyclic", "writable", "also_writable", "lease"})
"""The keys of a drive whose fields take more than the key itself; `_drive` makes these."""


def build_roster(roster: Fields, file: str) -> Roster:
    """Return the roster of a file without mistakes."""
    line = LineEntry(**_fields(roster.get("line")))
    lease = _lease(roster.get("lease"), LeaseEntry())
    drives = tuple(_drive(entry, lease) for entry in drives_of(roster))
    return Roster(
        **_fields(roster, without=_BUILT),
        file=file, line=line, drives=drives, lease=lease,
        groups=_groups(roster, drives, line.protocol),
        api=_api(roster.get("api"), line.name), mqtt=_mqtt(roster.get("mqtt")),
        modbus=_modbus(roster.get("modbus")), notify=_notify(roster.get("notify")),
        journal=_journal(roster.get("journal")), state=_state(roster.get("state"), line),
    )  # fmt: skip


def _state(given: str | None, line: LineEntry) -> str | None:
    """Return the state file."""
    return usual_state(line.name, line.port) if given is None else given


def _fields(entry: Fields, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the values of a mapping by the names of the models' fields.

    What is absent gets the default of the model, and a key without a field is an error there.
    """
    return {
        RENAMED.get(key, key): _CONVERTED.get(key, _same)(value)
        for key, value in entry.values.items()
        if key not in without
    }


def _same(value: Any) -> Any:
    return value


def _set(items: Iterable[Item]) -> frozenset[Any]:
    return frozenset(item.value for item in items)


_CONVERTED: Final[Mapping[str, Callable[[Any], Any]]] = {
    "watchdog": lambda given: WatchdogEntry(**_fields(given)),
    "unchecked": _set,
    "accept_software": lambda given: tuple(item.value for item in given),
    "identity": lambda given: {Code.parse(at.text): text for at, text in given},
    "stored_writes": lambda given: StoredWrites(**_fields(given)),
    "http": lambda given: HttpAddress(host=given[0], port=given[1]),
    "hosts": lambda given: tuple(item.value.lower() for item in given),
    "units": lambda given: tuple(item.value for item in given),
    "allow": lambda given: tuple(item.value for item in given),
    "command": lambda given: tuple(item.value for item in given),
    "mail": lambda given: MailEntry(**_fields(given)),
    "to": lambda given: tuple(item.value for item in given),
    "events": lambda given: tuple(item.value for item in given),
    "limit": lambda given: MessageLimit(**_fields(given)),
    "tls": lambda given: TlsEntry(**_fields(given)) if isinstance(given, Fields) else given,
}
"""How values become those of fields, for a key of this name in every table of a roster."""


def _lease(entry: Fields | None, default: LeaseEntry) -> LeaseEntry:
    return default if entry is None else LeaseEntry(**default.model_dump() | _fields(entry))


def _drive(entry: Fields, lease: LeaseEntry) -> DriveEntry:
    of = family(entry.get("family"))
    cyclic: Items | None = entry.get("cyclic")
    forms = _forms(entry.get("addressing"), of)
    # A family's status set may hold a subcode that a drive with `standard` addressing lacks.
    status = [
        CyclicEntry(code=code, every_s=every_s)
        for code, every_s in of.status
        if any(form.carries(code) for form in forms)
    ]
    given: Items | None = entry.get("writable")
    writable = of.writable if given is None else _set(given)
    watchdog: Fields | None = entry.get("watchdog")
    owned: frozenset[Code] = frozenset()
    if watchdog is not None and watchdog.get("configure", False) and of.watchdog is not None:
        owned = frozenset((of.watchdog.time_code, of.watchdog.action_code))
    return DriveEntry(
        **_fields(entry, without=_COMPLETED),
        forms=forms,
        cyclic=tuple(status if cyclic is None
                     else [CyclicEntry(**_fields(item.value)) for item in cyclic]),
        writable=(writable | _set(entry.get("also_writable", ()))) - owned,
        owned=owned,
        lease=_lease(entry.get("lease"), lease),
    )  # fmt: skip


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
    given = {} if entry is None else _fields(entry)
    return ApiEntry(**{"socket": default_socket(line)} | given)


def _mqtt(entry: Fields | None) -> MqttEntry | None:
    if entry is None:
        return None
    usual_port = 8883 if entry.get("tls", True) else 1883
    return MqttEntry(**{"port": usual_port} | _fields(entry))


def _modbus(entry: Fields | None) -> ModbusEntry | None:
    return None if entry is None else ModbusEntry(**_fields(entry))


def _notify(entry: Fields | None) -> NotifyEntry | None:
    return None if entry is None else NotifyEntry(**_fields(entry))


def _journal(entry: Fields | None) -> JournalEntry | None:
    return None if entry is None else JournalEntry(**_fields(entry))
