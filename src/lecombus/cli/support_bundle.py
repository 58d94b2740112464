"""`lecombus support-bundle`: what a maintainer needs, as one file without secrets.

Each part is collected by itself and may fail: then it says why, and the others are there all the
same. So a bundle is also made when the daemon is down or the roster is wrong. Everything goes
through one masker (`config.masking`); what is not sure to be free of secrets is left out.
"""

from __future__ import annotations

import io
import json
import os
import platform
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import click
import httpx2

from lecombus import __version__
from lecombus.cli.arguments import DaemonOptions, json_option
from lecombus.cli.daemon_access import ask, work
from lecombus.cli.exits import CommandError, Exit
from lecombus.client.line import Line
from lecombus.config import RosterError, load_roster
from lecombus.config.masking import Masker, mask_roster
from lecombus.roster import Roster

__all__ = ["support_bundle_command"]

ROSTERS: Final = Path("/etc/lecombus")
MODE: Final = 0o600
"""Of the bundle: it names machines and users."""

JOURNAL_ROWS: Final = 500
WITHIN_S: Final = 60.0
"""How long a part may take."""

LIBRARIES: Final = (
    "aiomqtt", "aiosmtplib", "anyio", "apsw", "click", "httptools", "httpx2", "msgspec",
    "paho-mqtt", "prometheus-client", "pydantic", "pymodbus", "pyserial", "pyserial-asyncio",
    "PyYAML", "rich", "starlette", "uvicorn",
)  # fmt: skip

KERNEL_FILES: Final = ("/proc/loadavg", "/proc/meminfo", "/proc/uptime", "/etc/os-release",
                       "/proc/tty/drivers", "/proc/tty/driver/serial")  # fmt: skip
USB_FACTS: Final = ("idVendor", "idProduct", "manufacturer", "product", "serial", "bcdDevice",
                    "speed")  # fmt: skip

DAEMON_PARTS: Final = {
    "daemon/line.json": "/v1/line", "daemon/drives.json": "/v1/drives",
    "daemon/groups.json": "/v1/groups", "daemon/leases.json": "/v1/leases",
    "daemon/plan.json": "/v1/plan",
    "daemon/journal.json": f"/v1/journal?last=true&limit={JOURNAL_ROWS}",
    "daemon/journal-verify.json": "/v1/journal/verify",
}  # fmt: skip

README: Final = """\
Support bundle of lecombus {version}, made {made}.

Secrets are masked with ***: tokens, passwords, private keys, passwords of drives, the words of
commands and all comments of the roster. Look through the files before you send them: names of
drives, machines and users, addresses and serial numbers are in them.

roster.yaml       the roster as it is, without comments
check.txt, plan.txt   what `lecombus check` and `lecombus plan` say of it
daemon/           what the running daemon says; daemon/away.txt: why there is nothing
state.json        identities of the drives and write counts
system/           versions, kernel, serial adapters, files, the service

The log is not in here. It often says more than all of this:
    journalctl -u lecombus@{line} --since -1day > lecombus-log.txt
It names clients and users, and no tokens or passwords.
"""


@dataclass(slots=True)
class Parts:
    """The files of a bundle.

    Args:
        masker: Masks what goes into them.
        files: Their texts, by name.
    """

    masker: Masker
    files: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, text: str) -> None:
        """Add a text, masked."""
        self.files[name] = self.masker.text(text)

    def add_json(self, name: str, document: Any) -> None:
        """Add a JSON document, masked."""
        masked = self.masker.document(document)
        self.add(name, json.dumps(masked, indent=1, ensure_ascii=False, default=str) + "\n")

    def collect(self, name: str, make: Callable[[], str]) -> None:
        """Add a text that may not be available; then the file says why."""
        try:
            self.add(name, make())
        except (OSError, subprocess.SubprocessError, ValueError) as exc:
            self.add(name, f"not available: {exc}\n")


@click.command("support-bundle")
@click.option(
    "-c", "--config", "given", metavar="ROSTER", type=click.Path(dir_okay=False, path_type=Path),
    help=f"The roster; default: the only one in {ROSTERS}.",
)  # fmt: skip
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Where to write it; default: a new file in this folder.")  # fmt: skip
@click.option("--socket", metavar="PATH", help="The daemon's socket; default: the roster's.")
@json_option
def support_bundle_command(
    given: Path | None, output: Path | None, socket: str | None, as_json: bool
) -> int:
    """Collect what a maintainer needs into one .tar.gz, without secrets.

    Versions, the roster, what check and plan say, what the daemon knows (values, metrics, the last
    rows of the journal), the kernel and the serial adapters. Works with the daemon down and with a
    wrong roster too. Nothing is sent to the line, and nothing to anyone: look through the file,
    then send it.
    """
    path = given or only_roster()
    if output is not None and output.exists():
        raise is_there(output)
    made = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    roster, parts = read_roster(path)
    name = path.stem if roster is None else roster.line.name
    parts.add("README.txt", README.format(version=__version__, made=made, line=path.stem))
    for command in ("check", "plan"):
        parts.collect(f"{command}.txt", partial(said, command, "-c", str(path)))
    add_daemon(parts, socket or (None if roster is None else roster.api.socket))
    add_system(parts, roster, path.stem)
    target = output or Path(f"lecombus-support-{name}-{made}.tar.gz")
    write_bundle(target, f"lecombus-support-{name}", parts.files)
    if as_json:
        click.echo(json.dumps({"file": str(target), "parts": sorted(parts.files)}))
    else:
        click.echo(f"{target}: {len(parts.files)} files; look through them before you send it")
    return Exit.DONE


def only_roster() -> Path:
    """Return the roster of this machine, where there is just one.

    Raises:
        CommandError: There is none, or it is not clear which.
    """
    found = sorted(ROSTERS.glob("*.yaml")) if ROSTERS.is_dir() else []
    if len(found) == 1:
        return found[0]
    names = ", ".join(path.name for path in found)
    problem = f"{ROSTERS} has {names}" if found else f"{ROSTERS} has no roster"
    raise CommandError(Exit.USAGE, problem, "name one with -c ROSTER")


def read_roster(path: Path) -> tuple[Roster | None, Parts]:
    """Read the roster, and begin the bundle with it; it may be wrong.

    Raises:
        OSError: The file cannot be read.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    masked = mask_roster(text)
    if masked is None:
        parts = Parts(Masker())
        parts.add("roster.yaml", "# left out: it is no YAML, so its secrets cannot be found\n")
    else:
        parts = Parts(Masker({*masked.secrets, *contents(masked.files)}))
        parts.add("roster.yaml", masked.text)
    try:
        return load_roster(path), parts
    except RosterError:
        return None, parts


def contents(files: Iterable[str]) -> Iterator[str]:
    """Give the passwords in files, as far as this user may read them."""
    for name in files:
        try:
            yield Path(name).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError):
            continue


def said(*words: str) -> str:
    """Run a command, and return what it says; another program first: `systemctl`."""
    own = [sys.executable, "-P", "-m", "lecombus"] if words[0] in ("check", "plan") else []
    done = subprocess.run(
        [*own, *words], capture_output=True, text=True, timeout=WITHIN_S, check=False,
        env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    return f"{done.stdout}{done.stderr}(exit status {done.returncode})\n"


def add_daemon(parts: Parts, socket: str | None) -> None:
    """Add what the daemon says, or why it says nothing."""
    daemon = DaemonOptions(socket=socket, url=None, as_json=True)
    for name, path in DAEMON_PARTS.items():
        try:
            parts.add_json(name, json.loads(ask(daemon, path).text))
        except CommandError as exc:
            if exc.status == Exit.UNREACHABLE or exc.status == Exit.FORBIDDEN:
                parts.add("daemon/away.txt", f"{exc}\n")
                return
            parts.add(name, f"not available: {exc}\n")
    try:
        parts.add("daemon/metrics.txt", work(daemon, metrics_page))
    except (CommandError, httpx2.HTTPError) as exc:
        parts.add("daemon/metrics.txt", f"not available: {exc}\n")


async def metrics_page(line: Line) -> str:
    """Return the metrics page, which is no JSON."""
    return (await line.connection.http.get("/metrics")).text


def add_system(parts: Parts, roster: Roster | None, unit: str) -> None:
    """Add versions, the kernel, adapters, files and the service."""
    parts.add_json("system/versions.json", versions())
    for name in KERNEL_FILES:
        parts.collect(f"system{name}.txt", Path(name).read_text)
    parts.collect("system/serial.txt", lambda: serial_adapters(roster))
    names = ["lecombus", "lecombus-mqtt", "lecombus-modbus", "lecombus-notify"]
    units = [f"{one}@{unit}.service" for one in names]
    parts.collect(
        "system/service.txt", lambda: said("systemctl", "show", "--no-pager", "-p", SHOWN, *units)
    )
    if roster is None:
        return
    parts.collect("system/files.txt", lambda: files_of(roster))
    if roster.state is not None:
        state = Path(roster.state)
        try:
            parts.add_json("state.json", json.loads(state.read_text(encoding="utf-8")))
        except (OSError, ValueError) as exc:
            parts.add("state.json", f"not available: {exc}\n")


SHOWN: Final = ("Id,LoadState,ActiveState,SubState,Result,NRestarts,ExecMainStatus,MemoryCurrent,"
                "CPUUsageNSec,ActiveEnterTimestamp,FragmentPath,DropInPaths")  # fmt: skip


def versions() -> dict[str, Any]:
    """Return the versions of everything that lecombus runs on."""
    found: dict[str, Any] = {
        "lecombus": __version__, "python": sys.version, "executable": sys.executable,
        "kernel": " ".join(platform.uname()), "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }  # fmt: skip
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def serial_adapters(roster: Roster | None) -> str:
    """Return the names of serial ports, and what their USB adapters say of themselves."""
    rows: list[str] = []
    if roster is not None:
        port = roster.line.port
        rows.append(f"port of the roster: {port}")
        if port.startswith("/"):
            rows.append(f"  leads to {os.path.realpath(port)}, there: {Path(port).exists()}")
    for folder in (Path("/dev/serial/by-id"), Path("/dev/lecombus")):
        if folder.is_dir():
            rows += [f"{one} -> {os.path.realpath(one)}" for one in sorted(folder.iterdir())]
    for tty in sorted(Path("/sys/class/tty").glob("tty[UA][SC]*")):
        rows.append(f"{tty.name}: driver {Path(os.path.realpath(tty / 'device/driver')).name}")
        rows += [f"  {row}" for row in usb_facts(tty)]
    return "\n".join(rows) + "\n"


def usb_facts(tty: Path) -> Iterator[str]:
    """Give what the USB device of a serial port says of itself."""
    latency = tty / "device" / "latency_timer"
    if latency.exists():
        yield f"latency_timer {latency.read_text().strip()}"
    device = Path(os.path.realpath(tty / "device"))
    for folder in (device, *list(device.parents)[:3]):
        if (folder / "idVendor").exists():
            for name in USB_FACTS:
                if (folder / name).exists():
                    yield f"{name} {(folder / name).read_text(errors='replace').strip()}"
            return


def files_of(roster: Roster) -> str:
    """Return owner, mode, size and age of the files that a roster names; never their content."""
    tls, mqtt = roster.api.tls, roster.mqtt
    names = [
        roster.file, roster.api.socket, roster.api.tokens, roster.state,
        None if roster.journal is None else roster.journal.file,
        *((tls.certificate, tls.key, tls.client_ca) if tls is not None else ()),
        *((mqtt.ca, mqtt.certificate, mqtt.key, mqtt.password_file) if mqtt is not None else ()),
    ]  # fmt: skip
    rows = []
    for name in filter(None, names):
        try:
            found = Path(name).stat()
        except OSError as exc:
            rows.append(f"{name}: {exc.strerror}")
            continue
        changed = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(found.st_mtime))
        rows.append(
            f"{name}: mode {found.st_mode:o}, owner {found.st_uid}:{found.st_gid}, "
            f"{found.st_size} bytes, changed {changed}"
        )
        folder = os.statvfs(Path(name).parent)
        rows.append(f"  free in its file system: {folder.f_bavail * folder.f_frsize} bytes")
    return "\n".join(rows) + "\n"


def write_bundle(target: Path, folder: str, files: dict[str, str]) -> None:
    """Write the bundle, readable by its owner alone; nothing is written over.

    Raises:
        CommandError: There is such a file.
        OSError: It could not be written; nothing is left of it.
    """
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, MODE)
    except FileExistsError:
        raise is_there(target) from None
    now_s = int(time.time())
    try:
        with os.fdopen(descriptor, "wb") as file, tarfile.open(fileobj=file, mode="w:gz") as bundle:
            for name, text in sorted(files.items()):
                data = text.encode(errors="replace")
                member = tarfile.TarInfo(f"{folder}/{name.lstrip('/')}")
                member.size, member.mtime, member.mode = len(data), now_s, 0o644
                bundle.addfile(member, io.BytesIO(data))
    except BaseException as exc:  # an interrupt too: half a bundle would stand in the way
        target.unlink(missing_ok=True)
        if isinstance(exc, OSError) and not exc.filename:
            exc.filename = str(target)  # a full disk does not name it
        raise


def is_there(target: Path) -> CommandError:
    """Return the error for a file that is not written over."""
    return CommandError(Exit.USAGE, f"{target} is there already", "name another file with -o")
