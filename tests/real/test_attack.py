"""A full line while clients over TCP send whatever they can: no watchdog and no memory is lost.

The simulated drives are a process of their own, as in `test_load`; the clients here only use
sockets, so that nothing of them is limited by a client library.
"""

from __future__ import annotations

import time

import httpx2
import pytest

from support.certificates import client_context, make_certificates
from support.daemon_host import Daemon, free_port, lecombus, short_dir
from support.tcp_attack import GET, Attack, Handshakes, full_line, resident_mb

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(400)]

MARGIN = "lecombus_watchdog_margin_seconds"
FOR_S = 10.0

ATTACKS: dict[str, tuple[int, bytes]] = {
    "many headers": (64, GET % b"/v1/line" + b"a:\r\n" * 12_000 + b"\r\n"),
    "just under the bounds": (64, GET % b"/v1/line" + b"a:\r\n" * 60 + b"\r\n"),
    "many parameters": (4, GET % (b"/v1/line?" + b"a&" * 31_000) + b"\r\n"),
    "an endless body": (
        4,
        GET % b"/v1/line" + b"Content-Length: 99999999999\r\n\r\n" + b"x" * 9000,
    ),
    "chunks of one byte": (
        8,
        GET % b"/v1/line" + b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 9000,
    ),
    "pipelined pages": (64, (GET % b"/v1/drives" + b"\r\n") * 100),
    "reads of the line": (
        64,
        (GET % b"/v1/drives/drive-11/codes/C0150?fr%65sh=true" + b"\r\n") * 100,
    ),
}
"""How many connections, and what each sends over and over without waiting for anything."""


def least_margin(daemon: Daemon, seconds: float = FOR_S) -> float:
    """Look at all margins for a while."""
    least, end_s = float("inf"), time.monotonic() + seconds
    while time.monotonic() < end_s:
        least = min(least, *daemon.metric(MARGIN).values())
        time.sleep(0.05)
    return least


def test_whatever_comes_over_tcp_takes_no_watchdog_and_no_memory() -> None:
    with short_dir() as folder:
        port = free_port()
        with full_line(folder, port) as (daemon, _):
            time.sleep(10.0)  # what audits have put off
            calm, before_mb = least_margin(daemon), resident_mb(daemon)
            missed = daemon.metric("lecombus_watchdog_misses_total")
            for name, (count, data) in ATTACKS.items():
                for reads in (True, False):
                    with Attack(port, count, data, reads=reads) as attack:
                        least = least_margin(daemon)
                    said = f"{name}, answers {'' if reads else 'not '}taken, {attack.sent} bytes"
                    assert attack.sent > len(data), said
                    assert daemon.metric("lecombus_watchdog_misses_total") == missed, said
                    assert least >= 0.8 * calm, said
                    assert resident_mb(daemon) - before_mb <= 20.0, said
            assert daemon.end() == 0


HELLO = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"

GUARDED_ATTACKS: dict[str, tuple[int, bytes]] = {
    "the beginning of a handshake": (200, HELLO),
    "rubbish": (200, b"\x00" * 20_000),
    "requests without TLS": (64, GET % b"/v1/line" + b"\r\n"),
    "alerts": (64, b"\x15\x03\x03\x00\x02\x02\x28" * 1000),
}
"""How many connections, and what each sends where TLS is expected."""


def test_whatever_comes_over_tls_takes_no_watchdog_and_no_stop() -> None:
    with short_dir() as folder:
        made, port = make_certificates(folder), free_port()
        tls = f"{{certificate: {made.path('server.pem')}, key: {made.path('server.key')}}}"
        with full_line(folder, port, f"tokens: {folder}/tokens, tls: {tls}") as (daemon, _):
            token = folder / "plc.token"
            words = ("new", "plc", "--scope", "control", "-c", daemon.roster, "-o", token)
            assert lecombus("token", *words, within_s=60).status == 0
            time.sleep(10.0)
            before_mb = resident_mb(daemon)
            context = client_context(made)
            attacks: dict[str, Attack] = {
                name: Attack(port, *what) for name, what in GUARDED_ATTACKS.items()
            }
            attacks["whole handshakes"] = Handshakes(port, 1, context)
            headers = {"Authorization": f"Bearer {token.read_text().strip()}"}
            url = f"https://localhost:{port}"
            stop = {"action": "quick-stop", "target": "drive-11"}
            # One keeps its connection, from the address of the attack; the other comes anew.
            keeps = httpx2.Limits(keepalive_expiry=60.0)
            with httpx2.Client(
                base_url=url, headers=headers, verify=context, timeout=20, limits=keeps
            ) as plc:
                assert plc.get("/v1/line").status_code == 200
                for name, attack in attacks.items():
                    missed = daemon.metric("lecombus_watchdog_misses_total")
                    with attack:
                        time.sleep(FOR_S)
                        assert daemon.metric("lecombus_watchdog_misses_total") == missed, name
                        assert plc.post("/v1/stop", json=stop).status_code == 200, name
                        elsewhere = httpx2.HTTPTransport(verify=context, local_address="127.0.0.2")
                        with httpx2.Client(
                            base_url=url, headers=headers, transport=elsewhere, timeout=20
                        ) as other:
                            assert other.post("/v1/stop", json=stop).status_code == 200, name
                    assert attack.sent > 0, name
                    assert resident_mb(daemon) - before_mb <= 20.0, name
            assert daemon.end() == 0
