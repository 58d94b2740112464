"""The two sides of a comparison: the tree of a commit or of the checkout, and how it is run.

Both are exported into `.compare/trees/`, so a file that is edited while the comparison runs changes
nothing. A side whose locks are those of the checkout uses the checkout's environment; another one
gets its own by its own `scripts/venv`.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

__all__ = ["HOME", "ROOT", "Side", "side_of"]

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".compare"
ORACLE = "tests/compare"
INSIDE = f"{ORACLE}/inside"
"""What runs inside a side, on its own source: the only part of the oracle that imports lecombus."""
LOCKS = ("requirements/build.txt", "requirements/runtime.txt", "requirements/dev.txt")
RUN = ("src", "tests/proof", "tests/support", INSIDE, *LOCKS)
"""What decides what a side does."""
FROM_HERE = ("config", ORACLE)
"""What decides what is asked of both sides: always that of the checkout."""
MEANT = f"{ORACLE}/meant.yaml"
"""What is meant to differ decides nothing of what is recorded."""


@dataclass(frozen=True)
class Side:
    """One side.

    Args:
        name: The commit, or `checkout`.
        tree: Where its files are.
        python: The interpreter whose packages fit its locks.
        key: Digest of all that decides what it does, and of what is asked of it.
    """

    name: str
    tree: Path
    python: Path
    key: str

    def command(self, *words: str) -> list[str]:
        """Return the words that run its lecombus."""
        return [str(self.python), "-m", "lecombus", *words]

    def environment(self) -> dict[str, str]:
        """Return the environment in which its source and its tests are found, and no others."""
        kept = {key: text for key, text in os.environ.items() if not key.startswith("LECOMBUS_")}
        kept.pop("NOTIFY_SOCKET", None)
        return {
            **kept, "PYTHONPATH": f"{self.tree / 'src'}:{self.tree / 'tests'}",
            "PYTHONHASHSEED": "0", "COLUMNS": "200", "TERM": "dumb", "LC_ALL": "C.UTF-8",
            "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip


def git(*words: str, env: dict[str, str] | None = None) -> str:
    """Run git in the repository."""
    done = subprocess.run(
        ("git", *words), cwd=ROOT, capture_output=True, text=True, check=True, env=env
    )
    return done.stdout.strip()


def side_of(commit: str | None) -> Side:
    """Export a side and find its interpreter.

    Args:
        commit: Anything git knows as a commit; None: the checkout with all changes.
    """
    checkout = _tree_of_checkout()
    if commit is None:
        name, tree = "checkout", checkout
    else:
        name = git("rev-parse", "--short", "--verify", f"{commit}^{{commit}}")
        tree = git("rev-parse", f"{commit}^{{tree}}")
    place = HOME / "trees" / tree[:12]
    _export(tree, place)
    if not (place / INSIDE).exists():
        _export(_first_oracle() or checkout, place, INSIDE)
    return Side(name, place, _python(place), _key(place, checkout))


def _tree_of_checkout() -> str:
    """Return the tree of all files as they are, those included that git does not know yet."""
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "GIT_INDEX_FILE": f"{folder}/index"}
        git("read-tree", "HEAD", env=env)
        git("add", "--all", env=env)
        return git("write-tree", env=env)


def _first_oracle() -> str | None:
    """Return the commit that brought the oracle: what came before it runs that one's `inside`."""
    found = git("log", "--diff-filter=A", "--format=%H", "--", INSIDE).splitlines()
    return found[-1] if found else None


def _export(tree: str, place: Path, path: str = ".") -> None:
    """Write files of a tree to a place, once."""
    done = place / f".exported-{path.replace('/', '-')}"
    if done.exists():
        return
    place.mkdir(parents=True, exist_ok=True)
    packed = subprocess.run(
        ("git", "archive", tree, path), cwd=ROOT, capture_output=True, check=True
    )
    subprocess.run(("tar", "-x", "-C", place), input=packed.stdout, check=True)
    done.touch()


def _python(place: Path) -> Path:
    """Return an interpreter with the packages of a tree's locks, made where there is none yet."""
    same = all((place / one).read_bytes() == (ROOT / one).read_bytes() for one in LOCKS)
    if same and (ROOT / ".venv/bin/python").exists():
        return ROOT / ".venv/bin/python"
    subprocess.run(("scripts/venv", "dev"), cwd=place, check=True)
    return place / ".venv/bin/python"


def _key(place: Path, checkout: str) -> str:
    digest = hashlib.sha256()
    for name in RUN:
        found = place / name
        for file in sorted(found.rglob("*")) if found.is_dir() else [found]:
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(place)}\0".encode() + file.read_bytes())
    asked = git("ls-tree", "-r", checkout, *FROM_HERE).splitlines()
    digest.update("\n".join(row for row in asked if not row.endswith(MEANT)).encode())
    return digest.hexdigest()[:16]
