"""What deploy/ ships is read here by the programs that will read it on a user's machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from ipaddress import ip_network
from pathlib import Path

import pytest

from support.real_parts import missing, require

pytestmark = pytest.mark.real

DEPLOY = Path(__file__).parents[2] / "deploy"
UNIT = DEPLOY / "lecombus@.service"


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in words],
        capture_output=True,
        text=True,
        timeout=15,
        env={**os.environ, "SYSTEMD_COLORS": "0", "LC_ALL": "C"},
        check=False,
    )


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit with programs that are really here, under an instance's name."""
    text = UNIT.read_text().replace("/opt/lecombus/bin/lecombus", sys.executable)
    path = tmp_path / "lecombus@hall-3.service"
    path.write_text(text)
    return path


def complaints(unit: Path) -> str:
    """What systemd-analyze says about this unit, without what it says about the machine's own."""
    done = run(require("systemd-analyze"), "verify", "--man=no", unit)
    said = (done.stdout + done.stderr).splitlines()
    return "\n".join(line for line in said if "lecombus" in line)


def test_systemd_finds_nothing_wrong_with_the_unit(unit: Path) -> None:
    assert complaints(unit) == ""


def values_of(name: str, key: str) -> list[int]:
    """What a shipped unit sets a key to."""
    text = (DEPLOY / name).read_text()
    return [int(value) for value in re.findall(rf"^{key}=(-?\d+)$", text, re.MULTILINE)]


@pytest.mark.parametrize(
    "name",
    [
        str(unit.relative_to(DEPLOY))
        for unit in sorted([*DEPLOY.glob("*.service"), *DEPLOY.glob("containers/*.container")])
    ],
)
def test_a_unit_with_a_nice_value_has_a_weight_against_other_services_too(name: str) -> None:
    """Where processes are grouped by session, a nice value counts only within the service."""
    nice, weight = values_of(name, "Nice"), values_of(name, "CPUWeight")
    assert len(weight) <= 1
    if nice:
        assert weight
        assert (weight[0] > 100) == (nice[0] < 0)


def test_only_the_line_goes_before_other_services() -> None:
    units = (str(unit.relative_to(DEPLOY)) for unit in DEPLOY.rglob("*@.*") if unit.is_file())
    first = {name for name in units if max(values_of(name, "CPUWeight"), default=100) > 100}
    assert first == {"lecombus@.service", "containers/lecombus-container@.container"}


def test_the_unit_of_the_messages_is_right_and_neither_stops_its_line_nor_ends_with_it(
    tmp_path: Path,
) -> None:
    text = (DEPLOY / "lecombus-notify@.service").read_text()
    (tmp_path / "lecombus@hall-3.service").write_text("[Service]\nExecStart=/bin/true\n")
    unit = tmp_path / "lecombus-notify@hall-3.service"
    unit.write_text(text.replace("/opt/lecombus/bin/lecombus", sys.executable))
    assert complaints(unit) == ""
    # systemd restarts with a daemon that crashed what is PartOf= it: nothing would say that.
    assert not re.search(r"^(PartOf|StopPropagatedFrom)=", text, re.MULTILINE)
    for stops_it in ("BindsTo=", "Requires=", "Conflicts=", "PropagatesStopTo="):
        assert stops_it not in text
    done = run(
        require("systemd-analyze"), "security", "--offline=yes", "--threshold=14", "--no-pager",
        unit,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr


@pytest.mark.parametrize(
    ("good", "bad"),
    [
        ("WatchdogSec=10s", "WatchdogSec=often"),
        ("DevicePolicy=closed", "DevicePolicies=closed"),
        ("ExecStart=", "ExecStart=/nowhere"),
    ],
)
def test_the_check_of_the_unit_would_see_a_mistake(unit: Path, good: str, bad: str) -> None:
    unit.write_text(unit.read_text().replace(good, bad, 1))
    assert complaints(unit) != ""


def test_the_unit_exposes_little_of_the_system(unit: Path) -> None:
    done = run(
        require("systemd-analyze"),
        "security",
        "--offline=yes",
        "--threshold=12",
        "--no-pager",
        unit,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr


@pytest.mark.parametrize("kind", ["modbus", "mqtt"])
def test_the_unit_of_a_bridge_is_right_and_exposes_little(tmp_path: Path, kind: str) -> None:
    text = (DEPLOY / f"lecombus-{kind}@.service").read_text()
    path = tmp_path / f"lecombus-{kind}@hall-3.service"
    path.write_text(text.replace("/opt/lecombus/bin/lecombus", sys.executable))
    assert complaints(path) == ""
    words = ("security", "--offline=yes", "--threshold=15", "--no-pager", path)
    done = run(require("systemd-analyze"), *words)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    # It ends with the line's service, and never ends it.
    assert "PartOf=lecombus@%i.service" in text
    assert not re.search(r"^(Conflicts|BindsTo|Requires|PropagatesStopTo)=", text, re.MULTILINE)


@pytest.mark.parametrize("kind", ["modbus", "mqtt", "notify"])
def test_a_daemon_that_crashed_is_started_without_waiting_for_a_bridge(kind: str) -> None:
    """PartOf= restarts a bridge with it; with After= its end would come first (systemd.unit(5))."""
    text = (DEPLOY / f"lecombus-{kind}@.service").read_text()
    assert not re.search(r"^(After|Before)=.*lecombus@", text, re.MULTILINE)


def test_the_backup_of_a_line_is_right_exposes_little_and_comes_each_day(tmp_path: Path) -> None:
    text = (DEPLOY / "lecombus-backup@.service").read_text()
    service = tmp_path / "lecombus-backup@hall-3.service"
    service.write_text(text.replace("/opt/lecombus/bin/lecombus", sys.executable))
    timer = service.with_suffix(".timer")
    timer.write_text((DEPLOY / "lecombus-backup@.timer").read_text())
    assert complaints(service) == ""
    assert complaints(timer) == ""
    done = run(
        require("systemd-analyze"), "security", "--offline=yes", "--threshold=3", "--no-pager",
        service,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    timer.write_text(timer.read_text().replace("daily", "each day"))
    assert complaints(timer) != "", "the check would see a mistake"


def test_the_unit_speaks_with_this_machine_only() -> None:
    for line in ("IPAddressDeny=any", "IPAddressAllow=localhost"):
        assert f"\n{line}\n" in UNIT.read_text()


def drop_in(unit: Path, name: str) -> Path:
    """Install one of the drop-ins that are shipped beside the unit."""
    dropped = unit.with_name(f"{unit.name}.d") / name
    dropped.parent.mkdir()
    dropped.write_text((DEPLOY / name).read_text())
    return dropped


IDENTITY_SINCE = 257
"""The systemd that knows `PrivateUsers=identity`; those before keep the value that stood before."""


def test_users_of_the_socket_are_shown_by_a_drop_in(unit: Path) -> None:
    version = int(run(require("systemd-analyze"), "--version").stdout.split()[1])
    dropped = drop_in(unit, "show-client-users.conf")
    ignored = "Failed to parse boolean value, ignoring: identity"
    assert (ignored in complaints(unit)) == (version < IDENTITY_SINCE)
    lines = [line for line in dropped.read_text().splitlines() if line.startswith("PrivateUsers=")]
    assert lines == ["PrivateUsers=no", "PrivateUsers=identity"], "the last one known counts"
    unit.write_text(unit.read_text().replace("PrivateUsers=yes", "\n".join(lines)))
    limit = 13 if version < IDENTITY_SINCE else 12
    for threshold, status in ((limit, 0), (12, int(limit > 12))):
        done = run(
            require("systemd-analyze"), "security", "--offline=yes", f"--threshold={threshold}",
            "--no-pager", unit,
        )  # fmt: skip
        assert bool(done.returncode) == bool(status), done.stdout[-2000:] + done.stderr


NAMESPACE = """
import ctypes, os, sys
port, user, group, dialout = sys.argv[1], *map(int, sys.argv[2:])
ready, go = os.pipe(), os.pipe()
child = os.fork()
if not child:
    os.setgroups([dialout])
    os.setresgid(group, group, group)
    os.setresuid(user, user, user)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(4, 1, 0, 0, 0)  # PR_SET_DUMPABLE: the parent writes the maps
    if libc.unshare(0x10000000):  # CLONE_NEWUSER
        os._exit(77)
    os.write(ready[1], b"x")
    os.read(go[0], 1)
    assert dialout not in os.getgroups()
    os.open(port, os.O_RDWR | os.O_NOCTTY)
    os._exit(0)
os.close(ready[1])
if os.read(ready[0], 1):
    for name, text in (
        ("setgroups", "deny"),
        ("uid_map", f"0 0 1\\n{user} {user} 1\\n"),
        ("gid_map", f"0 0 1\\n{group} {group} 1\\n"),
    ):
        with open(f"/proc/{child}/{name}", "w") as file:
            file.write(text)
    os.write(go[1], b"x")
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
"""What systemd does for PrivateUsers=yes: groups and user first, then a namespace of two users."""


def test_a_serial_port_of_the_group_opens_with_private_users() -> None:
    if os.getuid():
        missing("only root may set users and groups")
    far, near = os.openpty()
    user, dialout = 4242, 4343
    try:
        os.chown(near, 0, dialout)
        os.fchmod(near, 0o660)
        words = [os.ttyname(near), str(user), str(user)]
        done = run(sys.executable, "-c", NAMESPACE, *words, str(dialout))
        if done.returncode == 77:
            missing("no user namespaces here")
        assert done.returncode == 0, done.stderr
        other = run(sys.executable, "-c", NAMESPACE, *words, str(dialout + 1))
        assert "PermissionError" in other.stderr, "another group does not open it"
    finally:
        os.close(far)
        os.close(near)


def test_a_device_server_has_its_drop_in(unit: Path) -> None:
    dropped = drop_in(unit, "device-server.conf")
    assert complaints(unit) == ""
    allowed = re.findall(r"^IPAddressAllow=(.*)$", dropped.read_text(), re.MULTILINE)
    assert [str(ip_network(one)) for one in allowed[0].split()] == allowed[0].split()
    dropped.write_text(dropped.read_text().replace("10.0.0.0/8", "10.0.0.0/99"))
    assert complaints(unit) != "", "the check would see a mistake"


def test_the_unit_gives_serial_ports_and_no_other_device() -> None:
    allowed = re.findall(r"^DeviceAllow=(.*)$", UNIT.read_text(), re.MULTILINE)
    assert allowed == ["char-ttyUSB rw", "char-ttyACM rw", "char-ttyS rw"]
    assert "\nDevicePolicy=closed\n" in UNIT.read_text()


def test_systemd_can_make_the_user(tmp_path: Path) -> None:
    wanted = DEPLOY / "sysusers.d" / "lecombus.conf"
    (tmp_path / "etc").mkdir()
    done = run(require("systemd-sysusers"), f"--root={tmp_path}", wanted)
    assert done.returncode == 0, done.stderr
    users = (tmp_path / "etc" / "passwd").read_text()
    assert re.search(
        r"^lecombus:x:\d+:\d+:LECOM line daemon:/var/lib/lecombus:", users, re.MULTILINE
    )
    group = (tmp_path / "etc" / "group").read_text()
    assert re.search(r"^dialout:x:\d+:lecombus$", group, re.MULTILINE)


def udev_complaints(rules: Path) -> str:
    """What udev says about a rules file: by `verify` where it has that, else by reading it."""
    udevadm = require("udevadm")
    if int(re.findall(r"\d+", run(udevadm, "--version").stdout)[0]) >= 254:
        done = run(udevadm, "verify", "--no-summary", rules)
        return done.stdout + done.stderr if done.returncode else ""
    # Before version 254 only a test run reads rules; it gets to see a directory of its own.
    place = Path("/usr/lib/udev/rules.d")
    script = 'mount --bind "$1" "$2" && exec "$3" test /sys/class/tty/tty0'
    done = run("unshare", "--mount", "sh", "-c", script, "sh", rules.parent, place, udevadm)
    said = done.stdout + done.stderr
    if f"{place}/{rules.name}" not in said:
        missing(f"udev's rules can only be read as root here: {said[-200:]}")
    return "\n".join(line for line in said.splitlines() if f"{rules.name}:" in line)


def test_udev_finds_nothing_wrong_with_the_rules(tmp_path: Path) -> None:
    rules = tmp_path / "60-lecombus.rules"
    rules.write_text((DEPLOY / "60-lecombus.rules").read_text())
    assert udev_complaints(rules) == ""


@pytest.mark.parametrize("wrong", ['LATENCY=="1"', 'ATTR{latency_timer}="1" GROUP="dialout"'])
def test_the_check_of_the_rules_would_see_a_mistake(tmp_path: Path, wrong: str) -> None:
    rules = tmp_path / "60-lecombus.rules"
    rules.write_text((DEPLOY / "60-lecombus.rules").read_text() + wrong + "\n")
    assert udev_complaints(rules) != ""


def test_prometheus_takes_the_scrape_configuration_and_the_alerts() -> None:
    done = run(require("promtool"), "check", "config", DEPLOY / "prometheus" / "prometheus.yml")
    assert done.returncode == 0, done.stderr
    assert re.search(r"SUCCESS: [1-9]\d* rules found", done.stdout)
