"""Whatever stands in a data file, it is read or refused with its place: nothing else is raised."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib import resources
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from lecombus.drives import FAMILY_NAMES, Family
from lecombus.drives.family_files import load_family
from lecombus.drives.faults.causes import cause_rules
from lecombus.drives.faults.fault_tables import link_report, load_table
from lecombus.drives.faults.reasons import reasons
from lecombus.errors import DescriptionError
from lecombus.parameters import Code

OTHERS = ("x", "''", "7", "-1", "0x8", "99999999999", "true", "[]", "{}", "[7]", "[a, b]", "{a: b}",
          "C0150", "C9999", "~", "[[]]", "{1: [a, b]}", "others", '"7"', "[0, 0]")  # fmt: skip


def read(folder: str, file: str) -> str:
    return (resources.files("lecombus.drives") / folder / file).read_text(encoding="utf-8")


def family_loader(name: str) -> Callable[[Callable[[str], str]], object]:
    return lambda read_file: load_family(name, read_file)


def table_loader(name: str) -> Callable[[Callable[[str], str]], object]:
    return lambda read_file: load_table(name, read_file)


FILES: list[tuple[str, str, Callable[[Callable[[str], str]], object]]] = [
    *(("families", f"{name}.yaml", family_loader(name)) for name in FAMILY_NAMES),
    ("families", "common-2102.yaml", family_loader("93xx")),
    ("families", "verbs-93xx.yaml", family_loader("93xx")),
    ("families", "common-lecom.yaml", family_loader("smvector")),
    *(("faults", f"{name}.yaml", table_loader(name)) for name in ("82xx", "smvector")),
    ("faults", "extended.yaml", link_report),
    ("faults", "causes.yaml", cause_rules),
    ("faults", "reasons.yaml", reasons),
]


@cache
def composed(text: str) -> Any:
    return yaml.compose(text, Loader=yaml.CSafeLoader)


def nodes_of(node: Any) -> Iterator[Any]:
    yield node
    for child in node.value if not isinstance(node, yaml.ScalarNode) else ():
        for one in child if isinstance(child, tuple) else (child,):
            yield from nodes_of(one)


@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_a_file_with_any_value_replaced_is_read_or_refused(data: st.DataObject) -> None:
    folder, file, load = data.draw(st.sampled_from(FILES))
    text = read(folder, file)
    nodes = list(nodes_of(composed(text)))
    node = nodes[data.draw(st.integers(0, len(nodes) - 1))]
    wrong = data.draw(st.sampled_from(OTHERS))
    block = not isinstance(node, yaml.ScalarNode) and not node.flow_style
    changed = text[: node.start_mark.index] + wrong + "\n" * block + text[node.end_mark.index :]
    with suppress(DescriptionError):
        load(lambda name: changed if name == file else read(folder, name))


WORDS = 'words: [{fields: [{name: x, nam: y, bits: [0, 1]}], code: C0001, bits: {}, source: "1"}]'
SMALL = """\
family: t
title: t
addressing: [standard]
codes:
  - {code: C0001, name: off, format: VD, source: "1", selection: {8: [no, nein]}}
answer_times: [{codes: others, read_ms: 20, write_ms: 20, source: "1"}]
hold_after_write_ms: 0
feed: C0001
identity: []
status: []
writable: []
protocol: lecom
"""


def load_small(text: str) -> Family:
    return load_family("t", {"t.yaml": text}.__getitem__)


def test_words_that_yaml_takes_for_no_are_texts() -> None:
    info = load_small(SMALL).codes[Code(1)]
    assert (info.name, str(info.selection[8])) == ("off", "no")


@pytest.mark.parametrize(
    ("right", "wrong", "where", "path", "value", "message"),
    [
        ("VD,", "VX,", "5:38", "codes.0.format", "VX", "VX is not known here; VD, VH, VS, VO are"),
        ("read_ms: 20", 'read_ms: "20"', "6:41", "answer_times.0.read_ms", "20", "a whole number"),
        ("read_ms: 20", "read_ms: 0", "6:41", "answer_times.0.read_ms", "0", "0: a whole number"),
        ("VD,", "VD, parameter_set: 2,", "5:42", "codes.0.parameter_set", "2", "not known here"),
        ("{8:", "{8: [a, b], 0x8:", "5:78", "codes.0.selection.0x8", "", "8 stands here twice"),
        ("title: t", "[title]: t", "2:1", "", "", "a text is right here"),
        ("title: t", "title: &t [*t]", "2:8", "title", "", "a text is right here"),
        ("status: []", "status: [{}]", "10:10", "status.0.code", "", "code is missing"),
        ("status: []", f"status: []\n{WORDS}", "11:29", "words.0.fields.0.nam", "y", "fault, name"),
        ("status: []", "status: C0001", "10:9", "status", "C0001", "a list is right here"),
        ("status: []", "status: [C0001]", "10:10", "status.0", "C0001", "a table of keys"),
    ],
)
def test_an_error_has_place_path_value_and_what_is_right(
    right: str, wrong: str, where: str, path: str, value: str, message: str
) -> None:
    with pytest.raises(DescriptionError, match=message) as caught:
        load_small(SMALL.replace(right, wrong, 1))
    error = caught.value
    assert (error.file, error.where, error.path) == ("families/t.yaml", where, path)
    assert not value or error.value == value
