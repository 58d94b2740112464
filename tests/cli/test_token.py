"""`lecombus token`: makes, lists and revokes tokens."""

from __future__ import annotations

import fcntl
import json
import os
import pwd
import stat
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from cli.conftest import Run
from lecombus.tokens.token_file import read_tokens

ROSTER = """
line: {name: bench, port: "sim:"}
drives: [{name: feeder, address: 11, family: 8200vector}]
groups: {conveyors: {members: [feeder]}}
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "tokens"
    monkeypatch.setenv("LECOMBUS_TOKENS", str(path))
    return path


def test_a_new_token_is_printed_once_and_stored_nowhere(run: Run, file: Path) -> None:
    ran = run("token", "new", "scada", "--scope", "read")
    assert ran.status == 0
    secret = ran.out.strip()
    found = read_tokens(file).find(secret, time.time())
    assert found is not None
    assert (found.name, found.targets, found.expires) == ("scada", (), None)
    assert secret not in file.read_text()
    listed = run("token", "list").out
    assert listed.startswith("scada\tread\tall\t")
    assert listed.endswith("\tnever\tvalid\n")
    assert secret not in listed + run("token", "list", "--json").out


def test_scopes_targets_and_end_stand_in_the_file(run: Run, file: Path, tmp_path: Path) -> None:
    words = ("--scope", "write", "--scope", "control", "--for", "feeder", "--expires", "90d")
    output = tmp_path / "plc.token"
    ran = run("token", "new", "plc", *words, "--json", "-o", str(output))
    said = json.loads(ran.out)
    assert (said["scopes"], said["targets"]) == (["write", "control"], ["feeder"])
    assert "sha256" not in said
    assert "token" not in said
    assert stat.S_IMODE(output.stat().st_mode) == 0o600
    found = read_tokens(file).find(output.read_text().strip(), time.time())
    assert found is not None
    assert found.expires is not None
    assert 89 < (found.expires - found.created).days <= 90


def test_a_revoked_token_is_gone_and_the_others_stay(run: Run, file: Path) -> None:
    for name in ("a", "b", "c"):
        run("token", "new", name, "--scope", "read")
    assert run("token", "revoke", "a", "nobody").status == 2
    assert [one.name for one in read_tokens(file)] == ["a", "b", "c"], "all or none"
    assert run("token", "revoke", "a", "c").status == 0
    assert [one.name for one in read_tokens(file)] == ["b"]


def test_a_token_is_revoked_in_the_file_that_a_link_leads_to(
    run: Run, file: Path, tmp_path: Path
) -> None:
    """A daemon may name the file itself, or another link."""
    (tmp_path / "real").mkdir()
    real = tmp_path / "real" / "tokens"
    assert run("token", "new", "plc", "--scope", "control", "--file", str(real)).status == 0
    real.chmod(0o600)
    file.symlink_to(real)
    assert run("token", "revoke", "plc").status == 0
    assert (file.is_symlink(), read_tokens(real).entries) == (True, ())
    assert stat.S_IMODE(real.stat().st_mode) == 0o600
    assert sorted(path.name for path in tmp_path.iterdir()) == ["real", "tokens"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("plc",), "Missing option '--scope'"),
        (("plc", "--scope", "admin"), "'admin' is not one of"),
        (("a b", "--scope", "read"), "`a b` is not a name"),
        (("-x", "--scope", "read"), "No such option"),
        (("plc", "--scope", "read", "--expires", "soon"), "90d or 12h"),
        (("plc", "--scope", "read", "--expires", "2020-01-01"), "in the past"),
        (("plc", "--scope", "read", "--expires", "99999d"), "more than 20 years"),
        (("plc", "--scope", "read", "--expires", "2027-13-01"), "not a time"),
        (("plc", "--scope", "metrics", "--for", "feeder"), "shows all drives"),
        (("twice", "--scope", "read"), "there is a token twice already"),
    ],
)
def test_what_is_wrong_makes_no_token(
    run: Run, file: Path, words: tuple[str, ...], says: str
) -> None:
    run("token", "new", "twice", "--scope", "read")
    before = file.read_bytes()
    ran = run("token", "new", *words)
    assert (ran.status, ran.out) == (2, "")
    assert says in ran.err
    assert file.read_bytes() == before


def test_drives_are_looked_up_where_a_roster_is_given(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("LECOMBUS_TOKENS", raising=False)
    roster = tmp_path / "r.yaml"
    roster.write_text(ROSTER)
    ran = run("token", "new", "plc", "--scope", "read", "-c", str(roster))
    assert (ran.status, "has no `api.tokens`" in ran.err) == (2, True)
    roster.write_text(f"{ROSTER}api: {{tokens: {tmp_path}/tokens}}\n")
    ran = run("token", "new", "plc", "--scope", "read", "--for", "belt", "-c", str(roster))
    assert (ran.status, "no drive or group belt" in ran.err) == (2, True)
    ran = run("token", "new", "plc", "--scope", "read", "--for", "conveyors", "-c", str(roster))
    assert ran.status == 0
    assert [one.targets for one in read_tokens(tmp_path / "tokens")] == [("conveyors",)]


def test_a_file_that_others_may_write_is_not_extended(run: Run, file: Path) -> None:
    run("token", "new", "a", "--scope", "read")
    file.chmod(0o666)
    ran = run("token", "new", "b", "--scope", "read")
    assert (ran.status, ran.out) == (1, "")
    assert "others may write it" in ran.err


def test_a_token_is_not_written_over_another_file(run: Run, file: Path, tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.write_text("x")
    assert run("token", "new", "a", "--scope", "read", "-o", str(there)).status == 2
    assert there.read_text() == "x"
    assert not file.exists()


def test_a_token_that_could_not_be_kept_leaves_no_file(
    run: Run, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its secret would never be valid, and the file would stand against the next attempt."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    output = tmp_path / "plc.token"
    words = ("token", "new", "plc", "--scope", "control", "-o", str(output))
    with monkeypatch.context() as patched:
        patched.setattr("lecombus.tokens.token_file.os.fsync", fail)
        ran = run(*words)
    assert (ran.status, ran.out, list(tmp_path.iterdir())) == (1, "", [])
    assert ran.err == f"{file}: no space left on device\n"
    assert run(*words).status == 0
    assert read_tokens(file).find(output.read_text().strip(), time.time()) is not None


def test_another_process_that_locks_the_folder_does_not_keep_a_token_from_being_revoked(
    run: Run, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every user who may read the folder may lock it."""
    monkeypatch.setattr("lecombus.cli.token.LOCK_S", 0.0)
    run("token", "new", "a", "--scope", "read")
    folder = os.open(file.parent, os.O_RDONLY)
    fcntl.flock(folder, fcntl.LOCK_EX)
    try:
        ran = run("token", "revoke", "a")
    finally:
        os.close(folder)
    assert ran.status == 0
    assert "another process keeps" in ran.err
    assert list(read_tokens(file)) == []


@pytest.mark.parametrize(("user", "daemon", "status"), [(0, 4242, 0), (0, 7, 1), (7, 4242, 1)])
def test_root_changes_a_file_of_the_daemons_user_and_of_no_other(
    run: Run, file: Path, monkeypatch: pytest.MonkeyPatch, user: int, daemon: int, status: int
) -> None:
    run("token", "new", "a", "--scope", "read")
    real = os.fstat

    def foreign(descriptor: int) -> os.stat_result:
        found = list(real(descriptor))
        found[4] = 4242
        return os.stat_result(found)

    monkeypatch.setattr(os, "fstat", foreign)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(pwd, "getpwnam", lambda name: SimpleNamespace(pw_uid=daemon))
    for words in (("token", "list"), ("token", "revoke", "a")):
        ran = run(*words)
        assert (ran.status, "belongs to user 4242" in ran.err) == (status, status != 0)
