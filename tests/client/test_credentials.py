"""What a client shows at a URL, and what it trusts."""

from __future__ import annotations

import ssl
from pathlib import Path

import pytest

from lecombus.client import UnreachableError
from lecombus.client.credentials import headers_for, token_of, trusted
from lecombus.client.errors import NotPermittedError


def test_a_token_is_read_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "token"
    for text in ("", "two words\n", "ümlaut"):
        file.write_text(text)
        file.chmod(0o600)
        with pytest.raises(UnreachableError, match="holds no token"):
            token_of(file)
    with pytest.raises(UnreachableError, match="holds no token"):
        token_of(tmp_path / "none")
    file.write_text("lcb_abc\n")
    assert token_of(file) == "lcb_abc"


@pytest.mark.parametrize("mode", [0o604, 0o602, 0o644])
def test_a_token_that_every_user_may_read_is_not_used(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "token"
    file.write_text("lcb_abc\n")
    file.chmod(mode)
    with pytest.raises(NotPermittedError, match="every user") as caught:
        token_of(file)
    assert "lcb_abc" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "sent"),
    [
        ("https://drives.example:9740", True),
        ("http://127.0.0.1:9740", True),
        ("http://[::1]:9740", True),
        ("http://localhost:9740", True),
        ("http://drives.example:9740", False),
        ("http://127.0.0.1.example:9740", False),
        ("http://192.0.2.5", False),
    ],
)
def test_a_token_is_not_sent_through_a_network_as_it_is(
    tmp_path: Path, url: str, sent: bool
) -> None:
    file = tmp_path / "token"
    file.write_text("lcb_abc\n")
    file.chmod(0o600)
    if sent:
        assert headers_for(url, file) == {"authorization": "Bearer lcb_abc"}
    else:
        with pytest.raises(NotPermittedError, match="not sent"):
            headers_for(url, file)
    assert headers_for("", file) == headers_for(url, None) == {}


def test_tls_trusts_only_what_it_is_given(tmp_path: Path) -> None:
    assert trusted("http://x", None).cert_store_stats()["x509"] == 0
    assert trusted("https://x", None).verify_mode is ssl.CERT_REQUIRED
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(UnreachableError, match="holds no certificates"):
        trusted("https://x", tmp_path / "ca.pem")
    with pytest.raises(UnreachableError, match="holds no certificate with its key"):
        trusted("https://x", None, tmp_path / "ca.pem")
