"""The package for arm64: its compiled modules work, and a line runs, on both releases of Debian.

The machine is emulated (`packages.arm64_root`), so nothing here says how fast it is.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from packages.arm64_root import HOME, Arm64Root
from support.package_build import build

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(1800)]

RELEASES = {"bookworm": "3.11", "trixie": "3.13"}
AARCH64 = 183
"""The machine in the header of a compiled module (ELF)."""

ONLINE_WITHIN_S = 300.0
ENDS_WITHIN_S = 60.0
LOOK_AGAIN_S = 0.5

IMPORTS = """
from importlib import import_module
for name in sys.argv[1:]:
    assert import_module(name).__file__.endswith(".so"), name
"""
USES = """
import apsw, httptools, msgspec, pydantic, yaml
asked = '''select json_extract('{"a": [1, 2]}', '$.a[1]'), 0.1 + 0.2'''
rows = apsw.Connection(":memory:").execute(asked)
assert list(rows) == [(2, 0.1 + 0.2)]
class Struct(msgspec.Struct):
    whole: int
    part: float
one = Struct(2**60, 0.1)
assert msgspec.json.decode(msgspec.json.encode(one), type=Struct) == one
class Model(pydantic.BaseModel):
    whole: int
    part: float
text = '{"whole":1152921504606846976,"part":0.1}'
assert Model.model_validate_json(text).model_dump_json() == text
class Heard:
    def on_url(self, url): self.url = url
heard = Heard()
httptools.HttpRequestParser(heard).feed_data(b"GET /a?b=c HTTP/1.1\\r\\nHost: d\\r\\n\\r\\n")
assert httptools.parse_url(heard.url).query == b"b=c"
read = yaml.load("a: [1, 2.5, b]", yaml.CSafeLoader)
assert yaml.load(yaml.dump(read, Dumper=yaml.CSafeDumper), yaml.CSafeLoader) == {"a": [1, 2.5, "b"]}
import platform
print(platform.machine())
"""
SCRAPE = """
from urllib.request import urlopen
print(urlopen(sys.argv[1]).read().decode())
"""
ROSTER = """
line: {{name: bench, port: "sim:"}}
drives:
  - name: feeder
    address: 11
    family: 8200vector
    watchdog: {{time: 10s, action: quick-stop, configure: true}}
journal: {place}/bench.sqlite
state: {place}/bench.json
api: {{socket: {place}/bench.sock, http: "127.0.0.1:{port}"}}
"""


@pytest.fixture(scope="session")
def arm64_package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    (made,) = build(tmp_path_factory.mktemp("arm64"), "arm64")
    return made


@pytest.fixture(scope="session", params=RELEASES)
def arm64(
    request: pytest.FixtureRequest, arm64_package: Path, tmp_path_factory: pytest.TempPathFactory
) -> Arm64Root:
    """The package in an unpacked Debian."""
    place = tmp_path_factory.mktemp("arm64") / "root"
    return Arm64Root(request.param, RELEASES[request.param], arm64_package, place)


def modules(root: Arm64Root, tag: str) -> list[str]:
    """Return the compiled modules for a Python, by the names that they are imported by."""
    home = root.place / HOME
    found = sorted(home.rglob(f"*.cpython-{tag}-*.so"))
    names = [str(path.relative_to(home)).partition(".")[0].replace("/", ".") for path in found]
    return [name.removesuffix(".__init__") for name in names]


def test_every_compiled_module_is_for_arm64_and_works(arm64: Arm64Root) -> None:
    for path in (arm64.place / HOME).rglob("*.so"):
        with path.open("rb") as file:
            assert struct.unpack("<16x2xH", file.read(20)) == (AARCH64,), path
    python = arm64.python("print(*sys.version_info[:2], sep='')").strip()
    names = modules(arm64, python)
    assert len(names) >= 7
    arm64.python(IMPORTS, *names)
    assert arm64.python(USES).strip() == "aarch64"


@contextlib.contextmanager
def a_line(root: Arm64Root, place: Path) -> Iterator[int]:
    """A daemon of a simulated line until the end of the block; gives its port for HTTP."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    roster, log = place / "bench.yaml", place / "log"
    roster.write_text(ROSTER.format(place=place, port=port))
    assert "bench" in root.lecombus("check", "-c", roster)
    daemon = root.start(log, "run", "-c", roster)
    try:
        until_s = time.monotonic() + ONLINE_WITHIN_S
        while "to=online" not in (said := log.read_text()):
            assert daemon.poll() is None, said
            assert time.monotonic() < until_s, said
            time.sleep(LOOK_AGAIN_S)
        yield port
        daemon.terminate()
        assert daemon.wait(ENDS_WITHIN_S) == 0, log.read_text()
    finally:
        daemon.kill()
        daemon.wait(ENDS_WITHIN_S)
    said = log.read_text()
    assert "event=stopped" in said
    assert "level=error" not in said
    assert "Traceback" not in said


def test_a_line_runs(arm64: Arm64Root, tmp_path: Path) -> None:
    asked = ("--socket", tmp_path / "bench.sock")
    assert arm64.lecombus("--version").startswith("lecombus ")
    with a_line(arm64, tmp_path) as port:
        assert "\tonline\t" in arm64.lecombus("status", *asked)
        wrote = arm64.lecombus("write", "feeder", "C0046", "20", "--verify", *asked)
        assert "feeder\tC0046\tverified\t20 Hz" in wrote
        assert "verified" in arm64.lecombus("stop", *asked)
        kept = tmp_path / "feeder.yaml"
        assert "codes read" in arm64.lecombus("backup", "feeder", "-o", kept, *asked)
        assert kept.exists()
        assert "verified\tcode=C0046 value=20" in arm64.lecombus("journal", *asked)
        assert "whole: " in arm64.lecombus("journal", "verify", *asked)
        page = arm64.python(SCRAPE, f"http://127.0.0.1:{port}/metrics")
        assert 'lecombus_drive_up{line="bench",drive="feeder"} 1' in page


@pytest.mark.parametrize("bridge", ["modbus", "mqtt", "notify"])
def test_the_bridges_start(arm64: Arm64Root, bridge: str) -> None:
    assert f"lecombus bridge {bridge}" in arm64.lecombus("bridge", bridge, "--help")
