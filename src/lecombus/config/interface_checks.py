"""Rules between the keys of what lecombus speaks with, beside the line: the API, files, bridges.

Each check is as those of `checks`, which calls `check_interfaces`.
"""

from __future__ import annotations

from os.path import normpath
from pathlib import Path
from typing import Final

from lecombus.config.container_types import Fields, Items
from lecombus.config.mistakes import Mistakes, shown
from lecombus.roster import is_loopback

__all__ = ["STATE_DIR", "check_interfaces", "usual_state"]

STATE_DIR = Path("/var/lib/lecombus")
"""Where a line keeps its state file unless the roster says another place; the unit makes it."""


def usual_state(line: str, port: str) -> str | None:
    """Return the state file of a line whose roster names none.

    What simulated drives say is worth nothing after the end.
    """
    return None if port.startswith("sim:") else str(STATE_DIR / f"{line}.json")


def check_interfaces(roster: Fields, mistakes: Mistakes) -> None:
    """Note what is wrong in the keys of the API, of files and of bridges.

    Args:
        roster: What could be read.
        mistakes: Noted into.
    """
    _check_access(roster, mistakes)
    _check_written_files(roster, mistakes)
    _check_modbus(roster, mistakes)
    _check_notify(roster, mistakes)
    _check_mqtt(roster, mistakes)


def _check_access(roster: Fields, mistakes: Mistakes) -> None:
    """Note an address that other machines reach, where not every request needs a token and TLS."""
    api = roster.get("api")
    http = api.get("http") if isinstance(api, Fields) else None
    if not isinstance(api, Fields) or http is None or is_loopback(http[0]):
        return
    missing = [f"`{key}`" for key in ("tokens", "tls") if key not in api.nodes]
    if missing:
        what = f"`http` is not local: that needs {' and '.join(missing)} too"
        right = f"give them, or write 127.0.0.1:{http[1]} and use a tunnel, such as ssh -L"
        mistakes.note(api.place("http"), what, right)


WRITTEN: Final = (("journal", "file"), ("", "state"), ("api", "socket"))
"""By part and key: what lecombus makes; a file that has the place already is moved or replaced."""
READ: Final = (("api", "tokens"), *(("tls", key) for key in ("certificate", "key", "client_ca")))


def _check_written_files(roster: Fields, mistakes: Mistakes) -> None:
    """Note a file that lecombus writes and that another key names too, or is the roster."""
    api, line = roster.get("api"), roster.get("line")
    parts = {"": roster, "api": api, "journal": roster.get("journal")}
    parts["tls"] = api.get("tls") if isinstance(api, Fields) else None
    first: dict[str, str] = {}
    if isinstance(line, Fields) and "state" not in roster.nodes and line.get("name") is not None:
        usual = usual_state(line.get("name"), line.get("port", ""))
        first |= {} if usual is None else {usual: "state"}
    for part, key in (*WRITTEN, *READ):
        entry = parts[part]
        path = entry.get(key) if isinstance(entry, Fields) else None
        if path is None or not isinstance(entry, Fields):
            continue
        above = {"": "", "tls": "api.tls."}.get(part, f"{part}.")
        other = first.get(normpath(path))
        if (part, key) in WRITTEN and Path(path).resolve() == Path(mistakes.file).resolve():
            what = f"`{above}{key}` is this roster, in whose place lecombus would write"
            mistakes.note(entry.place(key), what, "give it a file of its own")
        elif other is not None:
            what = f"`{above}{key}` is the file of `{other}` too, which lecombus writes"
            mistakes.note(entry.place(key), what, "give each its own file")
        elif (part, key) in WRITTEN:
            first[normpath(path)] = f"{above}{key}"


def _check_modbus(roster: Fields, mistakes: Mistakes) -> None:
    """Note a Modbus address that other machines reach, without a list of those that may."""
    modbus = roster.get("modbus")
    if not isinstance(modbus, Fields) or is_loopback(modbus.get("host", "127.0.0.1")):
        return
    allow = modbus.get("allow")
    if "allow" not in modbus.nodes or (isinstance(allow, Items) and not allow.items):
        what = "`host` is not local: that needs `allow` too, because Modbus has no passwords"
        right = "list the addresses of the controllers, such as `allow: [192.0.2.7]`"
        mistakes.note(modbus.place("host"), what, right)


def _check_notify(roster: Fields, mistakes: Mistakes) -> None:
    """Note messages that go nowhere, a command that is not found, events named twice."""
    notify = roster.get("notify")
    if not isinstance(notify, Fields):
        return
    if "command" not in notify.nodes and "mail" not in notify.nodes:
        mistakes.note(notify.node, "messages go nowhere", "give `command` or `mail`")
    command, events = notify.get("command"), notify.get("events")
    if isinstance(command, Items) and command.items:
        first = command.items[0]
        if command.complete and not first.value.startswith("/"):
            what = f"the program {shown(first.value)} is not an absolute path"
            mistakes.note(first.node, what, f"write it from /, such as /usr/bin/{first.value}")
    seen: set[str] = set()
    for item in events if isinstance(events, Items) else ():
        if item.value in seen:
            what = f"the event `{item.value}` is there twice"
            mistakes.note(item.node, what, "remove one of them")
        seen.add(item.value)
    mail = notify.get("mail")
    if isinstance(mail, Fields):
        _check_mail(mail, mistakes)


def _check_mail(mail: Fields, mistakes: Mistakes) -> None:
    """Note keys that belong to a mail server where none is named, and passwords others can read."""
    if "host" not in mail.nodes:
        for key in ("port", "security", "user", "password_file", "ca"):
            if key in mail.nodes:
                what = f"`{key}` needs `host`: sendmail of this computer has its own settings"
                mistakes.note(mail.place(key), what, "name the mail server, or remove it")
        return
    for key, other in (("user", "password_file"), ("password_file", "user")):
        if key in mail.nodes and other not in mail.nodes:
            mistakes.note(mail.place(key), f"`{key}` needs `{other}`", "give both, or none")
    if mail.get("security") == "none":
        if "ca" in mail.nodes:
            right = "remove it, or write `security: starttls`"
            mistakes.note(mail.place("ca"), "`ca` is for TLS, which is off", right)
        if "password_file" in mail.nodes and not is_loopback(mail.get("host", "")):
            what = "without TLS everybody on the way can read the password"
            mistakes.note(mail.place("security"), what, "`starttls` or `tls` would be right")


def _check_mqtt(roster: Fields, mistakes: Mistakes) -> None:
    """Note keys of the broker that do nothing without another one."""
    mqtt = roster.get("mqtt")
    if not isinstance(mqtt, Fields):
        return
    for key, other in (("certificate", "key"), ("key", "certificate"),
                       ("password_file", "username")):  # fmt: skip
        if key in mqtt.nodes and other not in mqtt.nodes:
            mistakes.note(mqtt.place(key), f"`{key}` needs `{other}` too", f"give `{other}`")
    if mqtt.get("tls", True) is False:
        for key in ("ca", "certificate", "key"):
            if key in mqtt.nodes:
                what = f"`{key}` is for TLS, which `tls: false` switches off"
                mistakes.note(mqtt.place(key), what, "remove one of them")
