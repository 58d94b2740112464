"""The package of this source tree, built once, while a clean system for it is made."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from support.debian_root import make_root
from support.package_build import architecture, build


@pytest.fixture(scope="session")
def clean_root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Future[Path]]:
    """The directory of a clean Debian 12, which is made while the package is built."""
    place = tmp_path_factory.mktemp("bookworm") / "root"

    def make() -> Path:
        make_root("bookworm", place)
        return place

    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(make)


@pytest.fixture(scope="session")
def package(clean_root: Future[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of this tree for this machine."""
    (made,) = build(tmp_path_factory.mktemp("package"), architecture())
    return made
