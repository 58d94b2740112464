"""What is found about a drive that does not turn: findings, their words, and their JSON form.

Here stand the sentences that are lecombus' own, in both languages; those about codes and faults
come from the data files. `why` decides what is found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from lecombus.drive_state.readings import (
    ActiveFault,
    DriveInfo,
    DriveState,
    LineInfo,
    LineState,
    Quality,
    Reading,
    json_value,
    rfc3339,
    seconds,
)
from lecombus.drives import Family, Language, Text, Verb
from lecombus.drives.faults.fault_tables import Fault
from lecombus.drives.faults.reasons import Reason, Weight
from lecombus.drives.words import OperatingState
from lecombus.parameters import Code, Json, Value
from lecombus.saved_state import LastEnable

__all__ = [
    "MemoryEntry",
    "StandstillFinding",
    "WhyReport",
    "answer_of",
    "enable_finding",
    "fault_finding",
    "finding_of",
    "lapse_finding",
    "latch_finding",
    "line_finding",
    "lock_finding",
    "silence_finding",
    "state_finding",
]


@dataclass(frozen=True, slots=True)
class StandstillFinding:
    """One thing found.

    Args:
        name: A stable word for it.
        weight: Whether it keeps the drive from turning, may, or is good to know.
        text: What it is.
        remedy: What to do next.
        shown_by: What shows it, such as `C0150 reads H0380`.
        age_s: Age of the oldest value it rests on, seconds; None where it rests on none.
        stale: One of these values is not fresh.
        verb: The verb that it advises, where it advises one.
    """

    name: str
    weight: Weight
    text: Text
    remedy: Text
    shown_by: str = ""
    age_s: float | None = None
    stale: bool = False
    verb: Verb | None = None

    def with_codes_opened(self, codes: Sequence[str]) -> StandstillFinding:
        """Advise that the roster must let codes be written before the verb can be used."""
        named, remedy = ", ".join(codes), self.remedy
        opened = Text(
            f"{remedy.en}; the roster does not let it write {named}: first add {named} to "
            "`also_writable` of this drive and reload the roster",
            f"{remedy.de}; das Roster lässt {named} nicht schreiben: vorher {named} "
            "bei diesem Antrieb in `also_writable` aufnehmen und das Roster neu laden",
        )
        return replace(self, remedy=opened)

    def as_json(self, language: Language) -> dict[str, Json]:
        """Return the JSON form."""
        return {
            "name": self.name,
            "weight": self.weight.value,
            "text": self.text.in_language(language),
            "remedy": self.remedy.in_language(language) or None,
            "shown_by": self.shown_by or None,
            "age_s": None if self.age_s is None else seconds(self.age_s),
            "stale": self.stale,
        }


@dataclass(frozen=True, slots=True)
class MemoryEntry:
    """One entry of the fault memory.

    Args:
        code: Where it stands.
        number: The LECOM fault number.
        known: What the manual says of it; None where it does not list it.
        age_s: How long ago it was read, seconds.
        stale: That is too long ago.
    """

    code: Code
    number: int
    known: Fault | None
    age_s: float | None
    stale: bool

    def as_json(self, language: Language) -> dict[str, Json]:
        """Return the JSON form."""
        known = self.known
        return {
            "code": str(self.code),
            "number": self.number,
            "keypad": (known.keypad if known is not None else "") or None,
            "kind": None if known is None else known.kind.value,
            "meaning": None if known is None else known.meaning.in_language(language),
            "age_s": None if self.age_s is None else seconds(self.age_s),
            "stale": self.stale,
        }


@dataclass(frozen=True, slots=True)
class WhyReport:
    """Why a drive does not turn, as far as that is known.

    Args:
        drive: How it is doing.
        answer: The most important finding, or that nothing known keeps it from turning.
        findings: All findings, the most important first.
        states: What its words show.
        output: Its output frequency or speed, as known.
        history: Its fault memories that hold a fault, the newest first.
        history_known: Whether any of them has been read.
        last_enable: The last enable, where it was refused or taken back and none succeeded since.
    """

    drive: DriveInfo
    answer: Text
    findings: tuple[StandstillFinding, ...]
    states: tuple[OperatingState, ...]
    output: Reading | None
    history: tuple[MemoryEntry, ...]
    history_known: bool
    last_enable: LastEnable | None = None

    def as_json(self, language: Language) -> dict[str, Json]:
        """Return the JSON form in a language."""
        output = self.output
        known = None if output is None or output.value is None else output
        return {
            "drive": self.drive.name,
            "family": self.drive.family,
            "state": self.drive.state.value,
            "reason": self.drive.reason or None,
            "since": rfc3339(self.drive.since_s),
            "answer": self.answer.in_language(language),
            "findings": [one.as_json(language) for one in self.findings],
            "states": [state.value for state in self.states],
            "output": None if known is None else {
                "value": json_value(known.value) if known.value is not None else None,
                "unit": known.unit,
                "age_s": None if known.age_s is None else seconds(known.age_s),
                "stale": known.quality is not Quality.GOOD,
            },
            "history": [one.as_json(language) for one in self.history],
            "history_known": self.history_known,
            "last_enable": None if self.last_enable is None else self.last_enable.as_json(),
        }  # fmt: skip


# -- words -----------------------------------------------------------------------------------------

GERMAN_LINE: Final[Mapping[LineState, str]] = {
    LineState.CLOSED: "geschlossen",
    LineState.LOST: "verloren",
    LineState.OPEN: "offen",
}
LINE_REMEDY: Final = Text(
    "it is being opened again; check the adapter and its cable",
    "sie wird wieder geöffnet; Adapter und Kabel prüfen",
)
OFFLINE_REMEDY: Final = Text(
    "check its supply, address, baud rate and plug; it is asked again all the time",
    "Versorgung, Adresse, Baudrate und Stecker prüfen; er wird weiter regelmäßig abgefragt",
)
SILENCED_REMEDY: Final = Text(
    "take a lease for it: it is spoken to again once its watchdog has had its time; then have it "
    "stopped, write the setpoint and enable it (docs/leases.md)",
    "ein Lease für ihn nehmen: er wird wieder angesprochen, sobald seine Überwachung ihre Zeit "
    "hatte; dann stoppen, Sollwert schreiben und freigeben (docs/leases.md)",
)
STARTING_REMEDY: Final = Text(
    "wait; what keeps the audit from ending stands behind the colon",
    "warten; was die Prüfung aufhält, steht hinter dem Doppelpunkt",
)
LAPSE_REMEDY: Final = Text(
    "if the log has `silenced` before it, that was on purpose; else a longer time, fewer drives or "
    "a higher baud rate (lecombus_watchdog_misses_total counts both)",
    "steht im Protokoll davor `silenced`, war es Absicht; sonst längere Zeit, weniger Antriebe "
    "oder höhere Baudrate (lecombus_watchdog_misses_total zählt beides)",
)
UNSEEN_STOP: Final = Text(
    "a quick stop that it set may last, for no status word of this family shows one: lecombus "
    "enable releases it when the motor may turn",
    "ein Quickstop davon kann noch bestehen, denn kein Statuswort dieser Familie zeigt ihn: "
    "lecombus enable hebt ihn auf, wenn der Motor drehen darf",
)
NUMBER_REMEDY: Final = Text(
    "look at the keypad, or in the fault memories below",
    "am Keypad nachsehen, oder unten in den Fehlerspeichern",
)
NOT_LISTED_REMEDY: Final = Text(
    "look the number up in the drive's operating instructions",
    "die Nummer in der Betriebsanleitung nachschlagen",
)
RESET: Final = Text(
    "then reset it (lecombus reset-fault)", "dann rücksetzen (lecombus reset-fault)"
)
NOTHING: Final = Text(
    "nothing that is known keeps it from turning",
    "nichts Bekanntes hält ihn vom Drehen ab",
)
KINDS: Final[Mapping[str, str]] = {"trip": "TRIP", "message": "Meldung", "warning": "Warnung"}


def line_finding(line: LineInfo) -> StandstillFinding | None:
    """Say that there is no line, if there is none."""
    if line.state is LineState.OPEN:
        return None
    text = Text(
        f"the line is {line.state.value}: {line.reason}",
        f"die Leitung ist {GERMAN_LINE[line.state]}: {line.reason}",
    )
    return StandstillFinding("line", Weight.REASON, text, LINE_REMEDY)


def silence_finding(info: DriveInfo, line: LineInfo) -> StandstillFinding | None:
    """Say that no drive of the line answers, or that another program reads the port."""
    remark = line.remarks.get("silence")
    if remark is None or info.state not in (DriveState.OFFLINE, DriveState.DEGRADED):
        return None
    what, _, remedy = remark.rpartition(": ")
    text = Text(f"{what}", f"Leitung gestört: {what}")
    return StandstillFinding("line-silent", Weight.REASON, text, Text(remedy, remedy))


def state_finding(info: DriveInfo) -> StandstillFinding | None:
    """Say that the drive is silent or not audited, if it is."""
    since = rfc3339(info.since_s)
    if info.state is DriveState.OFFLINE:
        text = Text(
            f"it does not answer since {since}: {info.reason}",
            f"er antwortet nicht seit {since}: {info.reason}",
        )
        return StandstillFinding("offline", Weight.REASON, text, OFFLINE_REMEDY)
    if info.state is DriveState.STARTING:
        text = Text(
            f"it has not been audited yet, nothing but stops is written to it: {info.reason}",
            f"er ist noch nicht geprüft, es werden nur Stopps gesendet: {info.reason}",
        )
        return StandstillFinding("not-audited", Weight.REASON, text, STARTING_REMEDY)
    return None


def silenced_finding(info: DriveInfo) -> StandstillFinding:
    """Say that it is sent nothing on purpose; its reason says why."""
    since = rfc3339(info.since_s)
    text = Text(
        f"nothing is sent to it on purpose since {since}: {info.reason}",
        f"ihm wird seit {since} absichtlich nichts gesendet: {info.reason}",
    )
    return StandstillFinding("silenced", Weight.REASON, text, SILENCED_REMEDY)


def fault_finding(info: DriveInfo) -> StandstillFinding | None:
    """Name the fault the drive shows, if it does."""
    fault = info.fault
    if fault is None:
        return None
    weight = Weight.HINT if fault.kind == "warning" else Weight.REASON
    stale = info.state is DriveState.OFFLINE
    text, remedy = fault_text(fault), fault_remedy(fault)
    verb = Verb.RESET_FAULT if fault.known is not None and fault.kind == "trip" else None
    return StandstillFinding(
        str(fault.kind), weight, text, remedy, fault.shown_by, stale=stale, verb=verb
    )


def lock_finding(remark: str) -> StandstillFinding:
    """Say that nothing may be written to the drive."""
    text = Text(
        f"nothing but stops is written to it: {remark}",
        f"es werden nur Stopps gesendet: {remark}",
    )
    return StandstillFinding("locked", Weight.HINT, text, Text("", ""))


def latch_finding(remark: str) -> StandstillFinding:
    """Say that it takes no setpoint until it is enabled under a lease."""
    text = Text(f"it takes no setpoint: {remark}", f"er nimmt keinen Sollwert an: {remark}")
    remedy = Text(
        "the program that controls it takes a lease and enables it (docs/leases.md); `lecombus "
        "leases` shows who holds which",
        "das steuernde Programm nimmt ein Lease und gibt ihn frei (docs/leases.md); `lecombus "
        "leases` zeigt, wer welches hat",
    )
    return StandstillFinding("latched", Weight.REASON, text, remedy)


def enable_finding(last: LastEnable) -> StandstillFinding:
    """Say that the last enable was refused or taken back, and why."""
    en, de = ("taken back", "zurückgenommen") if last.taken_back else ("refused", "abgelehnt")
    if not last.taken_back and last.outcome != "refused":
        en, de = "of unknown outcome", "mit unbekanntem Ergebnis beendet"
    why = "; ".join(filter(None, (last.reason, last.cause)))
    text = Text(
        f"the last enable, at {last.at}, was {en}: {why}",
        f"die letzte Freigabe, um {last.at}, wurde {de}: {why}",
    )
    # A setting that is still in the way is a separate reason, and so is a stop that came since.
    weight = Weight.REASON if last.by_drive and not last.stopped_since else Weight.HINT
    name = "enable-taken-back" if last.taken_back else "enable-refused"
    verb = Verb.ENABLE if last.taken_back else None
    return StandstillFinding(name, weight, text, Text(last.remedy, last.remedy), verb=verb)


def lapse_finding(lapses: int, *, unseen: bool) -> StandstillFinding:
    """Say that lecombus fed the drive's watchdog too late.

    Args:
        lapses: How often since lecombus started.
        unseen: It was not enabled since, and no status word of it shows a quick stop.
    """
    often = ("once", "einmal") if lapses == 1 else (f"{lapses} times", f"{lapses}-mal")
    text = Text(
        f"its watchdog was fed too late {often[0]} since lecombus started, and may have acted then",
        f"die Überwachung wurde seit dem Start {often[1]} zu spät bedient und kann angesprochen "
        "haben",
    )
    if unseen:
        text = Text(f"{text.en}; {UNSEEN_STOP.en}", f"{text.de}; {UNSEEN_STOP.de}")
    verb = Verb.ENABLE if unseen else None
    weight = Weight.REASON if unseen else Weight.HINT
    return StandstillFinding("watchdog-lapsed", weight, text, LAPSE_REMEDY, verb=verb)


def fault_text(fault: ActiveFault) -> Text:
    """Name a fault with what usually lies behind it."""
    known, kind = fault.known, KINDS[fault.kind]
    if known is None:
        number = f" {fault.number}" if fault.number is not None else ""
        return Text(str(fault), f"{kind}{number}, nicht in der Liste ({fault.shown_by})")
    keypad = f"{known.keypad} ({known.number})" if known.keypad else str(known.number)
    en, de = f"{fault.kind} {keypad}: {known.meaning.en}", f"{kind} {keypad}: {known.meaning.de}"
    if known.cause.en:
        en, de = f"{en}; usual cause: {known.cause.en}", f"{de}; übliche Ursache: {known.cause.de}"
    return Text(en, de)


def fault_remedy(fault: ActiveFault) -> Text:
    """Say what to do about a fault; only a TRIP stays until it is reset."""
    if fault.known is None:
        return NUMBER_REMEDY if fault.number is None else NOT_LISTED_REMEDY
    remedy = fault.known.remedy
    if fault.kind != "trip":
        return remedy
    return Text(f"{remedy.en}; {RESET.en}", f"{remedy.de}; {RESET.de}")


def finding_of(reason: Reason, family: Family, values: Mapping[Code, Reading]) -> StandstillFinding:
    """Make a finding of a reason, with the values it rests on."""
    codes = [one.code for one in (*reason.values, *reason.not_values)]
    if reason.states:
        codes = [*words_showing(reason, family, values), *codes]
    rests = [values[code] for code in dict.fromkeys(codes) if code in values]
    shown_by = ", ".join(f"{family.spoken(one.code)} reads {raw(one.value)}" for one in rests)
    ages = [one.age_s for one in rests if one.age_s is not None]
    stale = any(one.quality is not Quality.GOOD for one in rests)
    return StandstillFinding(
        reason.name, reason.weight, reason.text, reason.remedy, shown_by,
        max(ages, default=None), stale, reason.verb,
    )  # fmt: skip


def words_showing(reason: Reason, family: Family, values: Mapping[Code, Reading]) -> list[Code]:
    """Name the status words that show a reason's states."""
    found = []
    for code, word in family.words.items():
        reading = values.get(code)
        number = None if reading is None or reading.value is None else reading.value.number
        if isinstance(number, int) and reason.states & set(word.shown_states(number)):
            found.append(code)
    return found


def raw(value: Value | None) -> str:
    """Write a value as on the wire."""
    return "nothing" if value is None else value.raw


def answer_of(
    findings: list[StandstillFinding], output: Reading | None, states: tuple[OperatingState, ...]
) -> Text:
    """Say in one sentence what it is, or that nothing known keeps it from turning."""
    for finding in findings:
        if finding.weight is Weight.REASON:
            if not finding.stale:
                return finding.text
            return Text(
                f"{finding.text.en} (as last known)", f"{finding.text.de} (zuletzt bekannt)"
            )
    reads = ""
    if output is not None and output.value is not None and output.quality is Quality.GOOD:
        reads = f"{output.value.raw}{f' {output.unit}' if output.unit else ''}"
    if not reads and OperatingState.ZERO_SPEED in states:
        return Text(
            f"{NOTHING.en}; it measures a speed of 0", f"{NOTHING.de}; er misst die Drehzahl 0"
        )
    if not reads:
        return NOTHING
    return Text(
        f"{NOTHING.en}; its output (C0050) reads {reads}",
        f"{NOTHING.de}; sein Ausgang (C0050) zeigt {reads}",
    )
