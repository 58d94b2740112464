"""The container image of the package, and podman's reading of the quadlet file."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.debian_root import DebianRoot, make_root
from support.package_build import ROOT
from support.real_parts import require

pytestmark = [pytest.mark.real, pytest.mark.long, pytest.mark.timeout(1800)]

QUADLET = "lecombus-container@.container"
ROSTER = """
line: {name: boxed, port: "sim:"}
drives: [{name: feeder, address: 11, family: 8200vector}]
"""


def run(*words: str | Path, within_s: float = 900.0) -> str:
    done = subprocess.run(
        [str(word) for word in words],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=within_s,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture
def container(package: Path) -> Iterator[str]:
    """A container of the image, which is deleted with it."""
    require("buildah")
    require("mmdebstrap")
    image = run("scripts/image", package).splitlines()[-1]
    name = run("buildah", "from", f"oci-archive:{image}").splitlines()[-1]
    try:
        yield name
    finally:
        of = run("buildah", "inspect", "--format", "{{.FromImageID}}", name).strip()
        run("buildah", "rm", name)
        run("buildah", "rmi", of)


def inside(container: str, *words: str, more: tuple[str, ...] = ()) -> list[str]:
    """Words that run a program in the container, without another runtime than buildah's own."""
    return ["buildah", "run", "--isolation=chroot", *more, container, "--", *words]


def test_the_image_runs_a_line_as_its_own_user(container: str, tmp_path: Path) -> None:
    assert run(*inside(container, "id", "-un")).strip() == "lecombus"
    assert run(*inside(container, "/usr/bin/lecombus", "--version")).startswith("lecombus ")
    roster = tmp_path / "line.yaml"
    roster.write_text(ROSTER)
    roster.chmod(0o644)
    tmp_path.chmod(0o755)
    mounted = (f"--volume={roster}:/etc/lecombus/line.yaml:ro",)
    script = (
        "lecombus run -c /etc/lecombus/line.yaml & line=$!;"
        " until lecombus status 2>/dev/null | grep -q 'feeder.*online'; do sleep 0.3; done;"
        " lecombus stop; kill $line; wait $line"
    )
    said = run(*inside(container, "sh", "-c", script, more=mounted), within_s=120.0)
    assert "verified" in said
    assert "event=stopped" in said


def test_podman_makes_a_service_of_the_quadlet_file(tmp_path: Path) -> None:
    make_root("trixie", tmp_path / "clean", "podman")
    with DebianRoot(tmp_path / "clean", tmp_path / "root") as root:
        text = (ROOT / "deploy" / "containers" / QUADLET).read_text()
        folder = root.path("/etc/containers/systemd")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / QUADLET).write_text(text)
        made = root.run("/usr/libexec/podman/quadlet", "-dryrun")
        (start,) = [line for line in made.splitlines() if line.startswith("ExecStart=")]
        for words in ("--read-only", "--cap-drop all", "--sdnotify=container", "%i.yaml"):
            assert words in start
        (folder / QUADLET).write_text(text.replace("ReadOnly=", "ReadsOnly="))
        assert "ReadsOnly" in root.run("/usr/libexec/podman/quadlet", "-dryrun", status=None)
