"""Until when certificates are valid, as openssl says too."""

from __future__ import annotations

import contextlib
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.config.certificate_dates import expiries_of, expiry_of, expiry_text, not_after
from lecombus.roster import TlsEntry
from support.certificates import make_certificates

DAY_S = 86400.0
NOW_S = datetime(2026, 11, 23, 12, tzinfo=UTC).timestamp()


@pytest.mark.parametrize("days", [1, 90, 9000, 40_000], ids=str)
def test_dates_are_those_that_openssl_shows(tmp_path: Path, days: int) -> None:
    """From 2050 on they have four digits for the year."""
    made = make_certificates(tmp_path)
    made.sign("one", "/O=Works/CN=one", days)
    call = ["openssl", "x509", "-enddate", "-noout", "-in", str(made.path("one.pem"))]
    said = subprocess.run(call, check=True, capture_output=True, text=True).stdout
    end = datetime.strptime(said.strip(), "notAfter=%b %d %H:%M:%S %Y GMT").replace(tzinfo=UTC)
    assert expiry_of(made.path("one.pem")) == end.timestamp()


def test_the_first_of_a_file_that_expires_counts_and_both_files_do(tmp_path: Path) -> None:
    made = make_certificates(tmp_path)
    made.sign("short", "/CN=short", 3)
    chain = made.path("server.pem").read_text() + made.path("short.pem").read_text()
    made.path("chain.pem").write_text(chain)
    entry = TlsEntry(
        certificate=str(made.path("chain.pem")), key="", client_ca=str(made.path("ca.pem"))
    )
    found = expiries_of(entry)
    assert found["certificate"] == expiry_of(made.path("short.pem"))
    assert found["client_ca"] == expiry_of(made.path("ca.pem"))


def element(kind: int, content: bytes) -> bytes:
    size = len(content)
    length = bytes([size]) if size < 128 else b"\x82" + size.to_bytes(2, "big")
    return bytes([kind]) + length + content


@pytest.mark.parametrize(("kind", "text", "end"), [
    (0x17, b"491231235959Z", datetime(2049, 12, 31, 23, 59, 59, tzinfo=UTC)),
    (0x17, b"500101000000Z", datetime(1950, 1, 1, tzinfo=UTC)),
    (0x18, b"99991231235959Z", datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)),
])  # fmt: skip
@pytest.mark.parametrize("version", [b"", element(0xA0, element(2, b"\x02"))], ids=["v1", "v3"])
def test_every_form_of_the_date(version: bytes, kind: int, text: bytes, end: datetime) -> None:
    times = element(0x17, b"200101000000Z") + element(kind, text)
    before = element(2, b"\x01") + element(0x30, b"") + element(0x30, bytes(300))
    body = element(0x30, version + before + element(0x30, times))
    assert not_after(element(0x30, body)) == end.timestamp()


@given(st.binary(max_size=80))
def test_what_is_no_certificate_has_no_date(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        not_after(data)


def test_a_file_without_a_certificate_has_no_date(tmp_path: Path) -> None:
    (tmp_path / "x.pem").write_text("nothing")
    with pytest.raises(ValueError, match="holds no certificate"):
        expiry_of(tmp_path / "x.pem")


@pytest.mark.parametrize(("left_s", "said"), [
    (31 * DAY_S, ""),
    (30 * DAY_S, "it expires on 2026-12-23, in 30 days"),
    (1.5 * DAY_S, "it expires on 2026-11-25, in 1 day"),
    (3600.0, "it expires on 2026-11-23, in 0 days"),
    (0.0, "it expired on 2026-11-23"),
    (-40 * DAY_S, "it expired on 2026-10-14"),
])  # fmt: skip
def test_what_is_said(left_s: float, said: str) -> None:
    assert expiry_text(NOW_S + left_s, NOW_S) == said
