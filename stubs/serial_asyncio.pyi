"""What lecombus uses of pyserial-asyncio 0.6, which carries no types of its own."""

from asyncio import AbstractEventLoop, BaseProtocol, Transport
from collections.abc import Callable
from typing import TypeVar

from serial import Serial

_P = TypeVar("_P", bound=BaseProtocol)

class SerialTransport(Transport):
    _closing: bool
    _loop: AbstractEventLoop
    _serial: Serial
    _write_buffer: list[bytes]
    def __init__(
        self, loop: AbstractEventLoop, protocol: BaseProtocol, serial_instance: Serial
    ) -> None: ...
    @property
    def serial(self) -> Serial: ...
    def _ensure_reader(self) -> None: ...
    def _remove_reader(self) -> None: ...
    def _ensure_writer(self) -> None: ...
    def _remove_writer(self) -> None: ...
    def _read_ready(self) -> None: ...
    def _write_ready(self) -> None: ...

async def create_serial_connection(
    loop: AbstractEventLoop, protocol_factory: Callable[[], _P], *args: object, **kwargs: object
) -> tuple[SerialTransport, _P]: ...
