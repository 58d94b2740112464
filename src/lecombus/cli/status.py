"""`lecombus status` and `why`: the line, its drives, one drive, and why it does not turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import click

from lecombus.cli.arguments import DaemonOptions, daemon_options
from lecombus.cli.daemon_access import ask, drive_path, show, work
from lecombus.cli.document_rows import (
    Document,
    cells_of,
    code_of,
    quality_of,
    shown_code,
    shown_value,
)
from lecombus.cli.exits import Exit
from lecombus.cli.screen import Styled, age, on_terminal, show_rows, table_text
from lecombus.client.documents import Answer
from lecombus.client.line import Line

__all__ = ["status_command", "why_command"]

_TRIPS = ("trip", "fault")


@click.command("status")
@click.argument("drive", required=False)
@daemon_options
def status_command(drive: str | None, daemon: DaemonOptions) -> int:
    """Show the line and all its drives, or DRIVE with every value that is known of it.

    Nothing is sent to the line. MOTOR says whether a drive runs or what stops it, by every word
    that shows it; "stopped" means that it does not drive its motor, which may coast. A value
    that is not fresh is shown with its age.

    In a pipe: first the line (the word `line`, name, state, reason), then one line a drive (drive,
    address, family, state, reason, motor, speed, setpoint); or one a value (code, name, value,
    unit, quality, age, reason; quality `once`: not asked for again). With --json: {"line": ..,
    "drives": ..}, the daemon's documents, or with DRIVE the drive's document.
    """
    if drive is not None:
        show(ask(daemon, drive_path(drive)), _show_drive, as_json=daemon.as_json)
        return Exit.DONE
    line, drives = work(daemon, _line_and_drives)
    if daemon.as_json:
        click.echo(f'{{"line": {line.text}, "drives": {drives.text}}}')
    else:
        _show_line(line.data, _listed(drives.data, "drives"))
    return Exit.DONE


async def _line_and_drives(line: Line) -> tuple[Answer, Answer]:
    return await line.ask("/v1/line"), await line.ask("/v1/drives")


def _listed(data: Sequence[Document] | Document, key: str) -> Sequence[Document]:
    """Return the list in a document that is one, or has one under a key."""
    if isinstance(data, dict):
        found: Sequence[Document] = data.get(key) or []
        return found
    return data  # type: ignore[return-value]


def _show_line(line: Document, drives: Sequence[Document]) -> None:
    name, state, why = table_text(line.get("line")), table_text(line.get("state")), _why(line)
    if on_terminal():
        click.echo(f"line {name}: {state}" + (f", {why}" if why else ""))
    else:
        show_rows((), [("line", name, state, why)])
    rows = []
    for drive in drives:
        who = cells_of(drive, "drive", "address", "family")
        how = table_text(drive.get("state"))
        why = _why(drive).replace(f"line {state}: {line.get('reason')}", f"line {state}")
        motion: Document = drive.get("motion") or {}
        is_tripped = any(one.get("name") in _TRIPS for one in motion.get("stops") or ())
        style = "red" if is_tripped else "yellow" if motion.get("stale") else ""
        motor = Styled(_motor(motion), style)
        speeds = (_actual(motion), _speed(motion.get("setpoint")))
        if on_terminal():
            how = Styled(how, "") if is_tripped else how
            rows.append((*who, how, motor, *speeds, why))
        else:
            rows.append((*who, how, why, motor, *speeds))
    show_rows(("drive", "address", "family", "state", "motor", "speed", "setpoint", "why"), rows)


def _motor(motion: Document) -> str:
    """Say what a drive does with its motor, and what stops it."""
    doing = table_text(motion.get("doing"))
    stops = [table_text(one.get("text")).partition(": ")[0] for one in motion.get("stops") or ()]
    text = f"{doing}: {', '.join(stops)}" if stops else doing
    return f"{text}, as known {age(motion.get('age_s'))} ago" if motion.get("stale") else text


def _actual(motion: Document) -> str:
    """Return the speed; without one, whether it is 0, as far as the drive shows that."""
    if motion.get("speed"):
        return _speed(motion["speed"])
    zero = motion.get("zero")
    return "" if zero is None else "0" if zero else "not 0"


def _speed(speed: Document | None) -> str:
    """Return a speed with its unit, and its age where it is not fresh."""
    if not speed or speed.get("value") is None:
        return ""
    text = " ".join(filter(None, (table_text(speed["value"]), table_text(speed.get("unit")))))
    return f"{text}, {age(speed.get('age_s'))} ago" if speed.get("stale") else text


def _show_drive(drive: Document) -> None:
    name = table_text(drive.get("drive") or drive.get("name"))
    if on_terminal():
        why = _why(drive)
        state = table_text(drive.get("state")) + (f", {why}" if why else "")
        click.echo(f"{name} at address {drive.get('address')} ({drive.get('family')}): {state}")
        _show_identity(drive.get("identity") or {}, drive.get("family"))
        _show_motion(drive.get("motion") or {})
        _show_states(drive.get("states"))
        _show_fault(drive.get("fault") or {})
    rows = [
        (
            shown_code(drive.get("family"), code_of(value)),
            table_text(value.get("name")),
            shown_value(value),
            table_text(value.get("unit")),
            quality,
            age(value.get("age_s")),
            reason,
        )
        for value in _listed(drive, "values")
        for quality, reason in [quality_of(value)]
    ]
    show_rows(("code", "name", "value", "unit", "quality", "age", "why"), rows)


def _show_motion(motion: Document) -> None:
    """Print whether it runs, and by which words that shows; nothing where it is not known."""
    shown = dict.fromkeys(word for one in motion.get("stops") or () for word in one["shown_by"])
    if motion.get("doing"):
        click.echo(f"  motor: {_motor(motion)}" + (f" [{', '.join(shown)}]" if shown else ""))


def _show_states(states: Sequence[str] | None) -> None:
    """Print what the status words show; nothing is printed while that is not known well."""
    if states is not None:
        named = ", ".join(state.replace("_", " ") for state in states)
        click.echo(f"  its status words show: {named or 'nothing of note'}")


def _show_fault(fault: Document) -> None:
    """Print what usually lies behind a fault and what to do; what it is stands in the remarks."""
    for key in ("cause", "remedy"):
        if fault.get(key):
            click.echo(f"  {key}: {fault[key]}")


def _show_identity(identity: Document, family_name: object) -> None:
    """Print the identity that a drive reports."""
    if identity:
        labels = ", ".join(
            f"{shown_code(family_name, code)} {table_text(text)}" for code, text in identity.items()
        )
        click.echo(f"  it says of itself: {labels}")


def _why(one: Document) -> str:
    """Return the reason of a drive's or line's state and what else stands to be said about it."""
    remarks: Document = one.get("remarks") or {}
    parts = [table_text(one.get("reason")), *(table_text(text) for text in remarks.values())]
    return "; ".join(part for part in parts if part)


# ---- why -------------------------------------------------------------------------------------

WORDS: Mapping[str, Mapping[str, str]] = {
    "en": {
        "do": "do", "also": "also", "may": "may matter", "note": "good to know",
        "memory": "fault memory, newest first (what was once, not what is now)",
        "empty": "the fault memory is empty", "unread": "the fault memory has not been read",
        "stale": "as known {age} ago",
    },
    "de": {
        "do": "Abhilfe", "also": "außerdem", "may": "kann dazu beitragen", "note": "Hinweise",
        "memory": "Fehlerspeicher, Neuestes zuerst (was war, nicht was ist)",
        "empty": "der Fehlerspeicher ist leer", "unread": "der Fehlerspeicher ist nicht gelesen",
        "stale": "Stand vor {age}",
    },
}  # fmt: skip

HEADINGS = (("reason", "also"), ("hint", "may"), ("note", "note"))


@click.command("why")
@click.argument("drive")
@click.option("--stored", is_flag=True, help="What the daemon knows; nothing is read.")
@click.option(
    "--lang", type=click.Choice(["en", "de"]), default="en", show_default=True,
    help="The language of findings and faults.",
)  # fmt: skip
@daemon_options
def why_command(drive: str, stored: bool, lang: str, daemon: DaemonOptions) -> int:
    """Say why DRIVE does not turn, or why it has stopped, and what to do next.

    The few codes that matter are read first, unless --stored: status and control word, setpoint,
    control source, fault memory. Then come the drive's and the line's state, the active fault with
    cause and remedy, what inhibits or stops it, what the line may not do, and the fault memory.
    Only what is known is said, and what is not fresh is marked.

    In a pipe: first the answer (the word `answer`, drive, state, text), then one line a finding
    (reason, hint or note, its name, text, remedy, what shows it, `stale` or nothing) and one a
    fault in the memory (the word `history`, code, number, keypad, meaning). With --json: the
    daemon's document.
    """
    params = {"lang": lang} if stored else {"lang": lang, "fresh": "true"}
    answer = ask(daemon, f"{drive_path(drive)}/why", **params)
    show(answer, partial(_show_why, words=WORDS[lang]), as_json=daemon.as_json)
    return Exit.DONE


def _show_why(why: Document, words: Mapping[str, str]) -> None:
    if not on_terminal():
        _list_why(why)
        return
    findings: Sequence[Document] = why.get("findings") or []
    click.echo(f"{why.get('drive')} ({why.get('family')}, {why.get('state')}): {why.get('answer')}")
    first = [one for one in findings[:1] if one.get("weight") == "reason"]
    for finding in first:
        _show_finding(finding, words, is_answer=True)
    for weight, heading in HEADINGS:
        rest = [one for one in findings[len(first) :] if one.get("weight") == weight]
        if rest:
            click.echo(f"{words[heading]}:")
        for finding in rest:
            _show_finding(finding, words, is_answer=False)
    _show_history(why, words)


def _show_finding(finding: Document, words: Mapping[str, str], *, is_answer: bool) -> None:
    """Print one finding; `is_answer`: its text was printed as the answer already."""
    marks = [table_text(finding.get("shown_by"))]
    if finding.get("stale"):
        marks.append(words["stale"].format(age=age(finding.get("age_s"))))
    shown = "; ".join(mark for mark in marks if mark.strip())
    text = "" if is_answer else table_text(finding.get("text"))
    line = " ".join(part for part in (text, f"[{shown}]" if shown else "") if part)
    if line:
        click.echo(f"  {'' if is_answer else '- '}{line}")
    if finding.get("remedy"):
        click.echo(f"  {'' if is_answer else '  '}{words['do']}: {finding['remedy']}")


def _show_history(why: Document, words: Mapping[str, str]) -> None:
    history: Sequence[Document] = why.get("history") or []
    if not history:
        click.echo(words["empty" if why.get("history_known") else "unread"])
        return
    click.echo(f"{words['memory']}:")
    for one in history:
        keypad = f" {one['keypad']}" if one.get("keypad") else ""
        meaning = f": {one['meaning']}" if one.get("meaning") else ""
        code = shown_code(why.get("family"), table_text(one.get("code")))
        click.echo(f"  {code}  {one.get('number')}{keypad}{meaning}")


def _list_why(why: Document) -> None:
    rows = [("answer", *cells_of(why, "drive", "state", "answer"))]
    for one in why.get("findings") or []:
        cells = cells_of(one, "weight", "name", "text", "remedy", "shown_by")
        rows.append((*cells, "stale" if one.get("stale") else ""))
    for one in why.get("history") or []:
        rows.append(("history", *cells_of(one, "code", "number", "keypad", "meaning")))
    show_rows((), rows)
