"""A family of drives: answer times, watchdog, codes, words, and the questions about them.

`family_files` makes a `Family` of the data files in `families/`. Everything is resolved then, so
that a question on the path of every exchange is a dictionary access. A code without a description
is not an error: it may be read, its write is not repeated after a lost answer, and its format
follows from the value given.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

from lecombus.parameters import AddressForm, Code, Value

from .code_info import CodeInfo, WriteClass
from .control_words import ControlWordInfo
from .faults.fault_tables import NO_FAULT, Fault, FaultKind, FaultTable, fault_table
from .field_types import (
    DescribedCode,
    Flag,
    Source,
    WordNumber,
    Words,
    WritableCode,
    milliseconds,
    whole,
)
from .restore_rules import RestoreRule
from .stops import StopAction, StopRule
from .verb_rules import VerbRules
from .words import FieldReading, WordInfo
from .yaml_models import FILE_TABLE, ReadAs

__all__ = [
    "AnswerTime",
    "Family",
    "SoftwareGate",
    "WatchdogTraits",
]

SHORTENED_RESPONSE = Code(1921)

KEYPAD_PARAMETERS = range(100, 1000)
"""What a keypad shows with three digits; below that lies what only the network has."""

ANSWER_FACTOR = 2.0
LIMIT_FACTOR = 1.2


ModeNumber = Annotated[int, whole(0, 255)]
RosterAction = Annotated[Literal["none", "inhibit", "quick-stop", "trip"], BeforeValidator(str)]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerTime:
    """How long a drive thinks (t3) about one code.

    Args:
        read_s: Usual time of a read, seconds.
        write_s: Usual time of a write, seconds.
        slow_read_s: Longest time of a read, seconds.
        slow_write_s: Longest time of a write, seconds.
        slow_c0001: The value of C0001 at which the longest time is the usual one.
        is_limit: The manual gives the time as the most it can be ("up to"), not as a usual one.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    read_s: Annotated[float, milliseconds(), Field(alias="read_ms")]
    write_s: Annotated[float, milliseconds(), Field(alias="write_ms")]
    slow_read_s: Annotated[float, milliseconds(), Field(alias="slow_read_ms")] = 0.0
    slow_write_s: Annotated[float, milliseconds(), Field(alias="slow_write_ms")] = 0.0
    slow_c0001: Annotated[ModeNumber | None, Field(alias="slow_when_c0001")] = None
    is_limit: Annotated[Flag, Field(alias="limit")] = False
    source: Source


@dataclass(frozen=True, slots=True, eq=False)
class WatchdogTraits:
    """How a family's watchdog is set. The time is written in milliseconds.

    Args:
        time_code: The monitoring time.
        action_code: What happens when it runs out.
        actions: The roster's word for each action, with the value written.
        low_s: Shortest time that can be set, seconds.
        high_s: Longest time that can be set, seconds.
        volatile: The setting is gone after a power cycle.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    time_code: WritableCode
    action_code: WritableCode
    actions: Mapping[Annotated[str, ReadAs(RosterAction, str)], WordNumber]
    low_s: Annotated[float, milliseconds(0), Field(alias="low_ms")]
    high_s: Annotated[float, milliseconds(), Field(alias="high_ms")]
    volatile: Flag
    source: Source

    def action_of(self, number: int) -> str | None:
        """Return the roster's word for the action that a number stands for."""
        return next((word for word, one in self.actions.items() if one == number), None)


@dataclass(frozen=True, slots=True)
class SoftwareGate:
    """The software versions whose codes the manual vouches for: others are not written to.

    Args:
        code: Where the version is read.
        versions: The versions accepted, as read.
        source: Manual and section.
    """

    __pydantic_config__ = FILE_TABLE

    code: DescribedCode
    versions: tuple[Words, ...]
    source: Source


PASSWORDS: Final = frozenset((94, 1194))
"""The user password of Lenze drives (C0094, P194), in families that do not describe it.

No family has another code that is secret, so these are hidden where the family is not known.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """A family of drives: equal only to itself, so that it is a cheap key.

    Args:
        name: The roster's word for it.
        title: Its name for people.
        forms: The addressing forms it knows, the cheaper first.
        codes: Its described codes, those of further parameter sets included.
        status: The default cyclic reads: code and period in seconds.
        writable: The codes a roster allows to write unless it says otherwise.
        watchdog: How its watchdog is set; None where none is known.
        feed_code: The cheapest useful read: feeds a watchdog, probes an absent drive.
        hold_after_write_s: How long the module is left alone after a write while its shortened
            response (C1921 = 1) is on, seconds.
        identity: Codes that identify the drive.
        stops: How it is stopped.
        words: Its status words.
        answer_times: Answer times of the codes that have their own, by code number.
        other_answer_time: The answer time of all other codes.
        software: Which software may be written to; None: any.
        set_offsets: What is added to a code's number for each parameter set; (0,) where only the
            set in use can be reached.
        restore: What a backup may put back, and in which order.
        control_words: Its control words.
        configured_by: The code whose value decides what the bits of its words mean (93XX: the
            signal configuration C0005); None where they are fixed.
        configuration: The signal configuration this is for, such as `1xx1`; empty: any.
        variants: This family in each signal configuration by its name, in any under the empty
            name; empty where there are none.
        saved_by: The code that has to be written before stored values survive a power cycle; None
            where every write is stored immediately.
        verbs: How it is enabled, given a speed and rid of a fault; None where nothing is known.
        keypad_offset: The keypad names the codes above this by P and the difference: C1411 is P411
            on an SMVector; None where it names them as the line does.
        protocol: The line protocol that it speaks.
    """

    name: str
    title: str
    forms: tuple[AddressForm, ...]
    codes: Mapping[Code, CodeInfo]
    status: tuple[tuple[Code, float], ...]
    writable: frozenset[Code]
    watchdog: WatchdogTraits | None
    feed_code: Code
    hold_after_write_s: float
    identity: tuple[Code, ...]
    stops: Mapping[StopAction, StopRule]
    words: Mapping[Code, WordInfo]
    answer_times: Mapping[int, AnswerTime]
    other_answer_time: AnswerTime
    protocol: str
    software: SoftwareGate | None = None
    set_offsets: tuple[int, ...] = (0,)
    saved_by: Code | None = None
    control_words: Mapping[Code, ControlWordInfo] = field(default_factory=dict)
    configured_by: Code | None = None
    configuration: str = ""
    variants: Mapping[str, Family] = field(default_factory=dict)
    restore: tuple[RestoreRule, ...] = ()
    verbs: VerbRules | None = None
    keypad_offset: int | None = None

    @property
    def shortened_code(self) -> Code | None:
        """The code that is 1 while the module acknowledges before it has passed a write on.

        Source: EDB2102EN 6.3.2 (C1921).
        """
        return SHORTENED_RESPONSE if self.hold_after_write_s > 0.0 else None

    def keypad_name(self, code: Code) -> str:
        """Return what the drive's own keypad calls a code: P411; empty where that is its number.

        Source: CMVLC401A 9 (parameter Pnnn of an SMVector is code 1000 + nnn), 8.1 (registers up to
        1099 are there for the network only).
        """
        offset = self.keypad_offset
        if offset is None or code.number - offset not in KEYPAD_PARAMETERS:
            return ""
        subcode = f"/{code.subcode}" if code.subcode else ""
        return f"P{code.number - offset:03d}{subcode}"

    def spoken(self, code: Code) -> str:
        """Return a code for people, as the drive's keypad does: P411, or C0046."""
        return self.keypad_name(code) or str(code)

    def info(self, code: Code) -> CodeInfo | None:
        """Return a code's description; None where there is none (it may be read all the same)."""
        return self.codes.get(code)

    def is_secret(self, code: Code) -> bool:
        """Whether a code holds a password, also one that is not described."""
        info = self.info(Code(code.number)) or self.info(code)
        return code.number in PASSWORDS if info is None else info.secret

    def configured(self, number: int | None) -> Family:
        """Return this family as a drive of it is whose signal configuration is known.

        Args:
            number: The value of `configured_by`; None where it is not known. Where the manual says
                nothing of it, what holds for every configuration is all that is known.

        Source: EDB2102EN 8.2 (C0135, C0150).
        """
        written = "" if number is None else str(number)
        for name, variant in self.variants.items():
            if len(name) == len(written) and all(
                one in ("x", two) for one, two in zip(name, written, strict=True)
            ):
                return variant
        return self.variants.get("", self)

    def described(self) -> Iterable[CodeInfo]:
        """Return every described code by number, those of further parameter sets included."""
        return self.codes.values()

    def answer_time_s(self, code: Code, *, write: bool, c0001: int | None = None) -> float:
        """Return the usual time the drive thinks before it answers, seconds.

        Args:
            code: The code; its subcode makes no difference.
            write: A write rather than a read.
            c0001: The drive's operating mode (82XX), where it is known.
        """
        times = self.answer_times.get(code.number, self.other_answer_time)
        if c0001 is not None and c0001 == times.slow_c0001:
            return times.slow_write_s if write else times.slow_read_s
        return times.write_s if write else times.read_s

    def longest_answer_time_s(self, code: Code, *, write: bool) -> float:
        """Return the longest time the drive may think: what time-outs are made from, seconds."""
        times = self.answer_times.get(code.number, self.other_answer_time)
        return times.slow_write_s if write else times.slow_read_s

    def patience_s(self, code: Code, *, write: bool, answer_time_s: float | None = None) -> float:
        """Return how long to wait for a drive to begin its answer, seconds.

        About twice the longest answer time; where the manual gives a limit already, a fifth more
        than that: twice 500 ms would keep other drives' watchdogs waiting for nothing.

        Args:
            code: The code.
            write: A write rather than a read.
            answer_time_s: The roster's word on how long this drive thinks, seconds.

        Source: EDB2102EN 8.3.5 (twice the maximum response time); 6.3 (up to 500 ms).
        """
        times = self.answer_times.get(code.number, self.other_answer_time)
        if answer_time_s is not None and times is self.other_answer_time:
            return ANSWER_FACTOR * answer_time_s
        longest_s = max(times.slow_write_s if write else times.slow_read_s, answer_time_s or 0.0)
        return (LIMIT_FACTOR if times.is_limit else ANSWER_FACTOR) * longest_s

    def write_class(self, code: Code, value: Value | None = None) -> WriteClass:
        """Return what repeating a write could do; without a value, at the worst.

        An undescribed code is EDGE: nothing says that it may be repeated.
        """
        info = self.codes.get(code)
        if info is None:
            return WriteClass.EDGE
        rule = info.plain_when
        number = None if value is None else value.quantity
        if rule is not None and number is not None and int(number) & rule.mask == rule.equals:
            return WriteClass.PLAIN
        return info.write_class

    def is_command(self, code: Code) -> bool:
        """Return whether writing a code can move the drive, or does more than change a setting.

        True of a code that nothing is known of.
        """
        info = self.codes.get(code)
        if info is None or info.motion:
            return True
        return info.write_class not in (WriteClass.PLAIN, WriteClass.SAVE)

    def status_bits(self, code: Code, value: int) -> dict[str, bool]:
        """Return the bits of a status word; empty for a code that is none."""
        word = self.words.get(code)
        return word.flags(value) if word is not None else {}

    def status_fields(self, code: Code, value: int) -> dict[str, FieldReading]:
        """Read the numbers inside a status word; empty for a code that is none."""
        word = self.words.get(code)
        return word.readings(value) if word is not None else {}

    def active_fault(self, code: Code, value: int) -> bool | None:
        """Return whether a status word reports an active fault; None where it does not say."""
        word = self.words.get(code)
        return word.active_fault(value) if word is not None else None

    def shown_fault(self, code: Code, value: int) -> FaultKind | None:
        """Return the kind of fault a status word shows; None for none, or if it does not say."""
        word = self.words.get(code)
        if word is None:
            return None
        if word.active_fault(value):
            return FaultKind.TRIP
        notice = word.notice(value)
        return FaultKind(notice) if notice else None

    @property
    def fault_table(self) -> FaultTable | None:
        """The family's faults, None where none are known; read from its file at first use."""
        return fault_table(self.name)

    def fault(self, number: int) -> Fault | None:
        """Return what a number in the fault memory means.

        Returns:
            None for no fault (0), and for a number that the manual does not list.
        """
        table = self.fault_table
        return table.fault(number) if table is not None and number != NO_FAULT else None
