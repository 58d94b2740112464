"""How a line protocol is found by its name."""

from __future__ import annotations

import pytest

from lecombus.drives import FAMILY_NAMES, family, family_names
from lecombus.errors import ConfigError
from lecombus.fieldbus.protocols import find, names
from lecombus.parameters import rules_of


def test_lecom_is_found_once_and_has_the_packaged_families() -> None:
    assert "lecom" in names()
    assert find("lecom") is find("lecom")
    assert find("lecom").rules is rules_of("lecom")
    assert family_names("lecom") == FAMILY_NAMES
    assert {family(name).protocol for name in FAMILY_NAMES} == {"lecom"}


@pytest.mark.parametrize("name", ["profibus", "", "lecom.protocol", "protocols"])
def test_a_protocol_that_there_is_not_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"there is no line protocol {name}"):
        find(name)
    with pytest.raises(ConfigError, match=f"there is no line protocol {name}"):
        rules_of(name)
    assert family_names(name) == ()


@pytest.mark.parametrize(
    ("address", "what"),
    [(1, None), (99, None), (0, "all drives"), (40, "the group 41..49"), (100, "out of range")],
)
def test_what_is_wrong_with_an_address_is_said_by_the_protocol(
    address: int, what: str | None
) -> None:
    fieldbus = find("lecom")
    wrong = fieldbus.wrong_address(address)
    assert fieldbus.is_address(address) is (wrong is None)
    assert (wrong is None) if what is None else (wrong is not None and what in wrong[0])
