"""`lecombus describe`: what is known of a family's codes, without a daemon or a drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import click

from lecombus.api.decimal_json import encode
from lecombus.cli.arguments import CODE, json_option
from lecombus.cli.document_rows import Document
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.drives import CodeInfo, Family, Language, WriteClass, family
from lecombus.drives.code_info import BY_OWN_MANUAL, OTHERS
from lecombus.drives.descriptions import bits_document, code_document, family_document
from lecombus.fieldbus.protocols import family_names
from lecombus.parameters import Code

__all__ = ["GERMAN", "describe_command"]

Say = Callable[[str], str]
"""Gives an English word in the language asked for."""

GERMAN: Final[Mapping[str, str]] = {
    "code": "Code",
    "keypad": "Tastenfeld",
    "name": "Name",
    "format": "Format",
    "hexadecimal digits": "Hexadezimalziffern",
    "unit": "Einheit",
    "values": "Werte",
    "value": "Wert",
    "default": "Werkseinstellung",
    "access": "Zugriff",
    "kept": "Speicherort",
    "parameter set": "Parametersatz",
    "subcodes": "Subcodes",
    "source": "Quelle",
    "bit": "Bit",
    "bits": "Bits",
    "to": "bis",
    "read": "lesen",
    "write": "schreiben",
    "while inhibited": "bei Reglersperre",
    "edge": "Flanke",
    "step": "Schritt",
    "save": "Speichern",
    "address": "Adresse",
    "reset": "Rücksetzen",
    "stored": "dauerhaft",
    "module": "im Modul",
    "volatile": "flüchtig",
    "reserved": "reserviert",
    "free: its meaning is set in the drive": "frei: die Bedeutung wird im Antrieb eingestellt",
}

FAULT_RESET = Code(43)
HEADINGS = ("code", "name", "format", "values", "access", "kept", "source")


@click.command("describe")
@click.argument("family_name", metavar="FAMILY", type=click.Choice(family_names()))
@click.argument("code", required=False, type=CODE)
@click.option(
    "--lang",
    type=click.Choice([one.value for one in Language]),
    default=Language.EN.value,
    show_default=True,
    help="In this language.",
)
@click.option(
    "--configuration",
    type=int,
    metavar="C0005",
    help="The words of a 93XX with this signal configuration, such as 1011.",
)
@json_option
def describe_command(
    family_name: str, code: Code | None, lang: str, configuration: int | None, as_json: bool
) -> int:
    """Show what is known of the codes of FAMILY, or all that is known of one CODE.

    Everything is from the manuals; a range that they do not give is missing here, and any other
    code can be read too. In a pipe: code, name, format, values, access, kept, source; or with
    CODE one property a line. With --json: the document of GET /v1/drives/DRIVE/described, or
    with CODE that code's part of it.
    """
    described = configured(family(family_name), configuration)
    language = Language(lang)
    if code is None:
        show_family(described, language, as_json=as_json)
        return Exit.DONE
    info = described.info(code)
    if info is None:
        raise not_described(described, code)
    if as_json:
        click.echo(encode(code_document(described, info)))
    else:
        show_rows(("", ""), list(properties(described, info, language)))
    return Exit.DONE


def not_described(described: Family, code: Code) -> CommandError:
    """Say that a code has no description, and what is near it or does the same."""
    problem = f"{described.spoken(code)} of {described.name} is not described"
    remedy = "any code may be read all the same"
    near = ", ".join(described.spoken(one.code) for one in neighbours(described, code))
    if near:
        remedy = f"near it are {near}; {remedy}"
    if code == FAULT_RESET and described.verbs and described.verbs.reset.code is None:
        problem = f"{described.name} has no {code}: inhibit followed by enable resets a fault"
        remedy = "lecombus reset-fault does it; the drive restarts, and stays inhibited"
    return CommandError(Exit.USAGE, problem, remedy, "no-such-code", code=str(code))


def configured(described: Family, number: int | None) -> Family:
    """Return a family as its words are with a signal configuration.

    Raises:
        CommandError: It has no such configuration.
    """
    found = described.configured(number)
    if number is not None and not found.configuration:
        known = ", ".join(filter(None, described.variants)) or "none"
        raise CommandError(
            Exit.USAGE,
            f"nothing is known of the signal configuration {number} of {described.name}",
            f"known are: {known}",
        )
    return found


def show_family(described: Family, language: Language, *, as_json: bool) -> None:
    """Print every code, one a line."""
    if as_json:
        codes = [code_document(described, info) for info in described.described()]
        click.echo(encode({**family_document(described), "codes": [*codes]}))
        return
    if on_terminal():
        click.echo(described.title)
    say = words_in(language)
    rows = [
        (
            described.spoken(info.code) if on_terminal() else str(info.code),
            info.name_in(language),
            info.format.value,
            info.allowed_in(language),
            access(info, say),
            say(info.storage.value),
            info.source,
        )
        for info in described.described()
    ]
    show_rows([say(heading) for heading in HEADINGS], rows)


def properties(described: Family, info: CodeInfo, language: Language) -> Iterator[tuple[str, str]]:
    """Give what is known of a code, one property after the other."""
    say = words_in(language)
    digits = f", {info.hex_digits} {say('hexadecimal digits')}" if info.hex_digits else ""
    yield say("code"), str(info.code)
    if at_keypad := described.keypad_name(info.code):
        yield say("keypad"), at_keypad
    yield say("name"), info.name_in(language)
    yield say("format"), f"{info.format.value}{digits}"
    if info.unit:
        yield say("unit"), info.unit
    if info.low is not None:
        yield say("values"), info.allowed_in(language)
    for number, text in info.selection.items():
        yield f"{say('value')} {number}", text.in_language(language)
    if info.selection_partial:
        yield say("values"), OTHERS[language]
    if info.array:
        yield say("subcodes"), BY_OWN_MANUAL[language]
    if info.default is not None:
        yield say("default"), info.default
    yield say("access"), access(info, say)
    yield say("kept"), say(info.storage.value)
    if len(described.set_offsets) > 1:
        yield say("parameter set"), str(info.parameter_set)
    for bit in bits_document(described, info):
        assert isinstance(bit, dict)
        yield bit_place(bit, say), bit_text(bit, language)
    yield say("source"), info.source


def access(info: CodeInfo, say: Say) -> str:
    """Say what may be done with a code."""
    may = (("read", info.readable), ("write", info.writable))
    parts = [say(word) for word, is_so in may if is_so]
    if info.write_class is not WriteClass.PLAIN:
        parts.append(f"({say(info.write_class.value)})")
    if info.needs_inhibit:
        parts.append(say("while inhibited"))
    return " ".join(parts)


def bit_place(bit: Document, say: Say) -> str:
    """Name the place of a bit or a field."""
    low, high = bit["low"], bit["high"]
    return f"{say('bit')} {low}" if low == high else f"{say('bits')} {low} {say('to')} {high}"


def bit_text(bit: Document, language: Language) -> str:
    """Say what a bit or a field is; in English by the name that programs know it by."""
    say = words_in(language)
    if bit["kind"] == "free":
        return say("free: its meaning is set in the drive")
    if bit["kind"] == "reserved":
        return say("reserved")
    name = bit["name_de" if language is Language.DE else "name"]
    meanings = ", ".join(f"{one['value']} {one[language.value]}" for one in bit["meanings"])
    return f"{name}: {meanings}" if meanings else str(name)


def neighbours(described: Family, code: Code) -> Sequence[CodeInfo]:
    """Give the described codes nearest to one that is not."""
    nearest = sorted(described.described(), key=lambda one: abs(one.code.number - code.number))
    return sorted(nearest[:3], key=lambda one: one.code)


def words_in(language: Language) -> Say:
    """Return what gives words in a language."""
    return GERMAN.__getitem__ if language is Language.DE else str
