"""`lecombus why`: why a drive does not turn, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import click

from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import connect, path_of
from lecombus.cli.document_rows import Document
from lecombus.cli.exits import Exit
from lecombus.cli.screen import age, on_terminal, show_rows, table_text

__all__ = ["why_command"]

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
def why_command(
    drive: str, stored: bool, lang: str, socket: str | None, url: str | None, as_json: bool
) -> int:
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
    with connect(socket, url) as daemon:
        path = f"{path_of('drive', drive)}/why"
        params = {"lang": lang} if stored else {"lang": lang, "fresh": "true"}
        answer = daemon.get(path, **params)
    if as_json:
        click.echo(answer.text)
    elif on_terminal():
        _show(answer.data, WORDS[lang])
    else:
        _list(answer.data)
    return Exit.DONE


def _show(why: Document, words: Mapping[str, str]) -> None:
    findings: Sequence[Document] = why.get("findings") or []
    click.echo(f"{why.get('drive')} ({why.get('family')}, {why.get('state')}): {why.get('answer')}")
    first = [one for one in findings[:1] if one.get("weight") == "reason"]
    for finding in first:
        _show_finding(finding, words, indent="  ", is_answer=True)
    for weight, heading in HEADINGS:
        rest = [one for one in findings[len(first) :] if one.get("weight") == weight]
        if rest:
            click.echo(f"{words[heading]}:")
        for finding in rest:
            _show_finding(finding, words, indent="  ", is_answer=False)
    _show_history(why, words)


def _show_finding(
    finding: Document, words: Mapping[str, str], *, indent: str, is_answer: bool
) -> None:
    """Print one finding; `is_answer`: its text was printed as the answer already."""
    marks = [table_text(finding.get("shown_by"))]
    if finding.get("stale"):
        marks.append(words["stale"].format(age=age(finding.get("age_s"))))
    shown = "; ".join(mark for mark in marks if mark.strip())
    text = "" if is_answer else table_text(finding.get("text"))
    line = " ".join(part for part in (text, f"[{shown}]" if shown else "") if part)
    if line:
        click.echo(f"{indent}{'' if is_answer else '- '}{line}")
    if finding.get("remedy"):
        click.echo(f"{indent}{'' if is_answer else '  '}{words['do']}: {finding['remedy']}")


def _show_history(why: Document, words: Mapping[str, str]) -> None:
    history: Sequence[Document] = why.get("history") or []
    if not history:
        click.echo(words["empty" if why.get("history_known") else "unread"])
        return
    click.echo(f"{words['memory']}:")
    for one in history:
        keypad = f" {one['keypad']}" if one.get("keypad") else ""
        meaning = f": {one['meaning']}" if one.get("meaning") else ""
        click.echo(f"  {one.get('code')}  {one.get('number')}{keypad}{meaning}")


def _list(why: Document) -> None:
    rows = [("answer", *(table_text(why.get(key)) for key in ("drive", "state", "answer")))]
    keys = ("weight", "name", "text", "remedy", "shown_by")
    rows += [
        (*(table_text(one.get(key)) for key in keys), "stale" if one.get("stale") else "")
        for one in why.get("findings") or []
    ]
    rows += [
        ("history", *(table_text(one.get(key)) for key in ("code", "number", "keypad", "meaning")))
        for one in why.get("history") or []
    ]
    show_rows((), rows)
