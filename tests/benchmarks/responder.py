"""A child: one pseudo terminal each for several masters, and answers that take no time.

`python -m benchmarks.responder FOLDER NAME..`; each NAME becomes a link in FOLDER. A request that
begins with EOT is a LECOM telegram: a read is answered with `H0001`, a write with ACK. Anything
else is the Modbus RTU question for one register, always the same, and so is its answer.
"""

from __future__ import annotations

import os
import select
import sys
import tty
from functools import lru_cache, reduce
from operator import xor
from pathlib import Path

__all__ = ["main", "modbus_crc"]

EVEN = bytes(n | (n.bit_count() % 2) << 7 for n in range(128))
EOT, ENQ, ETX = 0x04, 0x05, 0x03


def modbus_crc(data: bytes) -> bytes:
    """The check of a Modbus RTU telegram."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


REGISTER = b"\x01\x03\x02\x00\x01"
MODBUS_ANSWER = REGISTER + modbus_crc(REGISTER)


@lru_cache
def lecom_answer(request: bytes) -> bytes:
    """Answer a whole telegram."""
    plain = bytes(byte & 0x7F for byte in request)
    if plain[-1] != ENQ or plain[3] == 0x02:
        return b"\x06"
    body = plain[3:-1] + b"H0001" + bytes((ETX,))
    answer = b"\x02" + body + bytes((reduce(xor, body),))
    return bytes(EVEN[byte] for byte in answer)


def open_end(link: Path) -> int:
    """Make a pseudo terminal behind a link; gives our end."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    link.symlink_to(os.ttyname(theirs))
    return ours  # theirs stays open: the end must not hang up between two masters


def main(folder: str, *names: str) -> None:
    """Answer until the input ends."""
    ends = [open_end(Path(folder) / name) for name in names]
    stdin = sys.stdin.fileno()
    sys.stdin.readline()
    sys.stdout.write("true\n")
    sys.stdout.flush()
    while True:
        for end in select.select([stdin, *ends], [], [])[0]:
            if end == stdin:
                return
            request = os.read(end, 256)
            answer = lecom_answer(request) if request[0] & 0x7F == EOT else MODBUS_ANSWER
            os.write(end, answer)


if __name__ == "__main__":
    main(*sys.argv[1:])
