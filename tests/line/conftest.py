"""What holds for every test of a line."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def nothing_reaches_the_loop_handler(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """The loop logs exceptions that nobody took: there must be none."""
    yield
    assert not [record for record in caplog.records if record.name == "asyncio"]
