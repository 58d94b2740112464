"""What holds for every test.

A test on the real clock shares its machine with whatever else runs there: a processor taken away
for half a second can make a right program miss a real time-out. The files of such tests say so
(`pytestmark = pytest.mark.clock`, or `real`). A test of theirs that fails is run twice more, and
the run says so at its end; it fails if it fails three times. All other tests are never repeated:
what fails there once is wrong. That they use no real clock is seen to here (`USES`).
"""

import asyncio
import gc
import os
import socket
import subprocess
import time
from collections.abc import Callable, Generator
from functools import wraps
from pathlib import Path

import hypothesis
import pytest

from support.golden import NAME, Golden, GoldenFiles

# How long an example takes says more of the machine than of us: nothing is judged by the clock.
hypothesis.settings.register_profile("lecombus", deadline=None)
hypothesis.settings.load_profile("lecombus")

REPEATED = 2

ON_THE_CLOCK = ("clock", "real")
"""The marks of files whose tests may wait on the real clock."""


def _always(*_: object, **__: object) -> bool:
    return True


USES: tuple[tuple[object, str, Callable[..., bool]], ...] = (
    (time, "sleep", _always),
    (os, "openpty", _always),
    (socket.socket, "bind", _always),
    (socket.socket, "connect", _always),
    (asyncio.BaseEventLoop, "call_at", _always),  # the virtual loop has one of its own
    (subprocess.Popen, "wait", lambda _, timeout=None: timeout is not None),
    (subprocess.Popen, "communicate", lambda _, data=None, timeout=None: timeout is not None),
)
"""What waits on the real clock, and with which arguments."""

COUNTED = "counted"
"""The property under which a test leaves a line that the run shows at its end."""

LEAST_TIMEOUT_S = 60
"""For tests marked `real`: processes are started there, on a machine that may be busy."""


GARBAGE_EVERY = (10_000, 20, 20)
"""Objects made between two searches for garbage: Python's own 700 take a sixth of all the time."""


used: set[str] = set()
"""What the test that runs now has used of `USES`."""


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name a test by the words that it is given: a golden file is read by people."""
    if isinstance(val, list | tuple) and val and all(isinstance(word, str) for word in val):
        return " ".join(val).encode("unicode_escape").decode()
    return None


def pytest_collection_finish() -> None:
    """Search for garbage less often, and not among modules and tests, which stay to the end."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GARBAGE_EVERY)


FILES = pytest.StashKey[GoldenFiles]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--write-golden", action="store_true", help="write golden.txt again")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Compares what is said with the golden file of the test's folder (`support.golden`)."""
    files, path = request.config.stash[FILES], Path(request.node.path)
    new = [name for name in ("tmp_path", "short_dir") if name in request.fixturenames]
    places = {name.upper(): Path(request.getfixturevalue(name)) for name in new}
    return Golden(files, path.with_name(NAME), f"{path.stem}::{request.node.name}", places)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    files = session.config.stash[FILES]
    if files.writes and exitstatus == 0:
        whole = not session.config.getoption("keyword") and all(
            "::" not in word for word in session.config.args
        )
        files.write({Path(item.path).stem for item in session.items} if whole else set())


def pytest_configure(config: pytest.Config) -> None:
    config.stash[FILES] = GoldenFiles(writes=config.getoption("write_golden"))
    for owner, name, waits in USES:
        setattr(owner, name, _noted(getattr(owner, name), name, waits))


def _noted(
    usual: Callable[..., object], name: str, waits: Callable[..., bool]
) -> Callable[..., object]:
    @wraps(usual)
    def noting(*args: object, **more: object) -> object:
        if name not in used and waits(*args, **more):
            used.add(name)
        return usual(*args, **more)

    return noting


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        real = item.get_closest_marker("real") is not None
        if is_on_the_clock(item):
            item.add_marker(pytest.mark.flaky(reruns=REPEATED, reruns_delay=1))
        if real and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LEAST_TIMEOUT_S))


def is_on_the_clock(item: pytest.Item) -> bool:
    """Whether a test may wait on the real clock."""
    return any(item.get_closest_marker(mark) is not None for mark in ON_THE_CLOCK)


def pytest_runtest_setup() -> None:
    used.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    result = yield
    if used and not is_on_the_clock(item):
        names = ", ".join(sorted(used))
        pytest.fail(f"it waits on the real clock ({names}): its file must be marked", pytrace=False)
    return result


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    show_counts(terminalreporter)
    repeated = terminalreporter.stats.get("rerun", [])
    if repeated:
        terminalreporter.section("repeated, because they failed on a real clock")
        for report in repeated:
            terminalreporter.write_line(report.nodeid)


def show_counts(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what tests counted: those that call `record_property("counted", text)`."""
    counted = [
        text
        for report in terminalreporter.stats.get("passed", [])
        for key, text in report.user_properties
        if key == COUNTED
    ]
    if counted:
        terminalreporter.section("counted")
        for text in counted:
            terminalreporter.write_line(str(text))
