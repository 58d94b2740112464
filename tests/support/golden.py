"""What the program says, word for word, kept in one file for each folder of tests.

A test gives what it heard to the fixture `golden`; it fails, with the difference, if that is not
what stands in `golden.txt` beside its file. `make golden` writes the files from what is said now.
Other assertions look at kinds, places and values, so that a reworded message fails in one place.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from zlib import crc32

import pytest

__all__ = ["NAME", "Golden", "GoldenFiles", "read_golden"]

NAME = "golden.txt"
HEAD = "What the program says in the tests of this folder; `make golden` writes it again."
MARK = "== "
LONGEST = 120
"""So long a test's name may be; what is longer is cut off."""


def read_golden(path: Path) -> dict[str, str]:
    """Read a golden file: by test, what it hears."""
    found: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in path.read_text().splitlines() if path.exists() else ():
        if line.startswith(MARK):
            lines = found.setdefault(line.removeprefix(MARK), [])
        else:
            lines.append(line)
    return {key: "\n".join(said).strip("\n") for key, said in found.items()}


class GoldenFiles:
    """The golden files of a run.

    Args:
        writes: They are written again at the end of the run, in place of being compared with.
    """

    def __init__(self, *, writes: bool) -> None:
        self.writes = writes
        self._texts: dict[Path, dict[str, str]] = {}
        self._heard: dict[Path, dict[str, str]] = {}

    def at(self, path: Path) -> dict[str, str]:
        """What stands in a file."""
        if path not in self._texts:
            self._texts[path] = read_golden(path)
        return self._texts[path]

    def heard(self, path: Path, key: str, text: str) -> None:
        """Note what was heard, to be written."""
        self._heard.setdefault(path, {})[key] = text

    def write(self, modules: set[str]) -> None:
        """Write the files: of the modules that were run whole, only what was heard now stays."""
        for path, heard in self._heard.items():
            kept = {
                key: text for key, text in self.at(path).items()
                if key.partition("::")[0] not in modules
            }  # fmt: skip
            rows = [f"\n{MARK}{key}\n{text}\n" for key, text in sorted((kept | heard).items())]
            path.write_text("".join([f"{HEAD}\n", *rows]))


class Golden:
    """Compares what one test hears: `golden(text)`, as often as it likes.

    Args:
        files: The files.
        path: The file of this test's folder.
        key: The test.
        places: Folders that are new in each run, by the name they are shown by.
    """

    def __init__(
        self, files: GoldenFiles, path: Path, key: str, places: Mapping[str, Path]
    ) -> None:
        self._files = files
        self._path = path
        self._key = key if len(key) < LONGEST else f"{key[:LONGEST]}.. {crc32(key.encode()):08x}"
        self._places = places
        self._count = 0

    def __call__(self, *said: object) -> None:
        """Compare what was said, one thing to a line, with what stands in the file."""
        self._count += 1
        key = self._key if self._count == 1 else f"{self._key} #{self._count}"
        text = "\n".join(line.rstrip() for one in said for line in str(one).splitlines())
        text = text.strip("\n")
        for name, place in self._places.items():
            text = text.replace(str(place), name)
        assert text, "nothing was said"
        assert f"\n{MARK}" not in f"\n{text}", "this would be read as a headline"
        if self._files.writes:
            self._files.heard(self._path, key, text)
            return
        expected = self._files.at(self._path).get(key, "")
        if text != expected:
            rows = difflib.unified_diff(
                expected.split("\n"), text.split("\n"), str(self._path), "said now", lineterm=""
            )
            pytest.fail("\n".join([f"{key}: (if it is right: make golden)", *rows]), pytrace=False)
