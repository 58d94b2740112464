"""Real parts that tests run against: programs of the system that a machine may not have.

On a desk a test whose part is missing is left out and says what to install. In CI (CI=true)
nothing may be missing, so that a green run means that everything was really run.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import NoReturn

import pytest

__all__ = ["missing", "require"]

_PACKAGES = {
    "mosquitto": "mosquitto",
    "mosquitto_passwd": "mosquitto",
    "mosquitto_pub": "mosquitto-clients",
    "mosquitto_rr": "mosquitto-clients",
    "mosquitto_sub": "mosquitto-clients",
    "node": "nodejs",
    "apt-get": "apt",
    "cp": "coreutils",
    "dpkg-deb": "dpkg",
    "nsenter": "util-linux",
    "systemd-nspawn": "systemd-container",
    "promtool": "prometheus",
    "prometheus": "prometheus",
    "ser2net": "ser2net",
    "socat": "socat",
    "systemd-analyze": "systemd",
    "systemd-sysusers": "systemd",
    "udevadm": "udev",
}
"""The Debian package of each program; all stand in requirements/debian.txt."""


def require(program: str) -> Path:
    """Return where a program is.

    Args:
        program: Its name; also looked for in the directories only root has in its path.
    """
    path = os.environ.get("PATH", os.defpath) + ":/usr/sbin:/sbin"
    found = shutil.which(program, path=path)
    if found is None:
        missing(f"{program} is missing: apt-get install {_PACKAGES.get(program, program)}")
    return Path(found)


def missing(what: str) -> NoReturn:
    """End the test because a real part is not there: a failure in CI, left out elsewhere."""
    if os.environ.get("CI") == "true":
        pytest.fail(what, pytrace=False)
    pytest.skip(what)
