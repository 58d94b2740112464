"""Families of drives from data files, and what follows from them.

`family` and `code_info` are the models, `families/*.yaml` the data with the sections of the
manuals, `family_files` reads them (`yaml_models` and `field_types` serve all data files). `words`
decodes status words, `control_words` control words, `faults` explains fault numbers, `stops` and
`verbs` make the writes that stop, enable, set and reset a drive, `encoding` makes a value of what a
user gives. `descriptions` says what a family is as documents, `procedures` holds what a backup, a
restore or a change of address needs of one drive.

What must not live here: input and output but for the packaged data files, clocks, the line, values
that were read from a drive.
"""

from __future__ import annotations

from .code_info import CodeInfo, Storage, WriteClass
from .control_words import ControlWordInfo
from .encoding import check_allowed, encode_for
from .family import PASSWORDS, Family, SoftwareGate, WatchdogTraits
from .family_files import FAMILY_NAMES, add_families, family, read_family_file
from .faults.fault_tables import Fault, FaultKind
from .field_types import Language, Text
from .restore_rules import (
    is_last,
    must_be_same,
    not_restored,
    restore_rank,
    restore_rule,
    saving_rule,
)
from .stops import (
    StopAction,
    asks_to_stop,
    confirm_codes,
    knows_stop,
    needs_control_word,
    stop_confirmed,
    stop_steps,
    stop_value,
)
from .verb_rules import Verb
from .words import OperatingState, WordInfo, believed_states, german_name, join_states

__all__ = [
    "FAMILY_NAMES",
    "PASSWORDS",
    "CodeInfo",
    "ControlWordInfo",
    "Family",
    "Fault",
    "FaultKind",
    "Language",
    "OperatingState",
    "SoftwareGate",
    "StopAction",
    "Storage",
    "Text",
    "Verb",
    "WatchdogTraits",
    "WordInfo",
    "WriteClass",
    "add_families",
    "asks_to_stop",
    "believed_states",
    "check_allowed",
    "confirm_codes",
    "encode_for",
    "family",
    "german_name",
    "is_last",
    "join_states",
    "knows_stop",
    "must_be_same",
    "needs_control_word",
    "not_restored",
    "read_family_file",
    "restore_rank",
    "restore_rule",
    "saving_rule",
    "stop_confirmed",
    "stop_steps",
    "stop_value",
]
