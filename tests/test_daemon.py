"""What the daemon says of itself."""

from __future__ import annotations

import pytest

from lecombus.daemon import place


@pytest.mark.parametrize(
    ("http", "written"),
    [
        (("127.0.0.1", 9740), "127.0.0.1:9740"),
        (("localhost", 80), "localhost:80"),
        (("::1", 9740), "[::1]:9740"),
        (("[::1]", 9740), "[::1]:9740"),
        (None, "none"),
    ],
)
def test_where_http_is_served_is_written_as_one_would_type_it(
    http: tuple[str, int] | None, written: str
) -> None:
    assert place(http) == written
