"""A newcomer's path on a clean Debian system: from the package to its removal, on systemd itself.

Each step is a function, in the order in which a user takes them; docs/install.md says the same.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest
import yaml

from support.debian_root import DebianRoot, make_root
from support.package_build import with_version
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.timeout(1200)]

EXAMPLE = "/usr/share/doc/lecombus/examples/small.yaml"
ROSTER = "/etc/lecombus/hall-3.yaml"
MORE = """
journal: /var/lib/lecombus/hall-3.sqlite
mqtt: {host: 127.0.0.1, tls: false, control: true}
"""
BRIDGE = "lecombus-mqtt@hall-3.service"
BACKUP, BACKUPS = "lecombus-backup@hall-3", "/var/lib/lecombus-backup"
PORT = "/run/simulated/hall-3"
UNIT = "lecombus@hall-3.service"
OPERATOR, VISITOR = "anna", "visitor"
"""Users: one is a member of the group lecombus, one is not."""

PROMETHEUS = "127.0.0.1:9090"
ENDS_WITHIN_S = 60.0
LOOK_AGAIN_S = 0.3
SCRAPE = """
import sys, urllib.error, urllib.request as requests
headers = {"Authorization": f"Bearer {sys.argv[1]}"} if sys.argv[1:] else {}
try:
    answer = requests.urlopen(requests.Request("http://127.0.0.1:9740/metrics", headers=headers))
    print(answer.read().decode())
except urllib.error.HTTPError as exc:
    print(exc.code)
"""
TOKENS = "/etc/credstore/lecombus.hall-3.tokens"
"""What only root may read, and the service gets from systemd."""


def until(happens: Callable[[], bool], what: str) -> None:
    """Wait until something is so; machines may be slow, so no time of it is judged."""
    until_s = time.monotonic() + ENDS_WITHIN_S
    while not happens():
        assert time.monotonic() < until_s, f"not within {ENDS_WITHIN_S:.0f} s: {what}"
        time.sleep(LOOK_AGAIN_S)


def states(root: DebianRoot) -> dict[str, str]:
    """Return the drives and their states, as `lecombus status` shows them in a pipe."""
    lines = root.run("lecombus", "status", status=None).splitlines()
    found = re.findall(r"^(feeder|belt)\t\d+\t\w+\t(\w+)", "\n".join(lines), re.MULTILINE)
    return dict(found)


def all_online(root: DebianRoot) -> None:
    until(lambda: states(root) == {"feeder": "online", "belt": "online"}, "all drives online")


def process(root: DebianRoot) -> str:
    return root.run("systemctl", "show", "--property=MainPID", "--value", UNIT).strip()


def simulator(root: DebianRoot, command: str) -> str:
    return root.run("lecombus", "simulate", "--pty", PORT, "--tell", command)


def install(root: DebianRoot, package: Path) -> None:
    root.path("/srv/lecombus.deb").write_bytes(package.read_bytes())
    root.run("apt-get", "install", "--yes", "/srv/lecombus.deb")
    version = package.name.split("_")[1]
    assert root.run("dpkg-query", "--show", "--showformat=${Version}", "lecombus") == version
    assert root.run("lecombus", "--version").split()[1] in version
    assert "(dialout)" in root.run("id", "lecombus")
    root.run("usermod", "--append", "--groups", "lecombus", OPERATOR)
    typed = ("COMP_WORDS=lecombus st", "COMP_CWORD=1", "_LECOMBUS_COMPLETE=bash_complete")
    completed = root.run("env", *typed, "lecombus")
    assert completed.split() == ["plain,stop", "plain,status"]


def write_roster(root: DebianRoot) -> None:
    text = root.path(EXAMPLE).read_text()
    text = text.replace("name: bench", "name: hall-3")
    text = re.sub(r"port: /dev/\S+", f"port: {PORT}", text)
    text = re.sub(r"  http: \S+", rf"\g<0>\n  tokens: /run/credentials/{UNIT}/tokens", text)
    root.path(ROSTER).write_text(text + MORE)
    root.run("chown", "root:lecombus", ROSTER)
    root.run("chmod", "640", ROSTER)
    assert "hall-3" in root.run("lecombus", "check", "-c", ROSTER)


def make_token(root: DebianRoot) -> None:
    words = ("--scope", "metrics", "--file", TOKENS, "-o", "/srv/prometheus.token")
    root.run("lecombus", "token", "new", "prometheus", *words)
    root.run("chmod", "600", TOKENS)


def connect_drives(root: DebianRoot) -> None:
    """Put simulated drives where the adapter would be."""
    root.run("install", "-d", "-o", "lecombus", str(Path(PORT).parent))
    words = ("lecombus", "simulate", "-c", ROSTER, "--pty", PORT)
    root.start(*words, user="lecombus")
    until(lambda: root.path("/proc").exists() and "pts" in linked(root), "the simulated port")


def linked(root: DebianRoot) -> str:
    return root.run("readlink", "--", PORT, status=None)


def start(root: DebianRoot) -> None:
    root.run("systemctl", "enable", "--now", UNIT)
    all_online(root)
    about = root.run("cat", f"/proc/{process(root)}/status")
    number = root.run("id", "--user", "lecombus").strip()
    assert re.search(rf"^Uid:\t{number}\t", about, re.MULTILINE)
    for line in (
        "CapEff:\t0000000000000000",
        "CapBnd:\t0000000000000000",
        "NoNewPrivs:\t1",
        "Seccomp:\t2",
    ):
        assert line in about
    assert root.run("systemctl", "--failed", "--no-legend") == ""


def scrape(root: DebianRoot) -> None:
    assert root.run("python3", "-c", SCRAPE).strip() == "401"
    token = root.path("/srv/prometheus.token").read_text().strip()
    page = root.run("python3", "-c", SCRAPE, token)
    for drive in ("feeder", "belt"):
        assert f'lecombus_drive_up{{line="hall-3",drive="{drive}"}} 1' in page


def watch(root: DebianRoot) -> None:
    """A Prometheus of this machine in the system's network, with the package's job and rules.

    It looks more often than a user's, and alerts do not wait.
    """
    shipped, place = root.path("/usr/share/lecombus/prometheus"), root.path("/srv/prometheus")
    place.mkdir()
    config = yaml.safe_load((shipped / "prometheus.yml").read_text())
    config["global"] = dict.fromkeys(("scrape_interval", "evaluation_interval"), "500ms")
    token = str(root.path("/srv/prometheus.token"))
    config["scrape_configs"][0]["authorization"] = {"credentials_file": token}
    (place / "prometheus.yml").write_text(yaml.safe_dump(config))
    (rules,) = config["rule_files"]
    text = (shipped / rules).read_text()
    (place / rules).write_text(re.sub(r"\bfor: \w+", "for: 500ms", text))
    root.start_ours(
        require("prometheus"), f"--config.file={place / 'prometheus.yml'}",
        f"--storage.tsdb.path={place / 'data'}", f"--web.listen-address={PROMETHEUS}",
    )  # fmt: skip


def ask(root: DebianRoot, query: str) -> str:
    words = (require("promtool"), "query", "instant", f"http://{PROMETHEUS}", query)
    return root.run_ours(*words, status=None)  # it may not listen yet


def fires(root: DebianRoot, alert: str) -> bool:
    return "firing" in ask(root, f'ALERTS{{alertname="{alert}", alertstate="firing"}}')


def trip(root: DebianRoot) -> None:
    """A drive trips, its alert fires, and the fault is reset."""
    until(lambda: "lecombus_drive_up" in ask(root, "lecombus_drive_up == 1"), "it has scraped")
    assert not fires(root, "LecombusDriveTripped")
    simulator(root, "trip feeder 50")
    until(lambda: fires(root, "LecombusDriveTripped"), "the alert of the trip")
    assert 'drive="feeder"' in ask(root, "ALERTS{alertname='LecombusDriveTripped'}")
    assert "50" in root.run("lecombus", "why", "feeder", user=OPERATOR)
    assert "verified" in root.run("lecombus", "reset-fault", "feeder", user=OPERATOR)


def write(root: DebianRoot) -> None:
    words = ("lecombus", "write", "feeder", "C0046", "20", "--verify")
    assert "feeder\tC0046\tverified\t20 Hz" in root.run(*words, user=OPERATOR)
    root.run(*words, user=VISITOR, status=4)
    assert "verified" in root.run("lecombus", "stop", user=OPERATOR)
    journal = root.run("lecombus", "journal", user=OPERATOR)
    assert re.search(r"\twrite\tfeeder\tverified\tcode=C0046 value=20", journal)


def use_mqtt(root: DebianRoot) -> None:
    """A broker of this machine in the system's network; the bridge is the package's service."""
    root.start_ours(require("mosquitto"))  # without a file it listens on loopback, for all
    root.run("systemctl", "enable", "--now", BRIDGE)
    topic = "lecombus/hall-3/feeder"
    waiting = (require("mosquitto_sub"), "-V", "5", "-C", "1", "-W", "60")
    assert float(root.run_ours(*waiting, "-t", f"{topic}/value/C0050")) == 0
    words = ("-V", "5", "-q", "2", "-t", f"{topic}/set/C0046", "-m", "17", "-e", "answers/test")
    answer = json.loads(root.run_ours(require("mosquitto_rr"), *words, "-W", "60"))
    assert (answer["drive"], answer["outcome"]) == ("feeder", "done")
    assert re.search(r"\b17\b", simulator(root, "get feeder C0046")), "the drive has it"
    journal = root.run("lecombus", "journal")
    assert re.search(r"\twrite\tfeeder\tdone\tcode=C0046 value=17 .*client=mqtt", journal), journal
    look_at_the_fleet(root)


def look_at_the_fleet(root: DebianRoot) -> None:
    """It needs the broker's permission only, and no daemon's."""
    words = ("lecombus", "fleet", "--broker", "mqtt://127.0.0.1")
    seen = root.run(*words, "--once", user=VISITOR, status=None)
    assert {row.partition("\t")[0] for row in seen.splitlines()} == {"hall-3"}, seen
    assert "2 online" in seen
    stop = ("lecombus", "fleet", "stop", "hall-3", "--broker", "mqtt://127.0.0.1")
    assert root.run(*stop, user=VISITOR).count("\tverified\t") == 2


def begin_backup(root: DebianRoot) -> None:
    """The package's timer is off until it is wanted; its service is started here as it would."""
    assert root.run("systemctl", "is-enabled", f"{BACKUP}.timer", status=1).strip() == "disabled"
    root.run("systemctl", "enable", "--now", f"{BACKUP}.timer")
    assert BACKUP in root.run("systemctl", "list-timers", "--no-pager")
    root.run("systemctl", "start", "--no-block", f"{BACKUP}.service")


def look_at_backup(root: DebianRoot) -> None:
    service = f"{BACKUP}.service"

    def ended() -> bool:
        return root.run("systemctl", "is-active", service, status=None).strip() == "inactive"

    until(ended, "the end of the backup, without a failure")
    words = ("find", BACKUPS, "-name", "*.yaml", "-user", "lecombus")
    files = root.run(*words).split()
    assert sorted(Path(name).name.partition(".")[0] for name in files) == ["belt", "feeder"]
    (of_feeder,) = [name for name in files if "/feeder." in name]
    assert root.run("lecombus", "diff", of_feeder, "feeder", user=OPERATOR) == ""
    root.run("cat", of_feeder, user=VISITOR, status=1)


def bridge(root: DebianRoot) -> str:
    return root.run("systemctl", "show", "--property=MainPID", "--value", BRIDGE).strip()


def unplug(root: DebianRoot) -> None:
    running = process(root)
    simulator(root, "unplug")
    until(lambda: "online" not in states(root).values(), "no drive online")
    until(lambda: fires(root, "LecombusLineLost"), "the alert of the line")
    root.run("lecombus", "write", "feeder", "C0046", "21", user=OPERATOR, status=1)
    simulator(root, "plug")
    all_online(root)
    assert process(root) == running


def upgrade(root: DebianRoot, newer: Path) -> None:
    before, bridge_before = process(root), bridge(root)
    root.path("/srv/newer.deb").write_bytes(newer.read_bytes())
    root.run("dpkg", "--unpack", "/srv/newer.deb")
    # The program that runs has lost its files now, and must still do all that it may be asked for.
    assert "20 Hz" in root.run("lecombus", "write", "feeder", "C0046", "20", "--verify")
    assert "verified" in root.run("lecombus", "stop")
    root.run("lecombus", "reload")
    root.run("lecombus", "why", "feeder")
    root.run("lecombus", "backup", "feeder", "-o", "/tmp/feeder.yaml")
    assert process(root) == before
    root.run("dpkg", "--configure", "lecombus")
    until(lambda: process(root) not in ("0", before), "another process")
    until(lambda: bridge(root) not in ("0", bridge_before), "another process of the bridge")
    assert root.run("journalctl", "--unit", BRIDGE, "--no-pager").count("Started ") == 2
    all_online(root)
    log = root.run("journalctl", "--unit", UNIT, "--no-pager")
    assert "level=error" not in log
    assert "Traceback" not in log
    assert log.count("event=stopped") == 1


def upgrade_with_a_roster_that_is_refused(root: DebianRoot) -> None:
    """The line must not stand still for it."""
    before, good = process(root), root.path(ROSTER).read_text()
    root.path(ROSTER).write_text(good.replace("family: smvector", "family: unknown"))
    said = root.run("/var/lib/dpkg/info/lecombus.postinst", "configure", "0.0.1-1")
    assert "line hall-3 is NOT restarted" in said
    assert process(root) == before
    assert set(states(root).values()) == {"online"}
    root.path(ROSTER).write_text(good)


def remove(root: DebianRoot) -> None:
    root.run("apt-get", "remove", "--yes", "lecombus")
    assert process(root) == "0"
    root.run("lecombus", "--version", status=127)
    kept = root.files()
    assert {ROSTER, "/var/lib/lecombus/hall-3.json", "/var/lib/lecombus/hall-3.sqlite"} <= kept
    assert not root.path("/usr/lib/lecombus").exists()


def install_again(root: DebianRoot) -> None:
    """What was kept is used again, and what was enabled starts at the next boot."""
    root.run("apt-get", "install", "--yes", "/srv/lecombus.deb")
    assert root.run("systemctl", "is-enabled", UNIT).strip() == "enabled"
    root.run("systemctl", "start", UNIT)
    all_online(root)


def purge(root: DebianRoot, before: set[str]) -> None:
    root.run("apt-get", "purge", "--yes", "lecombus")
    new = root.files() - before
    kept = {"/etc/lecombus", ROSTER, TOKENS}
    assert {name for name in new if not name.startswith(BACKUPS)} == kept, "what people wrote"
    assert sum(name.endswith(".yaml") for name in new - kept) == 2, "and the backups"
    assert root.run("systemctl", "list-units", "--all", "--no-legend", "lecombus*") == ""
    assert not root.path("/run/lecombus").exists()
    root.run("rm", "-r", "/etc/lecombus", TOKENS, BACKUPS)
    assert root.files() == before
    assert root.run("systemctl", "--failed", "--no-legend") == ""


def take_the_path(root: DebianRoot, package: Path, newer: Path, *, detours: bool) -> None:
    for name in (OPERATOR, VISITOR):
        root.run("useradd", "--user-group", name)
    root.run("usermod", "--append", "--groups", "users", OPERATOR)
    root.run("install", "-d", "-m", "700", str(Path(TOKENS).parent))
    before = root.files()
    install(root, package)
    write_roster(root)
    make_token(root)
    connect_drives(root)
    start(root)
    watch(root)
    scrape(root)
    write(root)
    trip(root)
    begin_backup(root)
    use_mqtt(root)
    look_at_backup(root)
    unplug(root)
    upgrade(root, newer)
    upgrade_with_a_roster_that_is_refused(root)
    remove(root)
    if detours:
        install_again(root)
    purge(root, before)


def test_a_newcomers_path_on_debian_12(
    package: Path, clean_root: Future[Path], tmp_path: Path
) -> None:
    newer = with_version(package, "999-1", tmp_path)
    with DebianRoot(clean_root.result(), tmp_path / "root") as root:
        take_the_path(root, package, newer, detours=False)


@pytest.mark.long
def test_a_newcomers_path_on_debian_13(package: Path, tmp_path: Path) -> None:
    make_root("trixie", tmp_path / "clean")
    newer = with_version(package, "999-1", tmp_path)
    with DebianRoot(tmp_path / "clean", tmp_path / "root") as root:
        take_the_path(root, package, newer, detours=True)
