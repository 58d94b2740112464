"""Rules between the keys of one drive, above all those that follow from its family.

See `checks` for how a check behaves. Without a usable family only the rules that need none apply.
"""

from __future__ import annotations

from collections.abc import Collection

from lecombus.config.container_types import Fields, Item, Items
from lecombus.config.mistakes import Mistakes, Position, did_you_mean, one_of, shown
from lecombus.drives import Family, StopAction, WatchdogTraits, family, knows_stop
from lecombus.durations import format_duration
from lecombus.errors import CodeValueError
from lecombus.fieldbus.protocols import Fieldbus, find
from lecombus.parameters import Code
from lecombus.parameters.rules import forms_of

__all__ = ["check_drive", "check_lapse"]

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
    _check_writable(drive, of, mistakes)
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
        known = [word for word in StopAction if knows_stop(family(name), word)]
        mistakes.note(place, what, f"write on_lapse: {one_of([*known, 'silence', 'hold'])}")


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
        what = f"a watchdog time of {format_duration(time_s)} is no whole number of milliseconds"
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


def _check_writable(drive: Fields, of: Family, mistakes: Mistakes) -> None:
    """Refuse codes that change how the drive is reached; listed beside the key, they do nothing."""
    if drive.get("allow_address_change", "allow_address_change" in drive.nodes):
        return
    for item in (item for key in WRITABLE for item in _codes(drive, key)):
        moved = find(of.protocol).moves_drive(of, item.value)
        if moved is not None:
            what = f"{of.spoken(item.value)} {moved} and is never written like other codes"
            right = "remove it: `lecombus readdress` changes an address, with allow_address_change"
            mistakes.note(item.node, what, right)
