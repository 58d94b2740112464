"""YAML becomes nodes with places, or one mistake; by both of PyYAML's parsers alike."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from lecombus.config.mistakes import Mistakes, RosterError
from lecombus.config.yaml_nodes import DEEPEST, ListNode, MappingNode, Node, Scalar, compose
from support.golden import Golden

PARSERS = [yaml.SafeLoader, *([yaml.CSafeLoader] if yaml.__with_libyaml__ else [])]


@pytest.fixture(params=PARSERS, ids=lambda parser: parser.__name__)
def parser(request: pytest.FixtureRequest) -> Any:
    return request.param


def composed(text: str, parser: Any) -> tuple[Node | None, list[str]]:
    mistakes = Mistakes("f")
    node = compose(text, mistakes, parser=parser)
    return node, [str(mistake) for mistake in mistakes.error().mistakes] if mistakes else []


def refused(text: str, parser: Any) -> str:
    with pytest.raises(RosterError) as caught:
        composed(text, parser)
    (mistake,) = caught.value.mistakes
    return str(mistake)


def plainly(node: Node | None) -> Any:
    if isinstance(node, MappingNode):
        return {key: plainly(value) for key, (_, value) in node.items.items()}
    if isinstance(node, ListNode):
        return [plainly(item) for item in node.items]
    return None if node is None else node.text


def test_every_node_knows_its_place(parser: Any) -> None:
    node, _ = composed("a:\n  - {b: 1, c: é2}\n  - x\n", parser)
    assert isinstance(node, MappingNode)
    key, items = node.items["a"]
    assert isinstance(items, ListNode)
    assert (key.line, key.column, items.line, items.column) == (1, 1, 2, 3)
    inner = items.items[0]
    assert isinstance(inner, MappingNode)
    assert (inner.line, inner.column) == (2, 5)
    assert [(at.line, at.column, value.column) for at, value in inner.items.values()] == [
        (2, 6, 9), (2, 12, 15)
    ]  # fmt: skip


@pytest.mark.parametrize("text", ["no", "011", "11:30", "1.20", "1e3", "0x1F", "2026-11-21"])
def test_scalars_keep_their_text(text: str, parser: Any) -> None:
    node, _ = composed(f"a: {text}", parser)
    assert plainly(node) == {"a": text}


@pytest.mark.parametrize("text", ["", "~", "null", "NULL"])
def test_a_key_without_value_is_empty_and_a_quoted_one_is_not(text: str, parser: Any) -> None:
    node, _ = composed(f"a: {text}\nb: '{text}'", parser)
    assert isinstance(node, MappingNode)
    empty = [value.is_empty for _, value in node.items.values() if isinstance(value, Scalar)]
    assert empty == [True, False]


def test_merged_keys_give_way_to_written_ones_wherever_they_stand(parser: Any) -> None:
    text = "a: &a {x: 1, y: 2}\nb: &b {y: 3, z: 4}\nc: {x: 5, <<: [*a, *b]}\nd: {<<: *b, y: 6}"
    node, mistakes = composed(text, parser)
    assert not mistakes
    assert plainly(node)["c"] == {"x": "5", "y": "2", "z": "4"}
    assert plainly(node)["d"] == {"y": "6", "z": "4"}


def test_merging_what_is_no_mapping_is_noted(parser: Any, golden: Golden) -> None:
    _, mistakes = composed("a: &a 1\nb: {<<: *a}", parser)
    golden(*mistakes)


def test_a_key_that_stands_twice_is_noted_and_the_first_one_kept(
    parser: Any, golden: Golden
) -> None:
    node, mistakes = composed("a: 1\nb: 2\na: 3", parser)
    assert plainly(node) == {"a": "1", "b": "2"}
    golden(*mistakes)


def test_tags_are_noted_and_never_acted_on(parser: Any, golden: Golden) -> None:
    text = "a: !!python/object/apply:os.system [ls]\nb: !thing x\nc: !!str 5"
    _, mistakes = composed(text, parser)
    golden(*mistakes)


def test_a_text_without_document_is_nothing(parser: Any) -> None:
    assert composed("", parser) == (None, [])
    assert composed("# only a comment\n", parser) == (None, [])


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("a:\n\t- b\n", "f:2:1"),
        ("a: b: c", "f:1:5"),
        ("line:\n  port: sim:\n", "f:2:12"),
        ("a: *b", "f:1:4"),
        ("a: &a [*a]", "f:1:8"),
        ("a: 1\n---\nb: 2", "f:2:1"),
        ("{[a]: b}", "f:1:2"),
        ("a: b\x07c", "f:1:5"),
        ("a: 1\nb: \ud800", "f:2:4"),
    ],
)
def test_what_is_no_yaml_is_one_mistake_at_its_place(
    text: str, place: str, parser: Any, golden: Golden
) -> None:
    words = refused(text, parser)
    assert words.startswith(f"{place}: ")
    golden(words)


@pytest.mark.parametrize(
    "text",
    ['a: "x', "a: 'x", "a: [1, 2", "a: {b: 1", "a: %x", "a: @x", "a: `x`", "- a\nb: 1",
     "a: 1\n b: 2", "a\nb: 1", "a: [1\nb: 2", "a: !x!y z", "%YAML 9", "a: - b",
     "}", "&a &b", "%", "a: &! x", "a: |x\n b", "&a &b c", "a: !<x", "a: \"\\q\""],
)  # fmt: skip
def test_every_syntax_error_is_said_without_the_parsers_jargon(text: str, parser: Any) -> None:
    words = refused(text, parser)
    assert "not valid YAML: " in words
    assert "<block" not in words
    assert "token" not in words
    assert "<document" not in words


def test_deep_nesting_is_refused_before_it_hurts(parser: Any) -> None:
    assert f"more than {DEEPEST} deep" in refused("[" * 100_000, parser)
    assert f"more than {DEEPEST} deep" in refused("a: " + "{a: " * 50_000, parser)


def test_an_alias_bomb_is_refused_without_writing_it_out(parser: Any) -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 19)]
    assert "entries, aliases written out" in refused("\n".join(rows), parser)


def test_a_merge_bomb_is_refused_too(parser: Any) -> None:
    rows = ["a0: &a0 {" + ", ".join(f"k{n}: 1" for n in range(100)) + "}"]
    rows += [f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 50)}]}}" for n in range(1, 9)]
    assert "entries, aliases written out" in refused("\n".join(rows), parser)
