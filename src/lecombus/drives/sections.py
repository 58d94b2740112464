"""Building each section of a family description from its table in a data file.

One function a section, each refusing what it cannot mean with file, line and column: an entry
without source, an unknown action, a time of zero. The codes and the words, the longest sections,
have modules of their own (`code_entries`, `word_entries`). How sections of several files are put
together, and what must hold between sections, is `loading`.
"""

from __future__ import annotations

from lecombus.protocol.addressing import Code, Form
from lecombus.protocol.values import Value

from .document import Item, Table
from .family import AnswerTime, SoftwareGate, WatchdogTraits
from .readers import WORD_MAX, read_choice, read_code_number, read_flag, read_source
from .restoring import RestoreRule, RestoreWord
from .stops import StopAction, StopProof, StopRule

__all__ = [
    "read_answer_time",
    "read_form",
    "read_proofs",
    "read_restore",
    "read_software",
    "read_stop",
    "read_watchdog",
]

MAX_MS = 600_000

ROSTER_ACTIONS = ("none", "inhibit", "quick-stop", "trip")


def read_form(item: Item) -> Form:
    """Read an addressing form."""
    forms = {form.value: form for form in Form}
    form = forms.get(item.text())
    if form is None:
        item.fail(f"{item.text()} is no addressing form; {', '.join(forms)} are")
    return form


def read_answer_time(table: Table, manual: str) -> tuple[list[Code] | None, AnswerTime]:
    """Read one entry of `answer_times`.

    Returns:
        The codes it is for, None for all others, and the times.
    """
    codes = table.take("codes")
    read_s, write_s = _seconds(table.take("read_ms")), _seconds(table.take("write_ms"))
    slow_read, slow_write = table.get("slow_read_ms"), table.get("slow_write_ms")
    mode = table.get("slow_when_c0001")
    times = AnswerTime(
        read_s=read_s,
        write_s=write_s,
        slow_read_s=_seconds(slow_read) if slow_read else read_s,
        slow_write_s=_seconds(slow_write) if slow_write else write_s,
        slow_c0001=mode.integer(0, 255) if mode else None,
        is_limit=read_flag(table, "limit"),
        source=read_source(table, manual),
    )
    if times.slow_read_s < read_s or times.slow_write_s < write_s:
        table.fail("the slow time is shorter than the usual one")
    table.done()
    if codes.is_text():
        if codes.text() != "others":
            codes.fail("a list of codes is right here, or: others")
        return None, times
    return [read_code_number(item) for item in codes.items()], times


def read_software(table: Table, manual: str) -> SoftwareGate:
    """Read `software`."""
    gate = SoftwareGate(
        code=read_code_number(table.take("code")),
        versions=tuple(item.text() for item in table.take("versions").items()),
        source=read_source(table, manual),
    )
    table.done()
    return gate


def read_restore(table: Table, manual: str) -> RestoreRule:
    """Read one entry of `restore`."""
    word = read_choice(table.take("rule"), RestoreWord)
    value = table.get("value")
    if (value is not None) != (word is RestoreWord.SAVE):
        table.fail("value belongs to the rule save, and only there")
    rule = RestoreRule(
        word=word,
        codes=tuple(read_code_number(item) for item in table.take("codes").items()),
        because=table.take("because").text(),
        value=value.integer(0, WORD_MAX) if value else None,
        source=read_source(table, manual),
    )
    table.done()
    return rule


def read_watchdog(table: Table, manual: str) -> WatchdogTraits:
    """Read `watchdog`."""
    actions: dict[str, int] = {}
    for key, value in table.take("actions").table().pairs():
        if key.text() not in ROSTER_ACTIONS:
            key.fail(f"{key.text()} is no action; {', '.join(ROSTER_ACTIONS)} are")
        actions[key.text()] = value.integer(0, WORD_MAX)
    traits = WatchdogTraits(
        time_code=read_code_number(table.take("time_code")),
        action_code=read_code_number(table.take("action_code")),
        actions=actions,
        low_s=table.take("low_ms").integer(0, MAX_MS) / 1000,
        high_s=_seconds(table.take("high_ms")),
        volatile=table.take("volatile").flag(),
        source=read_source(table, manual),
    )
    if traits.low_s >= traits.high_s:
        table.fail("low_ms is not below high_ms")
    table.done()
    return traits


def read_stop(table: Table, manual: str) -> tuple[StopAction, StopRule]:
    """Read one entry of `stops`: a value, or bits changed in the control word."""
    value, set_bits, clear_bits = table.get("value"), table.get("set"), table.get("clear")
    if (value is None) == (set_bits is None):
        table.fail("either value or set is right here")
    rule = StopRule(
        code=read_code_number(table.take("code")),
        value=Value.decimal(value.integer(0, WORD_MAX)) if value else None,
        set_mask=set_bits.integer(1, WORD_MAX) if set_bits else 0,
        clear_mask=clear_bits.integer(0, WORD_MAX) if clear_bits else 0,
        proofs=read_proofs(table.take("proofs")),
        source=read_source(table, manual),
    )
    action = read_choice(table.take("action"), StopAction)
    table.done()
    return action, rule


def read_proofs(item: Item) -> dict[Code, StopProof]:
    """Read what codes must show, the most telling first."""
    proofs: dict[Code, StopProof] = {}
    for one in item.items():
        code, proof = _proof(one.table())
        if code in proofs:
            one.fail(f"{code} stands here twice", code=str(code))
        proofs[code] = proof
    return proofs


def _proof(table: Table) -> tuple[Code, StopProof]:
    mask = table.get("mask")
    proof = StopProof(
        mask=mask.integer(1, WORD_MAX) if mask else None,
        equals=table.take("equals").integer(0, WORD_MAX),
    )
    code = read_code_number(table.take("code"))
    table.done()
    return code, proof


def _seconds(item: Item) -> float:
    return item.integer(1, MAX_MS) / 1000
