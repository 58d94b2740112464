"""Rules between the keys of one drive, above all those that follow from its family.

See `checks` for how a check behaves. Without a usable family only the rules that need none apply.
"""

from __future__ import annotations

from lecombus.config.durations import format_duration
from lecombus.config.mistakes import Mistakes, Place, did_you_mean, one_of, shown
from lecombus.config.shapes import Entry, Item, Items
from lecombus.drives import Family, StopAction, WatchdogTraits, WriteClass, family, knows_stop
from lecombus.protocol.addressing import Code, Form

__all__ = ["check_drive", "check_lapse"]


def check_drive(drive: Entry, mistakes: Mistakes) -> None:
    """Note everything that is wrong inside one drive's entry."""
    _check_doubles(drive, mistakes)
    _check_forms(drive, mistakes)
    name = drive.get("family")
    if name is None:
        return
    of = family(name)
    watchdog = drive.get("watchdog")
    if of.watchdog is None and "watchdog" in drive.nodes:
        what = f"no watchdog is known for family {name}"
        mistakes.note(drive.place("watchdog"), what, "remove the key")
    elif of.watchdog is not None and isinstance(watchdog, Entry):
        _check_watchdog(watchdog, name, of.watchdog, mistakes)
    _check_writable(drive, of, mistakes)
    lease = drive.get("lease")
    if isinstance(lease, Entry) and "on_lapse" in lease.values:
        check_lapse(drive, lease.get("on_lapse"), lease.place("on_lapse"), mistakes)


def check_lapse(drive: Entry, action: str, place: Place, mistakes: Mistakes) -> None:
    """Note a lapse action that the drive's family does not know."""
    name = drive.get("family")
    if name is None or action not in set(StopAction):
        return
    if not knows_stop(family(name), StopAction(action)):
        what = f"on_lapse is {action}, but family {name} knows no {action}"
        known = [word for word in StopAction if knows_stop(family(name), word)]
        mistakes.note(place, what, f"write on_lapse: {one_of([*known, 'silence', 'hold'])}")


def _check_watchdog(watchdog: Entry, name: str, traits: WatchdogTraits, mistakes: Mistakes) -> None:
    time_s = watchdog.get("time")
    if time_s is not None:
        _check_time(time_s, watchdog.place("time"), name, traits, mistakes)
    action = watchdog.get("action")
    if action is not None and action not in traits.actions:
        allowed = one_of(traits.actions)
        what = f"the watchdog of family {name} has no action {shown(action)}"
        right = did_you_mean(action, traits.actions, f"{allowed} would be right")
        right = right if right.startswith(allowed) else f"{right} {allowed} would be right"
        mistakes.note(watchdog.place("action"), what, right)


def _check_time(
    time_s: float, place: Place, name: str, traits: WatchdogTraits, mistakes: Mistakes
) -> None:
    if not traits.low_s <= time_s <= traits.high_s:
        low = format_duration(max(traits.low_s, 0.001))
        what = f"a watchdog time of {format_duration(time_s)} is out of range for family {name}"
        mistakes.note(place, what, f"{low} to {format_duration(traits.high_s)} would be right")
    elif abs(time_s * 1000 - round(time_s * 1000)) > 1e-6:
        what = f"a watchdog time of {format_duration(time_s)} is no whole number of milliseconds"
        mistakes.note(place, what, f"write {round(time_s * 1000)}ms")


def _codes(drive: Entry, key: str) -> list[Item]:
    """Return the codes under `cyclic` or `writable` that could be read, with their places."""
    items = drive.get(key)
    if not isinstance(items, Items):
        return []
    if key == "writable":
        return list(items)
    entries = [item.value for item in items if "code" in item.value.values]
    return [Item(entry.place("code"), entry.get("code")) for entry in entries]


def _check_doubles(drive: Entry, mistakes: Mistakes) -> None:
    for key, doing in (("cyclic", "read cyclically"), ("writable", "writable")):
        first: dict[Code, Item] = {}
        for item in _codes(drive, key):
            other = first.setdefault(item.value, item)
            if other is not item:
                what = f"{item.value} is {doing} already (line {other.node.line})"
                mistakes.note(item.node, what, "keep one of the two")


def _check_forms(drive: Entry, mistakes: Mistakes) -> None:
    """Note codes that the drive's addressing cannot carry."""
    name = drive.get("family")
    addressing = drive.get("addressing")
    if addressing is None and name is not None and "addressing" not in drive.nodes:
        addressing = "both" if Form.EXTENDED in family(name).forms else "standard"
    if addressing != "standard":
        return
    for key in ("cyclic", "writable"):
        for item in _codes(drive, key):
            if not item.value.knows(Form.STANDARD):
                what = f"{item.value} needs extended addressing, which this drive does not have"
                right = "codes 0 to 6229 without subcode would be right, or addressing: both"
                mistakes.note(item.node, what, right)


def _check_writable(drive: Entry, of: Family, mistakes: Mistakes) -> None:
    """Refuse codes that change how the drive is reached, unless that is asked for in words."""
    if drive.get("allow_address_change", "allow_address_change" in drive.nodes):
        return
    for item in _codes(drive, "writable"):
        info = of.info(item.value)
        if info is not None and info.write_class is WriteClass.ADDRESS:
            what = f"{item.value} ({info.name}) changes how the drive is reached"
            right = "remove it, or write allow_address_change: true for this drive"
            mistakes.note(item.node, what, right)
