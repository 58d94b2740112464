"""Which daemon is meant, and what is said when there is none."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from cli.conftest import Run
from cli.daemon_stub import serve_stub
from lecombus.client import AmbiguousDaemonError, finding
from lecombus.client.finding import find_daemon

pytestmark = pytest.mark.clock


@pytest.fixture
def runtime_dir(short_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(finding, "RUNTIME_DIR", short_dir)
    return short_dir


def put_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def test_the_command_line_goes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LECOMBUS_SOCKET", "/run/lecombus/a.sock")
    monkeypatch.setenv("LECOMBUS_URL", "http://127.0.0.1:1")
    assert find_daemon(None, "http://127.0.0.1:2") == ("", "http://127.0.0.1:2")
    assert find_daemon("/b.sock", None) == ("/b.sock", "")
    assert find_daemon(None, None) == ("/run/lecombus/a.sock", "")


def test_a_url_from_the_environment_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LECOMBUS_URL", "http://127.0.0.1:9740")
    assert find_daemon(None, None) == ("", "http://127.0.0.1:9740")


def test_the_only_socket_of_the_machine_is_taken(run: Run, runtime_dir: Path) -> None:
    (runtime_dir / "not-a-socket.sock").write_text("")
    with serve_stub(runtime_dir / "hall-3.sock") as stub:
        stub.answers["GET /v1/line"] = (200, '{"state": "open"}')
        stub.answers["GET /v1/drives"] = (200, "[]")
        assert run("status").status == 0


@pytest.mark.parametrize("option", ["--socket", "--url"])
def test_an_empty_option_means_no_other_daemon(run: Run, runtime_dir: Path, option: str) -> None:
    with serve_stub(runtime_dir / "hall-3.sock") as stub:
        ran = run("stop", option, "")
        assert (ran.status, stub.asked) == (2, [])
    assert f"'{option}': it is empty" in ran.err


def test_two_daemons_are_named_and_none_is_chosen(run: Run, runtime_dir: Path) -> None:
    put_socket(runtime_dir / "a.sock")
    put_socket(runtime_dir / "b.sock")
    ran = run("stop")
    assert ran.status == 2
    assert "a.sock" in ran.err
    assert "b.sock" in ran.err
    assert "--socket" in ran.err


def test_no_daemon_is_said_with_how_to_start_one(run: Run, runtime_dir: Path) -> None:
    ran = run("status")
    assert ran.status == 3
    assert "systemctl start lecombus@NAME" in ran.err


@pytest.mark.parametrize("where", [("--socket", "/nowhere.sock"), ("--url", "http://127.0.0.1:9")])
def test_nobody_at_the_address_is_said_in_one_line(run: Run, where: tuple[str, str]) -> None:
    ran = run("status", *where)
    assert ran.status == 3
    assert ran.err.count("\n") == 1
    assert where[1] in ran.err


def test_a_socket_left_behind_is_not_a_daemon(run: Run, runtime_dir: Path) -> None:
    put_socket(runtime_dir / "hall-3.sock")
    assert run("status").status == 3


def test_a_socket_that_may_not_be_opened_is_a_matter_of_the_group(
    run: Run, runtime_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(self: socket.socket, address: object) -> None:
        raise PermissionError(13, os.strerror(13))

    put_socket(runtime_dir / "hall-3.sock")
    monkeypatch.setattr(socket.socket, "connect", denied)
    ran = run("status")
    assert ran.status == 4
    assert "group lecombus" in ran.err


@pytest.mark.parametrize("url", ["127.0.0.1:9740", "ftp://x", "http://", "http://[::"])
def test_a_url_that_is_none_is_a_usage_error(run: Run, url: str) -> None:
    with pytest.raises(AmbiguousDaemonError, match="is no URL"):
        find_daemon(None, url)
    assert run("status", "--url", url).status == 2


def test_socket_and_url_together_are_a_usage_error(run: Run) -> None:
    assert run("status", "--socket", "/a", "--url", "http://b").status == 2
