"""`lecombus bridge`: a library that is not installed is named with the extra that has it."""

from __future__ import annotations

import pytest

from lecombus.cli import bridge_commands
from lecombus.cli.bridge_commands import extra
from lecombus.cli.exits import CommandError


@pytest.mark.parametrize("missing", ["pymodbus", "pymodbus.framer"])
def test_a_library_that_is_missing_is_named_with_its_extra(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    def import_module(name: str) -> object:
        raise ModuleNotFoundError(f"No module named {missing!r}", name=missing)

    monkeypatch.setattr(bridge_commands, "import_module", import_module)
    with pytest.raises(CommandError, match=r"pymodbus.* is not installed.*lecombus\[modbus\]"):
        extra("lecombus.bridges.modbus.bridge", "modbus", "pymodbus")
    with pytest.raises(ModuleNotFoundError):
        extra("lecombus.bridges.modbus.bridge", "mqtt", "aiomqtt")
