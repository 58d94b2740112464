"""The line on a real pseudo terminal and a real TCP port, in real time."""

from __future__ import annotations

import itertools
import os
import select
import socket
import statistics
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lecombus.fieldbus.lecom.simulator import PtyEnd, SimLine, TcpEnd, build
from lecombus.fieldbus.lecom.simulator.wire import PARITY_TABLE
from support.sim_host import read_telegram

pytestmark = pytest.mark.real

READ = read_telegram(11, 200).translate(PARITY_TABLE)
PATIENCE_S = 5.0


def line(**options: object) -> SimLine:
    return build([("a", 11, "822x"), ("b", 12, "822x")], **options)  # type: ignore[arg-type]


def open_raw(path: str) -> int:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(descriptor)
    return descriptor


def read_answer(read: Callable[[], bytes], descriptor: int) -> tuple[bytes, list[float]]:
    """Read up to BCC; the bytes without parity, and when each piece came."""
    got, times = b"", []
    end_s = time.monotonic() + PATIENCE_S
    while not (len(got) >= 2 and got[-2] == 3):
        assert select.select([descriptor], [], [], end_s - time.monotonic())[0], got
        piece = bytes(byte & 0x7F for byte in read())
        got += piece
        times += [time.monotonic()] * len(piece)
    return got, times


def wait_until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.001)


@pytest.fixture
def no_leaks() -> Iterator[None]:
    threads = threading.active_count()
    descriptors = sum(1 for _ in Path("/proc/self/fd").iterdir())
    yield
    assert threading.active_count() == threads
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == descriptors


def test_a_pty_answers_within_one_percent_of_the_ideal_time(no_leaks: None) -> None:
    with PtyEnd(line(baud=9600)) as end:
        host = open_raw(end.path)
        took: list[float] = []
        for _ in range(15):
            start_s = time.monotonic()
            os.write(host, READ)
            answer, times = read_answer(lambda: os.read(host, 100), host)
            took.append(times[-1] - start_s)
        os.close(host)
    ideal_s = (6 + len(answer)) * 10 / 9600 + 0.020
    assert answer[3:-2] == b"S33S8221E_11000"
    # On a busy machine wake-ups come late now and then; the best show what the pacing does.
    assert min(took) == pytest.approx(ideal_s, rel=0.01)
    assert statistics.median(took) < ideal_s * 1.25


def test_bytes_of_a_long_answer_keep_their_distance(no_leaks: None) -> None:
    with PtyEnd(line(baud=2400)) as end:
        host = open_raw(end.path)
        gaps: list[float] = []
        spans: list[float] = []
        for _ in range(7):
            os.write(host, READ)
            answer, times = read_answer(lambda: os.read(host, 100), host)
            gaps += [later - earlier for earlier, later in itertools.pairwise(times)]
            spans.append(times[-1] - times[0])
        os.close(host)
    char_s = 10 / 2400
    # Bytes do not come in one piece; on a busy computer the median gap was 11 % too short.
    assert statistics.median(gaps) == pytest.approx(char_s, rel=0.3)
    # Absolute due times: single lateness does not add up over the answer.
    ideal_s = (len(answer) - 1) * char_s
    assert min(abs(span_s - ideal_s) for span_s in spans) < ideal_s * 0.01
    assert statistics.median(spans) == pytest.approx(ideal_s, rel=0.05)


def test_a_host_may_close_and_open_again(no_leaks: None) -> None:
    with PtyEnd(line(paced=False, think_scale=0.0)) as end:
        for _ in range(3):
            host = open_raw(end.path)
            os.write(host, READ)
            assert read_answer(lambda fd=host: os.read(fd, 100), host)[0]  # type: ignore[misc]
            os.close(host)


def test_unplugging_hangs_up_and_replugging_comes_back_by_the_same_name(
    tmp_path: Path, no_leaks: None
) -> None:
    link = tmp_path / "hall-3"
    with PtyEnd(line(paced=False), link) as end:
        assert end.path == str(link)
        for _ in range(3):
            host = open_raw(end.path)
            os.write(host, READ)
            end.unplug()
            end.unplug()
            assert select.select([host], [], [], PATIENCE_S)[0]
            with pytest.raises(OSError, match=r".*"):
                os.write(host, READ)
            os.close(host)
            assert not link.is_symlink()
            end.replug()
            end.replug()
            host = open_raw(end.path)
            os.write(host, READ)
            assert read_answer(lambda fd=host: os.read(fd, 100), host)[0]  # type: ignore[misc]
            os.close(host)
    assert not link.is_symlink()


def test_the_line_can_be_looked_at_while_it_runs(no_leaks: None) -> None:
    with PtyEnd(line(paced=False)) as end:
        host = open_raw(end.path)
        os.write(host, READ)
        read_answer(lambda: os.read(host, 100), host)
        with end.lock:
            end.line.advance(time.monotonic())
            assert [entry.code for entry in end.line["a"].log] == [200]
        os.close(host)


def test_a_host_at_another_baud_rate_is_not_understood(no_leaks: None) -> None:
    with PtyEnd(line(baud=9600)) as end:
        host = open_raw(end.path)
        for speed, heard in ((termios.B19200, 0), (termios.B9600, 1)):
            modes = termios.tcgetattr(host)
            modes[4] = modes[5] = speed
            termios.tcsetattr(host, termios.TCSANOW, modes)
            os.write(host, READ)
            wait_until(lambda: end.line.requests > 0)
            with end.lock:
                end.line.requests = 0
                assert end.line["a"].heard == heard
        read_answer(lambda: os.read(host, 64), host)
        os.close(host)


def test_closing_twice_is_harmless(no_leaks: None) -> None:
    end = PtyEnd(line())
    end.close()
    end.close()


def test_nobody_reading_does_not_stop_the_line(no_leaks: None) -> None:
    with PtyEnd(line(paced=False, think_scale=0.0)) as end:
        host = open_raw(end.path)
        for _ in range(600):
            os.write(host, READ)
        wait_until(lambda: end.line.requests == 600)
        os.close(host)


def test_tcp_serves_one_client_at_a_time(no_leaks: None) -> None:
    with TcpEnd(line(baud=19200)) as end:
        with socket.create_connection(("127.0.0.1", end.port)) as client:
            start_s = time.monotonic()
            client.sendall(READ)
            answer, times = read_answer(lambda: client.recv(100), client.fileno())
            ideal_s = (6 + len(answer)) * 10 / 19200 + 0.020
            assert times[-1] - start_s > ideal_s * 0.99
            with socket.create_connection(("127.0.0.1", end.port)) as second:
                second.settimeout(PATIENCE_S)
                assert second.recv(1) == b"", "turned away"
        wait_until(lambda: not end.connected)
        with socket.create_connection(("127.0.0.1", end.port)) as client:
            client.sendall(READ)
            assert read_answer(lambda: client.recv(100), client.fileno())[0]


def test_tcp_can_drop_and_refuse(no_leaks: None) -> None:
    with TcpEnd(line(paced=False)) as end:
        with socket.create_connection(("127.0.0.1", end.port)) as client:
            client.settimeout(PATIENCE_S)
            wait_until(lambda: end.connected)
            end.drop()
            assert client.recv(1) == b""
        end.refuse(True)
        end.refuse(True)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", end.port))
        end.refuse(False)
        with socket.create_connection(("127.0.0.1", end.port)) as client:
            client.sendall(READ)
            assert read_answer(lambda: client.recv(100), client.fileno())[0]
