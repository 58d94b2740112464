"""`lecombus run` loads no OpenSSL, and what asks for TLS all the same gets it."""

from __future__ import annotations

import subprocess
import sys

LOADED = "any('libcrypto' in line or 'libssl' in line for line in open('/proc/self/maps'))"


def _run(program: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_daemon_is_imported_without_openssl() -> None:
    program = (
        "from lecombus.cli.openssl import leave_out_openssl; leave_out_openssl()\n"
        "import lecombus.daemon, anyio._backends._asyncio, hashlib\n"
        f"print({LOADED}, hashlib.sha256(b'').hexdigest()[:8])"
    )
    assert _run(program) == "False e3b0c442\n"


def test_openssl_is_there_for_those_who_use_it() -> None:
    program = (
        "from lecombus.cli.openssl import leave_out_openssl; leave_out_openssl()\n"
        "import ssl as first, asyncio\n"
        "print(first.CERT_NONE == 0, first.create_default_context().check_hostname)\n"
        "import ssl\n"
        f"print(ssl is not first, ssl.SSLContext is first.SSLContext, {LOADED})"
    )
    assert _run(program) == "True True\nTrue True True\n"


def test_nothing_is_changed_where_openssl_is_loaded() -> None:
    program = (
        "import ssl; before = ssl\n"
        "from lecombus.cli.openssl import leave_out_openssl; leave_out_openssl()\n"
        "import sys; print(sys.modules['ssl'] is before)"
    )
    assert _run(program) == "True\n"
