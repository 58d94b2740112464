"""Modbus TCP itself: telegrams good and bad, many clients, slow ones, those not allowed."""

from __future__ import annotations

import struct
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress

import anyio
import pytest
from anyio.abc import SocketStream
from hypothesis import given
from hypothesis import strategies as st

from lecombus.bridges.modbus import modbus_server
from lecombus.bridges.modbus.modbus_server import MOST, ModbusServer, split
from lecombus.bridges.modbus.register_values import ModbusError, ModbusException
from lecombus.errors import ConfigError

pytestmark = [pytest.mark.clock, pytest.mark.anyio]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class Registers:
    """Registers 0 to 999 that read their own number; 500 is not fresh, 600 fails."""

    def __init__(self) -> None:
        self.written: list[tuple[str, int, tuple[int, ...]]] = []

    def read(self, first: int, count: int) -> Sequence[int]:
        if first <= 500 < first + count:
            raise ModbusError(ModbusException.NOT_FRESH)
        if first + count > 1000:
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        return range(first, first + count)

    def write(self, client: str, first: int, values: Sequence[int]) -> None:
        if first + len(values) > 1000:
            raise ModbusError(ModbusException.NO_SUCH_REGISTER)
        self.written.append((client, first, tuple(values)))


def server(registers: Registers | None = None, allow: Sequence[str] = ("127.0.0.0/8",)
           ) -> ModbusServer:  # fmt: skip
    return ModbusServer(registers or Registers(), (1, 255), allow, now=lambda: 0.0)


def answered(pdu: bytes, unit: int = 1) -> bytes:
    found = server().answer("127.0.0.1", unit, pdu)
    return bytes((found.function_code,)) + found.encode()


READ = struct.Struct(">BHH")


@pytest.mark.parametrize(("pdu", "answer"), [
    (READ.pack(3, 7, 2), "03 04 0007 0008"),
    (READ.pack(4, 7, 1), "04 02 0007"),
    (READ.pack(3, 875, 125), None),
    (READ.pack(6, 41, 3), "06 0029 0003"),
    (bytes.fromhex("10 0028 0002 04 0001 0003"), "10 0028 0002"),
    (READ.pack(3, 499, 2), "83 0B"),
    (READ.pack(3, 1000, 1), "83 02"),
    (READ.pack(3, 65535, 2), "83 02"),
    (READ.pack(3, 0, 0), "83 03"),
    (READ.pack(3, 0, 126), "83 03"),
    (READ.pack(3, 0, 65535), "83 03"),
    (READ.pack(3, 0, 1) + b"\0", "83 03"),
    (b"\x03\x00", "83 03"),
    (b"\x03", "83 03"),
    (b"\x06\x00\x29", "86 03"),
    (bytes.fromhex("10 0028 0000 00"), "90 03"),
    (bytes.fromhex("10 0028 0002 04 0001"), "90 03"),
    (bytes.fromhex("10 0028 0002 02 0001"), "90 03"),
    (bytes.fromhex("10 0028 0001 02 0001 0003"), "90 03"),
    (bytes.fromhex("10 0028 007C F8") + bytes(248), "90 03"),
    (bytes.fromhex("01 0000 0008"), "81 01"),
    (bytes.fromhex("05 0000 FF00"), "85 01"),
    (bytes.fromhex("08 0001 0000"), "88 01"),
    (bytes.fromhex("2B 0E 01 00"), "AB 01"),
    (bytes.fromhex("17 0000 0001 0028 0001 02 0001"), "97 01"),
    (bytes.fromhex("16 0028 FFFF 0001"), "96 01"),
    (b"\x00", "80 01"),
    (b"\x83\x02", "83 01"),
    (b"\xff", "FF 01"),
])  # fmt: skip
def test_what_each_request_is_answered_with(pdu: bytes, answer: str | None) -> None:
    found = answered(pdu)
    if answer is None:
        assert (found[0], found[1], len(found)) == (3, 250, 252)
    else:
        assert found.hex() == answer.replace(" ", "").lower()


def test_another_unit_is_not_answered_by_this_device() -> None:
    assert answered(READ.pack(3, 7, 1), unit=2).hex() == "830b"
    assert answered(READ.pack(3, 7, 1), unit=255).hex() == "03020007"


def test_what_a_client_sends_fills_no_log(caplog: pytest.LogCaptureFixture) -> None:
    bad = (b"\x03", b"\x10\x00", b"\xff", bytes.fromhex("10 0028 0000 00"))
    for pdu in (
        READ.pack(3, 0, 0),
        READ.pack(4, 0, 65535),
        *bad,
        b"\x10\0\0\0\x7c\xf8" + bytes(248),
    ):
        answered(pdu)
    assert caplog.records == []


def test_what_the_bridge_does_not_know_is_a_failure_and_does_not_end_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Newer(Registers):
        def read(self, first: int, count: int) -> Sequence[int]:
            raise ConfigError("there is no family `9400`")

    of = server(Newer())
    for _ in range(3):
        assert of.answer("127.0.0.1", 1, READ.pack(3, 7, 1)).encode() == b"\x04"
    assert [record.getMessage() for record in caplog.records] == [
        "event=modbus-failed reason=there is no family `9400`"
    ]


@given(st.binary(min_size=1, max_size=253))
def test_any_request_has_an_answer_that_fits_it(pdu: bytes) -> None:
    found = answered(pdu)
    assert found[0] & 0x7F == pdu[0] & 0x7F
    assert 2 <= len(found) <= 253


@given(st.lists(st.binary(min_size=1, max_size=253), max_size=5), st.data())
def test_a_stream_is_cut_into_telegrams_wherever_its_segments_end(
    pdus: list[bytes], data: st.DataObject
) -> None:
    stream = b"".join(struct.pack(">HHHB", number, 0, len(pdu) + 1, 7) + pdu
                      for number, pdu in enumerate(pdus))  # fmt: skip
    found, rest = [], b""
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        rest, stream = rest + stream[:size], stream[size:]
        while True:
            one, rest = split(rest)
            if one is None:
                break
            found.append(one)
    assert found == [(number, 7, pdu) for number, pdu in enumerate(pdus)]
    assert rest == b""


@pytest.mark.parametrize("head", [
    "0001 0001 0006 01", "0001 0000 0001 01", "0001 0000 0000 01", "0001 0000 00FF 01",
    "0001 0000 FFFF 01", "4745 5420 2F20 48",
])  # fmt: skip
def test_what_is_no_modbus_tcp_ends_the_connection(head: str) -> None:
    with pytest.raises(anyio.BrokenResourceError):
        split(bytes.fromhex(head))


@pytest.mark.parametrize(("client", "allowed"), [
    ("192.0.2.7", True), ("192.0.2.8", False), ("198.51.100.200", True), ("198.51.101.1", False),
    ("::ffff:192.0.2.7", True), ("2001:db8::9", True), ("2001:db9::9", False), ("", False),
    ("fe80::1%eth0", False), ("nonsense", False),
])  # fmt: skip
def test_who_may_connect(client: str, allowed: bool) -> None:
    networks = ("192.0.2.7/32", "198.51.100.0/24", "2001:db8::/64")
    assert server(allow=networks).is_allowed(client) is allowed


# -- over sockets ----------------------------------------------------------------------------------


@asynccontextmanager
async def listening(
    registers: Registers, allow: Sequence[str] = ("127.0.0.0/8",)
) -> AsyncIterator[int]:
    of = ModbusServer(registers, (1,), allow)
    listener = await anyio.create_tcp_listener(local_host="127.0.0.1")
    async with listener, anyio.create_task_group() as tasks:
        tasks.start_soon(listener.serve, of.serve)
        yield int(listener.extra(anyio.abc.SocketAttribute.local_port))
        tasks.cancel_scope.cancel()


async def received(stream: SocketStream, count: int) -> bytes:
    data = b""
    with anyio.fail_after(20.0):
        while len(data) < count:
            data += await stream.receive(count - len(data))
    return data


def frame(number: int, pdu: bytes) -> bytes:
    return struct.pack(">HHHB", number, 0, len(pdu) + 1, 1) + pdu


async def asked(stream: SocketStream, register: int) -> int:
    await stream.send(frame(1, READ.pack(3, register, 1)))
    return int.from_bytes((await received(stream, 11))[-2:], "big")


async def is_open(stream: SocketStream) -> bool:
    try:
        return await asked(stream, 7) == 7
    except (anyio.EndOfStream, anyio.BrokenResourceError, TimeoutError):
        return False


async def test_requests_sent_without_waiting_are_all_answered_in_order_and_once() -> None:
    registers = Registers()
    async with listening(registers) as port, await anyio.connect_tcp("127.0.0.1", port) as stream:
        requests = [frame(number, READ.pack(6, 40, number)) for number in range(1000)]
        data = b"".join(requests)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(stream.send, data)
            assert await received(stream, len(data)) == data  # an answer to FC 6 repeats it
    assert [values[0] for _, _, values in registers.written] == list(range(1000))
    assert {client for client, _, _ in registers.written} == {"127.0.0.1"}


async def test_one_byte_at_a_time_is_answered_too() -> None:
    async with listening(Registers()) as port, await anyio.connect_tcp(
        "127.0.0.1", port
    ) as stream:  # fmt: skip
        for byte in frame(9, READ.pack(4, 3, 1)):
            await stream.send(bytes((byte,)))
            await anyio.sleep(0.001)
        assert (await received(stream, 11)).hex() == "0009000000050104020003"


async def test_garbage_ends_its_connection_and_no_other() -> None:
    async with listening(Registers()) as port:
        good = await anyio.connect_tcp("127.0.0.1", port)
        bad = await anyio.connect_tcp("127.0.0.1", port)
        async with good, bad:
            await bad.send(b"GET / HTTP/1.1\r\n\r\n")
            with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)):
                await received(bad, 1)
            assert await is_open(good)


async def test_too_many_connections_end_the_one_that_was_idle_longest() -> None:
    async with listening(Registers()) as port:
        streams = [await anyio.connect_tcp("127.0.0.1", port) for _ in range(MOST)]
        for stream in streams:
            assert await is_open(stream)
        assert await is_open(streams[0])
        further = await anyio.connect_tcp("127.0.0.1", port)
        assert await is_open(further)
        assert [await is_open(one) for one in streams[:3]] == [True, False, True]
        for stream in (*streams, further):
            await stream.aclose()


async def test_an_address_that_is_not_allowed_is_disconnected_without_an_answer() -> None:
    registers = Registers()
    async with listening(registers, allow=("192.0.2.7/32",)) as port:
        stream = await anyio.connect_tcp("127.0.0.1", port)
        async with stream:
            with suppress(anyio.BrokenResourceError):
                await stream.send(frame(1, READ.pack(6, 40, 1)))
            with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)):
                await received(stream, 1)
    assert registers.written == []


async def test_slow_clients_are_disconnected_and_delay_nobody(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(modbus_server, "PATIENCE_S", 0.3)
    async with listening(Registers()) as port:
        partial = await anyio.connect_tcp("127.0.0.1", port)
        deaf = await anyio.connect_tcp("127.0.0.1", port)
        idle = await anyio.connect_tcp("127.0.0.1", port)
        good = await anyio.connect_tcp("127.0.0.1", port)
        async with partial, deaf, idle, good:
            await partial.send(b"\0\1\0\0\0\6")
            many = frame(1, READ.pack(3, 0, 125)) * 100

            async def ask_without_reading() -> None:
                with suppress(anyio.BrokenResourceError):
                    while True:
                        await deaf.send(many)

            async with anyio.create_task_group() as tasks:
                tasks.start_soon(ask_without_reading)
                assert await asked(good, 7) == 7
                with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)):
                    await received(partial, 1)
            assert await is_open(idle)
            assert await is_open(good)


async def test_a_telegram_that_comes_byte_by_byte_has_no_more_time_than_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(modbus_server, "PATIENCE_S", 0.5)
    async with listening(Registers()) as port:
        slow = await anyio.connect_tcp("127.0.0.1", port)
        async with slow:
            with suppress(anyio.BrokenResourceError):
                for byte in frame(1, READ.pack(3, 7, 1)):
                    await slow.send(bytes((byte,)))
                    await anyio.sleep(0.2)
            with pytest.raises((anyio.EndOfStream, anyio.BrokenResourceError)):
                await received(slow, 1)
