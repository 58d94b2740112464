"""The entry point: a file or a text becomes a `Roster`, or one `RosterError` with all mistakes.

Steps, each in its own module: text to nodes (`yaml_nodes`), nodes to values (`keys`), rules between
values (`checks`), values to models (`building`), whether the line can hold the watchdogs
(`capacity.watchdog_feasibility`), and at a reload what only a restart changes (`changes`). Only a
file that cannot be read and text that is no YAML end it early.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from lecombus import __version__
from lecombus.config.building import build_roster
from lecombus.config.changes import check_restart
from lecombus.config.checks import check_feasibility, check_roster
from lecombus.config.container_types import Fields
from lecombus.config.keys import ROSTER_VERSION, roster_table
from lecombus.config.mistakes import Mistakes, RosterError, Spot
from lecombus.config.yaml_nodes import MappingNode, Scalar, compose
from lecombus.fieldbus.protocols import names
from lecombus.roster import Roster

__all__ = ["load_roster", "parse_roster"]

LARGEST: Final = 1024 * 1024
"""Largest file read, in bytes; 90 drives with everything spelled out take about 60,000."""


def load_roster(path: Path, running: Roster | None = None) -> Roster:
    """Read a roster.

    Args:
        path: The file; mistakes name it as it is given here.
        running: The roster in use: what of it only a restart changes must be the same.

    Raises:
        RosterError: It cannot be read or used; carries every mistake.
    """
    file = str(path)
    mistakes = Mistakes(file)
    data = _read(path, mistakes)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as exc:
        before = data[: exc.start]
        column = len(before[before.rfind(b"\n") + 1 :].decode("utf-8")) + 1
        spot = Spot(before.count(b"\n") + 1, column)
        what = f"the byte {data[exc.start]:02X}h is not UTF-8"
        raise mistakes.fatal(spot, what, "save the file as UTF-8") from exc
    return parse_roster(text, file, running)


def parse_roster(text: str, file: str, running: Roster | None = None) -> Roster:
    """Read a roster from its text.

    Args:
        text: The whole file.
        file: What to call it in mistakes.
        running: The roster in use, if there is one (`load_roster`).

    Raises:
        RosterError: It cannot be used; carries every mistake.
    """
    mistakes = Mistakes(file)
    if len(text) > LARGEST:
        raise _too_large(mistakes)
    node = compose(text.removeprefix("\ufeff"), mistakes)
    if node is None or (isinstance(node, Scalar) and node.is_empty):
        right = "a roster has at least `line:` and `drives:`"
        raise mistakes.fatal(Spot(), "the file is empty", right)
    if not isinstance(node, MappingNode):
        right = "a roster is a mapping with at least `line:` and `drives:`"
        raise mistakes.fatal(node, "this is no roster", right)
    _check_version(node, mistakes)
    protocol = _protocol(node)
    roster = roster_table(protocol).read(node, "the roster", mistakes)
    assert isinstance(roster, Fields)
    check_roster(roster, protocol, mistakes)
    if mistakes:
        raise mistakes.error()
    built = build_roster(roster, file)
    check_feasibility(roster, built, mistakes)
    if running is not None:
        check_restart(node, built, running, mistakes)
    if mistakes:
        raise mistakes.error()
    return built


def _check_version(roster: MappingNode, mistakes: Mistakes) -> None:
    """Refuse a roster of a newer form; its mistakes would be those of this program.

    Raises:
        RosterError: It is one.
    """
    given = roster.items.get("version")
    text = given[1].text if given is not None and isinstance(given[1], Scalar) else ""
    if text.isascii() and text.isdecimal() and int(text[:9]) > ROSTER_VERSION:
        assert given is not None
        what = f"this roster has version {text[:9]}, and lecombus {__version__} knows no newer "
        what += f"version than {ROSTER_VERSION}"
        raise mistakes.fatal(
            given[1], what, "install the lecombus that it was written for, or a newer one"
        )


def _protocol(roster: MappingNode) -> str:
    """Return the protocol of the line, by which all else is read; the usual one if it is wrong."""
    line = roster.items.get("line")
    if line is not None and isinstance(line[1], MappingNode):
        given = line[1].items.get("protocol")
        if given is not None and isinstance(given[1], Scalar) and given[1].text in names():
            return given[1].text
    return "lecom"


def _read(path: Path, mistakes: Mistakes) -> bytes:
    """Return the file's bytes; never waits on a pipe or a device."""
    try:
        data = _read_regular(path)
    except OSError as exc:
        raise mistakes.fatal(Spot(), *_say_os_error(exc)) from exc
    except ValueError as exc:  # a NUL in the name
        raise mistakes.fatal(Spot(), "this is not a file name", "name a roster file") from exc
    if data is None:
        raise mistakes.fatal(Spot(), "this is not a regular file", "name a roster file")
    if len(data) > LARGEST:
        raise _too_large(mistakes)
    return data


def _read_regular(path: Path) -> bytes | None:
    """Return the file's beginning, one byte more than allowed at most; None for no plain file."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        mode = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError
        if not stat.S_ISREG(mode):
            return None
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            return file.read(LARGEST + 1)
    finally:
        os.close(descriptor)


def _too_large(mistakes: Mistakes) -> RosterError:
    what = f"the file is larger than {LARGEST // 1024} KiB"
    return mistakes.fatal(Spot(), what, "name a roster file; none is that large")


def _say_os_error(error: OSError) -> tuple[str, str]:
    if isinstance(error, FileNotFoundError):
        return "there is no such file", "check the path"
    if isinstance(error, IsADirectoryError):
        return "this is a directory", "name the roster in it"
    if isinstance(error, PermissionError):
        return "the file may not be read", "give this user permission to read it"
    return f"the file cannot be read: {error.strerror}", "check the path"
