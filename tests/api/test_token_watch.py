"""The tokens that are valid now: read again when the file changed, without a restart."""

from __future__ import annotations

import errno
import os
import threading
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import anyio
import anyio.to_thread
import pytest

from lecombus.api.token_watch import TokenWatch
from lecombus.tokens.grants import Scope
from lecombus.tokens.secret import digest_of, new_secret
from lecombus.tokens.token_file import TokenEntry, Tokens, read_tokens, write_tokens

pytestmark = [pytest.mark.anyio, pytest.mark.clock]

NOW = datetime(2026, 11, 23, 3, 0, tzinfo=UTC)


def entry(secret: str, name: str = "plc", **given: Any) -> TokenEntry:
    return TokenEntry(
        name=name, sha256=digest_of(secret), created=NOW, **{"scopes": (Scope.READ,)} | given
    )


class Watched:
    """A watched file of tokens, and what was noted."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tokens"
        self.now_s = NOW.timestamp()
        self.notes: list[str | None] = []
        self.watch = TokenWatch(self.path, lambda: self.now_s, self.notes.append)


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path)


async def test_a_token_is_valid_from_the_look_after_it_was_made_until_it_is_revoked(
    watched: Watched,
) -> None:
    secret, other = new_secret(), new_secret()
    await watched.watch.look()
    assert watched.watch.find(secret) is None
    write_tokens(watched.path, [entry(secret), entry(other, "b")])
    assert watched.watch.find(secret) is None
    await watched.watch.look()
    found = watched.watch.find(secret)
    assert found is not None
    assert watched.watch.holds(found)
    write_tokens(watched.path, [entry(other, "b")])
    await watched.watch.look()
    assert watched.watch.find(secret) is None
    assert not watched.watch.holds(found)
    assert watched.watch.find(other) is not None


async def test_a_token_expires_without_any_look(watched: Watched) -> None:
    secret = new_secret()
    write_tokens(watched.path, [entry(secret, expires=NOW + timedelta(seconds=5))])
    await watched.watch.look()
    found = watched.watch.find(secret)
    assert found is not None
    watched.now_s += 5
    assert watched.watch.find(secret) is None
    assert not watched.watch.holds(found)


@pytest.mark.parametrize("how", ["cut", "rubbish", "writable"])
async def test_a_file_that_is_refused_changes_nothing_until_a_good_one_is_there(
    watched: Watched, how: str
) -> None:
    secret, planted = new_secret(), new_secret()
    write_tokens(watched.path, [entry(secret)])
    await watched.watch.look()
    if how == "writable":
        write_tokens(watched.path, [entry(planted)])
        watched.path.chmod(0o662)
    else:
        text = watched.path.read_text()
        watched.path.write_text(text[:-20] if how == "cut" else "rubbish")
    await watched.watch.look()
    assert watched.watch.find(secret) is not None
    assert watched.watch.find(planted) is None
    said = watched.notes[-1]
    assert said is not None
    assert str(watched.path) in said
    await watched.watch.look()
    assert len(watched.notes) == 2, "said once, not at every look"
    watched.path.unlink()
    write_tokens(watched.path, [])
    await watched.watch.look()
    assert watched.notes[-1] is None
    assert watched.watch.find(secret) is None


async def test_without_a_file_no_token_is_valid(watched: Watched) -> None:
    secret = new_secret()
    write_tokens(watched.path, [entry(secret)])
    await watched.watch.look()
    watched.path.unlink()
    await watched.watch.look()
    assert watched.watch.find(secret) is None


async def test_a_change_of_nothing_but_the_mode_is_seen(watched: Watched) -> None:
    write_tokens(watched.path, [])
    await watched.watch.look()
    watched.path.chmod(0o666)
    await watched.watch.look()
    assert "others may write it" in str(watched.notes[-1])


async def test_a_reload_reads_also_what_did_not_change(watched: Watched) -> None:
    write_tokens(watched.path, [])
    await watched.watch.look()
    await watched.watch.look()
    assert len(watched.notes) == 1
    await watched.watch.look(always=True)
    assert len(watched.notes) == 2


async def test_a_file_that_could_not_be_read_for_a_moment_is_read_again(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its time and size are those of before: a revocation must not wait for the next change."""
    secret = new_secret()
    write_tokens(watched.path, [entry(secret)])
    await watched.watch.look()
    write_tokens(watched.path, [])

    def no_file_left(path: Path, *flags: Any) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), str(path))

    with monkeypatch.context() as patched:
        patched.setattr("lecombus.tokens.token_file.os.open", no_file_left)
        await watched.watch.look()
        await watched.watch.look()
    assert watched.watch.find(secret) is not None
    assert len(watched.notes) == 2, "said once, not at every look"
    await watched.watch.look()
    assert watched.watch.find(secret) is None
    assert watched.notes[-1] is None


async def test_a_slow_look_does_not_bring_back_what_a_later_one_found_revoked(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = new_secret()
    write_tokens(watched.path, [entry(secret)])
    began, revoked = threading.Event(), threading.Event()
    reads: list[Tokens] = []

    def slow(path: Path) -> Tokens:
        reads.append(read_tokens(path))
        if len(reads) == 1:
            began.set()
            revoked.wait(5)
        return reads[-1]

    monkeypatch.setattr("lecombus.api.token_watch.read_tokens", slow)
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(watched.watch.look)
        await anyio.to_thread.run_sync(began.wait, 5)
        write_tokens(watched.path, [])
        tasks.start_soon(partial(watched.watch.look, always=True))
        await anyio.sleep(0.1)
        revoked.set()
    assert watched.watch.find(secret) is None
