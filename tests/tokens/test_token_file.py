"""The file of tokens."""

from __future__ import annotations

import json
import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from lecombus.errors import OperationError
from lecombus.tokens.grants import Scope
from lecombus.tokens.secret import digest_of, new_secret
from lecombus.tokens.token_file import MOST_TOKENS, TokenEntry, read_tokens, write_tokens

NOW = datetime(2026, 11, 23, 3, 0, tzinfo=UTC)
NOW_S = NOW.timestamp()


def entry(secret: str, name: str = "scada", **given: Any) -> TokenEntry:
    return TokenEntry(
        name=name, sha256=digest_of(secret), created=NOW, **{"scopes": (Scope.READ,)} | given
    )


def test_what_was_written_is_read_and_holds_no_secret(tmp_path: Path) -> None:
    path, secret = tmp_path / "tokens", new_secret()
    made = [
        entry(secret, expires=NOW + timedelta(days=1)),
        entry(new_secret(), "plc", scopes=(Scope.CONTROL, Scope.WRITE), targets=("feeder",)),
    ]
    write_tokens(path, made)
    assert list(read_tokens(path)) == made
    assert secret not in path.read_text()
    assert secret[4:20] not in path.read_text()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert [one.name for one in tmp_path.iterdir()] == ["tokens"]


def test_no_file_is_no_token(tmp_path: Path) -> None:
    assert list(read_tokens(tmp_path / "tokens")) == []


def test_mode_and_owner_stay_and_nobody_else_may_write_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    write_tokens(path, [])
    path.chmod(0o600)
    write_tokens(path, [])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o666)
    write_tokens(path, [])
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tokens"
    write_tokens(path, [entry(new_secret())])
    before = path.read_bytes()

    def fails(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(OSError, match="No space"):
        write_tokens(path, [])
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["tokens"]


@pytest.mark.parametrize("mode", [0o660, 0o642, 0o666])
def test_a_file_that_others_may_write_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "tokens"
    write_tokens(path, [entry(new_secret())])
    path.chmod(mode)
    with pytest.raises(OperationError, match="others may write it") as caught:
        read_tokens(path)
    assert caught.value.kind == "tokens"
    assert str(path) in str(caught.value)


def test_a_file_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "tokens"
    write_tokens(path, [])
    real = os.fstat

    def foreign(descriptor: int) -> os.stat_result:
        found = list(real(descriptor))
        found[4] = 4242
        return os.stat_result(found)

    monkeypatch.setattr(os, "fstat", foreign)
    with pytest.raises(OperationError, match="belongs to user 4242"):
        read_tokens(path)


def document(*tokens: dict[str, Any], version: int = 1) -> str:
    return json.dumps({"version": version, "tokens": tokens})


GOOD = {
    "name": "a", "sha256": "0" * 64, "scopes": ["read"], "targets": [],
    "created": "2026-11-23T03:00:00Z", "expires": None,
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no JSON"),
        ("[]", "the document"),
        (document(version=2), "it has version 2, and this lecombus knows 1"),
        (document(GOOD | {"more": 1}, version=2), "it has version 2, and this lecombus knows 1"),
        (document(version=0), "version"),
        (document(GOOD, GOOD), "two tokens have the same name"),
        (document(GOOD, GOOD | {"name": "b"}), "two tokens have the same sha256"),
        (document(GOOD | {"scopes": []}), "tokens.0.scopes"),
        (document(GOOD | {"scopes": ["root"]}), "tokens.0.scopes.0"),
        (document(GOOD | {"sha256": "0" * 63}), "tokens.0.sha256"),
        (document(GOOD | {"name": "a b"}), "tokens.0.name"),
        (document(GOOD | {"name": "a\n"}), "tokens.0.name"),
        (document(GOOD | {"secret": "lcb_"}), "tokens.0.secret"),
        (document(GOOD | {"expires": "2026-11-23T03:00:00"}), "needs its zone"),
        (document(GOOD | {"created": "yesterday"}), "tokens.0.created"),
        (document(*[GOOD] * (MOST_TOKENS + 1)), "tokens"),
        (" " * 300_000, "longer than"),
    ],
)
def test_a_file_that_is_none_is_refused_as_a_whole(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "tokens"
    path.write_text(text)
    with pytest.raises(OperationError, match=says) as caught:
        read_tokens(path)
    assert "0" * 20 not in str(caught.value), "no digest stands in an error"


def test_a_file_of_a_later_version_asks_for_that_lecombus(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    path.write_text(document(version=2))
    with pytest.raises(OperationError) as caught:
        read_tokens(path)
    assert caught.value.remedy == "install the lecombus that wrote it, or a later one"


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_refused_without_waiting(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "tokens"
    make(path)
    with pytest.raises(OperationError):
        read_tokens(path)


def test_a_token_is_found_by_its_secret_until_it_expires(tmp_path: Path) -> None:
    path, secret = tmp_path / "tokens", new_secret()
    write_tokens(path, [entry(new_secret(), "a"), entry(secret, "b", expires=NOW), entry("x", "c")])
    tokens = read_tokens(path)
    found = tokens.find(secret, NOW_S - 1)
    assert found is not None
    assert found.name == "b"
    assert tokens.holds(found, NOW_S - 1)
    assert tokens.find(secret, NOW_S) is None
    assert not tokens.holds(found, NOW_S)
    assert tokens.find("x", NOW_S) is None, "a text without the form of a token is never one"
    assert tokens.find(new_secret(), NOW_S) is None


def test_a_token_whose_rights_changed_is_another(tmp_path: Path) -> None:
    path, secret = tmp_path / "tokens", new_secret()
    write_tokens(path, [entry(secret)])
    before = read_tokens(path).find(secret, NOW_S)
    assert before is not None
    write_tokens(path, [entry(secret, targets=("feeder",))])
    assert not read_tokens(path).holds(before, NOW_S)


def test_brackets_without_end_are_no_tokens(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    path.write_text("[" * 200_000)
    path.chmod(0o640)
    with pytest.raises(OperationError, match="it is no JSON") as refused:
        read_tokens(path)
    assert refused.value.kind == "tokens"
