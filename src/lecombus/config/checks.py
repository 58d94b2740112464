"""Rules between the keys of a roster: what is wrong only when two values are seen together.

Each check gets what could be read, complete or not, and notes what is wrong with it; a missing or
unusable value has been noted already, and the rules that need it are skipped.

First the line, the drives compared with each other, groups, and the end; then the keys of one
drive, above all the rules that follow from its family. Without a usable family only those apply
that need none. The API, files and bridges have theirs in `interface_checks`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from lecombus.capacity.watchdog_feasibility import find_infeasible
from lecombus.config.container_types import Fields, Item, Items
from lecombus.config.interface_checks import check_interfaces
from lecombus.config.mistakes import Mistakes, Position, did_you_mean, one_of, shown
from lecombus.config.scalar_types import UNUSABLE
from lecombus.config.yaml_nodes import Scalar
from lecombus.drives import Family, StopAction, WatchdogTraits, family, knows_stop
from lecombus.durations import format_duration
from lecombus.errors import CodeValueError
from lecombus.fieldbus.protocols import Fieldbus, find
from lecombus.parameters import Code
from lecombus.parameters.codes import forms_of
from lecombus.roster import Roster, is_network_port

__all__ = [
    "check_drive",
    "check_feasibility",
    "check_lapse",
    "check_roster",
    "check_silence",
    "default_socket",
    "drives_of",
]


def default_socket(line: str) -> str:
    """Return the API's socket for a line, where the roster names none; a name always fits."""
    return f"/run/lecombus/{line}.sock"


def drives_of(roster: Fields) -> list[Fields]:
    """Return the drives that could be read at all."""
    drives = roster.get("drives")
    return [item.value for item in drives] if isinstance(drives, Items) else []


def check_roster(roster: Fields, protocol: str, mistakes: Mistakes) -> None:
    """Note everything that is wrong between the keys of a roster.

    Args:
        roster: What could be read.
        protocol: The protocol of its line.
        mistakes: Noted into.
    """
    fieldbus = find(protocol)
    drives = drives_of(roster)
    line = roster.get("line")
    if isinstance(line, Fields):
        _check_line(line, mistakes)
        _check_count(line, roster, fieldbus, mistakes)
    for drive in drives:
        check_drive(drive, fieldbus, mistakes)
    _check_names(drives, mistakes)
    _check_addresses(drives, fieldbus, mistakes)
    _check_groups(roster, drives, mistakes)
    _check_shutdown(roster, drives, mistakes)
    _check_default_lapse(roster, drives, mistakes)
    check_interfaces(roster, mistakes)


def check_feasibility(entries: Fields, roster: Roster, mistakes: Mistakes) -> None:
    """Note every watchdog that the line cannot hold.

    Args:
        entries: The roster as it stands in the file, for the places.
        roster: The same, built: what a line can hold depends on all of it.
        mistakes: Noted into.
    """
    unheld = {one.drive: one for one in find_infeasible(roster)}
    for drive in drives_of(entries):
        one = unheld.get(drive.get("name"))
        watchdog = drive.get("watchdog")
        if one is not None and isinstance(watchdog, Fields):
            mistakes.note(watchdog.place("time"), one.what, one.right)


def _check_line(line: Fields, mistakes: Mistakes) -> None:
    direction = line.get("direction")
    port = line.get("port", "")
    if direction in {"kernel", "rts"} and is_network_port(port):
        what = f"direction {direction} cannot work on {shown(port)}"
        right = "a device server switches its transceiver itself: write adapter"
        mistakes.note(line.place("direction"), what, right)
    if line.get("repeaters") and line.get("medium", "rs485") != "rs485":
        what = f"medium {line.get('medium')} has no repeaters"
        mistakes.note(line.place("repeaters"), what, "remove the key, or write medium: rs485")


def _check_count(line: Fields, roster: Fields, fieldbus: Fieldbus, mistakes: Mistakes) -> None:
    """Note each drive beyond what the medium takes, at the first one too many."""
    medium = line.get("medium", None if "medium" in line.nodes else "rs485")
    if medium is None or not isinstance(roster.get("drives"), Items):
        return
    most, with_repeaters = fieldbus.most_drives[medium], fieldbus.most_with_repeaters
    if medium == "rs485" and line.get("repeaters"):
        most = with_repeaters
    drives = drives_of(roster)
    if len(drives) <= most:
        return
    what = f"there are {len(drives)} drives, but {medium} takes {most}"
    right = "remove drives or split them over two lines"
    if medium == "rs485" and most < with_repeaters:
        right = f"split them over two lines, or write repeaters: true for {with_repeaters}"
    if medium == "rs232":
        right = "keep one drive, or write medium: rs485"
    mistakes.note(drives[most].node, what, right)


def _check_names(drives: list[Fields], mistakes: Mistakes) -> None:
    first: dict[str, Fields] = {}
    for drive in drives:
        name = drive.get("name")
        if name is None:
            continue
        other = first.setdefault(name, drive)
        if other is not drive:
            what = f"a drive named {shown(name)} stands in line {other.place('name').line} already"
            mistakes.note(drive.place("name"), what, "every drive needs its own name")


def _check_addresses(drives: list[Fields], fieldbus: Fieldbus, mistakes: Mistakes) -> None:
    first: dict[int, Fields] = {}
    for drive in drives:
        address = drive.get("address")
        if address is None:
            continue
        other = first.setdefault(address, drive)
        if other is not drive:
            named = f"drive {shown(other.get('name', 'without a name'))}"
            line = other.place("address").line
            what = f"address {address} is that of {named} in line {line} already"
            mistakes.note(drive.place("address"), what, _free_address(address, drives, fieldbus))


def _free_address(near: int, drives: list[Fields], fieldbus: Fieldbus) -> str:
    """Return a remedy that names the next free address."""
    taken = {drive.get("address") for drive in drives}
    upwards = range(near, fieldbus.highest_address + 1)
    downwards = range(near, fieldbus.lowest_address - 1, -1)
    free = [number for number in (*upwards, *downwards)
            if fieldbus.is_address(number) and number not in taken]  # fmt: skip
    return f"every drive needs its own; {free[0]} is free" if free else "every drive needs its own"


def _check_groups(roster: Fields, drives: list[Fields], mistakes: Mistakes) -> None:
    names = {drive.get("name"): drive for drive in drives if drive.get("name") is not None}
    for at, group in roster.get("groups", ()):
        namesake = names.get(at.text)
        if namesake is not None:
            what = f"{shown(at.text)} is also a drive (line {namesake.place('name').line})"
            mistakes.note(at, what, "give the group another name")
        members = group.get("members")
        if isinstance(members, Items):
            # Names that could not be read are known no less: the drive's entry was refused.
            known = {text for drive in drives if (text := _written_name(drive)) is not None}
            _check_members(at.text, members, known, mistakes)


def _written_name(drive: Fields) -> str | None:
    node = drive.nodes.get("name")
    return node.text if isinstance(node, Scalar) else None


def _check_members(group: str, members: Items, known: set[str], mistakes: Mistakes) -> None:
    seen: set[str] = set()
    for item in members:
        if item.value in seen:
            what = f"{shown(item.value)} is a member of {shown(group)} twice"
            mistakes.note(item.node, what, "keep one of the two")
        elif item.value not in known:
            member = shown(item.value)
            what = f"the group {shown(group)} has the member {member}, which is not a drive"
            drives = f"the drives are {_some(known)}" if known else "name a drive of this roster"
            mistakes.note(item.node, what, did_you_mean(item.value, known, drives))
        seen.add(item.value)


def _some(names: Iterable[str], most: int = 8) -> str:
    ordered = sorted(names)
    return one_of(ordered) if len(ordered) <= most else f"{', '.join(ordered[:most])} .."


def _check_shutdown(roster: Fields, drives: list[Fields], mistakes: Mistakes) -> None:
    action = roster.get("on_shutdown", "nothing")
    if action == "nothing":
        return
    cannot = [drive for drive in drives if drive.get("family") is not None
              and not knows_stop(family(drive.get("family")), StopAction(action))]  # fmt: skip
    if not cannot:
        return
    first = cannot[0]
    what = (
        f"on_shutdown is {action}, but family {first.get('family')} of drive "
        f"{shown(first.get('name', '?'))} (line {first.node.line}) knows no {action}"
    )
    others = [word for word in StopAction if word != action and all(
        knows_stop(family(drive.get("family")), word) for drive in cannot)]  # fmt: skip
    mistakes.note(
        roster.place("on_shutdown"),
        what,
        f"write {one_of(f'`{word}`' for word in [*others, 'nothing'])}",
    )


def _check_default_lapse(roster: Fields, drives: list[Fields], mistakes: Mistakes) -> None:
    """Check the default of `lease` against each drive that does not say otherwise."""
    default = roster.get("lease")
    required = isinstance(default, Fields) and default.get("required", False)
    fallback = (
        default.get("on_lapse", "quick-stop") if isinstance(default, Fields) else "quick-stop"
    )
    for drive in drives:
        own = drive.get("lease", UNUSABLE)
        given = own if isinstance(own, Fields) else None
        needs = given.get("required", required) if given is not None else required
        says = given is not None and "on_lapse" in given.nodes
        if needs and not says:
            check_lapse(drive, fallback, drive.place("lease"), mistakes)
        action = given.get("on_lapse", fallback) if given is not None else fallback
        if action == "silence":  # also where none is required: a client may take one all the same
            check_silence(drive, drive.place("lease"), mistakes)


WRITABLE = ("writable", "also_writable")
"""The keys that list what may be written."""


def check_drive(drive: Fields, fieldbus: Fieldbus, mistakes: Mistakes) -> None:
    """Note everything that is wrong inside one drive's entry."""
    _check_doubles(drive, mistakes)
    _check_forms(drive, fieldbus, mistakes)
    name = drive.get("family")
    watchdog = drive.get("watchdog")
    if name is None:
        if isinstance(watchdog, Fields):
            _check_watchdog_of_any(watchdog, fieldbus, mistakes)
        return
    of = family(name)
    if of.watchdog is None and "watchdog" in drive.nodes:
        what = f"no watchdog is known for family {name}"
        mistakes.note(drive.place("watchdog"), what, "remove the key")
    elif of.watchdog is not None and isinstance(watchdog, Fields):
        _check_watchdog(watchdog, name, of.watchdog, mistakes)
    _check_codes(drive, of, mistakes)
    lease = drive.get("lease")
    if isinstance(lease, Fields) and "on_lapse" in lease.values:
        check_lapse(drive, lease.get("on_lapse"), lease.place("on_lapse"), mistakes)


def check_lapse(drive: Fields, action: str, place: Position, mistakes: Mistakes) -> None:
    """Note a lapse action that the drive's family does not know."""
    name = drive.get("family")
    if name is None or action not in set(StopAction):
        return
    if not knows_stop(family(name), StopAction(action)):
        what = f"on_lapse is {action}, but family {name} knows no {action}"
        mistakes.note(place, what, f"write on_lapse: {one_of(_lapses_of(name))}")


def _lapses_of(name: str) -> list[str]:
    """Return what a lapse may do to drives of a family: silence needs a watchdog."""
    known: list[str] = [word for word in StopAction if knows_stop(family(name), word)]
    return [*known, *(["silence"] if family(name).watchdog is not None else []), "hold"]


def check_silence(drive: Fields, place: Position, mistakes: Mistakes) -> None:
    """Note a lease at whose end nothing would stop the drive: silence without a watchdog."""
    watchdog = drive.get("watchdog")
    if watchdog is UNUSABLE or (isinstance(watchdog, Fields) and watchdog.get("action") != "none"):
        return  # of what cannot be read the mistake is noted already
    name = drive.get("family")
    known = [*StopAction, "hold"] if name is None else _lapses_of(name)
    right = f"write on_lapse: {one_of(word for word in known if word != 'silence')}"
    if name is None or family(name).watchdog is not None:
        right = f"give it a `watchdog`, or {right}"
    mistakes.note(
        place,
        f"on_lapse is silence, but nothing stops {drive.get('name')} then: the roster gives it no "
        "watchdog that acts",
        right,
    )


def _check_watchdog_of_any(watchdog: Fields, fieldbus: Fieldbus, mistakes: Mistakes) -> None:
    """Note what no family's watchdog can do, where the family is not known."""
    all_of = map(family, fieldbus.families)
    known = [of.watchdog for of in all_of if of.watchdog is not None]
    if not known:
        return
    low_s, high_s = min(one.low_s for one in known), max(one.high_s for one in known)
    actions = list(dict.fromkeys(action for one in known for action in one.actions))
    time_s, action = watchdog.get("time"), watchdog.get("action")
    if time_s is not None and not low_s <= time_s <= high_s:
        what = f"a watchdog time of {format_duration(time_s)} is out of range for every family"
        mistakes.note(watchdog.place("time"), what, _range(low_s, high_s))
    elif time_s is not None:
        _check_whole_ms(time_s, watchdog.place("time"), mistakes)
    if action is not None and action not in actions:
        _note_action(watchdog.place("action"), "no family's watchdog has an action", action,
                     actions, mistakes)  # fmt: skip


def _note_action(
    place: Position, who: str, action: str, actions: Collection[str], mistakes: Mistakes
) -> None:
    allowed = one_of(actions)
    right = did_you_mean(action, actions, f"{allowed} would be right")
    right = right if right.startswith(allowed) else f"{right} {allowed} would be right"
    mistakes.note(place, f"{who} {shown(action)}", right)


def _check_watchdog(
    watchdog: Fields, name: str, traits: WatchdogTraits, mistakes: Mistakes
) -> None:
    time_s = watchdog.get("time")
    if time_s is not None:
        _check_time(time_s, watchdog.place("time"), name, traits, mistakes)
    action = watchdog.get("action")
    if action is not None and action not in traits.actions:
        who = f"the watchdog of family {name} has no action"
        _note_action(watchdog.place("action"), who, action, traits.actions, mistakes)


def _check_time(
    time_s: float, place: Position, name: str, traits: WatchdogTraits, mistakes: Mistakes
) -> None:
    if not traits.low_s <= time_s <= traits.high_s:
        what = f"a watchdog time of {format_duration(time_s)} is out of range for family {name}"
        mistakes.note(place, what, _range(traits.low_s, traits.high_s))
    else:
        _check_whole_ms(time_s, place, mistakes)


def _range(low_s: float, high_s: float) -> str:
    return f"{format_duration(max(low_s, 0.001))} to {format_duration(high_s)} would be right"


def _check_whole_ms(time_s: float, place: Position, mistakes: Mistakes) -> None:
    if abs(time_s * 1000 - round(time_s * 1000)) > 1e-6:
        what = f"a watchdog time of {format_duration(time_s)} is not a whole number of milliseconds"
        mistakes.note(place, what, f"write {round(time_s * 1000)}ms")


def _codes(drive: Fields, key: str) -> list[Item]:
    """Return the codes under a key that could be read, with their places."""
    items = drive.get(key)
    if key == "identity":
        known = ((at, _code_of(at.text)) for at, _ in items or ())
        return [Item(at, code) for at, code in known if code is not None]
    if not isinstance(items, Items):
        return []
    if key in (*WRITABLE, "unchecked"):
        return list(items)
    entries = [item.value for item in items if "code" in item.value.values]
    return [Item(entry.place("code"), entry.get("code")) for entry in entries]


def _code_of(text: str) -> Code | None:
    try:
        return Code.parse(text)
    except CodeValueError:
        return None


def _check_doubles(drive: Fields, mistakes: Mistakes) -> None:
    ways = (
        ("cyclic", "read cyclically"),
        ("writable", "writable"),
        ("also_writable", "writable"),
        ("unchecked", "unchecked"),
        ("identity", "given"),
    )
    for key, doing in ways:
        first: dict[Code, Item] = {}
        for item in _codes(drive, key):
            other = first.setdefault(item.value, item)
            if other is not item:
                what = f"{item.value} is {doing} already (line {other.node.line})"
                mistakes.note(item.node, what, "keep one of the two")


def _check_forms(drive: Fields, fieldbus: Fieldbus, mistakes: Mistakes) -> None:
    """Note codes that the drive's addressing cannot carry."""
    name = drive.get("family")
    addressing = drive.get("addressing")
    if addressing is not None:
        forms = forms_of(fieldbus.rules, addressing)
    elif name is not None and "addressing" not in drive.nodes:
        forms = family(name).forms
    else:
        return
    for key in ("cyclic", *WRITABLE, "identity"):
        for item in _codes(drive, key):
            if not any(form.carries(item.value) for form in forms):
                mistakes.note(item.node, *fieldbus.uncarried(item.value))


def _check_codes(drive: Fields, of: Family, mistakes: Mistakes) -> None:
    """Refuse cyclic passwords, and to write what changes how the drive is reached."""
    for item in (item for item in _codes(drive, "cyclic") if of.is_secret(item.value)):
        what = f"{of.spoken(item.value)} is a password, so it is not read unasked"
        mistakes.note(item.node, what, "remove it")
    if drive.get("allow_address_change", "allow_address_change" in drive.nodes):
        return
    for item in (item for key in WRITABLE for item in _codes(drive, key)):
        moved = find(of.protocol).moves_drive(of, item.value)
        if moved is not None:
            what = f"{of.spoken(item.value)} {moved} and is never written like other codes"
            right = (
                "remove it: `lecombus readdress` changes an address, with allow_address_change, "
                "`lecombus rebaud` a baud rate"
            )
            mistakes.note(item.node, what, right)
