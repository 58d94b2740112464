"""A daemon with a journal, as a process, and how a test asks it over its socket."""

from __future__ import annotations

import http.client
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.children import die_with_parent, environment

__all__ = ["START_WITHIN_S", "ask", "daemon", "wait_for"]

START_WITHIN_S = 60.0
RUN = [sys.executable, "-P", "-c", "from lecombus.__main__ import main; main()", "run", "-c"]


class OverSocket(http.client.HTTPConnection):
    def __init__(self, path: Path) -> None:
        super().__init__("localhost", timeout=30)
        self._path = str(path)

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self._path)


def ask(path: Path, method: str, where: str, body: str = "", key: str = "") -> tuple[int, Any]:
    connection = OverSocket(path)
    try:
        connection.request(method, where, body or None, {"Idempotency-Key": key} if key else {})
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


@contextmanager
def daemon(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    log = (folder / "log").open("wb")
    with log, subprocess.Popen(
        [*RUN, str(folder / "roster.yaml")], stdout=log, stderr=log, env=environment(),
        preexec_fn=die_with_parent,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + START_WITHIN_S
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)
