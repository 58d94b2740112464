"""Certificates for tests, made by the openssl command."""

from __future__ import annotations

import ssl
import subprocess
from dataclasses import dataclass
from pathlib import Path

from lecombus.roster import TlsEntry

__all__ = ["Certificates", "client_context", "make_certificates"]

KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


@dataclass(frozen=True)
class Certificates:
    """An authority, and where what it signed stands."""

    folder: Path

    def path(self, name: str) -> Path:
        return self.folder / name

    def server(self, *, client_ca: bool = False) -> TlsEntry:
        return TlsEntry(
            certificate=str(self.path("server.pem")),
            key=str(self.path("server.key")),
            client_ca=str(self.path("ca.pem")) if client_ca else None,
        )

    def sign(self, name: str, subject: str, days: int = 90) -> None:
        """Make a key and a certificate that the authority signed."""
        names = ("-addext", "subjectAltName=DNS:localhost,DNS:drives.example,IP:127.0.0.1")
        signed = ("-CA", self.path("ca.pem"), "-CAkey", self.path("ca.key"))
        self._make(name, subject, days, *signed, *names)

    def _make(self, name: str, subject: str, days: int, *more: object) -> None:
        key, certificate = self.path(f"{name}.key"), self.path(f"{name}.pem")
        made = ("-keyout", key, "-out", certificate, "-subj", subject, "-days", days)
        call = ["openssl", "req", "-x509", *KEY, *made, *more]
        subprocess.run(list(map(str, call)), check=True, capture_output=True)
        key.chmod(0o600)


def make_certificates(folder: Path) -> Certificates:
    """Make an authority, a server and a client."""
    made = Certificates(folder)
    made._make("ca", "/CN=test authority", 90)
    made.sign("server", "/CN=localhost")
    made.sign("plc", "/O=Works/CN=plc 1")
    both = made.path("plc.pem").read_text() + made.path("plc.key").read_text()
    made.path("plc.both").write_text(both)
    return made


def client_context(made: Certificates, *, shows: bool = False) -> ssl.SSLContext:
    """Return what a client trusts and shows."""
    context = ssl.create_default_context(cafile=str(made.path("ca.pem")))
    if shows:
        context.load_cert_chain(made.path("plc.pem"), made.path("plc.key"))
    return context
