"""Files that cannot be read are one clear mistake; no text ever gives anything but a mistake."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.rosters import CONFIG, GOOD
from lecombus.config import RosterError, load_roster, parse_roster
from lecombus.errors import ConfigError, LecombusError
from support.golden import Golden


def refused(path: Path) -> str:
    with pytest.raises(RosterError) as caught:
        load_roster(path)
    (mistake,) = caught.value.mistakes
    return str(mistake).removeprefix(f"{path}:")


def written(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "line.yaml"
    path.write_bytes(data)
    return path


def test_a_good_file_is_read_also_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = written(tmp_path, b"\xef\xbb\xbf" + GOOD.encode())
    assert load_roster(path).line.name == "hall-3"
    assert load_roster(path).file == str(path)


def test_lines_may_end_as_in_windows(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD.replace("\n", "\r\n").encode())
    assert len(load_roster(path).drives) == 2


def test_there_is_no_file(tmp_path: Path, golden: Golden) -> None:
    golden(refused(tmp_path / "none.yaml"))


def test_the_file_is_a_directory(tmp_path: Path, golden: Golden) -> None:
    golden(refused(tmp_path))


def test_the_file_may_not_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    def denied(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", denied)  # a mode of 000 does not keep root out
    golden(refused(tmp_path / "line.yaml"))


def test_the_system_fails_while_reading(golden: Golden) -> None:
    golden(refused(Path("/proc/self/mem")))


def test_a_pipe_is_refused_at_once(tmp_path: Path, golden: Golden) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    golden(refused(path))


def test_a_name_with_nul_is_no_file(golden: Golden) -> None:
    golden(refused(Path("a\0b")))


@pytest.mark.parametrize("data", [b"", b"\n\n", b"# nothing\n", b"---\n", b"~\n", b"\xef\xbb\xbf"])
def test_the_file_is_empty(tmp_path: Path, data: bytes, golden: Golden) -> None:
    golden(refused(written(tmp_path, data)))


@pytest.mark.parametrize("data", [b"hello", b"- a", b"'line'"])
def test_the_file_is_something_else(tmp_path: Path, data: bytes, golden: Golden) -> None:
    golden(refused(written(tmp_path, data)))


def test_the_file_is_not_utf8(tmp_path: Path, golden: Golden) -> None:
    data = "line:\n  name: höl".encode() + b"\xe4\n"
    golden(refused(written(tmp_path, data)))


def test_the_file_is_too_large(tmp_path: Path, golden: Golden) -> None:
    path = written(tmp_path, GOOD.encode() + b"#" * (1024 * 1024))
    golden(refused(path))


def test_no_file_stays_open_after_a_refusal(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    for path in (tmp_path, Path("/proc/self/mem"), written(tmp_path, b"a: [")):
        refused(path)
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


def test_the_error_is_of_our_tree_and_says_everything() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_roster("line: {}\ndrives: []\n", "x.yaml")
    error = caught.value
    assert isinstance(error, RosterError)
    assert isinstance(error, LecombusError)
    assert str(error) == "\n".join(str(mistake) for mistake in error.mistakes)
    assert (error.file, error.where) == ("x.yaml", "1:7")
    assert [str(mistake)[:11] for mistake in error.mistakes] == [
        "x.yaml:1:7:", "x.yaml:1:7:", "x.yaml:2:9:"
    ]  # fmt: skip


def attempt(text: str) -> None:
    """Read a text: right or refused with places inside it, never anything else."""
    try:
        parse_roster(text, "f")
    except RosterError as error:
        lines = text.count("\n") + text.count("\r") + text.count("\x85") + 2
        lines += text.count("\u2028") + text.count("\u2029")
        for mistake in error.mistakes:
            assert 1 <= mistake.line <= lines
            assert mistake.column >= 1
            assert mistake.what
            assert mistake.right
            assert "\n" not in str(mistake)
            assert "Input should be" not in str(mistake)


@given(st.text())
def test_any_text_is_read_or_refused(text: str) -> None:
    attempt(text)


@given(st.text(alphabet="abc: \n-[]{}&*!|>'\"#%@`,?~<\t0", max_size=60))
@settings(max_examples=300)
def test_any_text_that_looks_like_yaml_is_read_or_refused(text: str) -> None:
    attempt(text)


FULL = (CONFIG / "full.yaml").read_text()
PIECES = st.sampled_from(
    ["", " ", "\n", ":", "~", "[]", "{}", "- ", "&a ", "*a", "<<: ", "yes", "-1", "0", "1e99",
     "9" * 400, "!!int ", "'", '"', "\t", "é", "\x00", "null", "[[", "C0150", "2s", "%", ",", "#"]
)  # fmt: skip


@given(st.data())
@settings(max_examples=150)
def test_any_change_of_a_roster_is_read_or_refused(data: Any) -> None:
    text = FULL
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = min(len(text), start + data.draw(st.integers(0, 12)))
        text = text[:start] + data.draw(PIECES) + text[end:]
    attempt(text)


VALUES = st.recursive(
    st.sampled_from(["~", "yes", "11", "-1", "2s", "C0150", "feeder", "''", "1.5", "sim", "'a:b'"]),
    lambda inner: (
        st.lists(inner, max_size=3).map(lambda items: f"[{', '.join(items)}]")
        | st.dictionaries(
            st.sampled_from(["name", "code", "every", "time", "members", "required", "x"]),
            inner,
            max_size=3,
        ).map(
            lambda pairs: "{" + ", ".join(f"{key}: {value}" for key, value in pairs.items()) + "}"
        )
    ),
    max_leaves=6,
)
KEYS = ["line", "drives", "groups", "lease", "on_shutdown", "api", "mqtt", "modbus", "notify",
        "journal", "version", "nmae"]  # fmt: skip
DRIVE_KEYS = ["name", "address", "family", "watchdog", "cyclic", "writable", "lease", "addressing",
              "answer_time", "accept_software", "allow_address_change"]  # fmt: skip


@given(st.dictionaries(st.sampled_from(KEYS), VALUES))
def test_any_value_at_any_key_is_read_or_refused(pairs: dict[str, str]) -> None:
    attempt("\n".join(f"{key}: {value}" for key, value in pairs.items()))


@given(st.dictionaries(st.sampled_from(DRIVE_KEYS), VALUES, min_size=1), VALUES)
def test_any_value_at_any_key_of_a_drive_is_read_or_refused(
    pairs: dict[str, str], shutdown: str
) -> None:
    entry = ", ".join(f"{key}: {value}" for key, value in pairs.items())
    attempt(
        f"line: {{name: a, port: sim}}\ndrives: [{{{entry}}}, {{name: b, address: 11, family: "
        f"generic, {entry}}}]\non_shutdown: {shutdown}\n"
    )
