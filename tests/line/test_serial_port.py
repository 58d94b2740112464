"""The serial end on real pseudo terminals: every byte passes, every loss shows, nothing leaks."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import logging
import os
import selectors
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import anyio
import pytest
import serial

from lecombus.errors import LineLostError
from lecombus.fieldbus.port import Direction, Parity, Port, PortSettings
from lecombus.line import devices, serial_device, serial_port
from lecombus.line.event_loop import run
from lecombus.line.serial_port import PseudoPort, RtsSerialPort, SerialPort, open_serial
from support.heard import Heard

pytestmark = pytest.mark.clock

EVERY_BYTE = bytes(range(256))
TIOCGEXCL = 0x80045440


class Pty:
    """A pseudo terminal: `path` is the device, `master` the drives' end."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(self.master)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(slave)
        os.close(slave)

    def close_master(self) -> None:
        if self.master >= 0:
            os.close(self.master)
            self.master = -1

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    async def take(self, count: int) -> bytes:
        taken = bytearray()
        with anyio.fail_after(5):
            while len(taken) < count:
                await anyio.wait_readable(self.master)
                taken += os.read(self.master, 4096)
        return bytes(taken)


@pytest.fixture
def pty() -> Iterator[Pty]:
    pair = Pty()
    yield pair
    pair.close_master()


def settings(
    pty: Pty, *, parity: Parity = "line", direction: Direction = "adapter"
) -> PortSettings:
    return PortSettings(
        url=pty.path,
        framing="8N1" if parity == "line" else "7E1",
        direction=direction,
        line="hall-3",
    )


def with_port(pty: Pty, body: Callable[[SerialPort, Heard], Awaitable[None]], **how: Any) -> Heard:
    """Run `body` with an open port, abort it, and give the loop time to say something false."""

    async def main() -> Heard:
        recorder = Heard()
        port = await open_serial(settings(pty, **how), recorder)
        try:
            await body(port, recorder)
        finally:
            port.abort()
            await anyio.sleep(0.01)
        return recorder

    return run(main)


@pytest.mark.parametrize("parity", ["line", "port"])
def test_every_byte_passes_both_ways_unchanged(pty: Pty, parity: Parity) -> None:
    """Among them XON, XOFF, CR, NUL and FF: any of them may be a BCC."""

    async def body(port: SerialPort, recorder: Heard) -> None:
        for byte in EVERY_BYTE:
            port.write(bytes([byte]))
        assert await pty.take(256) == EVERY_BYTE
        pty.send(EVERY_BYTE)
        await recorder.until(lambda: len(recorder.data) >= 256)
        assert bytes(recorder.data) == EVERY_BYTE

    with_port(pty, body, parity=parity)


def test_output_goes_on_after_an_xoff_came(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        pty.send(b"\x13")
        await recorder.until(lambda: recorder.data == b"\x13")
        port.write(b"\x0411460\x05")
        assert await pty.take(7) == b"\x0411460\x05"

    with_port(pty, body)


def test_a_device_left_cooked_by_another_program_is_made_raw(pty: Pty) -> None:
    slave = os.open(pty.path, os.O_RDWR | os.O_NOCTTY)
    attributes = termios.tcgetattr(slave)
    attributes[0] |= termios.IXON | termios.IXOFF | termios.ISTRIP | termios.ICRNL
    attributes[0] |= termios.BRKINT | termios.IGNPAR
    attributes[1] |= termios.OPOST
    attributes[2] |= termios.HUPCL
    attributes[3] |= termios.ICANON | termios.ECHO | termios.ISIG
    termios.tcsetattr(slave, termios.TCSANOW, attributes)

    async def body(_port: SerialPort, _recorder: Heard) -> None:
        iflag, oflag, cflag, lflag, _, _, cc = termios.tcgetattr(slave)
        assert not iflag & (termios.IXON | termios.IXOFF | termios.ISTRIP | termios.ICRNL)
        assert not iflag & (termios.BRKINT | termios.IGNPAR)
        assert not oflag & termios.OPOST
        assert not cflag & termios.HUPCL
        assert not lflag & (termios.ICANON | termios.ECHO | termios.ISIG)
        assert cflag & termios.CSIZE == termios.CS8
        assert cc[termios.VMIN] == 1

    try:
        with_port(pty, body)
    finally:
        os.close(slave)


@pytest.mark.parametrize(("parity", "carries"), [("line", True), ("port", False)])
def test_who_makes_parity_is_told(pty: Pty, parity: Parity, carries: bool) -> None:
    async def body(port: Port, _recorder: Heard) -> None:
        assert port.carries_parity is carries

    with_port(pty, body, parity=parity)


def test_a_pty_that_is_raw_already_opens_for_a_device_that_frames(pty: Pty) -> None:
    """A second setting of 7E1 on a pty fails with EINVAL: opening again must not run into it."""

    async def body(port: SerialPort, _recorder: Heard) -> None:
        port.write(b"\x04")

    for _ in range(3):
        with_port(pty, body, parity="port")


def test_a_closed_master_is_a_loss_told_once_within_a_second(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        pty.close_master()
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)
        await anyio.sleep(0.02)
        with pytest.raises(LineLostError):
            port.write(b"\x04")
        port.discard_input()

    recorder = with_port(pty, body)
    assert len(recorder.losses) == 1
    (loss,) = recorder.losses
    assert isinstance(loss, LineLostError)
    assert loss.line == "hall-3"
    assert pty.path in str(loss)


def test_a_write_that_finds_the_device_gone_raises_and_the_loss_follows_once(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        pty.close_master()
        with pytest.raises(LineLostError, match="writing failed"):
            port.write(b"\x0411460\x05")
        assert recorder.losses == [], "lost() is never called from inside write()"
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)

    assert len(with_port(pty, body).losses) == 1


def test_abort_after_a_found_loss_keeps_it_quiet(pty: Pty) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        pty.close_master()
        with pytest.raises(LineLostError):
            port.write(b"\x04")

    assert with_port(pty, body).losses == [], "abort() came before the loop told the loss"


def test_nothing_is_told_after_abort(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        pty.send(b"late")
        port.abort()
        port.abort()
        port.close()
        pty.close_master()
        await anyio.sleep(0.02)
        with pytest.raises(LineLostError, match="closed"):
            port.write(b"\x04")
        assert recorder.data == b""

    assert with_port(pty, body).losses == []


def test_a_receiver_may_abort_while_bytes_arrive(pty: Pty) -> None:
    async def main() -> list[bytes]:
        got: list[bytes] = []
        gone = asyncio.Event()

        class Quitter(Heard):
            def received(self, data: bytes) -> None:
                got.append(data)
                port.abort()
                gone.set()

        port = await open_serial(settings(pty), Quitter())
        pty.send(b"first")
        with anyio.fail_after(5):
            await gone.wait()
        pty.send(b"second")
        await anyio.sleep(0.02)
        return got

    assert b"".join(run(main)) == b"first"


def test_the_same_device_opens_again_after_a_loss(pty: Pty, tmp_path: Path) -> None:
    """As a stable name does: it leads to another device file after replugging."""
    name = tmp_path / "usb-adapter"
    name.symlink_to(pty.path)

    async def main() -> None:
        first = Heard()
        port = await open_serial(PortSettings(url=str(name)), first)
        assert port.describe() == f"{name} -> {pty.path}, 9600 8N1"
        pty.close_master()
        await first.until(lambda: bool(first.losses))
        with pytest.raises(LineLostError):
            await open_serial(PortSettings(url=str(name)), first)
        other = Pty()
        name.unlink()
        name.symlink_to(other.path)
        port = await open_serial(PortSettings(url=str(name)), Heard())
        port.write(b"again")
        assert await other.take(5) == b"again"
        port.abort()
        other.close_master()

    run(main)


def test_a_second_opening_is_refused_and_the_holder_is_named(pty: Pty) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        with pytest.raises(LineLostError, match=rf"in use by .*\(pid {os.getpid()}\)") as caught:
            await open_serial(settings(pty), Heard())
        assert pty.path in str(caught.value)
        port.write(b"still")
        assert await pty.take(5) == b"still"

    with_port(pty, body)


def test_a_program_that_holds_a_real_device_without_a_lock_is_named(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal program would take half of every answer, whoever opened first."""
    monkeypatch.setattr(devices, "is_pseudo", lambda _path: False)
    script = "import os,sys; fd=os.open(sys.argv[1], os.O_RDWR|os.O_NOCTTY); print(flush=True)"
    command = [sys.executable, "-c", f"{script}; sys.stdin.read()", pty.path]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()

        async def main() -> None:
            await open_serial(settings(pty), Heard())

        with pytest.raises(LineLostError, match=rf"in use by python\S* \(pid {holder.pid}\)"):
            run(main)
        holder.communicate()

    async def body(port: SerialPort, _recorder: Heard) -> None:
        exclusive = fcntl.ioctl(port.serial.fileno(), TIOCGEXCL, bytes(4))
        assert exclusive == b"\x01\0\0\0", "whoever comes later is kept out, locking or not"

    with_port(pty, body)


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_200_openings_all_hear_and_leave_no_descriptor_behind(pty: Pty) -> None:
    async def main() -> tuple[int, int]:
        counts = []
        for turn in range(201):
            recorder = Heard()
            port = await open_serial(settings(pty), recorder)
            if turn % 3 == 0:
                port.write(b"\x04")
                pty.send(b"\x06")
                await recorder.until(lambda heard=recorder: bool(heard.data))  # type: ignore[misc]
            if turn % 2:
                await asyncio.sleep(0)
            port.abort()
            counts.append(open_descriptors())
        return counts[0], counts[-1]

    first, last = run(main)
    assert first == last


def test_a_failed_opening_leaves_no_descriptor_behind(pty: Pty) -> None:
    async def body(_port: SerialPort, _recorder: Heard) -> None:
        before = open_descriptors()
        for direction in ("adapter", "kernel"):
            with pytest.raises(LineLostError):
                await open_serial(settings(pty, direction=direction), Heard())
        assert open_descriptors() == before

    with_port(pty, body)


def test_what_a_full_device_does_not_take_follows_in_order(pty: Pty) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        sent = bytes(range(256)) * 1000
        for start in range(0, len(sent), 1000):
            port.write(sent[start : start + 1000])
        assert await pty.take(len(sent)) == sent
        port.write(b"tail")
        assert await pty.take(4) == b"tail"

    assert with_port(pty, body).losses == []


def fill(port: SerialPort, piece: bytes) -> bytes:
    """Write until the device takes no more and something waits in the port."""
    sent = b""
    while not port.get_write_buffer_size():
        port.write(piece)
        sent += piece
    return sent


def test_a_write_does_not_overtake_what_waits(pty: Pty) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        sent = fill(port, EVERY_BYTE)
        with pytest.raises(BlockingIOError):  # noqa: PT012
            taken = b""
            while True:  # the loop stands still: the device has room, the port does not know yet
                taken += os.read(pty.master, 4096)
        port.write(b"tail")
        rest = len(sent) + 4 - len(taken)
        assert taken + await pty.take(rest) == sent + b"tail"

    with_port(pty, body)


def test_a_device_that_was_full_for_a_moment_is_no_loss(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lecombus.line.serial_port._STUCK_S", 0.2)

    async def body(port: SerialPort, _recorder: Heard) -> None:
        sent = fill(port, b"x")
        await pty.take(len(sent))
        await anyio.sleep(0.25)  # past the moment at which it would have been given up
        port.write(b"x")

    assert with_port(pty, body).losses == []


def test_a_device_that_takes_nothing_is_a_loss(pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lecombus.line.serial_port._STUCK_S", 0.05)

    async def body(port: SerialPort, recorder: Heard) -> None:
        for _ in range(1000):
            port.write(bytes(100))
        await recorder.until(lambda: bool(recorder.losses))
        assert "takes no more bytes" in str(recorder.losses[0])

    assert len(with_port(pty, body).losses) == 1


def test_unplugging_while_bytes_wait_to_be_sent_is_one_loss(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        for _ in range(1000):
            port.write(bytes(100))
        pty.close_master()
        await recorder.until(lambda: bool(recorder.losses), within_s=1.0)
        await anyio.sleep(0.02)

    assert len(with_port(pty, body).losses) == 1


@pytest.mark.parametrize("pseudo", [True, False])
def test_only_a_pseudo_terminal_is_let_go_of_after_each_telegram(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, pseudo: bool
) -> None:
    calls: list[str] = []
    plain = os.write

    def write(descriptor: int, data: bytes) -> int:
        calls.append("write")
        return plain(descriptor, data)

    async def test(port: Port, recorder: Heard) -> None:
        assert (type(port) is PseudoPort) is pseudo
        with monkeypatch.context() as watched:
            watched.setattr(os, "write", write)
            watched.setattr(os, "sched_yield", lambda: calls.append("let go"))
            port.write(b"1")
            port.write(b"2")

    if not pseudo:
        monkeypatch.setattr(devices, "is_pseudo", lambda path: False)
        monkeypatch.setattr(devices, "holders", lambda path: {})
    with_port(pty, test)
    assert calls == (["write", "let go"] * 2 if pseudo else ["write"] * 2)


def test_abort_drops_what_was_not_sent(pty: Pty) -> None:
    """The kernel would wait for it to go out, up to 30 s on a stalled adapter."""

    async def body(port: SerialPort, _recorder: Heard) -> None:
        handed_over = len(fill(port, bytes(1000))) - port.get_write_buffer_size()
        port.abort()
        arrived = 0
        with pytest.raises(OSError, match=r"Input/output error|temporarily"):  # noqa: PT012
            while True:
                arrived += len(os.read(pty.master, 4096))
        assert arrived < handed_over

    with_port(pty, body)


def test_discarded_input_is_never_given_on(pty: Pty) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        pty.send(b"old")
        until = time.monotonic() + 5
        while port.serial.in_waiting < 3:  # the loop stands still: nothing can be given on yet
            assert time.monotonic() < until
        port.discard_input()
        pty.send(b"new")
        await recorder.until(lambda: bool(recorder.data))
        assert recorder.data == b"new"

    with_port(pty, body)


def test_what_lies_in_the_kernel_is_given_on_when_it_is_looked_at(pty: Pty) -> None:
    """The loop has no turn meanwhile: nothing is awaited between the bytes and the look."""

    async def body(port: SerialPort, heard: Heard) -> None:
        port.look()
        assert not heard.data
        os.write(pty.master, b"answer")
        with selectors.DefaultSelector() as selector:
            selector.register(port._fd, selectors.EVENT_READ)
            assert selector.select(5.0)
        port.look()
        assert bytes(heard.data) == b"answer"
        port.abort()
        port.look()

    with_port(pty, body)


def test_a_device_that_does_not_exist_says_so() -> None:
    async def main() -> None:
        await open_serial(PortSettings(url="/dev/serial/by-id/none", line="hall-3"), Heard())

    with pytest.raises(LineLostError, match="no such device; is the adapter plugged in") as caught:
        run(main)
    assert caught.value.line == "hall-3"


def test_a_file_that_is_no_device_says_so(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()

    async def main() -> None:
        await open_serial(PortSettings(url=str(path)), Heard())

    with pytest.raises(LineLostError, match="cannot be used as a serial port"):
        run(main)


def test_a_device_that_may_not_be_opened_names_the_group(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: serial.Serial) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial.Serial, "open", refuse)

    async def main() -> None:
        await open_serial(settings(pty), Heard())

    Path(pty.path).chmod(0o660)
    with pytest.raises(LineLostError, match=f"in group {Path(pty.path).group()}"):
        run(main)
    Path(pty.path).chmod(0o600)
    with pytest.raises(LineLostError, match="only its owner may open it"):
        run(main)


def test_a_driver_without_rs485_mode_is_refused_with_what_to_do(pty: Pty) -> None:
    async def main() -> None:
        await open_serial(settings(pty, direction="kernel"), Heard())

    with pytest.raises(LineLostError, match=r"direction `kernel`.*direction `adapter`"):
        run(main)


def test_the_kernel_is_asked_to_raise_rts_while_sending(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pseudo terminal has no such mode: the call is caught on its way to the kernel."""
    asked: list[int] = []

    def ioctl(fd: int, request: int, argument: Any = 0, mutate: bool = True) -> Any:
        if request == serial.serialposix.TIOCGRS485:
            return 0
        if request == serial.serialposix.TIOCSRS485:
            asked.append(argument[0])
            return 0
        return fcntl.ioctl(fd, request, argument, mutate)

    names = {name: getattr(fcntl, name) for name in dir(fcntl)}
    monkeypatch.setattr(serial.serialposix, "fcntl", SimpleNamespace(**(names | {"ioctl": ioctl})))

    async def body(port: SerialPort, _recorder: Heard) -> None:
        assert not isinstance(port, RtsSerialPort), "nothing is left for us to switch"
        assert not port.serial.rts
        port.write(b"\x04")
        assert await pty.take(1) == b"\x04"

    with_port(pty, body, direction="kernel")
    enabled, on_send, after_send = 1, 2, 4
    assert asked == [enabled | on_send]
    assert not asked[0] & after_send


@pytest.mark.parametrize("raw_already", [False, True])
def test_a_device_that_does_not_frame_7e1_is_refused_with_what_to_do(
    pty: Pty, monkeypatch: pytest.MonkeyPatch, raw_already: bool
) -> None:
    """Such a driver ignores 7E1; the C library reports it only if nothing else changed."""
    monkeypatch.setattr(devices, "is_pseudo", lambda _path: False)

    async def main() -> None:
        if raw_already:
            (await open_serial(settings(pty), Heard())).abort()
        await open_serial(settings(pty, parity="port"), Heard())

    with pytest.raises(LineLostError, match="does not frame 7E1; parity `line`"):
        run(main)


def test_a_device_that_does_not_frame_8e1_is_refused(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a protocol other than LECOM asks for; a pseudo terminal has no parity."""
    monkeypatch.setattr(devices, "is_pseudo", lambda _path: False)

    async def main() -> None:
        await open_serial(PortSettings(url=pty.path, framing="8E1"), Heard())

    with pytest.raises(LineLostError, match=r"does not frame 8E1$"):
        run(main)


def test_a_device_is_set_to_the_framing_of_its_protocol(pty: Pty) -> None:
    """A pseudo terminal frames nothing, and is told to be 8N1 whatever is asked for."""

    async def main() -> None:
        port = await open_serial(PortSettings(url=pty.path, framing="8E1", baud=93750), Heard())
        try:
            assert port.describe().endswith("93750 8E1")
            assert not port.carries_parity
            flags = termios.tcgetattr(pty.master)[2]
            assert flags & termios.CSIZE == termios.CS8
            assert not flags & termios.PARENB
        finally:
            port.abort()

    run(main)


def test_a_caller_cancelled_while_a_driver_opens_slowly_can_still_close(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The opening runs in a thread that cannot be stopped: its port must reach somebody."""
    entered, go_on = asyncio.Event(), threading.Event()

    async def main() -> None:
        loop = asyncio.get_running_loop()

        def slow(how: PortSettings) -> serial_device.Device:
            loop.call_soon_threadsafe(entered.set)
            assert go_on.wait(5)
            return serial_device.open_device(how)

        async def opening() -> None:
            port = await open_serial(settings(pty), Heard())
            try:
                await anyio.sleep_forever()
            finally:
                port.abort()

        monkeypatch.setattr(serial_port, "open_device", slow)
        async with anyio.create_task_group() as group:
            group.start_soon(opening)
            await entered.wait()
            group.cancel_scope.cancel()
            go_on.set()

    before = open_descriptors()
    run(main)
    assert open_descriptors() == before


def test_a_device_without_rts_is_refused_for_rts(pty: Pty) -> None:
    async def main() -> None:
        await open_serial(settings(pty, direction="rts"), Heard())

    with pytest.raises(LineLostError, match="no RTS line; direction `adapter` needs none"):
        run(main)


class RtsLine:
    """How the RTS lines of all devices moved: when, and to what."""

    def __init__(self) -> None:
        self.moves: list[tuple[float, bool]] = []
        self._fell = asyncio.Event()

    def moved(self, device: Any) -> None:
        self.moves.append((time.monotonic(), device.rts))
        if not device.rts:
            self._fell.set()

    def forget(self) -> None:
        self.moves.clear()
        self._fell.clear()

    async def falls(self) -> None:
        with anyio.fail_after(5):
            await self._fell.wait()


@pytest.fixture
def rts_line(monkeypatch: pytest.MonkeyPatch) -> RtsLine:
    """Give every device an RTS line; a pseudo terminal has none."""
    line = RtsLine()
    monkeypatch.setattr(
        serial_device.Device, "_update_rts_state", lambda device: line.moved(device)
    )
    return line


def test_rts_is_on_from_before_the_telegram_until_it_left(
    pty: Pty, rts_line: RtsLine, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        assert isinstance(port, RtsSerialPort)
        assert {on for _, on in rts_line.moves} == {False}, (
            "it listens until it has something to say"
        )
        rts_line.forget()
        began = time.monotonic()
        port.write(b"\x0411460\x05" * 4)
        assert [on for _, on in rts_line.moves] == [True]
        await pty.take(28)
        await rts_line.falls()
        assert not rts_line.moves[1][1]
        assert rts_line.moves[1][0] - began >= 28 * 10 / 9600

    with caplog.at_level(logging.WARNING):
        with_port(pty, body, direction="rts")
    assert "event=rts-switched port=" in caplog.text


def test_rts_stays_on_over_telegrams_that_follow_at_once(pty: Pty, rts_line: RtsLine) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        rts_line.forget()
        port.write(bytes(10))
        second_at = time.monotonic()
        port.write(bytes(40))
        await pty.take(50)
        await rts_line.falls()
        assert [on for _, on in rts_line.moves] == [True, True, False]
        assert rts_line.moves[2][0] - second_at >= 40 * 10 / 9600

    with_port(pty, body, direction="rts")


def test_rts_stays_on_while_the_device_is_full(pty: Pty, rts_line: RtsLine) -> None:
    async def body(port: SerialPort, _recorder: Heard) -> None:
        sent = fill(port, b"x" * 10)
        rts_line.forget()
        await anyio.sleep(0.05)  # five times the wire time of the last ten characters
        assert rts_line.moves == []
        await pty.take(len(sent))
        await rts_line.falls()

    with_port(pty, body, direction="rts")


def test_a_device_that_loses_its_rts_is_a_loss(
    pty: Pty, rts_line: RtsLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(port: SerialPort, recorder: Heard) -> None:
        port.write(bytes(10))

        def fail(self: Any) -> None:
            raise OSError(errno.EIO, "gone")

        monkeypatch.setattr(serial_device.Device, "_update_rts_state", fail)
        await recorder.until(lambda: bool(recorder.losses))
        assert "switching RTS failed" in str(recorder.losses[0])

    assert len(with_port(pty, body, direction="rts").losses) == 1


def test_a_kernel_name_is_warned_about_where_a_stable_one_exists(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(_port: SerialPort, _recorder: Heard) -> None:
        assert devices.stable_name("/dev/null") is None

    stable = tmp_path / "usb-FTDI_1234"
    stable.symlink_to(pty.path)
    monkeypatch.setattr(devices, "BY_ID", tmp_path)
    assert devices.connected() == (str(stable),)
    with caplog.at_level(logging.WARNING):
        with_port(pty, body)
    assert f"event=unstable-name port={pty.path} reason=" in caplog.text
    assert f"use {stable}" in caplog.text


def test_a_stable_name_is_not_warned_about(
    pty: Pty, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stable = tmp_path / "usb-FTDI_1234"
    stable.symlink_to(pty.path)
    monkeypatch.setattr(devices, "BY_ID", tmp_path)

    async def main() -> None:
        (await open_serial(PortSettings(url=str(stable)), Heard())).abort()

    with caplog.at_level(logging.WARNING):
        run(main)
    assert not caplog.records


def test_a_driver_without_low_latency_is_used_and_noted(
    pty: Pty, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(_port: SerialPort, _recorder: Heard) -> None:
        pass

    with caplog.at_level(logging.INFO):
        with_port(pty, body)
    assert "event=no-low-latency port=" in caplog.text
