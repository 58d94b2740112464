"""Records whole answers of a running daemon over both of its sockets.

The daemon is `python -m lecombus run` of a tree, on the simulated drives of the roster (`sim:`); a
second one has a port that is not there. Nothing of lecombus is imported here.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from compare.normal import normal, normal_plan
from compare.requests import DRIVES, ROSTER, Request, corpus, get, send
from compare.trees import Side

START_S = 180.0
"""Longest time granted for all drives to be online and looked at."""
ANSWER_S = 15.0
"""Longest time an answer may take on a busy machine."""
QUIET_S = 0.5
"""Where several answers may come, they have ended when so long nothing follows a whole one."""
STABLE_S = 13
"""So long no document may have changed before the first request: values not read for 10 s are
stale, and all of them shall be."""


def record(side: Side) -> str:
    """Return the record of the HTTP part of one side."""
    return answers(side, "sim:", corpus(), settled=True) + answers(
        side, "/dev/lecombus-is-not-there", _without_line()
    )


def answers(side: Side, port: str, requests: Iterable[Request], *, settled: bool = False) -> str:
    """Ask a daemon of a side everything by both of its doors.

    Args:
        side: The side.
        port: The port of its line.
        requests: What is asked, in this order.
        settled: First wait until all drives are online and no document changes any more.
    """
    asked, sections = list(requests), []
    with running(side, port) as doors:
        for name, door in doors.items():
            if settled:
                _settle(doors["unix"])
            sections += [_section(f"{name}: {one.name}", door, one) for one in asked]
    return "".join(sections)


def _without_line() -> Iterator[Request]:
    """Give what is asked of a daemon whose port is not there."""
    for path in ("/v1/line", "/v1/drives/feeder", "/v1/drives", "/healthz", "/readyz", "/metrics",
                 "/v1/drives/feeder/codes/C0150", "/v1/drives/feeder/codes/C0150?fresh=true",
                 "/v1/drives/feeder/why", "/v1/drives/belt/identity"):  # fmt: skip
        yield get(path)
    yield send("PUT", "/v1/drives/feeder/codes/C0046", {"value": 1})
    yield send("POST", "/v1/drives/feeder/verbs/enable", b"")
    yield send("POST", "/v1/stop", {"action": "inhibit", "target": "all"})


Door = Callable[[], socket.socket]


@contextlib.contextmanager
def running(side: Side, port: str) -> Iterator[dict[str, Door]]:
    """Run a daemon of a tree; give what connects to it by its Unix socket and by TCP."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lc-")))
        http = _free_port()
        roster = folder / "roster.yaml"
        roster.write_text(ROSTER.format(port=port, folder=folder, http=http))
        log = stack.enter_context((folder / "log").open("wb"))
        process = subprocess.Popen(
            side.command("run", "-c", str(roster)), env=side.environment(), cwd=side.tree,
            stdout=log, stderr=log,
        )  # fmt: skip
        stack.callback(_end, process)
        doors: dict[str, Door] = {
            "tcp": lambda: socket.create_connection(("127.0.0.1", http), ANSWER_S),
            "unix": lambda: _unix(folder / "api.sock"),
        }
        _until(lambda: process.poll() is not None or _answers(doors), "the API answers")
        if process.poll() is not None:
            raise RuntimeError(f"the daemon ended: {(folder / 'log').read_text()}")
        yield doors


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _unix(path: Path) -> socket.socket:
    found = socket.socket(socket.AF_UNIX)
    found.settimeout(ANSWER_S)
    try:
        found.connect(os.fspath(path))
    except OSError:
        found.close()
        raise
    return found


def _answers(doors: dict[str, Door]) -> bool:
    try:
        return all(b" 200 " in ask(door, get("/v1/line")) for door in doors.values())
    except OSError:
        return False


def _until(condition: Callable[[], bool], what: str) -> None:
    end_s = time.monotonic() + START_S
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError(f"not within {START_S:g} s: {what}")
        time.sleep(0.05)


def _settle(door: Door) -> None:
    """Wait until all drives are online, nothing waits, and no document changes any more."""

    def state() -> str:
        answers = [ask(door, get(f"/v1/drives/{drive}{what}")).partition(b"\r\n\r\n")[2].decode()
                   for drive in DRIVES for what in ("", "/identity")]  # fmt: skip
        return normal("".join(answers))

    def online() -> bool:
        return state().count('"state": "online"') == len(DRIVES)

    _until(online, "all drives are online")
    for drive in DRIVES:  # read once a minute, so that its first turn would come by chance
        ask(door, get(f"/v1/drives/{drive}/codes/C0161?fresh=true"))
    _until(lambda: online() and _same_for_long(state, state()), "nothing changes any more")


def _same_for_long(state: Callable[[], str], before: str) -> bool:
    for _ in range(STABLE_S):
        time.sleep(1.0)
        if state() != before:
            return False
    return True


def ask(door: Door, request: Request) -> bytes:
    """Send a request on a connection of its own and return all that comes back."""
    found = bytearray()
    with door() as link:
        with contextlib.suppress(ConnectionError):
            link.sendall(request.data)
        with contextlib.suppress(ConnectionError):
            link.settimeout(ANSWER_S)
            while chunk := _receive(link):
                found += chunk
                whole = _is_whole(bytes(found), request.data)
                if whole and not request.several:
                    break
                link.settimeout(QUIET_S if whole else ANSWER_S)
    return bytes(found)


def _receive(link: socket.socket) -> bytes:
    try:
        return link.recv(1 << 16)
    except TimeoutError:
        return b""


def _is_whole(found: bytes, asked: bytes) -> bool:
    """Whether the last of the answers has come to its end."""
    rest = found
    while rest:
        head, end, rest = rest.partition(b"\r\n\r\n")
        if not end:
            return False
        length = head.lower().partition(b"content-length:")[2].partition(b"\r\n")[0]
        body = 0 if asked.startswith(b"HEAD") or not length else int(length)
        if len(rest) < body:
            return False
        rest = rest[body:]
    return True


def _section(name: str, door: Door, request: Request) -> str:
    """Return the section of one request: all answers, every header, the body by its parts."""
    answer = ask(door, request)
    rows = []
    text = answer.decode("latin-1")
    while text:
        head, _, rest = text.partition("\r\n\r\n")
        length = _length(head)
        body = "" if request.data.startswith(b"HEAD") else rest[:length]
        head = _true_length(head, None if request.data.startswith(b"HEAD") else body)
        rows += [*head.split("\r\n"), "", *_body(body, request.data)]
        text = rest[len(body) :]
    title = normal(name).replace("\n", " ")[:200]
    return normal("\n".join([f"=== {title}", *(rows or ["no answer"]), ""]))


def _length(head: str) -> int:
    found = head.lower().partition("content-length:")[2].partition("\r\n")[0].strip()
    return int(found) if found.isdecimal() else 0


def _true_length(head: str, body: str | None) -> str:
    """Replace a length that is right, or has no body: it changes with the digits of an age."""
    right = r"\d+" if body is None else str(len(body))
    return re.sub(rf"(?im)^(content-length: ){right}(?=\r?$)", r"\1RIGHT", head)


def _body(body: str, asked: bytes) -> list[str]:
    """Write a body, a long document one part a row."""
    try:
        json.loads(body)
    except ValueError:
        return [repr(row)[1:-1] for row in body.split("\n")]
    if asked.startswith(b"GET /v1/plan "):
        body = normal_plan(body)
    return body.replace(', "', ',\n "').replace("{", "{\n ").split("\n")
