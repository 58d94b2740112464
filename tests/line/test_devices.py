"""Who else has a port open."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator

import pytest

from lecombus.line import devices
from lecombus.line.devices import others_at

pytestmark = pytest.mark.clock


@pytest.fixture
def terminal() -> Iterator[str]:
    """A pseudo terminal of which this process holds both ends."""
    far, near = os.openpty()
    yield os.ttyname(near)
    os.close(near)
    os.close(far)


def until_open(path: str, process: subprocess.Popen[bytes]) -> None:
    for _ in range(500):
        if process.pid in devices.holders(path):
            return
        time.sleep(0.01)
    raise AssertionError("it never opened the port")


def test_a_program_that_reads_the_port_is_named_with_its_pid(terminal: str) -> None:
    assert others_at(terminal) == ()
    with subprocess.Popen(["cat", terminal], stdout=subprocess.DEVNULL) as cat:
        try:
            until_open(terminal, cat)
            assert others_at(terminal) == (f"cat (pid {cat.pid})",)
        finally:
            cat.kill()


def test_whoever_has_the_far_end_of_a_pseudo_terminal_is_not_in_the_way() -> None:
    script = (
        "import os, sys; far, near = os.openpty(); print(os.ttyname(near), flush=True); "
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        ["python3", "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as simulator:
        assert simulator.stdout is not None
        port = simulator.stdout.readline().strip()
        assert simulator.pid in devices.holders(port)
        assert others_at(port) == ()
        simulator.kill()


def test_the_pseudo_terminal_of_the_same_name_in_a_container_is_another(terminal: str) -> None:
    script = (
        "import os, sys, pty\n"
        "while True:\n"
        "    far, near = pty.openpty()\n"
        "    if os.ttyname(near) == sys.argv[1]: break\n"
        "print(os.readlink(f'/proc/self/fd/{near}'), flush=True)\n"
        "sys.stdin.read()"
    )
    own_terminals = "mount -t devpts -o newinstance,ptmxmode=0666 devpts /dev/pts && mount --bind"
    words = f'{own_terminals} /dev/pts/ptmx /dev/ptmx && exec python3 -c "$1" "$2"'
    with subprocess.Popen(
        ["unshare", "-Urm", "sh", "-c", words, "sh", script, terminal],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as container:  # fmt: skip
        assert container.stdout is not None
        assert container.stdout.readline().strip() == terminal
        assert others_at(terminal) == ()
        assert container.pid not in devices.holders(terminal)
        container.kill()


@pytest.mark.parametrize("port", ["socket://127.0.0.1:4001", "sim:", "/dev/none"])
def test_what_is_no_device_is_held_by_none(port: str) -> None:
    assert others_at(port) == ()
